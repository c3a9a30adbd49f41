"""The setpoint of every servo cycle along a toolpath, as its program asks for and its operator allows."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Generator, Iterator
from typing import NamedTuple, Protocol

from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.motion.blending import pieces
from pkm_cnc.motion.limits import ANY_DRIVES, DriveLimits, MotionParameters
from pkm_cnc.motion.operator import Operator, Refusal
from pkm_cnc.motion.piece import Piece
from pkm_cnc.motion.planner import Demand, Planner
from pkm_cnc.motion.supply import Segment, Supply
from pkm_cnc.program import Element, Event, Totals, approach
from pkm_cnc.records import (
    CMD_START,
    PHASE_END,
    PHASE_HOLD,
    PHASE_MOVE,
    STATE_ABORTED,
    STATE_FINISHED,
    STATE_HELD,
    STATE_PROGRAM_STOP,
    STATE_READY,
    STATE_RUNNING,
    Command,
    TcpSetpoint,
)

__all__ = ["Interpolator", "Progress", "Source"]

Cycles = Generator[TcpSetpoint, bool, None]


class Source(Protocol):
    """What is run: a `Toolpath`, or a program that is read as it is run."""

    @property
    def totals(self) -> Totals:
        """What all items add up to."""

    def items(self) -> Iterator[Element | Event]:
        """Elements, each starting where the one before ends, and events, from the beginning. At least one element."""


class Progress(NamedTuple):
    """Line of the program that the setpoint is on; path length of setpoint and of all, m; time to go, s.

    The time is that of the feeds and rapids with their overrides, without speeding up and braking; NaN: not known,
    because an override is 0.
    """

    line: int
    path_position: float
    path_length: float
    time_remaining: float


class Interpolator:
    """Turns a toolpath into one TCP setpoint a cycle; every call of `step` is the next cycle.

    Cycle 0 is the toolpath's start at rest. From there it goes from stop to stop as `blending` and `planner` say. A
    motion ends in the first cycle at or after the end of its profile, there exactly at the end point with velocity and
    acceleration zero, and that cycle is the time zero of the next: a stop costs less than one period, a junction that
    is passed nothing. The path ahead is planned in blocks, in the cycle that begins them. Without `drives` they may do
    anything.

    `attended`: an operator starts the program and lets it go on after M0, and (`optional_stop`) after M1; else it
    starts by itself, passes both, and an abort is a MachineFault. Commands take effect in the cycle of the next `step`.
    No cycle is spent on waiting: where `waits_for_operator`, `step` may be called only after a command that ends it.
    After an abort and a reset the program is run anew, led to its beginning by a rapid that `check` may refuse
    (InputError).

    `needs_feedback` says that the next setpoint depends on whether the TCP was in position in the last cycle (only
    while holding); `finished` that the last setpoint, the only one of PHASE_END, is out. `servo_period` is in s.
    """

    needs_feedback: bool
    finished: bool
    _segment: Segment  # that of the last setpoint
    _rests: bool | None  # at rest within a motion: whether that is a rapid

    def __init__(
        self,
        source: Source,
        parameters: MotionParameters,
        servo_period: float,
        drives: DriveLimits = ANY_DRIVES,
        *,
        attended: bool = False,
        optional_stop: bool = False,
        check: Callable[[Element], None] | None = None,
    ) -> None:
        self.finished = False
        self._source = source
        self._parameters = parameters
        self._period = servo_period
        self._attended = attended
        self._stops = ("program_stop", "optional_stop") if optional_stop else ("program_stop",)
        self._check = check
        self._planner = Planner(parameters, drives, servo_period)
        self._operator = Operator(STATE_READY if attended else STATE_RUNNING)
        self._changed = False  # the operator's wishes since the motion was planned
        self._standing = True
        self._last: TcpSetpoint | None = None
        self._segments: list[Segment] = []
        self._events: list[Event] = []
        self._begin(None)

    def _begin(self, rapid: Element | None) -> None:
        """Run the source from its first item on, after `rapid`."""
        self.needs_feedback, self._rests = False, None  # whatever an abort has cut off
        self._totals = dataclasses.replace(self._source.totals)
        self._passed = Totals()
        index, path_length = 0, 0.0
        if rapid is not None:
            self._totals.add(rapid)
        if self._last is not None:
            index, path_length = self._segment.number + 1, self._segment.path_start + self._segment.element.length
        self._path_start = path_length
        self._supply = Supply(_led_by(rapid, self._source.items()), index, path_length)
        path = pieces(self._supply, self._parameters, self._planner.taps > 1, index, path_length)
        self._cycles = self._program(path)

    @property
    def operator(self) -> Operator:
        """State, overrides and single block as they are after the last command and the last setpoint."""
        return self._operator

    @property
    def state(self) -> int:
        """STATE_*."""
        return self._operator.state

    @property
    def waits_for_operator(self) -> bool:
        """Whether there is no next setpoint until a command: machine time stands still."""
        operator = self._operator
        if operator.state == STATE_ABORTED and not self._attended:
            return False
        return operator.waits or (self._rests is not None and operator.override(self._rests) == 0.0)

    def command(self, command: Command) -> str:
        """Take a command of the operator; return "" or why it is refused, in one line."""
        try:
            operator = self._operator.commanded(command)
            if command.kind == CMD_START and self._last is not None:
                self._begin(self._approach())
        except (Refusal, InputError) as refusal:
            return str(refusal)
        self._operator = operator.rested() if self._standing else operator
        self._changed = True
        return ""

    def _approach(self) -> Element | None:
        assert self._last is not None
        first = next(item for item in self._source.items() if not isinstance(item, Event))
        rapid = approach((self._last.x, self._last.y, self._last.z), first, self._parameters.rapid)
        if rapid is not None and self._check is not None:
            self._check(rapid)
        return rapid

    def step(self, in_position: bool = True) -> TcpSetpoint:
        """The setpoint of the next cycle.

        `in_position`: the TCP of the cycle that the last call answered was within `in_position_tolerance` of its
        setpoint; it is looked at only when `needs_feedback`.
        Raises MachineFault when the TCP is not in position in time or an unattended run is aborted, RuntimeError after
        that or the last setpoint, and while it waits for the operator.
        """
        if self._standing:
            self._check_standing()
        try:
            setpoint = self._cycles.send(in_position) if self.needs_feedback else next(self._cycles)
        except StopIteration:
            raise RuntimeError("the interpolator has no setpoint after its last one or after a fault") from None
        if self._last is None or setpoint.segment != self._last.segment:
            self._enter(setpoint.segment)
        self._last = setpoint
        return setpoint

    def _check_standing(self) -> None:
        if self.waits_for_operator:
            raise RuntimeError("the interpolator waits for the operator")
        if self._operator.state == STATE_ABORTED:
            self._cycles.close()
            raise MachineFault(f"aborted by the operator in line {self._segment.element.line}")

    def _enter(self, index: int) -> None:
        for segment in self._supply.segments(index):
            if self._last is not None:
                self._passed.add(self._segment.element)
            self._segment = segment
            self._segments.append(segment)
        while event := self._supply.event(index):
            self._events.append(event)

    def take_segments(self) -> list[Segment]:
        """The segments come to since the last call, to be announced before the setpoint just answered."""
        taken, self._segments = self._segments, []
        return taken

    def take_events(self) -> list[Event]:
        """What the program asked for since the last call, in the cycle just answered."""
        taken, self._events = self._events, []
        return taken

    def progress(self) -> Progress:
        """Where the setpoint just answered is in the program; before the first one its beginning."""
        totals, passed, operator = self._totals, self._passed, self._operator
        feed = totals.feed_time - passed.feed_time
        rapid = totals.rapid_time - passed.rapid_time
        if self._last is None:
            return Progress(0, 0.0, totals.length, _time(feed, rapid, totals.dwell_time, operator))
        element, done = self._segment.element, self._last.path_length - self._segment.path_start
        if element.traverse:
            rapid -= done / element.feed
        else:
            feed -= done / element.feed
        remaining = _time(feed, rapid, totals.dwell_time - passed.dwell_time, operator)
        return Progress(element.line, self._last.path_length - self._path_start, totals.length, remaining)

    # the cycles

    def _program(self, path: Iterator[Piece]) -> Cycles:
        piece = next(path)
        setpoint, pending = self._last, False
        if setpoint is None:
            place = piece.shape.position(0.0)
            setpoint, pending = TcpSetpoint(*place, *(0.0,) * 6, 0.0, piece.feed, 0, PHASE_MOVE), True
        yield from self._happen(setpoint, piece.marks[0].segment, pending)
        following: Piece | None = piece
        while following is not None:
            setpoint, line = yield from self._motion(following, path)
            following, pending = next(path, None), True
            self._arrive(following is not None and following.line != line)
            if self._parameters.wait_in_position:
                yield setpoint
                yield from self._hold(setpoint)
                pending = False
            yield from self._happen(setpoint, setpoint.segment + 1, pending)
        if not self._parameters.wait_in_position:
            yield from self._hold(setpoint)
        self.finished = True
        self._operator = dataclasses.replace(self._operator, state=STATE_FINISHED)
        yield setpoint._replace(phase=PHASE_END)

    def _motion(self, first: Piece, path: Iterator[Piece]) -> Generator[TcpSetpoint, bool, tuple[TcpSetpoint, int]]:
        """To the next stop of the path; returns the setpoint that rests there, not sent yet, and its line."""
        move = self._planner.move(first, path)
        sent = 0
        while True:
            self._changed = False
            portion = move.portion(sent, self._demand(first.traverse))
            sent = 0
            self._standing, self._rests = False, None
            for setpoint in portion.setpoints[:-1] if portion.rests else portion.setpoints:
                yield setpoint
                sent += 1
                if self._changed:
                    break
            else:
                if portion.ends:
                    return portion.setpoints[-1], portion.line
                if portion.rests:
                    self._rests = first.traverse
                    self._arrive(portion.block_ends)
                    yield portion.setpoints[-1]
                    sent += 1

    def _demand(self, traverse: bool) -> Demand:
        operator = self._operator
        return Demand(0.0 if operator.stops else operator.override(traverse), operator.single_block)

    def _arrive(self, block_ends: bool) -> None:
        """Before the setpoint is sent with which the TCP rests."""
        operator, self._standing = self._operator, True
        self._operator = operator.waiting(STATE_HELD) if block_ends and operator.single_block else operator.rested()

    def _happen(self, setpoint: TcpSetpoint, index: int, pending: bool) -> Cycles:
        """What the program asks for before segment `index`; `pending`: the setpoint, which rests, is to be sent yet."""
        while event := self._supply.event(index):
            self._events.append(event)
            pending = True
            if event.kind == "dwell":
                for _ in range(math.floor((event.value or 0.0) / self._period + 0.5)):
                    yield setpoint
                self._passed.add(event)
            elif event.kind in self._stops and self._attended:
                self._operator = self._operator.waiting(STATE_PROGRAM_STOP)
                yield setpoint
                pending = False
        if pending:
            yield setpoint

    def _hold(self, setpoint: TcpSetpoint) -> Cycles:
        hold = setpoint._replace(phase=PHASE_HOLD)
        timeout = self._parameters.in_position_timeout
        cycles = 1
        self.needs_feedback = True
        while not (yield hold):
            if cycles * self._period >= timeout:
                line = self._segment.element.line
                tolerance = self._parameters.in_position_tolerance * 1e6
                raise MachineFault(
                    f"line {line}: the TCP has not come within {tolerance:g} um of its setpoint "
                    f"(motion.in_position_tolerance) in {timeout:g} s (motion.in_position_timeout) after the stop at "
                    "the end of this line"
                )
            cycles += 1
        self.needs_feedback = False


def _led_by(rapid: Element | None, items: Iterator[Element | Event]) -> Iterator[Element | Event]:
    if rapid is not None:
        yield rapid
    yield from items


def _time(feed: float, rapid: float, dwell: float, operator: Operator) -> float:
    """s, of nominal times and the overrides."""
    result = dwell
    for time, override in ((feed, operator.feed_override), (rapid, operator.rapid_override)):
        if time > 0.0:
            result += time / override if override > 0.0 else math.nan
    return result
