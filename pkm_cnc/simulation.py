"""The step loop without ROS: the same step objects as the nodes, the same messages, the same bag.

Stages without feedback (inverse and forward kinematics) work on blocks of cycles, because arrays are faster; each row
equals the single cycle bit for bit, so a run does not depend on the block length.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pkm_cnc import run_messages
from pkm_cnc.check import CheckedProgram
from pkm_cnc.config import Setup
from pkm_cnc.contour import ContourMonitor, SegmentSummary, in_position
from pkm_cnc.errors import InputError, MachineFault, UnreachableError
from pkm_cnc.kinematics import Motion, reached_rows
from pkm_cnc.motion import Interpolator, Segment
from pkm_cnc.plant import AxisPlant, ImperfectAxis, PlatformLoad
from pkm_cnc.program import Event, Program
from pkm_cnc.records import (
    PHASE_END,
    AxisCommand,
    AxisCorrection,
    AxisSetpoint,
    AxisState,
    Command,
    ContourError,
    TcpSetpoint,
    TcpState,
    Vector,
)
from pkm_cnc.run_messages import NEUTRAL, RunOptions
from pkm_cnc.servo import ServoDrive
from pkm_cnc.status import Status, StatusReports
from pkm_cnc.topics import RUN_END, STATUS, topics
from pkm_cnc.visuals import Visuals

__all__ = ["Cycle", "Sink", "make_load", "make_plant", "simulate", "simulated_cycles"]

BLOCK = 512
"""Cycles computed together: enough to make the cost of an array call small, few enough to stay in the cache."""


class Sink(Protocol):
    """Where a run is written to, e.g. a `pkm_cnc.bag.BagWriter`."""

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Take the CDR bytes of one message; `time` = its stamp, ns."""


class Cycle(NamedTuple):
    """Everything of one servo cycle; axes in the machine's order.

    `operator` are the operator's commands that take effect in this cycle, `state` is STATE_* with its setpoint,
    `events` what the program asks for in it, `statuses` what is reported of its course, `entered` the segments that the
    setpoint reaches, `summaries` those of the segments that the tool has left; `next_states` are the axes at cycle + 1,
    `corrections` None without a controller at the TCP.
    """

    cycle: int
    operator: Sequence[Command]
    state: int
    events: Sequence[Event]
    statuses: Sequence[Status]
    entered: Sequence[Segment]
    setpoint: TcpSetpoint
    axis_setpoints: list[AxisSetpoint]
    states: list[AxisState]
    commands: list[AxisCommand]
    next_states: list[AxisState]
    corrections: Sequence[AxisCorrection | None]
    tcp: TcpState
    error: ContourError
    summaries: list[SegmentSummary]


def make_plant(setup: Setup, axis: str) -> AxisPlant | ImperfectAxis:
    """The plant of one axis, at rest at the start pose."""
    parts, index = setup.axes[axis], list(setup.axes).index(axis)
    joints = setup.machine.inverse(setup.start_pose)
    start = float(joints[index])
    if not setup.imperfect(axis):
        return AxisPlant(parts.drive, parts.screw, parts.scale, parts.travel, setup.servo_period, start, axis)
    load = make_load(setup).at_rest(joints.tolist())[index] if setup.coupled else 0.0
    return ImperfectAxis(axis, parts.parts, setup.servo_period, setup.plant.steps, start, load)


def make_load(setup: Setup) -> PlatformLoad:
    """What all axes carry together."""
    return PlatformLoad(setup.actual, setup.load.mass, setup.servo_period)


