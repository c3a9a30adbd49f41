"""recorder: everything, raw, into a bag while the machine runs; its progress holds the machine to the disk's speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pkm_cnc.bag import BagWriter
from pkm_cnc.errors import InputError, PkmError
from pkm_cnc.messages import deserialize, time_of
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.ledger import Ledger
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.nodes.watchdog import Report
from pkm_cnc.records import PHASE_END, STATE_FINISHED, TcpSetpoint
from pkm_cnc.run_messages import End, run_end
from pkm_cnc.topics import RECORDER, RUN_END, STATUS, recorded_topics

__all__ = ["RecorderNode", "main"]


class RecorderNode(GraphNode):
    """Writes the bag. With `tapped`, the topics of the same process come through `tap_in` instead of subscriptions."""

    joins = False

    def __init__(self, name: str = RECORDER, *, tapped: bool = False, **arguments: Any) -> None:
        super().__init__(name, **arguments)
        self._tapped = tapped
        self.cycles = 0
        """Number of cycles recorded completely."""

    def prepare(self) -> None:
        """Make the bag."""
        if not self.run.bag:
            raise InputError("parameter bag is missing; give -p bag:=FOLDER")
        recorded = recorded_topics(tuple(self.setup.axes), self.setup.tcp_control.active)
        self._unpack = {topic.name: topic.codec.unpack for topic in recorded if topic.record}
        self._ledger = Ledger(list(self._unpack), [f"{axis}/actual" for axis in self.setup.axes])
        self._stride = max(1, self.setup.graph.window // 4)
        if not self._tapped:
            self.handled = tuple(topic.name for topic in recorded if topic.name != RUN_END)
        self._bag = BagWriter(Path(self.run.bag), recorded)

    def start(self) -> None:
        """Tell what was complete before the interpolator could hear it."""
        if self.cycles:
            self.publish("recorder/progress", self.cycles - 1, (True,))

    def take_message(self, topic: str, data: bytes) -> None:
        """Take one message from a subscription."""
        cycle = self._unpack[topic](data)[0] if topic in self._unpack else 0
        self._store(topic, cycle, time_of(data, self.topics[topic].typename), data)

    def tap_in(self, topic: str, cycle: int, time: int, data: bytes) -> None:
        """Take one message that a node of the same process publishes. What fails here is the recorder's fault."""
        if self.ended is None and self.topics[topic].recorded:
            try:
                self._store(topic, cycle, time, data)
            except PkmError as error:
                self.fail(str(error))

    def _store(self, topic: str, cycle: int, time: int, data: bytes) -> None:
        ledger = self._ledger
        if topic in self._unpack:
            if not ledger.take(topic, cycle):
                return
            if topic == "tcp/setpoint":
                setpoint = TcpSetpoint(*self._unpack[topic](data)[1])
                if setpoint.phase == PHASE_END:
                    ledger.ends_with(cycle, setpoint.segment)
        elif topic == "toolpath/segment":
            segment = deserialize(data, self.topics[topic].typename)
            if not ledger.take_segment(segment.index, bool(segment.evaluated)):
                return
        elif topic == "contour_monitor/segment_summary":
            ledger.take_summary()
        elif topic in ("operator/command", "program/event"):
            ledger.take_told(topic)
        elif topic == STATUS:
            status = deserialize(data, self.topics[topic].typename)
            if status.state == STATE_FINISHED:
                ledger.finished(status.commands, status.events)
        self._bag.write(topic, time, data)
        if ledger.complete >= self.cycles:
            self.cycles = ledger.complete + 1
            self.alive()
            if self.cycles % self._stride == 0 and self.running:
                self.publish("recorder/progress", ledger.complete, (True,))
        if ledger.whole:
            self.finish(End(ledger.complete, self.full_name, ""))

    def waits_for(self) -> Report:
        """The recorder waits for whoever publishes what the next cycle lacks."""
        late = self._ledger.late() or "run_info"
        return Report(self.full_name, self.topics[late].publisher, late, self.cycles)

    def current_cycle(self) -> int:
        """The first cycle that is not complete."""
        return self.cycles

    def ignored(self) -> int:
        """How many messages came twice."""
        return self._ledger.ignored

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
