"""The setpoint of every servo cycle along a toolpath."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Generator, Iterator, Sequence

from pkm_cnc.errors import MachineFault
from pkm_cnc.motion.feed_profile import FeedProfile
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Element, Toolpath
from pkm_cnc.records import PHASE_END, PHASE_HOLD, PHASE_MOVE, TcpSetpoint, Vector

__all__ = ["Interpolator", "MotionParameters"]

Cycles = Generator[TcpSetpoint, bool, TcpSetpoint]


@dataclasses.dataclass(frozen=True)
class MotionParameters:
    """How the TCP moves along the contour: the section `motion` of a machine file."""

    acceleration: float = parameter(
        2.0,
        "Largest change of the path speed, speeding up and braking. The acceleration across the path, v^2/r on an arc, "
        "is not limited by it. The default reaches 6000 mm/min within 2.5 mm, so that test contours are run at their "
        "feed but for their ends, and is common for the axes of machine tools.",
        unit="m/s^2",
        above=0.0,
    )
    rapid: float = parameter(
        1.0 / 6.0,
        "Path speed of rapids, which G0 gives its elements as their feed. The default, 10 m/min, is above the feeds of "
        "the usual tests and moderate for a machine.",
        unit="m/s",
        above=0.0,
    )
    tangent_angle: float = parameter(
        0.01,
        "Two feed elements that meet at a larger angle are joined by a stop, others are passed without slowing down. "
        "The default lets pass what rounding to 0.001 mm turns the direction of an element of 0.1 mm, and is a jump of "
        "the velocity of 1 % of the feed at most.",
        unit="rad",
        minimum=0.0,
        maximum=0.5,
    )
    wait_in_position: bool = parameter(
        False,
        "Wait at every stop, not only at the end of the program, until the TCP is in position. Off by default, as in "
        "the exact path mode (G61) of RS-274: a corner is a stop of the setpoint, the axes need not have caught up.",
    )
    in_position_tolerance: float = parameter(
        40e-6,
        "The TCP is in position when the controller believes it this close to the setpoint. The default is twice the "
        "resolution of the linear scale of the thesis (20 um): with a coarse scale a finer one may never be met.",
        unit="m",
        above=0.0,
    )
    in_position_timeout: float = parameter(
        10.0,
        "Longest time to wait for the TCP to be in position; longer is a fault. The default is far above what drives "
        "need to settle (at Kv = 16.7 1/s the lag falls to a millionth within 0.9 s) and short for somebody who waits.",
        unit="s",
        above=0.0,
    )


class Interpolator:
    """Turns a toolpath into one TCP setpoint a cycle; every call of `step` is the next cycle.

    Cycle 0 is the toolpath's start at rest. Elements form runs from stop to stop, each a time-optimal `FeedProfile`. A
    run ends in the first cycle at or after the end of its profile, there exactly at its end point with velocity and
    acceleration zero, and that cycle is the time zero of the next run: a stop costs less than one period, a tangent
    junction nothing. Runs are planned one at a time, in the cycle that begins them.

    `needs_feedback` says that the next setpoint depends on whether the TCP was in position in the last cycle (only
    while holding); `finished` that the last setpoint, the only one of PHASE_END, is out. `servo_period` is in s.
    """

    needs_feedback: bool
    finished: bool

    def __init__(self, toolpath: Toolpath, parameters: MotionParameters, servo_period: float) -> None:
        self.needs_feedback = False
        self.finished = False
        self._elements = toolpath.elements
        self._starts = toolpath.starts
        self._parameters = parameters
        self._period = servo_period
        self._cycles = self._program()

    def step(self, in_position: bool = True) -> TcpSetpoint:
        """The setpoint of the next cycle.

        `in_position`: the TCP of the cycle that the last call answered was within `in_position_tolerance` of its
        setpoint; it is looked at only when `needs_feedback`.
        Raises MachineFault when the TCP is not in position in time, RuntimeError after that or the last setpoint.
        """
        try:
            return self._cycles.send(in_position) if self.needs_feedback else next(self._cycles)
        except StopIteration:
            raise RuntimeError("the interpolator has no setpoint after its last one or after a fault") from None

    def _program(self) -> Cycles:
        first = self._elements[0]
        setpoint = self._rest(0, first.start, 0.0)
        yield setpoint
        for run in _runs(self._elements, self._parameters.tangent_angle):
            setpoint = yield from self._move(run)
            if self._parameters.wait_in_position or run.stop == len(self._elements):
                setpoint = yield from self._hold(setpoint)
        self.finished = True
        yield setpoint._replace(phase=PHASE_END)
        return setpoint

    def _move(self, run: range) -> Cycles:
        elements = self._elements[run.start : run.stop]
        profile = FeedProfile(
            [element.length for element in elements],
            [element.feed for element in elements],
            self._parameters.acceleration,
        )
        cycle = 1
        while (t := cycle * self._period) < profile.duration:
            index, s, v, a = profile.at(t)
            yield self._moving(run.start + index, s, v, a)
            cycle += 1
        setpoint = self._rest(run.stop - 1, elements[-1].end, elements[-1].length)
        yield setpoint
        return setpoint

    def _hold(self, setpoint: TcpSetpoint) -> Cycles:
        hold = setpoint._replace(phase=PHASE_HOLD)
        timeout = self._parameters.in_position_timeout
        cycles = 1
        self.needs_feedback = True
        while not (yield hold):
            if cycles * self._period >= timeout:
                line = self._elements[hold.segment].line
                tolerance = self._parameters.in_position_tolerance * 1e6
                raise MachineFault(
                    f"line {line}: the TCP has not come within {tolerance:g} um of its setpoint "
                    f"(motion.in_position_tolerance) in {timeout:g} s (motion.in_position_timeout) after the stop at "
                    "the end of this line"
                )
            cycles += 1
        self.needs_feedback = False
        return hold

    def _moving(self, index: int, s: float, v: float, a: float) -> TcpSetpoint:
        element = self._elements[index]
        x, y, z = element.position(s)
        tx, ty, tz = element.tangent(s)
        cx, cy, cz = element.curvature(s)
        w = v * v
        ax, ay, az = a * tx + w * cx, a * ty + w * cy, a * tz + w * cz
        path_length = self._starts[index] + s
        return TcpSetpoint(x, y, z, v * tx, v * ty, v * tz, ax, ay, az, path_length, element.feed, index, PHASE_MOVE)

    def _rest(self, index: int, position: Vector, s: float) -> TcpSetpoint:
        path_length = self._starts[index] + s
        feed = self._elements[index].feed
        return TcpSetpoint(*position, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, path_length, feed, index, PHASE_MOVE)


def _runs(elements: Sequence[Element], tangent_angle: float) -> Iterator[range]:
    """The indices of the elements from stop to stop, found one run at a time."""
    begin = 0
    for index in range(1, len(elements)):
        if not _joined(elements[index - 1], elements[index], tangent_angle):
            yield range(begin, index)
            begin = index
    yield range(begin, len(elements))


def _joined(before: Element, after: Element, tangent_angle: float) -> bool:
    if before.traverse or after.traverse:
        return False
    chord = math.dist(before.tangent(before.length), after.tangent(0.0))
    return 2.0 * math.asin(min(0.5 * chord, 1.0)) <= tangent_angle
