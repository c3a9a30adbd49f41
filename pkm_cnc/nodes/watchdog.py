"""Who is missing? Every node that waits too long says for whom; the one that is waited for and says nothing is it.

So the blame does not fall on the neighbours of a dead node, which wait as well. While one of them waits for the
operator, nobody is missing. Wall time, never ROS time: it decides when to give up, no result depends on it.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["OPERATOR", "Report", "Watchdog"]

OPERATOR = "operator"
"""Whom a node may wait for as long as it takes."""


class Report(NamedTuple):
    """A node that waits: for whom, on which topic, for which cycle."""

    node: str
    waiting_for: str
    topic: str
    cycle: int


class Watchdog:
    """Collects the reports of one run; `limit` s is how long a node waits before it gives up.

    A node looks every `period` s and reports from half the limit on, so that all who wait have said so before one
    judges.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._reports: dict[str, tuple[float, Report]] = {}
        self.period = min(1.0, limit / 8)

    def take(self, report: Report, now: float) -> None:
        """Note that a node waits at the time `now`, s."""
        self._reports[report.node] = (now, report)

    def too_long(self, waited: float) -> bool:
        """Whether a node that has waited that long, s, must report it."""
        return waited > self._limit / 2

    def verdict(self, waited: float, now: float) -> str:
        """Who is silent, as the reason of a fault; empty while it is too early to say, or the operator's turn.

        A report from before this wait began does not count: who made it has gone on since. One that waits for the
        operator is repeated every period and counts no longer than the limit: who made it may have died since.
        """
        reports = {node: report for node, (time, report) in self._reports.items() if time > now - waited}
        if any(
            report.waiting_for == OPERATOR and self._reports[node][0] > now - self._limit
            for node, report in reports.items()
        ):
            return ""
        reports = {node: report for node, report in reports.items() if report.waiting_for != OPERATOR}
        silent = [report for report in reports.values() if report.waiting_for not in reports]
        if waited < self._limit or not reports:
            return ""
        if not silent:  # a message was lost: nobody is missing, and yet nothing will ever move
            if waited < 2 * self._limit:
                return ""
            first = min(reports.values(), key=lambda report: (report.cycle, report.node))
            return f"all nodes wait: {first.node} for cycle {first.cycle} on {first.topic} from {first.waiting_for}"
        first = min(silent, key=lambda report: (report.cycle, report.waiting_for, report.topic))
        return f"{first.waiting_for} has not answered cycle {first.cycle} on {first.topic} for {self._limit:g} s"
