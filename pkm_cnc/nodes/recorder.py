"""recorder: everything, raw, into a bag while the machine runs; its progress holds the machine back to the disk's speed."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from pkm_cnc.bag import BagWriter
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.messages import deserialize
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.nodes.watchdog import Report
from pkm_cnc.records import PHASE_END
from pkm_cnc.run_messages import End, run_end
from pkm_cnc.topics import RECORDER, RUN_END, topics

__all__ = ["RecorderNode", "main"]

_STAMP = struct.Struct("<iI")
_MARKERS_STAMP, _HEADER_STAMP = 8, 4
"""Offset of the first stamp in a MarkerArray (behind the number of markers) and in a message with a header."""


class RecorderNode(GraphNode):
    """Writes the bag. With `tapped`, the topics of the same process come through `take` instead of subscriptions."""

    def __init__(self, name: str = RECORDER, *, tapped: bool = False, **arguments: Any) -> None:
        super().__init__(name, **arguments)
        self._tapped = tapped
        self._complete = -1

    def prepare(self) -> None:
        """Make the bag."""
        if not self.run.get("bag"):
            raise InputError("recorder: parameter bag is missing; give -p bag:=FOLDER")
        recorded = [topic for topic in topics(tuple(self.setup.axes)).values() if topic.recorded]
        self._servo = {topic.name: topic.codec.unpack for topic in recorded if topic.record}
        self._next = dict.fromkeys(self._servo, 0)
        self._arrived: dict[int, int] = {}
        self._last: int | None = None
        self._segments = self._summaries = self._evaluated = 0
        self._stride = max(1, self.setup.graph.window // 4)
        if not self._tapped:
            self.handled = tuple(topic.name for topic in recorded if topic.name != RUN_END)
        self._bag = BagWriter(Path(self.run["bag"]), recorded)

    def take_message(self, topic: str, data: bytes) -> None:
        """Take one message from a subscription."""
        cycle = self._servo[topic](data)[0] if topic in self._servo else 0
        offset = _MARKERS_STAMP if topic == "markers" else _HEADER_STAMP
        seconds, nanoseconds = _STAMP.unpack_from(data, offset)
        self._store(topic, cycle, seconds * 1_000_000_000 + nanoseconds, data)

    def take(self, topic: str, cycle: int, time: int, data: bytes) -> None:
        """Take one message that a node of the same process publishes. Faults are reported, never raised to it."""
        if self.ended is None and self.topics[topic].recorded:
            self._guard(lambda: self._store(topic, cycle, time, data))

    def _store(self, topic: str, cycle: int, time: int, data: bytes) -> None:
        if topic in self._next:
            if cycle != self._next[topic]:
                self._out_of_order(topic, cycle)
                return
            self._next[topic] = cycle + 1
        self._bag.write(topic, time, data)
        if topic in self._next:
            self._count(topic, cycle, data)
        elif topic == "toolpath/segment":
            self._segments += 1
            self._evaluated += bool(deserialize(data, self.topics[topic].typename).evaluated)
        elif topic == "contour_monitor/segment_summary":
            self._summaries += 1
        if self._last is not None:
            self._finish_if_all_there()

    def _out_of_order(self, topic: str, cycle: int) -> None:
        if cycle > self._next[topic]:
            raise MachineFault(f"{topic}: cycle {cycle} received, cycle {self._next[topic]} expected")
        self.join.ignored += 1

    def _count(self, topic: str, cycle: int, data: bytes) -> None:
        if topic == "tcp/setpoint" and self._servo[topic](data)[1][-1] == PHASE_END:
            self._last = cycle
            self._needed_segments = self._servo[topic](data)[1][-2] + 1
        arrived = self._arrived.get(cycle, 0) + 1
        if arrived < len(self._next):
            self._arrived[cycle] = arrived
            return
        self._arrived.pop(cycle)
        self._complete = cycle
        self.alive()
        if (cycle + 1) % self._stride == 0 and self.ended is None:
            self.publish("recorder/progress", cycle, (True,))

    def _finish_if_all_there(self) -> None:
        actual_ahead = all(self._next[f"{axis}/actual"] == self._last + 2 for axis in self.setup.axes)
        slow_there = self._segments == self._needed_segments and self._summaries == self._evaluated
        if self._complete == self._last and actual_ahead and slow_there:
            self.finish(End(self._last, self.full_name, ""))

    @property
    def cycles(self) -> int:
        """Number of cycles recorded completely."""
        return self._complete + 1

    def waits_for(self) -> Report:
        """The recorder waits for whoever publishes what the next cycle lacks."""
        cycle = self._complete + 1
        late = next((topic for topic, following in self._next.items() if following <= cycle), "run_info")
        return Report(self.full_name, self.topics[late].publisher, late, cycle)

    def figures(self) -> dict[str, str]:
        """Cycles recorded."""
        return {"cycle": str(self.cycles), "ignored messages": str(self.join.ignored)}

    def close(self) -> None:
        """Note how the run ended and close the bag."""
        assert self.ended is not None
        time = self.ended.cycle * self.setup.servo_period_ns
        try:
            self._bag.write(RUN_END, time, run_end(self.ended, time))
        finally:
            self._bag.close()


def main() -> None:
    """Entry point of `ros2 run pkm_cnc recorder`."""
    run_node(RecorderNode, RECORDER)