def simulated_cycles(
    setup: Setup, program: CheckedProgram, commands: Iterable[tuple[int, Command]] = (), attended: bool = False
) -> Iterator[Cycle]:
    """Run a checked program cycle by cycle, the operator's commands given in their cycles.

    Raises MachineFault naming cycle and axis, after the cycles before it, also for an abort and where the run waits for
    a command that is not there; InputError for a command that is refused.
    """
    panel = _Panel(setup, program.interpolator(attended), commands)
    motion = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period)
    axes = _Axes(setup)
    controller = _TcpControl(setup) if setup.tcp_control.active else None
    monitor = ContourMonitor()
    block = BLOCK if controller is None else 1  # with it the drives need the TCP of every cycle
    cycle, rests = 0, True
    while not panel.finished:
        steps, ended = panel.steps(rests, block)
        if not steps:
            assert ended is not None
            raise ended
        setpoints = [step.setpoint for step in steps]
        axis_setpoints, unreached = _axis_setpoints(motion, setpoints, cycle)
        corrections, refused = None, None
        if controller is not None and axis_setpoints:
            corrections, refused = controller.step(cycle, setpoints[0], axis_setpoints[0], axes.states)
        rows, fault = ([], refused) if refused is not None else axes.run(axis_setpoints, cycle, corrections)
        fault = fault or unreached
        read = [[state.position for state in row.states] for row in rows]
        sliders = [[state.slider_position for state in row.states] for row in rows]
        believed, fault = _tcp(setup.machine.forward, read, cycle, fault)
        true = believed
        if sliders != read or setup.actual is not setup.machine or setup.tilt.active:
            true, fault = _tcp(setup.true_tcp, sliders[: len(believed)], cycle, fault)
        for step, row, believed_point, true_point in zip(steps, rows, believed, true, strict=False):
            for segment in step.entered:
                monitor.add_segment(*segment)
            tcp, error = monitor.step(step.setpoint, believed_point, true_point)
            summaries = monitor.finish() if step.setpoint.phase == PHASE_END else monitor.take_summaries()
            yield Cycle(cycle, *step, *row, tcp, error, summaries)
            cycle += 1
        if fault is not None or ended is not None:
            raise fault or ended  # type: ignore[misc]
        measured = true if setup.tcp_control.direct_feedback else believed
        rests = in_position(setpoints[-1], measured[-1], setup.motion.in_position_tolerance)


class _Step(NamedTuple):
    """As the fields of `Cycle`."""

    operator: Sequence[Command]
    state: int
    events: Sequence[Event]
    statuses: Sequence[Status]
    entered: Sequence[Segment]
    setpoint: TcpSetpoint


class _Panel:
    """The interpolator with an operator whose commands are known before."""

    def __init__(self, setup: Setup, interpolator: Interpolator, commands: Iterable[tuple[int, Command]]) -> None:
        self._interpolator = interpolator
        self._reports = StatusReports(setup.servo_period_ns)
        self._statuses = [self._reports.at_start(interpolator)]
        self._commands = deque(sorted(commands, key=lambda command: command[0]))
        self._cycle = 0

    @property
    def finished(self) -> bool:
        """Whether the last setpoint is out."""
        return self._interpolator.finished

    def steps(self, in_position: bool, most: int) -> tuple[list[_Step], MachineFault | None]:
        """The next cycles, up to one whose setpoint depends on what the machine does before it; a fault after them."""
        interpolator = self._interpolator
        steps: list[_Step] = []
        try:
            steps.append(self._step(in_position))
            while len(steps) < most and not interpolator.needs_feedback and not interpolator.finished:
                steps.append(self._step(True))
        except MachineFault as fault:
            return steps, fault
        return steps, None

    def _step(self, in_position: bool) -> _Step:
        interpolator = self._interpolator
        given: Sequence[Command] = self._give() if self._commands else ()
        if interpolator.waits_for_operator:
            line = interpolator.progress().line
            next_one = (
                f"whose next command is for cycle {self._commands[0][0]}" if self._commands else "who commands nothing"
            )
            raise MachineFault(f"cycle {self._cycle}: line {line}: the run waits for the operator, {next_one}")
        setpoint = interpolator.step(in_position)
        events = interpolator.take_events()
        status = self._reports.after_setpoint(self._cycle, interpolator, setpoint, len(events))
        statuses: Sequence[Status] = ()
        if status is not None or self._statuses:
            statuses, self._statuses = [*self._statuses, *([] if status is None else [status])], []
        self._cycle += 1
        return _Step(given, interpolator.state, events, statuses, interpolator.take_segments(), setpoint)

    def _give(self) -> list[Command]:
        given = []
        while self._commands and self._commands[0][0] <= self._cycle:
            command = self._commands.popleft()[1]
            reason = self._interpolator.command(command)
            if reason:
                raise InputError(f"operator's command in cycle {self._cycle}: {reason}")
            given.append(command)
            self._statuses.append(self._reports.after_command(self._interpolator))
        return given


