"""What the recorder holds of a run: which cycle is complete, and whether all of the run is there."""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.nodes.in_order import InOrder

__all__ = ["Ledger"]


class Ledger:
    """Counts the messages of one run. A servo-rate topic must deliver cycles 0, 1, 2, ... without a gap.

    `ahead` are the topics that end one cycle later than the others, because they are what the last cycle led to.
    """

    def __init__(self, servo_topics: Sequence[str], ahead: Sequence[str]) -> None:
        self.complete = -1
        """The last cycle of which every servo-rate topic is there."""
        self._streams = {topic: InOrder(topic) for topic in servo_topics}
        self._segments = InOrder("toolpath/segment", "segment")
        self._ahead = tuple(ahead)
        self._arrived: dict[int, int] = {}
        self._last: int | None = None
        self._evaluated = self._summaries = self._needed_segments = 0
        self._told = {"operator/command": 0, "program/event": 0}
        self._to_be_told: dict[str, int] | None = None

    @property
    def ignored(self) -> int:
        """Number of messages that were there before."""
        return self._segments.ignored + sum(stream.ignored for stream in self._streams.values())

    def take(self, topic: str, cycle: int) -> bool:
        """Note a servo-rate message; return whether it is new.

        Raises MachineFault where a cycle was skipped.
        """
        if not self._streams[topic].take(cycle):
            return False
        arrived = self._arrived.get(cycle, 0) + 1
        if arrived == len(self._streams):
            del self._arrived[cycle]
            self.complete = cycle
        else:
            self._arrived[cycle] = arrived
        return True

    def take_segment(self, index: int, evaluated: bool) -> bool:
        """Note a toolpath segment; return whether it is new. Raises MachineFault where one was skipped."""
        if not self._segments.take(index):
            return False
        self._evaluated += evaluated
        return True

    def take_summary(self) -> None:
        """Note a segment's summary."""
        self._summaries += 1

    def take_told(self, topic: str) -> None:
        """Note a command of the operator or an event of the program."""
        self._told[topic] += 1

    def finished(self, commands: int, events: int) -> None:
        """Note the last status of the run, and how many commands and events it counts."""
        self._to_be_told = {"operator/command": commands, "program/event": events}

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
            all(self._streams[topic].expected == self._last + 2 for topic in self._ahead)
            and self._segments.expected == self._needed_segments
            and self._summaries == self._evaluated
            and self._told == self._to_be_told
        )

    def late(self) -> str | None:
        """A servo-rate topic that the next cycle lacks; None if what is missing is slower."""
        return next((topic for topic, stream in self._streams.items() if stream.expected <= self.complete + 1), None)
