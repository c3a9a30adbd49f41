"""What the recorder holds of a run: which cycle is complete, and whether all of the run is there."""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.errors import MachineFault

__all__ = ["Ledger"]


class Ledger:
    """Counts the messages of one run. A servo-rate topic must deliver cycles 0, 1, 2, ... without a gap.

    `ahead` are the topics that end one cycle later than the others, because they are what the last cycle led to.
    """

    def __init__(self, servo_topics: Sequence[str], ahead: Sequence[str]) -> None:
        self.complete = -1
        """The last cycle of which every servo-rate topic is there."""
        self.ignored = 0
        """Number of messages that were there before."""
        self._next = dict.fromkeys(servo_topics, 0)
        self._ahead = tuple(ahead)
        self._arrived: dict[int, int] = {}
        self._last: int | None = None
        self._segments = self._evaluated = self._summaries = self._needed_segments = 0

    def take(self, topic: str, cycle: int) -> bool:
        """Note a servo-rate message; return whether it is new.

        Raises MachineFault where a cycle was skipped.
        """
        expected = self._next[topic]
        if cycle < expected:
            self.ignored += 1
            return False
        if cycle > expected:
            raise MachineFault(f"{topic}: cycle {cycle} received, cycle {expected} expected")
        self._next[topic] = expected + 1
        arrived = self._arrived.get(cycle, 0) + 1
        if arrived == len(self._next):
            del self._arrived[cycle]
            self.complete = cycle
        else:
            self._arrived[cycle] = arrived
        return True

    def take_segment(self, index: int, evaluated: bool) -> bool:
        """Note a toolpath segment; return whether it is new. Raises MachineFault where one was skipped."""
        if index < self._segments:
            self.ignored += 1
            return False
        if index > self._segments:
            raise MachineFault(f"toolpath/segment: segment {index} received, segment {self._segments} expected")
        self._segments += 1
        self._evaluated += evaluated
        return True

    def take_summary(self) -> None:
        """Note a segment's summary."""
        self._summaries += 1

    def ends_with(self, cycle: int, segment: int) -> None:
        """Note the last cycle of the run and the segment that its setpoint is on."""
        self._last = cycle
        self._needed_segments = segment + 1

    @property
    def whole(self) -> bool:
        """Whether all of the run is there."""
        if self._last is None or self.complete < self._last:
            return False
        return (
            all(self._next[topic] == self._last + 2 for topic in self._ahead)
            and self._segments == self._needed_segments
            and self._summaries == self._evaluated
        )

    def late(self) -> str | None:
        """A servo-rate topic that the next cycle lacks; None if what is missing is slower."""
        return next((topic for topic, following in self._next.items() if following <= self.complete + 1), None)
