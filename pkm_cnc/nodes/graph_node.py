"""What every node of the graph does the same way: topics, the start, the watchdog and the end of a run.

Life cycle: `configure` reads and refuses the parameters and makes the topics, `activate` takes part in the run. A fault
goes through the error state to `finalized`; one node lives for one run, so that a run depends on nothing older.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from pkm_cnc.errors import InputError, MachineFault, PkmError
from pkm_cnc.messages import deserialize, message, serialize
from pkm_cnc.nodes.cycle_join import CycleJoin
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.nodes.ros_parameters import overrides, read_parameters
from pkm_cnc.nodes.watchdog import Report, Watchdog
from pkm_cnc.run_messages import End, end_of, run_end
from pkm_cnc.topics import ANYONE, RECORDER, RUN_END, STATUS, WAITING, Topic, topics

__all__ = ["GraphNode", "Tap"]

Tap = Callable[[str, int, int, bytes], None]
"""Takes what a node publishes, in the same process: topic, cycle, stamp in ns, CDR bytes."""

MANY = 5000
"""Depth of toolpath/segment and program/event: more segments and events than there can be in a window of cycles."""
MATCHING_PERIOD = 0.02
"""s of wall time between two looks at whether everyone is there."""
STARTUP_TIMEOUT = 60.0
"""s of wall time for all nodes to appear: ten processes on two busy cores take a tenth of it."""


class GraphNode(LifecycleNode):
    """One node of the graph. A subclass gives `prepare` (its step object) and `step`, or takes its own inputs.

    `parameters` are those of the machine and the run by dotted key (None: from the command line's --params-file);
    `tap` takes the place of the recorder's subscriptions where the recorder lives in this process.
    """

    handled: tuple[str, ...] = ()
    """Topics that the node takes message by message instead of joined by cycle."""
    changeable: tuple[str, ...] = ()
    """Run parameters that may be set while the node lives."""
    joins = True
    """Whether its other inputs are joined by cycle; if not, it does not subscribe to them."""

    def __init__(
        self,
        name: str,
        *,
        context: Context | None = None,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        tap: Tap | None = None,
    ) -> None:
        super().__init__(
            name,
            context=context,
            namespace=namespace,
            use_global_arguments=parameters is None,
            parameter_overrides=overrides(parameters or {}),
            automatically_declare_parameters_from_overrides=True,
        )
        self.tap = tap
        self.full_name = name
        self.ended: End | None = None
        self._configured = self._active = self._matched = False
        self._last_step = time.monotonic()

    # What a subclass gives ------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Make the step object from `self.setup` and `self.run`. Raises PkmError for what it refuses."""

    def start(self) -> None:
        """Called once, when everyone that must hear this node is there."""

    def may_step(self) -> bool:
        """Whether the next cycle, complete with its joined inputs, may be stepped."""
        return True

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """Do one cycle; `inputs` in the order of the topic table."""

    def take_message(self, topic: str, data: bytes) -> None:
        """Take one message of a topic in `handled`."""

    def waits_for(self) -> Report | None:
        """For whom the node waits; None while for nobody."""
        missing = self.join.missing()
        if not missing:
            return None
        return Report(self.full_name, missing[0].publisher, missing[0].name, self.join.cycle)

    def close(self) -> None:
        """Called once when the run has ended, however it ended."""

    def current_cycle(self) -> int:
        """The cycle that the node does next."""
        return self.join.cycle

    def ignored(self) -> int:
        """How many messages were ignored because they had come before."""
        return self.join.ignored

    def figures(self) -> dict[str, str]:
        """The node's own figures for /diagnostics."""
        return {}

    # Life cycle -----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, make the step object and the topics."""
        try:
            self.setup, self.run = read_parameters(self, self.changeable)
            self.axis = self._axis()
            self.full_name = f"{self.axis}/{self.get_name()}" if self.axis else self.get_name()
            self.topics = topics(tuple(self.setup.axes), self.setup.tcp_control.active, self.setup.coupled)
            self.prepare()
        except PkmError as error:
            self.ended = End(0, self.full_name, str(error), error.exit_code)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would turn it into an error state without a word
            self.ended = End(0, self.full_name, f"internal error: {error!r}")
            raise
        self._make_publishers()
        self._make_subscriptions()
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._matching = self.create_timer(MATCHING_PERIOD, self._look_for_all, clock=clock)
        self.create_timer(self._watchdog.period, self._watch, clock=clock)
        self._configured = True
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take part: wait until everyone is there, then step whatever arrives."""
        result = super().on_activate(state)
        self._active = True
        self._appear_by = time.monotonic() + STARTUP_TIMEOUT
        self._guard(self._step_all)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the run: in the middle of it that is a fault, and a fault goes through the error state."""
        self.fail("deactivated by a life cycle command")
        self._active = False
        super().on_deactivate(state)
        faulted = self.ended is not None and not self.ended.completed
        return TransitionCallbackReturn.ERROR if faulted else TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A node that is shut down ends the run of all."""
        self.fail("shut down by a life cycle command")
        return super().on_shutdown(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refused: a node lives for one run."""
        return TransitionCallbackReturn.FAILURE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A fault is final: the node does not come back to life."""
        return TransitionCallbackReturn.FAILURE

    def _axis(self) -> str:
        if self.get_name() not in ("servo_drive", "plant"):
            return ""
        axis = self.get_namespace().rpartition("/")[2]
        if axis not in self.setup.axes:
            known = ", ".join(self.setup.axes)
            raise InputError(f"{self.get_name()}: namespace {self.get_namespace()} must end in an axis ({known})")
        return axis

    # Topics ---------------------------------------------------------------------------------------------------------

    def _make_publishers(self) -> None:
        self._senders: dict[str, Any] = {}
        self._pack: dict[str, Any] = {}
        self._listeners: dict[str, set[str]] = {}
        for topic in self.topics.values():
            if topic.publisher in (self.full_name, ANYONE):
                kind, name = message_class(topic.typename), self._resolve(topic)
                self._senders[topic.name] = self.create_lifecycle_publisher(kind, name, self._qos(topic))
                tapped = self.tap is not None and topic.recorded and topic.publisher != ANYONE
                self._listeners[topic.name] = set(topic.subscribers) - ({RECORDER} if tapped else set())
                if topic.fixed_size:
                    self._pack[topic.name] = topic.codec.pack
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def _make_subscriptions(self) -> None:
        joined = [
            topic
            for topic in self.topics.values()
            if self.joins and topic.record and self.full_name in topic.subscribers and topic.name not in self.handled
        ]
        self.join = CycleJoin(joined)
        for slot, topic in enumerate(joined):
            self._subscribe(topic.name, partial(self._receive, slot, topic.codec.unpack))
        for name in self.handled:
            self._subscribe(name, partial(self._receive_handled, name))
        self._watchdog = Watchdog(self.setup.graph.watchdog)
        self._subscribe(WAITING, self._receive_waiting)
        self._subscribe(RUN_END, self._receive_end)

    def _subscribe(self, name: str, callback: Callable[[bytes], None]) -> None:
        topic = self.topics[name]
        kind = message_class(topic.typename)
        self.create_subscription(kind, self._resolve(topic), callback, self._qos(topic), raw=True)

    def _resolve(self, topic: Topic) -> str:
        if not self.axis:
            return topic.name
        axis, _, rest = topic.name.partition("/")
        return rest if axis == self.axis else f"{self._root()}/{topic.name}"

    def _root(self) -> str:
        namespace = self.get_namespace()
        return (namespace.rpartition("/")[0] if self.axis else namespace).rstrip("/")

    def _qos(self, topic: Topic) -> QoSProfile:
        latched = topic.name in ("run_info", "toolpath/segment", STATUS, RUN_END)
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=MANY if topic.name in ("toolpath/segment", "program/event") else max(64, 4 * self.setup.graph.window),
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def publish(self, name: str, cycle: int, values: tuple[Any, ...]) -> None:
        """Publish a message of fixed size from its record."""
        stamp = cycle * self.setup.servo_period_ns
        self.send(name, cycle, self._pack[name](cycle, stamp, values))

    def send(self, name: str, cycle: int, data: bytes) -> None:
        """Publish CDR bytes."""
        self._senders[name].publish(data)
        if self.tap is not None:
            self.tap(name, cycle, cycle * self.setup.servo_period_ns, data)

    # Start ----------------------------------------------------------------------------------------------------------

    def _look_for_all(self) -> None:
        if not self._active or self._matched or self.ended is not None:
            return
        obstacle = next((text for name in self._senders if (text := self._obstacle(name))), "")
        if not obstacle:
            self._matched = True
            self._matching.cancel()
            self._last_step = time.monotonic()
            self._guard(self.start)
            self._guard(self._step_all)
        elif time.monotonic() > self._appear_by:
            self.fail(f"{obstacle} (waited {STARTUP_TIMEOUT:g} s)")

    def _obstacle(self, name: str) -> str:
        """Why a topic cannot be used yet; empty when everyone who must hear it does. A killed node counts for 20 s."""
        sender, listeners = self._senders[name], self._listeners[name]
        if self.topics[name].publisher != ANYONE and self.count_publishers(sender.topic_name) > 1:
            return (
                f"{sender.topic_name} has another publisher: another machine runs in this ROS domain and namespace; "
                "give this one its own ROS_DOMAIN_ID or namespace"
            )
        there = {
            f"{end.node_namespace}/{end.node_name}".replace("//", "/").removeprefix(f"{self._root()}/")
            for end in self.get_subscriptions_info_by_topic(sender.topic_name)
        }
        if not listeners <= there:
            return f"{min(listeners - there)} has not appeared"
        return "" if sender.get_subscription_count() >= len(listeners) else f"{sender.topic_name} is not heard by all"

    # Stepping -------------------------------------------------------------------------------------------------------

    def _receive(self, slot: int, unpack: Callable[[bytes], tuple[int, tuple[Any, ...]]], data: bytes) -> None:
        if self.ended is not None:
            return
        try:
            cycle, values = unpack(data)
            if self.join.offer(slot, cycle, values):
                self._step_all()
        except PkmError as error:
            self.fail(str(error))
        except ValueError as error:
            self.fail(f"{self.join.inputs[slot].name}: {error}")

    def _step_all(self) -> None:
        while self.running and self.join.complete and self.may_step():
            cycle = self.join.cycle
            self.step(cycle, self.join.take())
            self._last_step = time.monotonic()

    @property
    def running(self) -> bool:
        """Whether the node takes part in a run that has begun and not ended."""
        return self._active and self._matched and self.ended is None

    def _receive_handled(self, name: str, data: bytes) -> None:
        if self.ended is None:
            self._guard(partial(self.take_message, name, data))
            self._guard(self._step_all)

    def _guard(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (PkmError, ValueError) as error:
            self.fail(str(error))

    # Watchdog -------------------------------------------------------------------------------------------------------

    def alive(self) -> None:
        """The node has done something: it waits from now on."""
        self._last_step = time.monotonic()

    def _watch(self) -> None:
        if not self._active or self.ended is not None:
            return
        self._publish_diagnostics(DiagnosticStatus.OK, "running" if self._matched else "waiting for all nodes")
        waited = time.monotonic() - self._last_step
        report = self.waits_for() if self._matched and self._watchdog.too_long(waited) else None
        if report is None:
            return
        content = message(self.topics[WAITING].typename, header=(0, ""), **report._asdict())
        self._senders[WAITING].publish(serialize(content))
        if self.current_cycle() <= self.setup.graph.window:  # only later cycles show that everyone has begun
            waited -= STARTUP_TIMEOUT
        verdict = self._watchdog.verdict(waited, time.monotonic())
        if verdict:
            self.fail(verdict)

    def _receive_waiting(self, data: bytes) -> None:
        report = deserialize(data, self.topics[WAITING].typename)
        self._watchdog.take(Report(report.node, report.waiting_for, report.topic, report.cycle), time.monotonic())

    # End ------------------------------------------------------------------------------------------------------------

    def fail(self, reason: str) -> None:
        """Stop the machine for a reason.

        Before everyone is there it stops this node alone: what it hears may be another machine's, which must not be
        stopped by it.
        """
        if not self._configured:
            self.ended = self.ended or End(0, self.full_name, reason)
        elif not self._matched and self.ended is None:
            self._end(End(0, self.full_name, reason))
        else:
            self.finish(End(self.current_cycle(), self.full_name, reason))

    def finish(self, end: End) -> None:
        """Tell everyone, on run_end and on /diagnostics, that the run is over."""
        if self.ended is None:
            end = self._end(end)  # first, because it may change: a bag that cannot be closed
            self._senders[RUN_END].publish(run_end(end, end.cycle * self.setup.servo_period_ns))

    def _receive_end(self, data: bytes) -> None:
        if self.ended is None:
            self._end(end_of(data))

    def _end(self, end: End) -> End:
        self.ended = end
        if not end.completed:
            self._publish_diagnostics(DiagnosticStatus.ERROR, f"{end.node}: {end.reason}")
        try:
            self.close()
        except MachineFault as error:
            self.ended = End(end.cycle, self.full_name, str(error))
        return self.ended

    def leave(self) -> None:
        """After the run: make sure that what was said is heard, then leave the life cycle."""
        if self._active:
            self._senders[RUN_END].wait_for_all_acked(Duration(seconds=1))
            self.trigger_deactivate()

    def _publish_diagnostics(self, level: bytes, text: str) -> None:
        status = DiagnosticStatus(level=level, name=f"pkm_cnc: {self.full_name}", message=text)
        figures = {"cycle": str(self.current_cycle()), "ignored messages": str(self.ignored()), **self.figures()}
        status.values = [KeyValue(key=key, value=value) for key, value in figures.items()]
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(report)
