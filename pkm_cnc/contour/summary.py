"""Contour error of one toolpath segment in figures, gathered cycle by cycle in constant memory."""

from __future__ import annotations

import math
from typing import NamedTuple

from pkm_cnc.program import Element, Line
from pkm_cnc.records import ContourError
from pkm_cnc.tolerances import FEED_REACHED

__all__ = ["SegmentStatistics", "SegmentSummary", "contour_error_report", "judged_range"]


class SegmentSummary(NamedTuple):
    """Figures over the cycles that count, in the order of SegmentSummary.msg; m, NaN = no cycle or no such part.

    `std` is that of the population; `below_feed` are cycles with the setpoint slower than programmed.
    """

    segment: int
    cycles: int
    below_feed: int
    left_mean: float
    left_std: float
    left_rms: float
    left_max_abs: float
    up_mean: float
    up_std: float
    up_rms: float
    up_max_abs: float
    magnitude_mean: float
    magnitude_rms: float
    magnitude_max: float
    tracking_error_mean: float


def judged_range(element: Element, path_start: float) -> tuple[float, float]:
    """From where to where on the contour, m, an element is judged: the middle half of a line, all of an arc."""
    margin = 0.25 * element.length if isinstance(element, Line) else 0.0
    return path_start + margin, path_start + element.length - margin


class SegmentStatistics:
    """Gathers the SegmentSummary of one element that begins `path_start` m along the contour.

    A line counts while the true TCP projects onto its middle half, clear of what happens at its ends; an arc always.
    """

    def __init__(self, index: int, element: Element, path_start: float) -> None:
        self._index = index
        self._from, self._to = judged_range(element, path_start)
        self._feed_reached = element.feed * (1.0 - FEED_REACHED)
        self._below_feed = 0
        self._left = _Running()
        self._up = _Running()
        self._magnitude = _Running()
        self._tracking_error = _Running()

    def add(self, error: ContourError, setpoint_speed: float, tracking_error: float) -> None:
        """Take in one cycle whose foot is on this element: m, m/s, and the tracking error's magnitude at the TCP, m."""
        if not self._from <= error.path_length <= self._to:
            return
        if setpoint_speed < self._feed_reached:
            self._below_feed += 1
        self._left.add(error.left)
        self._up.add(error.up)
        self._magnitude.add(error.magnitude)
        self._tracking_error.add(tracking_error)

    def summary(self) -> SegmentSummary:
        """The figures so far."""
        left, up, magnitude = self._left, self._up, self._magnitude
        return SegmentSummary(
            self._index,
            magnitude.count,
            self._below_feed,
            *(left.mean, left.std(), left.rms(), left.max_abs),
            *(up.mean, up.std(), up.rms(), up.max_abs),
            *(magnitude.mean, magnitude.rms(), magnitude.max_abs),
            self._tracking_error.mean,
        )


class _Running:
    """Mean, deviation and largest size of a stream of numbers, by Welford's recurrence; NaN while it is empty."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = math.nan
        self.max_abs = math.nan
        self._squares = 0.0  # sum of the squared deviations from the mean

    def add(self, value: float) -> None:
        self.count += 1
        if self.count == 1:
            self.mean = value
            self.max_abs = abs(value)
            self._squares = value - value  # NaN stays NaN
            return
        deviation = value - self.mean
        self.mean += deviation / self.count
        self._squares += deviation * (value - self.mean)
        if abs(value) > self.max_abs:
            self.max_abs = abs(value)

    def _variance(self) -> float:
        return self._squares / self.count if self.count else math.nan

    def std(self) -> float:
        return math.sqrt(self._variance())

    def rms(self) -> float:
        return math.sqrt(self.mean * self.mean + self._variance())


def contour_error_report(summary: SegmentSummary) -> dict[str, object]:
    """The part of an evaluated segment's JSON entry that comes from its summary; um and mm, None = not available."""

    def scaled(factor: float, **figures: float) -> dict[str, float | None]:
        return {key: None if math.isnan(value) else factor * value for key, value in figures.items()}

    return {
        "contour_error_um": scaled(
            1e6, mean=summary.left_mean, std=summary.left_std, rms=summary.left_rms, max_abs=summary.left_max_abs
        ),
        "contour_error_z_um": scaled(
            1e6, mean=summary.up_mean, std=summary.up_std, rms=summary.up_rms, max_abs=summary.up_max_abs
        ),
        "contour_error_3d_um": scaled(
            1e6, mean=summary.magnitude_mean, rms=summary.magnitude_rms, max=summary.magnitude_max
        ),
        "tracking_error_mm": scaled(1e3, mean=summary.tracking_error_mean),
        "below_feed": summary.below_feed,
    }
