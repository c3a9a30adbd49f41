"""What the operator may command when, and what he has commanded: a state machine without any motion.

| state | goes on with |
|---|---|
| ready | start |
| running | hold, abort; at a program stop and after a single block by itself to a wait |
| holding, held | resume, abort |
| program stop | resume, abort |
| aborting, aborted | reset, as soon as the TCP rests |

Overrides and single block may be set at any time before the end.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from pkm_cnc.records import (
    CMD_ABORT,
    CMD_FEED_OVERRIDE,
    CMD_HOLD,
    CMD_RAPID_OVERRIDE,
    CMD_RESET,
    CMD_RESUME,
    CMD_SINGLE_BLOCK,
    CMD_START,
    STATE_ABORTED,
    STATE_ABORTING,
    STATE_FINISHED,
    STATE_HELD,
    STATE_HOLDING,
    STATE_PROGRAM_STOP,
    STATE_READY,
    STATE_RUNNING,
    Command,
)

__all__ = ["LARGEST_OVERRIDE", "STATE_NAMES", "Operator", "Refusal"]

LARGEST_OVERRIDE = 2.0
"""Largest feed and rapid override, as on the panels of machine tools: 200 %."""

STATE_NAMES = {
    STATE_READY: "ready",
    STATE_RUNNING: "running",
    STATE_HOLDING: "holding",
    STATE_HELD: "held",
    STATE_PROGRAM_STOP: "program stop",
    STATE_ABORTING: "aborting",
    STATE_ABORTED: "aborted",
    STATE_FINISHED: "finished",
}
"""What people read of a state."""
_TRANSITIONS = {
    CMD_START: ("start", {STATE_READY: STATE_RUNNING}),
    CMD_HOLD: ("hold", {STATE_RUNNING: STATE_HOLDING}),
    CMD_RESUME: (
        "resume",
        {STATE_HOLDING: STATE_RUNNING, STATE_HELD: STATE_RUNNING, STATE_PROGRAM_STOP: STATE_RUNNING},
    ),
    CMD_ABORT: (
        "abort",
        dict.fromkeys((STATE_RUNNING, STATE_HOLDING, STATE_HELD, STATE_PROGRAM_STOP), STATE_ABORTING),
    ),
    CMD_RESET: ("reset", {STATE_ABORTED: STATE_READY}),
}
_RESTS = {STATE_HOLDING: STATE_HELD, STATE_ABORTING: STATE_ABORTED}
_WAITS = frozenset((STATE_READY, STATE_HELD, STATE_PROGRAM_STOP, STATE_ABORTED))


class Refusal(Exception):
    """Why a command is not taken, in one line."""


@dataclass(frozen=True)
class Operator:
    """What has been commanded: `state` STATE_*, overrides 0 to 2, whether to stop after each block."""

    state: int
    feed_override: float = 1.0
    rapid_override: float = 1.0
    single_block: bool = False

    def commanded(self, command: Command) -> Operator:
        """After `command`. Raises Refusal."""
        kind, value = command
        if kind in _TRANSITIONS:
            return self._changed(*_TRANSITIONS[kind])
        if self.state == STATE_FINISHED:
            raise Refusal("the program is finished")
        if kind in (CMD_FEED_OVERRIDE, CMD_RAPID_OVERRIDE):
            name = "feed_override" if kind == CMD_FEED_OVERRIDE else "rapid_override"
            if not (math.isfinite(value) and 0.0 <= value <= LARGEST_OVERRIDE):
                raise Refusal(f"{name} {value:g} is not from 0 to {LARGEST_OVERRIDE:g}")
            if kind == CMD_FEED_OVERRIDE:
                return dataclasses.replace(self, feed_override=float(value))
            return dataclasses.replace(self, rapid_override=float(value))
        if kind == CMD_SINGLE_BLOCK:
            if value not in (0.0, 1.0):
                raise Refusal(f"single_block {value:g} is neither 0 nor 1")
            return dataclasses.replace(self, single_block=bool(value))
        raise Refusal(f"there is no command of kind {kind}")

    def _changed(self, name: str, transitions: dict[int, int]) -> Operator:
        if self.state not in transitions:
            possible = " or ".join(STATE_NAMES[state] for state in transitions)
            raise Refusal(f"{name} is not possible in state {STATE_NAMES[self.state]}: it needs {possible}")
        return dataclasses.replace(self, state=transitions[self.state])

    def rested(self) -> Operator:
        """When the TCP has come to rest: a hold or an abort is done."""
        return dataclasses.replace(self, state=_RESTS.get(self.state, self.state))

    def waiting(self, state: int) -> Operator:
        """When the program itself comes to a wait (or its end), unless an abort or hold is under way already."""
        return dataclasses.replace(self, state=state) if self.state == STATE_RUNNING else self.rested()

    @property
    def waits(self) -> bool:
        """Whether nothing happens until a command."""
        return self.state in _WAITS

    @property
    def stops(self) -> bool:
        """Whether the TCP is to come to rest as soon as the limits allow."""
        return self.state in _RESTS

    def override(self, traverse: bool) -> float:
        """The factor of the speed of rapids, or of the feed."""
        return self.rapid_override if traverse else self.feed_override