def _axis_setpoints(
    motion: Motion, setpoints: list[TcpSetpoint], first_cycle: int
) -> tuple[list[list[AxisSetpoint]], MachineFault | None]:
    """The setpoints of the axes up to the first that cannot be reached, and that fault."""
    table = np.array([setpoint[:9] for setpoint in setpoints])
    joints, refusal = reached_rows(
        lambda *vectors: np.stack(motion(*vectors), axis=-1), table[:, 0:3], table[:, 3:6], table[:, 6:9]
    )
    rows = [list(map(AxisSetpoint._make, row)) for row in joints.tolist()]
    return rows, None if refusal is None else MachineFault(f"cycle {first_cycle + len(rows)}: {refusal}")


def _tcp(
    forward: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    joints: list[list[float]],
    first_cycle: int,
    fault: MachineFault | None,
) -> tuple[list[Vector], MachineFault | None]:
    """The TCP of rows of joints up to the first that has none, and that fault, or else the one that was before."""
    if not joints:
        return [], fault
    reached, refusal = reached_rows(forward, np.array(joints))
    points = [(x, y, z) for x, y, z in reached.tolist()]
    return points, fault if refusal is None else MachineFault(f"cycle {first_cycle + len(points)}: {refusal}")


class _AxesRow(NamedTuple):
    """As the fields of `Cycle`."""

    axis_setpoints: list[AxisSetpoint]
    states: list[AxisState]
    commands: list[AxisCommand]
    next_states: list[AxisState]
    corrections: Sequence[AxisCorrection | None]


