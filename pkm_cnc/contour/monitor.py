"""The step object of the contour monitor: true TCP against contour, with a summary for every evaluated segment."""

from __future__ import annotations

import math
from collections import deque

from pkm_cnc.contour.contour_error import ContourTracker
from pkm_cnc.contour.summary import SegmentStatistics, SegmentSummary
from pkm_cnc.program import Element
from pkm_cnc.records import ContourError, TcpSetpoint, TcpState, Vector

__all__ = ["ContourMonitor", "in_position"]


class ContourMonitor:
    """Judges one run cycle by cycle, online and from a bag alike: the same steps give the same bits."""

    def __init__(self) -> None:
        self._tracker = ContourTracker()
        self._ahead: deque[tuple[int, Element, float]] = deque()  # segments the tool has not entered
        self._entered = -1  # the segment the tool is on
        self._statistics: SegmentStatistics | None = None  # its figures, if it is evaluated
        self._setpoint_segment = -1
        self._finished: list[SegmentSummary] = []

    def add_segment(self, index: int, element: Element, path_start: float) -> None:
        """Append toolpath segment `index`, which begins `path_start` m along the contour, before its first use.

        Raises MachineFault if the index does not follow the last one.
        """
        self._tracker.add(index, element, path_start)
        self._ahead.append((index, element, path_start))

    def step(self, setpoint: TcpSetpoint, believed: Vector, true: Vector) -> tuple[TcpState, ContourError]:
        """One cycle: the TCP as the controller believes it and as it truly is, m in base_link.

        Raises MachineFault if the setpoint's segment has not been added or lies behind the tool's.
        """
        error = self._tracker.step(true, setpoint.segment)
        tx, ty, tz = setpoint.x - true[0], setpoint.y - true[1], setpoint.z - true[2]
        self._setpoint_segment = setpoint.segment
        statistics = self._statistics if error.segment == self._entered else self._enter(error.segment)
        if statistics is not None:
            vx, vy, vz = setpoint.vx, setpoint.vy, setpoint.vz
            speed = math.sqrt(vx * vx + vy * vy + vz * vz)
            statistics.add(error, speed, math.sqrt(tx * tx + ty * ty + tz * tz))
        return TcpState(*believed, *true, tx, ty, tz), error

    def take_summaries(self) -> list[SegmentSummary]:
        """Summaries of the evaluated segments that the tool has left since the last call, in order.

        A segment that was passed without a foot on it (shorter than a period's motion) has a summary of no cycles.
        """
        taken, self._finished = self._finished, []
        return taken

    def finish(self) -> list[SegmentSummary]:
        """At the end of the run: the summaries not taken yet, up to the segment the setpoint came to."""
        self._leave_all_before(self._setpoint_segment + 1)
        return self.take_summaries()

    def _enter(self, segment: int) -> SegmentStatistics | None:
        self._leave_all_before(segment)
        index, element, path_start = self._ahead.popleft()
        self._entered = index
        self._statistics = SegmentStatistics(index, element, path_start) if element.evaluated else None
        return self._statistics

    def _leave_all_before(self, segment: int) -> None:
        if self._statistics is not None:
            self._finished.append(self._statistics.summary())
            self._statistics = None
        while self._ahead and self._ahead[0][0] < segment:
            index, element, path_start = self._ahead.popleft()
            if element.evaluated:
                self._finished.append(SegmentStatistics(index, element, path_start).summary())


def in_position(setpoint: TcpSetpoint, measured: Vector, tolerance: float) -> bool:
    """Whether the TCP is within `tolerance` (m) of the setpoint, as the controller knows it.

    That is `measured`: what the scales tell of the TCP, or what a measuring system at the TCP does.
    """
    return math.dist((setpoint.x, setpoint.y, setpoint.z), measured) <= tolerance
