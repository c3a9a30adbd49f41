"""Who is missing? Every node that waits too long says for whom; the one that is waited for and says nothing is it.

So the blame does not fall on the neighbours of a dead node, which wait as well. Wall time, never ROS time: it decides
when to give up, no result depends on it.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Report", "Watchdog"]

GRACE = 0.5
"""s between saying that one waits and judging who is silent, so that all who wait have said so."""


class Report(NamedTuple):
    """A node that waits: for whom, on which topic, for which cycle."""

    node: str
    waiting_for: str
    topic: str
    cycle: int


class Watchdog:
    """Collects the reports of one run; `limit` s is how long a node waits before it reports."""

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._reports: dict[str, Report] = {}

    def take(self, report: Report) -> None:
        """Note that a node waits."""
        self._reports[report.node] = report

    def too_long(self, waited: float) -> bool:
        """Whether a node that has waited that long, s, must report it."""
        return waited > self._limit

    def verdict(self, waited: float) -> str:
        """Who is silent, as the reason of a fault; empty while it is too early to say."""
        silent = [report for report in self._reports.values() if report.waiting_for not in self._reports]
        if waited < self._limit + GRACE or not silent:
            return ""
        first = min(silent, key=lambda report: (report.cycle, report.waiting_for, report.topic))
        return f"{first.waiting_for} has not answered cycle {first.cycle} on {first.topic} for {self._limit:g} s"
