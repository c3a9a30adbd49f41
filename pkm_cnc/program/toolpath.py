"""The programmed contour: lines and arcs in `base_link`, each known by its path length s.

All is SI (m, rad, m/s). The methods of the elements run in every servo cycle, hence plain floats and `math`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ZERO_LENGTH

__all__ = ["Arc", "Element", "Line", "Toolpath"]


@dataclass(frozen=True, slots=True)
class Line:
    """A straight motion from `start` to `end` (m, in `base_link`) with path speed `feed` (m/s).

    `line` is its line in the part program; `traverse` tells a rapid; `evaluated` whether its contour error counts.
    `length` (m) follows from the ends. A line without length has the tangent (0, 0, 0) and is no part of a toolpath.
    """

    line: int
    start: Vector
    end: Vector
    feed: float
    traverse: bool
    evaluated: bool
    length: float = field(init=False, repr=False, compare=False)
    _tangent: Vector = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        dx, dy, dz = (b - a for a, b in zip(self.start, self.end, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        tangent = (dx / length, dy / length, dz / length) if length > 0.0 else (0.0, 0.0, 0.0)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "_tangent", tangent)

    def position(self, s: float) -> Vector:
        """Point at path length `s` (m), exactly `start` at and before 0, exactly `end` at and after `length`."""
        if s <= 0.0:
            return self.start
        if s >= self.length:
            return self.end
        x, y, z = self.start
        tx, ty, tz = self._tangent
        return x + s * tx, y + s * ty, z + s * tz

    def tangent(self, s: float) -> Vector:
        """Unit tangent in the direction of travel, the same at every `s`."""
        return self._tangent

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by the path length (1/m): zero."""
        return 0.0, 0.0, 0.0

    def nearest(self, point: Vector, near: float) -> float:
        """Path length (m) in [0, length] of the point of the line nearest to `point` (m); `near` is not needed."""
        px, py, pz = point
        x, y, z = self.start
        tx, ty, tz = self._tangent
        s = (px - x) * tx + (py - y) * ty + (pz - z) * tz
        if s <= 0.0:
            return 0.0
        return s if s < self.length else self.length


@dataclass(frozen=True, slots=True)
class Arc:
    """A circular motion about `center`, parallel to the x-y plane: `start`, `end` and `center` have one z.

    The first fields are those of `Line`. `sweep` (rad) is the angle travelled, + counter-clockwise seen from +z, at
    most one full turn; a full circle has `sweep` = +-2 pi. `radius` and `length` (m) follow.
    `programmed_center` is the center as the part program gives it, None if it does not: the arc itself is put through
    its ends exactly.
    """

    line: int
    start: Vector
    end: Vector
    feed: float
    traverse: bool
    evaluated: bool
    center: Vector
    sweep: float
    programmed_center: Vector | None = field(default=None, repr=False, compare=False)
    radius: float = field(init=False, repr=False, compare=False)
    length: float = field(init=False, repr=False, compare=False)
    _spoke: tuple[float, float] = field(init=False, repr=False, compare=False)  # center to start, x y
    _turning: float = field(init=False, repr=False, compare=False)  # signed curvature, + counter-clockwise

    def __post_init__(self) -> None:
        x, y = self.start[0] - self.center[0], self.start[1] - self.center[1]
        radius = math.sqrt(x * x + y * y)
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "length", radius * abs(self.sweep))
        object.__setattr__(self, "_spoke", (x, y))
        object.__setattr__(self, "_turning", math.copysign(1.0 / radius, self.sweep))

    def position(self, s: float) -> Vector:
        """Point at path length `s` (m), exactly `start` at and before 0, exactly `end` at and after `length`."""
        if s <= 0.0:
            return self.start
        if s >= self.length:
            return self.end
        x, y = self._spoke_at(s)
        cx, cy, z = self.center
        return cx + x, cy + y, z

    def tangent(self, s: float) -> Vector:
        """Unit tangent in the direction of travel at path length `s` (m), clamped to [0, length]."""
        x, y = self._spoke_at(s)
        turning = self._turning
        return -turning * y, turning * x, 0.0

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by the path length (1/m) at `s` (m), clamped to [0, length]: towards the center."""
        x, y = self._spoke_at(s)
        square = self._turning * self._turning
        return -square * x, -square * y, 0.0

    def nearest(self, point: Vector, near: float) -> float:
        """Path length (m) in [0, length] of the point of the arc nearest to `point` (m).

        Below a full turn that is the true nearest point; between equally near ends the start. On a full circle one
        angle belongs to s = 0 and to s = length: the angle is unwrapped to the branch nearest to the hint `near` (m,
        path length of the last known foot) and then clamped, so a tool that still lags behind the start has its foot
        at 0 and one that has run past the end has it at `length`. A point on the arc's axis is equally far from all of
        the arc: `near`, clamped.
        """
        length = self.length
        cx, cy, _ = self.center
        dx, dy = point[0] - cx, point[1] - cy
        if dx * dx + dy * dy < ZERO_LENGTH * ZERO_LENGTH:
            return min(max(near, 0.0), length)
        x, y = self._spoke
        angle = math.atan2(x * dy - y * dx, x * dx + y * dy)
        if self._turning < 0.0:
            angle = -angle
        turn = abs(self.sweep)
        if turn >= math.tau:
            s = angle * self.radius
            return min(max(s + length * round((near - s) / length), 0.0), length)
        if angle < 0.0:
            angle += math.tau
        if angle <= turn:
            return min(angle * self.radius, length)
        return length if angle - turn < math.tau - angle else 0.0

    def _spoke_at(self, s: float) -> tuple[float, float]:
        """From the center to the point at `s`, x y: the start's spoke turned by the angle travelled."""
        if s <= 0.0:
            return self._spoke
        if s > self.length:
            s = self.length
        angle = s * self._turning
        cosine, sine = math.cos(angle), math.sin(angle)
        x, y = self._spoke
        return x * cosine - y * sine, x * sine + y * cosine


Element = Line | Arc


@dataclass(frozen=True, slots=True)
class Toolpath:
    """The elements of a part program in order, each starting exactly where the one before ends.

    `starts` is the path length (m) at each element's start, `length` (m) that at the end of the last.
    Raises ValueError for elements that do not connect, an element without length, no elements.
    """

    elements: tuple[Element, ...]
    starts: tuple[float, ...] = field(init=False, repr=False, compare=False)
    length: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.elements:
            raise ValueError("a toolpath needs at least one element")
        starts = []
        length = 0.0
        end = self.elements[0].start
        for index, element in enumerate(self.elements):
            if element.start != end:
                raise ValueError(f"element {index} starts at {element.start}, the one before ends at {end}")
            if not element.length > 0.0:
                raise ValueError(f"element {index} has the length {element.length} m")
            starts.append(length)
            length += element.length
            end = element.end
        object.__setattr__(self, "starts", tuple(starts))
        object.__setattr__(self, "length", length)

    def __iter__(self) -> Iterator[Element]:
        return iter(self.elements)
