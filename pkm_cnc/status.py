"""Where the controller is in the part program, as told to people ten times a second of machine time."""

from __future__ import annotations

import math
from typing import NamedTuple

from pkm_cnc.motion import Interpolator
from pkm_cnc.records import (
    STATE_ABORTED,
    STATE_HELD,
    STATE_PROGRAM_STOP,
    STATE_READY,
    TcpSetpoint,
)

__all__ = ["GOES_ON_WITH", "Status", "StatusReports"]

GOES_ON_WITH = {
    STATE_READY: "start",
    STATE_HELD: "resume",
    STATE_PROGRAM_STOP: "resume",
    STATE_ABORTED: "reset",
}
"""The service that a state waits for."""
PERIOD_NS = 100_000_000
"""ns of machine time between two reports: 10 Hz."""


class Status(NamedTuple):
    """State (STATE_*), line of the program, m, m, m/s, m/s, s, factors; NaN = not known.

    `feed` is the path speed of the setpoint, `path_length` that of the whole contour. `commands` and `events` count
    what the operator has commanded and the program asked for so far.
    """

    state: int
    line: int
    path_position: float
    path_length: float
    feed: float
    programmed_feed: float
    time_remaining: float
    feed_override: float
    rapid_override: float
    single_block: bool
    commands: int
    events: int


class StatusReports:
    """Decides when to report what of one run. It looks at machine time alone, so that equal runs report the same."""

    def __init__(self, servo_period_ns: int) -> None:
        self._cycles = max(1, PERIOD_NS // servo_period_ns)
        self._state = 0
        self._setpoint: TcpSetpoint | None = None
        self._commands = self._events = 0

    def at_start(self, interpolator: Interpolator) -> Status:
        """What to report before the first setpoint."""
        return self._of(interpolator)

    def after_command(self, interpolator: Interpolator) -> Status:
        """What to report after a command was accepted."""
        self._commands += 1
        return self._of(interpolator)

    def after_setpoint(
        self, cycle: int, interpolator: Interpolator, setpoint: TcpSetpoint, events: int
    ) -> Status | None:
        """What to report after the setpoint of `cycle`, with which so many events happened: when it is time, and when
        the state is another one.
        """
        self._setpoint = setpoint
        self._events += events
        if cycle % self._cycles and interpolator.state == self._state:
            return None
        return self._of(interpolator)

    def _of(self, interpolator: Interpolator) -> Status:
        self._state = interpolator.state
        setpoint, progress, operator = self._setpoint, interpolator.progress(), interpolator.operator
        vx, vy, vz = (0.0, 0.0, 0.0) if setpoint is None else (setpoint.vx, setpoint.vy, setpoint.vz)
        return Status(
            state=interpolator.state,
            line=progress.line,
            path_position=progress.path_position,
            path_length=progress.path_length,
            feed=math.sqrt(vx * vx + vy * vy + vz * vz),
            programmed_feed=0.0 if setpoint is None else setpoint.feed,
            time_remaining=progress.time_remaining,
            feed_override=operator.feed_override,
            rapid_override=operator.rapid_override,
            single_block=operator.single_block,
            commands=self._commands,
            events=self._events,
        )
