"""The correction of a contour: a vector across the direction of travel for every path length.

The contour falls into spans, from stop to stop of the feed motion; rapids are left alone. On each span the correction
is a cubic spline over equally spaced knots, so it is smooth: it has no loops or jumps that the contour has not. Its
coefficients fade to zero towards both ends of a span, where it leaves the contour with its direction and curvature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Toolpath

__all__ = ["Correction", "Span", "across", "spans_of"]

Array = NDArray[np.float64]

DEGREE = 3
LEAST = 8
"""Intervals of a span: fewer have no room between two faded ends."""
FADE_LAGS = 2.5
"""How far behind the ramp v^2/2a of a stop the correction is full, in distances v/Kv by which the tool lags, where the
tool still moves when the next motion begins: by then 92 % of that is gone."""
FADE_PART = 0.25
"""1. Of a short span at most that much fades at either end."""
BLENDED = 0.35
"""rad. Under G64 elements that meet at a smaller angle approximate a curve."""
PENALTY = 1e-6
"""1. Weight of the second differences of the coefficients (P-spline of Eilers and Marx, 1996) against the data: takes
away 1e-8 of what is 30 knots long, and decides where there are no data."""


@dataclass(frozen=True)
class Span:
    """From `begin` to `end` (m along the contour) the tool moves without a stop.

    `ramp`, m, is the way that it takes to come to its feed or to rest, and behind `fade`, m, what it still does of the
    motion before is forgotten: at least by as much the correction fades at either end.
    """

    begin: float
    end: float
    intervals: int
    ramp: float
    fade: float

    @property
    def step(self) -> float:
        """Distance of the knots, m."""
        return (self.end - self.begin) / self.intervals

    def knots(self) -> Array:
        """All knots (intervals + 7,), m, three of them before `begin` and behind `end`."""
        knots = self.begin + self.step * np.arange(-DEGREE, self.intervals + DEGREE + 1, dtype=np.float64)
        knots[-DEGREE - 1] = self.end  # rounding must not leave the last sample outside
        return knots

    def weights(self) -> Array:
        """How much of each coefficient (intervals + 3,) is kept: 1, and 0 for the three at either end."""
        middles = self.step * np.arange(-1.0, self.intervals + 2)  # where the coefficients have their say
        inside = np.minimum(middles, (self.end - self.begin) - middles)
        x = np.clip((inside - self.step) / max(self.fade - self.step, 1e-12), 0.0, 1.0)
        return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def spans_of(contour: Toolpath, motion: MotionParameters, kv: float, spacing: float) -> tuple[Span, ...]:
    """The spans of a contour, for drives of velocity gain `kv` (1/s) and knots about `spacing` (m) apart."""
    spans: list[Span] = []
    feed = 0.0
    begin = None
    for index, (element, start) in enumerate(zip(contour.elements, contour.starts, strict=True)):
        if element.traverse:
            continue
        begin, feed = (start, element.feed) if begin is None else (begin, max(feed, element.feed))
        if _goes_on(contour, index, motion):
            continue
        end = start + element.length
        intervals = max(LEAST, round((end - begin) / spacing))
        ramp = feed * feed / (2.0 * motion.acceleration)
        fade = ramp + (0.0 if motion.wait_in_position else FADE_LAGS * feed / kv)
        longest = FADE_PART * (end - begin)
        spans.append(Span(begin, end, intervals, min(ramp, longest), min(fade, longest)))
        begin = None
    return tuple(spans)


def _goes_on(contour: Toolpath, index: int, motion: MotionParameters) -> bool:
    """Whether the tool goes from element `index` to the next without a stop and without a corner."""
    if index + 1 == len(contour.elements):
        return False
    before, after = contour.elements[index], contour.elements[index + 1]
    if after.traverse or before.path_mode.code == "G61.1":
        return False
    chord = math.dist(before.tangent(before.length), after.tangent(0.0))
    largest = BLENDED if before.path_mode.code == "G64" else motion.tangent_angle
    return 2.0 * math.asin(min(0.5 * chord, 1.0)) <= largest


@dataclass(frozen=True)
class Correction:
    """`coefficients[i]` (intervals + 3, 3), m, are those of the spline over `spans[i]`."""

    spans: tuple[Span, ...]
    coefficients: tuple[Array, ...]

    @staticmethod
    def none(spans: tuple[Span, ...]) -> Correction:
        """No correction."""
        return Correction(spans, tuple(np.zeros((span.intervals + DEGREE, 3)) for span in spans))

    @staticmethod
    def fitted(spans: tuple[Span, ...], s: Array, vectors: Array, faded: bool = False) -> Correction:
        """The least-squares splines through `vectors` (n, 3), m, at path lengths `s` (n,), m, faded at the ends.

        `faded`: they are so already.

        Several runs are averaged by giving all their samples. Vectors that are not finite do not count.
        """
        good = np.isfinite(vectors).all(axis=1)
        s, vectors = s[good], vectors[good]
        weights = [(span.weights() > 0.0) * 1.0 if faded else span.weights() for span in spans]
        fits = (_fit(span, s, vectors) * weight[:, None] for span, weight in zip(spans, weights, strict=True))
        return Correction(spans, tuple(fits))

    def plus(self, other: Correction, gain: float) -> Correction:
        """This and `gain` times another over the same spans."""
        pairs = zip(self.coefficients, other.coefficients, strict=True)
        return Correction(self.spans, tuple(one + gain * two for one, two in pairs))

    def at(self, s: Array, derivative: int = 0) -> Array:
        """The correction (n, 3), m, or a derivative by path length, at path lengths `s` (n,), m; 0 off the spans."""
        from scipy.interpolate import BSpline

        result = np.zeros((len(s), 3))
        for span, coefficients in zip(self.spans, self.coefficients, strict=True):
            inside = (span.begin <= s) & (s <= span.end)
            result[inside] = BSpline(span.knots(), coefficients, DEGREE)(s[inside], derivative)
        return result

    def settled(self, s: Array) -> NDArray[np.bool_]:
        """Which of the path lengths `s` (n,), m, are in a span and off its faded ends."""
        result = np.zeros(len(s), dtype=bool)
        for span in self.spans:
            result |= (span.begin + span.fade <= s) & (s <= span.end - span.fade)
        return result

    def size(self) -> float:
        """The largest coefficient, m: no correction is larger."""
        return max((float(np.abs(part).max()) for part in self.coefficients), default=0.0)


def _fit(span: Span, s: Array, vectors: Array) -> Array:
    """Coefficients (intervals + 3, 3)."""
    from scipy.interpolate import BSpline
    from scipy.linalg import solveh_banded

    inside = (span.begin <= s) & (s <= span.end)
    count = span.intervals + DEGREE
    if not inside.any():
        return np.zeros((count, 3))
    basis = BSpline.design_matrix(s[inside], span.knots(), DEGREE)
    normal = (basis.T @ basis).todia()
    banded = np.zeros((DEGREE + 1, count))  # upper form
    for offset in range(DEGREE + 1):
        banded[DEGREE - offset, offset:] = normal.diagonal(offset)
    stiff = PENALTY * max(1.0, inside.sum() / count)
    for weights, offset in (((1.0, 5.0, 6.0), 0), ((-2.0, -4.0, -4.0), 1), ((1.0, 1.0, 1.0), 2)):
        diagonal = np.full(count - offset, weights[2])
        diagonal[0] = diagonal[-1] = weights[0]
        if offset == 0:
            diagonal[1] = diagonal[-2] = weights[1]
        banded[DEGREE - offset, offset:] += stiff * diagonal
    banded[DEGREE] += 1e-9 * stiff  # all of it is defined even where the data lie in one interval
    solved: Array = solveh_banded(banded, basis.T @ vectors[inside])
    return solved


def across(vectors: Array, tangents: Sequence[Sequence[float]] | Array) -> Array:
    """The parts of `vectors` (n, 3) at right angles to the unit `tangents` (n, 3)."""
    along = np.asarray(tangents, dtype=float)
    return np.asarray(vectors - (vectors * along).sum(axis=1)[:, None] * along)
