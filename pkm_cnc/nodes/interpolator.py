"""interpolator: part program -> setpoint of the TCP, one message a servo cycle, a window ahead of the slowest."""

from __future__ import annotations

import time
from functools import partial

from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMessage

from pkm_cnc import run_messages
from pkm_cnc.check import prepare
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.messages import message, serialize, stamp
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.operator_panel import OVERRIDES, OperatorPanel
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.nodes.watchdog import OPERATOR, Report
from pkm_cnc.program import read_program
from pkm_cnc.records import Command
from pkm_cnc.status import Status, StatusReports
from pkm_cnc.topics import CONTOUR_MONITOR, INTERPOLATOR, RECORDER, STATUS

__all__ = ["InterpolatorNode", "main"]

MONITOR_PROGRESS, RECORDER_PROGRESS = f"{CONTOUR_MONITOR}/progress", f"{RECORDER}/progress"
CLOCK_PERIOD_NS = 10_000_000
"""ns of machine time between two /clock messages: 100 Hz, for tools only."""


class InterpolatorNode(GraphNode):
    """Publishes run_info, toolpath/segment ahead of use, tcp/setpoint, and /clock for tools."""

    handled = (MONITOR_PROGRESS, RECORDER_PROGRESS)
    changeable = tuple(OVERRIDES)

    def prepare(self) -> None:
        """Read and check the whole program: nothing moves before all of it is known to be reachable."""
        if not self.run.program:
            raise InputError("parameter program is missing; give -p program:=FILE")
        self._options = run_messages.RunOptions(self.run.attended, self.run.from_line)
        self._program = read_program(self.run.program)
        self._blocks = self._program.text.split("\n")
        checked = prepare(self.setup, self._program, self._options.from_line)
        self._interpolator = checked.interpolator(self._options.attended)
        self._cycle = 0
        self._reports = StatusReports(self.setup.servo_period_ns)
        self._in_position = True
        self._progress = {MONITOR_PROGRESS: -1, RECORDER_PROGRESS: -1}
        self._outdated = 0
        self.overruns = 0
        self._clock_publisher = self.create_publisher(ClockMessage, "/clock", 10)
        self._clock_cycles = max(1, CLOCK_PERIOD_NS // self.setup.servo_period_ns)
        OperatorPanel(self, self._command)

    def _command(self, command: Command) -> str:
        """Give the operator's command to the interpolator; return why it is refused, empty if it is not.

        What is accepted is told before the setpoint in which it takes effect, so that it can be given there again.
        """
        if not self.running:
            return "the machine is not running: " + (self.ended.reason if self.ended else "not all nodes are there yet")
        waited = self._interpolator.waits_for_operator
        reason = self._interpolator.command(command)
        if not reason:
            stamp_ns = self._cycle * self.setup.servo_period_ns
            self.send("operator/command", self._cycle, run_messages.operator_command(command, self._cycle, stamp_ns))
            self._report(self._reports.after_command(self._interpolator))
            if waited:  # machine time stood still: it was nobody's delay
                self.alive()
                self._started = time.monotonic() - self._cycle * self.setup.servo_period
            self._guard(self._release)
        return reason

    def _report(self, status: Status | None) -> None:
        if status is not None:
            stamp_ns = self._cycle * self.setup.servo_period_ns
            self.send(STATUS, self._cycle, run_messages.controller_status(status, self._blocks, self._cycle, stamp_ns))

    def start(self) -> None:
        """Begin the run."""
        self.send("run_info", 0, run_messages.run_info(self.setup, self._program, self._options))
        self._started = time.monotonic()
        self._report(self._reports.at_start(self._interpolator))
        for name, kind in OVERRIDES.items():
            if getattr(self.run, name) != 1.0:
                self._command(Command(kind, getattr(self.run, name)))
        if self.run.pacing == "realtime":
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(self.setup.servo_period, partial(self._guard, self._release), clock=clock)
        self._release()

    def take_message(self, topic: str, data: bytes) -> None:
        """A consumer tells its progress."""
        cycle, (in_position,) = self.topics[topic].codec.unpack(data)
        if cycle >= self._cycle:
            raise MachineFault(f"{topic}: cycle {cycle} reported, but {self._cycle} is the next to be sent")
        if cycle <= self._progress[topic]:
            self._outdated += 1
            return
        self._progress[topic] = cycle
        if topic == MONITOR_PROGRESS:
            self._in_position = in_position
        self.alive()
        self._release()

    def _release(self) -> None:
        """Publish every setpoint that the window, the machine's rest and the pacing allow."""
        while self.running and not self._interpolator.finished and self._may_release():
            setpoint = self._interpolator.step(self._in_position)
            stamp_ns = self._cycle * self.setup.servo_period_ns
            for index, element, start in self._interpolator.take_segments():
                data = run_messages.segment(index, element, start, stamp_ns)
                self.send("toolpath/segment", self._cycle, data)
            events = self._interpolator.take_events()
            for event in events:
                self.send("program/event", self._cycle, run_messages.program_event(event, self._cycle, stamp_ns))
            self._report(self._reports.after_setpoint(self._cycle, self._interpolator, setpoint, len(events)))
            self.publish("tcp/setpoint", self._cycle, setpoint)
            if self._cycle % self._clock_cycles == 0:
                self._clock_publisher.publish(serialize(message("rosgraph_msgs/msg/Clock", clock=stamp(stamp_ns))))
            self._cycle += 1

    def _may_release(self) -> bool:
        if (
            self._interpolator.waits_for_operator
            or self._cycle > min(self._progress.values()) + self.setup.graph.window
        ):
            return False
        if self._interpolator.needs_feedback and self._progress[MONITOR_PROGRESS] < self._cycle - 1:
            return False
        return self.run.pacing == "fast" or self._due()

    def _due(self) -> bool:
        late = time.monotonic() - self._started - self._cycle * self.setup.servo_period
        if late > self.setup.servo_period:
            self.overruns += 1
        return late >= 0

    def waits_for(self) -> Report | None:
        """The interpolator waits for the operator, or for the consumer whose progress holds its window."""
        if self._interpolator.waits_for_operator:
            return Report(self.full_name, OPERATOR, "operator/command", self._cycle)
        if self._interpolator.finished:
            return Report(self.full_name, RECORDER, "run_end", self._cycle - 1)
        slowest = min(self._progress, key=lambda topic: (self._progress[topic], topic))
        return Report(self.full_name, self.topics[slowest].publisher, slowest, self._progress[slowest] + 1)

    def current_cycle(self) -> int:
        """The cycle to be sent next."""
        return self._cycle

    def ignored(self) -> int:
        """How many reports of progress told nothing new."""
        return self._outdated

    def figures(self) -> dict[str, str]:
        """Overruns of the real-time pacing."""
        return {"overruns": str(self.overruns)}

    def close(self) -> None:
        """Tell how well the pacing was kept."""
        if self.overruns:
            self.get_logger().warning(f"realtime: {self.overruns} of {self._cycle} cycles were late by over a period")


def main() -> None:
    """Entry point of `ros2 run pkm_cnc interpolator`."""
    run_node(InterpolatorNode, INTERPOLATOR)
