"""contour_monitor: where the TCP is, as believed and as it truly is, and how far from the programmed contour."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from numpy.typing import ArrayLike, NDArray

from pkm_cnc import run_messages
from pkm_cnc.contour import ContourMonitor, in_position
from pkm_cnc.errors import MachineFault, UnreachableError
from pkm_cnc.messages import deserialize
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.in_order import InOrder
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.nodes.watchdog import Report
from pkm_cnc.program import Element
from pkm_cnc.records import PHASE_END, PHASE_MOVE, AxisState, TcpSetpoint, Vector
from pkm_cnc.topics import CONTOUR_MONITOR
from pkm_cnc.visuals import Visuals

__all__ = ["ContourMonitorNode", "main"]

SEGMENT = "toolpath/segment"


class ContourMonitorNode(GraphNode):
    """tcp/setpoint and all actuals -> tcp/state, contour_error, summaries, pictures for tools, progress."""

    handled = (SEGMENT,)

    def prepare(self) -> None:
        """Make the monitor."""
        self._monitor = ContourMonitor()
        self._visuals = Visuals(self.setup.actual, tuple(self.setup.axes), self.setup.servo_period_ns)
        self._ahead: deque[Element] = deque()
        self._segments = InOrder(SEGMENT, "segment")
        self._stride = max(1, self.setup.graph.window // 4)
        self._tolerance = self.setup.motion.in_position_tolerance

    def take_message(self, topic: str, data: bytes) -> None:
        """A segment arrives ahead of its use."""
        content = deserialize(data, self.topics[topic].typename)
        if not self._segments.take(content.index):
            return
        element = run_messages.element_of(content)
        self._monitor.add_segment(content.index, element, content.path_start)
        self._ahead.append(element)

    def may_step(self) -> bool:
        """The segment of the next setpoint must be known."""
        return TcpSetpoint(*self.join.peek(0)).segment < self._segments.expected

    def ignored(self) -> int:
        """How many actuals, setpoints and segments came twice."""
        return super().ignored() + self._segments.ignored

    def waits_for(self) -> Report | None:
        """A setpoint may wait for its segment as well as for the actuals."""
        if self.join.complete:
            return Report(self.full_name, self.topics[SEGMENT].publisher, SEGMENT, self.join.cycle)
        return super().waits_for()

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """Judge one cycle."""
        setpoint = TcpSetpoint(*inputs[0])
        states = [AxisState(*values) for values in inputs[1:]]
        try:
            believed = _tcp(self.setup.machine.forward, [state.position for state in states])
            true = _tcp(self.setup.true_tcp, [state.slider_position for state in states])
        except UnreachableError as unreachable:
            raise MachineFault(f"cycle {cycle}: {unreachable}") from None
        tcp, error = self._monitor.step(setpoint, believed, true)
        while (
            self._segments.expected - len(self._ahead) <= setpoint.segment
        ):  # drawn when entered, so that W is not seen
            self._visuals.add(self._ahead.popleft())
        for topic, data in self._visuals.step(cycle, states, tcp):
            self.send(topic, cycle, data)
        last = setpoint.phase == PHASE_END
        for summary in self._monitor.finish() if last else self._monitor.take_summaries():
            time = cycle * self.setup.servo_period_ns
            self.send("contour_monitor/segment_summary", cycle, run_messages.segment_summary(summary, time))
        self.publish("tcp/state", cycle, tcp)
        self.publish("contour_error", cycle, error)
        if (cycle + 1) % self._stride == 0 or setpoint.phase != PHASE_MOVE:
            measured = true if self.setup.tcp_control.direct_feedback else believed
            rests = in_position(setpoint, measured, self._tolerance)
            self.publish("contour_monitor/progress", cycle, (rests,))


def _tcp(forward: Callable[[ArrayLike], NDArray[Any]], joints: list[float]) -> Vector:
    x, y, z = forward(joints).tolist()
    return x, y, z


def main() -> None:
    """Entry point of `ros2 run pkm_cnc contour_monitor`."""
    run_node(ContourMonitorNode, CONTOUR_MONITOR)
