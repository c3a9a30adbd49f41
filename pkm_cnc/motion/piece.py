"""What the TCP is sent along: lines and arcs of the programmed contour, trimmed, and the curves that join them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.program import Element, Frame, PathMode, frames
from pkm_cnc.records import Vector

__all__ = ["Curve", "Mark", "Piece", "Shape", "frames_of", "places_on"]

INTERVALS = 128
"""Knots of a curve's parameter by its length. The path speed is then right to 1e-6 of itself round a right angle and to
1e-3 where the path all but turns back; the jerk shows what is missing."""
GAUSS = (-math.sqrt(0.6), 5.0 / 18.0), (0.0, 8.0 / 18.0), (math.sqrt(0.6), 5.0 / 18.0)
"""Places in [-1, 1] and weights (sum 1) of the quadrature in each interval."""


class Shape(Protocol):
    """A line, an arc or a curve, by its path length s, m."""

    @property
    def length(self) -> float:
        """Path length, m."""

    def position(self, s: float) -> Vector:
        """Point at `s`, m, in `base_link`."""

    def tangent(self, s: float) -> Vector:
        """Unit tangent at `s`."""

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by s at `s`, 1/m."""

    def frame(self, s: float) -> Frame:
        """Position, tangent and curvature at `s`."""


class Mark(NamedTuple):
    """From `s` (m, on the shape) on, s' stands for `path_length` + `rate` (s' - s) of the toolpath, in `segment`.

    `line` is the segment's line in the part program.
    """

    s: float
    segment: int
    path_length: float
    rate: float
    line: int


@dataclass(frozen=True, slots=True)
class Piece:
    """`length` m of `shape` from `begin` m on, at most at `feed` m/s.

    `line` is that of the part program; `stop`: the TCP rests at its end. `mode` tells how it goes on to the next piece,
    `traverse` a rapid.
    """

    shape: Shape
    begin: float
    length: float
    feed: float
    line: int
    marks: tuple[Mark, ...]
    mode: PathMode
    traverse: bool
    stop: bool = False

    def place(self, s: float) -> tuple[int, float]:
        """Segment of the toolpath and path length along it, m, at `s` (m, on the shape)."""
        marks = self.marks
        index = bisect_right(marks, s, key=lambda mark: mark.s) - 1 if len(marks) > 1 else 0
        mark = marks[max(index, 0)]
        return mark.segment, mark.path_length + mark.rate * (s - mark.s)


