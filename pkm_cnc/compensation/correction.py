"""The correction of a contour: a vector across the direction of travel for every path length.

The contour falls into spans, from stop to stop of the feed motion; rapids are left alone. On each span the correction
is a cubic spline over equally spaced knots, so it is smooth: it has no loops or jumps that the contour has not. It is
zero at both ends of a span with its first two derivatives: it leaves the contour in its direction and curvature.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.compensation.smooth_fit import SmoothFit
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Arc, Element, Toolpath

__all__ = ["CLOSE", "SMOOTH", "Correction", "Span", "across", "product", "spans_of"]

Array = NDArray[np.float64]

DEGREE = 3
LEAST = 8
"""Intervals of a span: fewer have no room between two ends that are zero."""
RUN_UP, RUN_OUT = 2.0, 1.0
"""Lags v/Kv. How far behind the ramp v^2/2a of a stop errors are learnt from where the tool still moves when the next
motion begins: by then 86 % of that is gone; and how far before the ramp of the next stop the correction begins to end,
so that it does not end steeply."""
TIGHT = 1.5
"""Lags v/Kv. The tool cuts through an arc of that radius R by more than a fifth of it: v^2/(2 Kv^2 R) on a serial
machine. What would make it follow is no small correction of the path."""
BLENDED = 0.35
"""rad. Under G64 elements that meet at a smaller angle approximate a curve."""
CLOSE, SMOOTH = 1e-6, 1e-3
"""1. Weight of the second differences of the coefficients beside the number of samples a knot: of what is 30 knots
long it takes away 2e-9 and 2e-6, of what is 6 knots long 1e-6 and 1e-3, and it decides where there are no samples."""


@dataclass(frozen=True)
class Span:
    """From `begin` to `end` (m along the contour) the tool moves without a stop.

    The first `run_up` and the last `run_out`, m, are left to the correction to begin and to end: the tool still does
    something of the motion before, and comes to rest.
    """

    begin: float
    end: float
    intervals: int
    run_up: float
    run_out: float

    @property
    def step(self) -> float:
        """Distance of the knots, m."""
        return (self.end - self.begin) / self.intervals

    def knots(self) -> Array:
        """All knots (intervals + 7,), m, three of them before `begin` and behind `end`."""
        knots = self.begin + self.step * np.arange(-DEGREE, self.intervals + DEGREE + 1, dtype=np.float64)
        knots[-DEGREE - 1] = self.end  # rounding must not leave the last sample outside
        return knots

    @property
    def free(self) -> slice:
        """Which of the coefficients (intervals + 3,) may differ from zero: not the three that reach an end."""
        return slice(DEGREE, self.intervals)


def spans_of(contour: Toolpath, motion: MotionParameters, kv: float, spacing: float) -> tuple[Span, ...]:
    """The spans of a contour, for drives of velocity gain `kv` (1/s) and knots about `spacing` lags v/Kv apart."""
    spans: list[Span] = []
    for first, last in _runs(contour, motion, kv):
        begin, end = contour.starts[first], contour.starts[last] + contour.elements[last].length
        feed = max(element.feed for element in contour.elements[first : last + 1])
        intervals = max(LEAST, round((end - begin) * kv / (spacing * feed)))
        ramp, lag = feed * feed / (2.0 * motion.acceleration), feed / kv
        run_up = ramp + (0.0 if motion.wait_in_position else RUN_UP * lag)
        run_out = ramp + RUN_OUT * lag
        spans.append(Span(begin, end, intervals, run_up, run_out))
    return tuple(spans)


def _runs(contour: Toolpath, motion: MotionParameters, kv: float) -> Iterator[tuple[int, int]]:
    """First and last element of what is run without a stop, a corner or an arc that is too tight for the drives."""
    first = None
    for index, element in enumerate(contour.elements):
        if element.traverse or _tight(element, kv):
            if first is not None:
                yield first, index - 1
            first = None
            continue
        first = index if first is None else first
        if not _goes_on(contour, index, motion):
            yield first, index
            first = None


def _tight(element: Element, kv: float) -> bool:
    """Whether it is passed like a corner."""
    return isinstance(element, Arc) and element.radius * kv < TIGHT * element.feed


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
    def fitted(spans: tuple[Span, ...], s: Array, vectors: Array, weight: float = CLOSE) -> Correction:
        """The least-squares splines through `vectors` (n, 3), m, at path lengths `s` (n,), m.

        `weight` is that of their second differences, `CLOSE` where the samples leave no gaps, else `SMOOTH`. Several
        runs are averaged by giving all their samples. Vectors that are not finite do not count.
        """
        good = np.isfinite(vectors).all(axis=1)
        s, vectors = s[good], vectors[good]
        return Correction(spans, tuple(_fit(span, s, vectors, weight) for span in spans))

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

    def untouched(self, begin: float, end: float) -> bool:
        """Whether between the path lengths `begin` and `end`, m, nothing is learnt."""
        return not any(max(begin, span.begin + span.run_up) < min(end, span.end - span.run_out) for span in self.spans)

    def settled(self, s: Array) -> NDArray[np.bool_]:
        """Which of the path lengths `s` (n,), m, are in a span, off its `run_up` and its `run_out`."""
        result = np.zeros(len(s), dtype=bool)
        for span in self.spans:
            result |= (span.begin + span.run_up <= s) & (s <= span.end - span.run_out)
        return result

    def size(self) -> float:
        """The largest coefficient, m: no correction is larger."""
        return max((float(np.abs(part).max()) for part in self.coefficients), default=0.0)


def _fit(span: Span, s: Array, vectors: Array, weight: float) -> Array:
    """Coefficients (intervals + 3, 3)."""
    from scipy.interpolate import BSpline

    inside = (span.begin <= s) & (s <= span.end)
    coefficients = np.zeros((span.intervals + DEGREE, 3))
    if inside.any():
        basis = BSpline.design_matrix(s[inside], span.knots(), DEGREE)[:, span.free]
        fit = SmoothFit(basis.T @ basis, weight * max(1.0, inside.sum() / span.intervals))
        coefficients[span.free] = fit.solve(basis.T @ vectors[inside])
    return coefficients


def across(vectors: Array, tangents: Sequence[Sequence[float]] | Array) -> Array:
    """The parts of `vectors` (n, 3) at right angles to the unit `tangents` (n, 3)."""
    along = np.asarray(tangents, dtype=float)
    return np.asarray(vectors - (vectors * along).sum(axis=1)[:, None] * along)


def product(matrices: Array, vectors: Array) -> Array:
    """Row by row the product of `matrices` (n, m, k) and `vectors` (n, k), (n, m)."""
    return np.asarray(np.einsum("kij,kj->ki", matrices, vectors))