class _TcpControl:
    """The controller that looks at the TCP, with the TCP that the contour monitor will tell of the same cycle."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._controller = setup.tcp_controller()

    def step(
        self, cycle: int, setpoint: TcpSetpoint, axis_setpoints: list[AxisSetpoint], states: list[AxisState]
    ) -> tuple[list[AxisCorrection] | None, MachineFault | None]:
        """The corrections, or why there are none."""
        try:
            believed = _point(self._setup.machine.forward([state.position for state in states]))
            true = _point(self._setup.true_tcp([state.slider_position for state in states]))
            missing = (setpoint.x - true[0], setpoint.y - true[1], setpoint.z - true[2])
            tcp = TcpState(*believed, *true, *missing)
            return self._controller.step(setpoint, axis_setpoints, states, tcp), None
        except UnreachableError as error:
            return None, MachineFault(f"cycle {cycle}: {error}")


def _point(coordinates: NDArray[np.float64]) -> Vector:
    x, y, z = coordinates.tolist()
    return x, y, z


class _Axes:
    """Drives and plants of all axes, stepped together."""

    def __init__(self, setup: Setup) -> None:
        self._names = list(setup.axes)
        self._drives = [ServoDrive(parts.drive, setup.servo_period) for parts in setup.axes.values()]
        self._plants = [make_plant(setup, axis) for axis in setup.axes]
        self._load = make_load(setup) if setup.coupled else None
        self.states = [plant.state for plant in self._plants]
        """Of the next cycle."""

    def run(
        self,
        axis_setpoints: list[list[AxisSetpoint]],
        first_cycle: int,
        corrections: Sequence[AxisCorrection | None] | None = None,
    ) -> tuple[list[_AxesRow], MachineFault | None]:
        """The rows up to the end or to the first fault, and that fault; `corrections` are those of a single cycle."""
        corrections = corrections or [None] * len(self._names)
        rows: list[_AxesRow] = []
        for cycle, setpoints in enumerate(axis_setpoints, first_cycle):
            commands, following = [], []
            try:
                loads = [0.0] * len(self._names) if self._load is None else self._load.step(self.states)
            except UnreachableError as error:
                return rows, MachineFault(f"cycle {cycle}: {error}")
            for name, drive, plant, setpoint, state, correction, load in zip(
                self._names, self._drives, self._plants, setpoints, self.states, corrections, loads, strict=True
            ):
                try:
                    commands.append(drive.step(setpoint, state, correction))
                    following.append(plant.step(commands[-1], load))
                except MachineFault as error:
                    return rows, MachineFault(f"cycle {cycle}: {name}: {error}")
            rows.append(_AxesRow(setpoints, self.states, commands, following, corrections))
            self.states = following
        return rows, None


def simulate(
    setup: Setup,
    program: Program,
    checked: CheckedProgram,
    sink: Sink | None = None,
    watch: Callable[[Cycle], None] | None = None,
    commands: Iterable[tuple[int, Command]] = (),
    options: RunOptions = NEUTRAL,
    cycles: int | None = None,
) -> int:
    """Run a program as `simulated_cycles` does, write it to `sink`, show every cycle to `watch`; return their number.

    `checked` is what `prepare` has made of `program` from `options.from_line` on; `cycles`: stop after so many. Raises
    MachineFault; the sink then holds the cycles before the fault and the reason of the end.
    """
    recording = None if sink is None else _Recording(setup, program, options, sink)
    reason = "" if cycles is None else f"stopped after {cycles} cycles"
    count = 0
    try:
        for cycle in itertools.islice(simulated_cycles(setup, checked, commands, options.attended), cycles):
            count += 1
            if recording is not None:
                recording.put(cycle)
            if watch is not None:
                watch(cycle)
    except MachineFault as fault:
        if recording is not None:
            recording.end(run_messages.End(count, "simulation", str(fault)))
        raise
    if recording is not None:
        recording.end(run_messages.End(count if reason else count - 1, "simulation", reason))
    return count


class _Recording:
    """Writes cycles as the messages that the graph's recorder would hold."""

    def __init__(self, setup: Setup, program: Program, options: RunOptions, sink: Sink) -> None:
        self._period = setup.servo_period_ns
        self._axes = list(setup.axes)
        self._blocks = program.text.split("\n")
        self._sink = sink
        self._pack = {
            topic.name: topic.codec.pack
            for topic in topics(self._axes, setup.tcp_control.active).values()
            if topic.record
        }
        self._visuals = Visuals(setup.actual, self._axes, setup.servo_period_ns)
        sink.write("run_info", 0, run_messages.run_info(setup, program, options))

    def _tell(self, done: Cycle, time: int) -> None:
        for command in done.operator:
            self._sink.write("operator/command", time, run_messages.operator_command(command, done.cycle, time))
        for index, element, start in done.entered:
            self._sink.write("toolpath/segment", time, run_messages.segment(index, element, start, time))
            self._visuals.add(element)
        for event in done.events:
            self._sink.write("program/event", time, run_messages.program_event(event, done.cycle, time))
        for status in done.statuses:
            self._sink.write(STATUS, time, run_messages.controller_status(status, self._blocks, done.cycle, time))

    def _servo(self, topic: str, cycle: int, values: Any) -> None:
        time = cycle * self._period
        self._sink.write(topic, time, self._pack[topic](cycle, time, values))

    def put(self, done: Cycle) -> None:
        """Write one cycle."""
        number, time = done.cycle, done.cycle * self._period
        self._tell(done, time)
        self._servo("tcp/setpoint", number, done.setpoint)
        for place, axis in enumerate(self._axes):
            self._servo(f"{axis}/setpoint", number, done.axis_setpoints[place])
            if number == 0:
                self._servo(f"{axis}/actual", number, done.states[place])
            self._servo(f"{axis}/command", number, done.commands[place])
            self._servo(f"{axis}/actual", number + 1, done.next_states[place])
            correction = done.corrections[place]
            if correction is not None:
                self._servo(f"{axis}/correction", number, correction)
        for topic, data in self._visuals.step(number, done.states, done.tcp):
            self._sink.write(topic, time, data)
        for summary in done.summaries:
            data = run_messages.segment_summary(summary, time)
            self._sink.write("contour_monitor/segment_summary", time, data)
        self._servo("tcp/state", number, done.tcp)
        self._servo("contour_error", number, done.error)

    def end(self, end: run_messages.End) -> None:
        """Note how the run ended."""
        time = end.cycle * self._period
        self._sink.write(RUN_END, time, run_messages.run_end(end, time))