@dataclass(frozen=True, slots=True)
class Curve:
    """A quintic that leaves one element and meets the next with their tangents and curvatures.

    With the parameter p in [0, 1], B(p) has at both ends the position, the tangent times `speed` (m) and the curvature
    times speed^2. `start` and `end` are (position, tangent, curvature). The path length is the integral of |dB/dp|.
    """

    start: tuple[Vector, Vector, Vector]
    end: tuple[Vector, Vector, Vector]
    speed: float
    length: float = field(init=False, repr=False, compare=False)
    _coefficients: tuple[tuple[float, ...], ...] = field(init=False, repr=False, compare=False)
    _s: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _slope: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        g = self.speed
        rows = []
        for p0, t0, c0, p1, t1, c1 in zip(*self.start, *self.end, strict=True):
            v0, v1, a0, a1, d = g * t0, g * t1, g * g * c0, g * g * c1, p1 - p0
            rows.append(
                (
                    p0,
                    v0,
                    0.5 * a0,
                    10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
                    -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
                    6.0 * d - 3.0 * (v0 + v1) - 0.5 * (a0 - a1),
                )
            )
        object.__setattr__(self, "_coefficients", tuple(rows))
        middles = (np.arange(INTERVALS) + 0.5) / INTERVALS
        lengths = np.zeros(INTERVALS)
        for place, weight in GAUSS:
            lengths += weight / INTERVALS * self._rate(middles + 0.5 * place / INTERVALS)
        ends = [0.0, *np.cumsum(lengths).tolist()]
        object.__setattr__(self, "_s", tuple(ends))
        object.__setattr__(self, "_slope", tuple((1.0 / self._rate(np.arange(INTERVALS + 1) / INTERVALS)).tolist()))
        object.__setattr__(self, "length", ends[-1])

    def _rate(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """|dB/dp|, m."""
        square = 0.0 * p
        for _, b, c, d, e, f in self._coefficients:
            component = b + p * (2.0 * c + p * (3.0 * d + p * (4.0 * e + p * 5.0 * f)))
            square = square + component * component
        return np.asarray(np.sqrt(square))

    def _parameter(self, s: float) -> float:
        """p at `s`: a cubic between the knots, whose slopes dp/ds are known."""
        ends = self._s
        k = min(max(bisect_right(ends, s) - 1, 0), INTERVALS - 1)
        step = ends[k + 1] - ends[k]
        x = (s - ends[k]) / step
        y = 1.0 - x
        m0, m1, dp = step * self._slope[k], step * self._slope[k + 1], 1.0 / INTERVALS
        return k * dp + x * (x * (3.0 - 2.0 * x) * dp + y * (y * m0 - x * m1))

    def position(self, s: float) -> Vector:
        """Point at path length `s` (m), exactly the ends at and beyond them."""
        return self.frame(s)[0]

    def tangent(self, s: float) -> Vector:
        """Unit tangent at path length `s` (m)."""
        return self.frame(s)[1]

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by the path length (1/m) at `s` (m)."""
        return self.frame(s)[2]

    def frame(self, s: float) -> Frame:
        """Position, tangent and curvature at `s` (m): together they cost little more than one of them."""
        if s <= 0.0:
            return self.start
        if s >= self.length:
            return self.end
        p = self._parameter(s)
        (ax, bx, cx, dx, ex, fx), (ay, by, cy, dy, ey, fy), (az, bz, cz, dz, ez, fz) = self._coefficients
        x = ax + p * (bx + p * (cx + p * (dx + p * (ex + p * fx))))
        y = ay + p * (by + p * (cy + p * (dy + p * (ey + p * fy))))
        z = az + p * (bz + p * (cz + p * (dz + p * (ez + p * fz))))
        vx = bx + p * (2.0 * cx + p * (3.0 * dx + p * (4.0 * ex + p * 5.0 * fx)))
        vy = by + p * (2.0 * cy + p * (3.0 * dy + p * (4.0 * ey + p * 5.0 * fy)))
        vz = bz + p * (2.0 * cz + p * (3.0 * dz + p * (4.0 * ez + p * 5.0 * fz)))
        wx = 2.0 * cx + p * (6.0 * dx + p * (12.0 * ex + p * 20.0 * fx))
        wy = 2.0 * cy + p * (6.0 * dy + p * (12.0 * ey + p * 20.0 * fy))
        wz = 2.0 * cz + p * (6.0 * dz + p * (12.0 * ez + p * 20.0 * fz))
        square = vx * vx + vy * vy + vz * vz
        rate, along = math.sqrt(square), (vx * wx + vy * wy + vz * wz) / square
        return (
            (x, y, z),
            (vx / rate, vy / rate, vz / rate),
            ((wx - along * vx) / square, (wy - along * vy) / square, (wz - along * vz) / square),
        )


def frames_of(shapes: Sequence[Shape], which: NDArray[np.intp], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position, tangent and curvature at `s` (k,), m, of `shapes[which]`: (3, 3, k), to the bit as `Shape.frame`."""
    curved = np.array([isinstance(shape, Curve) for shape in shapes])
    if not curved.any():
        return frames(cast("Sequence[Element]", shapes), which, s)
    result = np.empty((3, 3, len(s)))
    for row in np.flatnonzero(curved[which]).tolist():
        result[:, :, row] = shapes[which[row]].frame(float(s[row]))
    rows = np.flatnonzero(~curved[which])
    if len(rows):
        elements = [shape for shape in shapes if not isinstance(shape, Curve)]
        result[:, :, rows] = frames(cast("Sequence[Element]", elements), (np.cumsum(~curved) - 1)[which[rows]], s[rows])
    return result


def places_on(
    pieces: Sequence[Piece], which: NDArray[np.intp], s: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Segments of the toolpath and path lengths along it, m, at `s` (k,), m, on the shapes of `pieces[which]`."""
    marks = [mark for piece in pieces for mark in piece.marks]
    firsts = np.cumsum([0, *(len(piece.marks) for piece in pieces)])
    index = firsts[which]
    for number, piece in enumerate(pieces):
        if len(piece.marks) > 1:
            rows = np.flatnonzero(which == number)
            index[rows] += np.maximum(np.searchsorted([mark.s for mark in piece.marks], s[rows], side="right") - 1, 0)
    begins, segments, path_lengths, rates, _ = (np.array(column)[index] for column in zip(*marks, strict=True))
    return segments, path_lengths + rates * (s - begins)
