"""The setpoint of every servo cycle along a toolpath."""

from __future__ import annotations

from collections.abc import Generator

from pkm_cnc.errors import MachineFault
from pkm_cnc.motion.blending import pieces
from pkm_cnc.motion.limits import ANY_DRIVES, DriveLimits, MotionParameters
from pkm_cnc.motion.planner import Planner
from pkm_cnc.program import Toolpath
from pkm_cnc.records import PHASE_END, PHASE_HOLD, PHASE_MOVE, TcpSetpoint

__all__ = ["Interpolator"]

Cycles = Generator[TcpSetpoint, bool, TcpSetpoint]


class Interpolator:
    """Turns a toolpath into one TCP setpoint a cycle; every call of `step` is the next cycle.

    Cycle 0 is the toolpath's start at rest. From there it goes from stop to stop as `blending` and `planner` say. A
    motion ends in the first cycle at or after the end of its profile, there exactly at the end point with velocity and
    acceleration zero, and that cycle is the time zero of the next: a stop costs less than one period, a junction that
    is passed nothing. The path ahead is planned in blocks, in the cycle that begins them. Without `drives` they may do
    anything.

    `needs_feedback` says that the next setpoint depends on whether the TCP was in position in the last cycle (only
    while holding); `finished` that the last setpoint, the only one of PHASE_END, is out. `servo_period` is in s.
    """

    needs_feedback: bool
    finished: bool

    def __init__(
        self, toolpath: Toolpath, parameters: MotionParameters, servo_period: float, drives: DriveLimits = ANY_DRIVES
    ) -> None:
        self.needs_feedback = False
        self.finished = False
        self._elements = toolpath.elements
        self._parameters = parameters
        self._period = servo_period
        self._drives = drives
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
        setpoint = TcpSetpoint(*first.start, *(0.0,) * 6, 0.0, first.feed, 0, PHASE_MOVE)
        yield setpoint
        planner = Planner(self._parameters, self._drives, self._period)
        path = pieces(self._elements, self._parameters, smooth=planner.taps > 1)
        while piece := next(path, None):
            for setpoint in planner.move(piece, path):
                yield setpoint
            if self._parameters.wait_in_position:
                setpoint = yield from self._hold(setpoint)
        if not self._parameters.wait_in_position:
            setpoint = yield from self._hold(setpoint)
        self.finished = True
        yield setpoint._replace(phase=PHASE_END)
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
