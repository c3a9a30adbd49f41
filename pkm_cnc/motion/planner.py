"""The setpoints from one stop to the next: a time-optimal profile, smoothed where jerk is limited, and verified.

1. The path is cut into cells with limits (`path_limits`); the profile is the fastest within them (`feed_profile`).
2. With a limit of jerk, the path length of a cycle is the mean of the profile's over the last n cycles, n T being the
   longest of acceleration / jerk: still on the path, and its acceleration changes within n periods at the soonest. Low
   limits of speed are extended to both sides by half that time, so that the mean keeps them.
3. What TCP and drives do is computed for every servo cycle; where something is over its limit, the cells there are
   slowed down as much as it is over, and the profile is made anew.

The path is planned in blocks, each as if the TCP stopped at its end. What does not depend on that - where the profile
is the same if the TCP goes on as fast as it can - is sent, the rest planned again with what follows. So the path ahead
is as long as needed, and memory does not grow with the path.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple, NoReturn

from pkm_cnc.errors import MachineFault
from pkm_cnc.motion.block import Block, Plan, Settings
from pkm_cnc.motion.limits import DriveLimits, MotionParameters
from pkm_cnc.motion.piece import Piece
from pkm_cnc.motion.sampling import Sample
from pkm_cnc.records import TcpSetpoint
from pkm_cnc.tolerances import LIMIT_EXCESS

__all__ = ["Demand", "Move", "Planner", "Portion"]

BLOCK = 1024
"""Cells planned together, at least: enough to brake in from usual feeds, few enough to be planned in a moment."""
GROUP = 32
"""Pieces cut into cells together."""
STRENGTHS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""1. Parts of the acceleration with which braking is tried."""
PATIENCE = 16
"""Cycles, at least, after which a change is tried again that could not be made before."""
TRANSITION_ROUNDS = 12
"""Rounds of slowing down when a change is tried: what they do not heal lies in what is sent already."""
REFINEMENTS = 20
"""Halvings of the last cycle's braking, so that it ends at the new feed: to a millionth of a cycle's."""
ENTRIES = 4
"""How often braking is made stronger because what follows had to be slowed down."""


class Demand(NamedTuple):
    """What the operator wants of a motion: the override of its speed, 0 = rest; whether to rest after each block."""

    scale: float
    single_block: bool


class Portion(NamedTuple):
    """Setpoints to be sent next. `rests`: with the last of them the TCP rests; `ends`: at the motion's end.

    `block_ends`: it rests because a block of the program ends there. `line` is that of the last one.
    """

    setpoints: list[TcpSetpoint]
    rests: bool
    ends: bool
    block_ends: bool
    line: int


class Planner:
    """Plans each motion from a stop to the next; nothing is kept from one to the next.

    `taps` is n, the number of cycles over which a motion is smoothed: 1 without a limit of jerk.
    """

    def __init__(self, motion: MotionParameters, drives: DriveLimits, period: float) -> None:
        ramps = [motion.acceleration / motion.jerk] if motion.jerk else []
        ramps += [
            a / j for a, j in zip(drives.acceleration.tolist(), drives.jerk.tolist(), strict=True) if j < math.inf
        ]
        self.taps = max(math.ceil(max(ramps) / period), 2) if ramps else 1
        self._settings = Settings(motion, drives, period, self.taps)

    def move(self, first: Piece, others: Iterator[Piece]) -> Move:
        """The motion from rest at the start of `first` to rest at the next stop.

        Takes from `others` what the path ahead needs, and no piece after the one that has `stop`.
        """
        return Move(self._settings, first, others)


@dataclass(frozen=True)
class _Course:
    """A plan of which the first `use` setpoints are to be sent, from `block` to `then`.

    `rests`: then the TCP rests; `ready`: `then` can be planned from as it is; `following` is planned already.
    """

    block: Block
    plan: Plan
    use: int
    then: Block
    rests: bool = False
    ends: bool = False
    block_ends: bool = False
    ready: bool = False
    following: _Course | None = None


class Move:
    """One motion from stop to stop, in portions."""

    def __init__(self, settings: Settings, first: Piece, others: Iterator[Piece]) -> None:
        self._pieces = chain((first,), others)
        self._patience = max(PATIENCE, settings.taps)
        self._ended = False  # no more pieces
        self._demand = Demand(0.0, False)
        block = Block(settings, first, 1.0)
        self._course = _Course(block, Plan([], 0, [], []), 0, block, rests=True)
        self._done = 0  # setpoints of the course that are sent

    def portion(self, sent: int, demand: Demand) -> Portion:
        """What to send next; `sent` setpoints of the last portion are sent.

        What is demanded takes effect with the first of these, or as soon afterwards as the limits can be kept.
        Raises MachineFault for limits that cannot be kept, UnreachableError for a place outside the workspace.
        """
        self._done += sent
        most = None
        if demand != self._demand:
            if self._at_rest() or self._redirect(demand):
                self._demand = demand
            else:
                most = self._patience
        while self._done >= self._course.use:
            self._go_on()
        course, first = self._course, self._done
        last = course.use if most is None else min(course.use, first + most)
        setpoints, complete = course.plan.setpoints[first:last], last == course.use
        line = course.plan.samples[last - 1].piece.marks[-1].line
        return Portion(setpoints, complete and course.rests, complete and course.ends, course.block_ends, line)

    def _at_rest(self) -> bool:
        """Whether the profile rests, and what is left of its plan is the mean that comes to rest, too."""
        course, samples = self._course, self._course.plan.samples
        if self._done == 0:
            return course.rests and course.use == 0
        return course.rests and samples[self._done - 1].path == samples[-1].path

    def _go_on(self) -> None:
        """Begin the course after the one that is done."""
        course, scale = self._course, self._demand.scale
        self._done = 0
        if course.following is not None:
            self._course = course.following
            return
        block = course.then
        refuge = course.plan._replace(
            samples=course.plan.samples[course.use :], setpoints=course.plan.setpoints[course.use :]
        )
        if course.rests:
            if scale == 0.0:
                standing = Plan([], 0, [block.history[-1]], [block.sent[-1]])
                self._course = _Course(
                    block, standing, 1, block.sending(standing.samples, standing.setpoints), rests=True
                )
                return
            if not block.cells:
                block.scale = scale
            elif not course.ready or block.scale != scale:
                block = block.redirected(scale)
        self._course = self._planned(block, refuge)

    def _planned(self, block: Block, refuge: Plan) -> _Course:
        """The next course from `block`; `refuge` is how what was sent last goes on to a stop."""
        wanted = BLOCK
        while True:
            self._fill(block, wanted)
            course = self._to_line_end(block) if self._demand.single_block else None
            plan = course.plan if course else block.plan(self._ended)
            if course is not None:
                return course
            if plan is None:  # what came into view is too slow for the speed that is reached: stop before it
                if not refuge.samples:
                    return _stopping(block) or _too_fast(block)
                then = block.copy()
                then.rest(refuge)
                return _Course(block, refuge, len(refuge.samples), then, rests=True, ready=True)
            course = self._course_of(block, plan)
            if course is not None:
                if course.use > 0:
                    return course
                block, refuge, wanted = course.then, plan, BLOCK
            else:
                wanted = 2 * len(block.cells)

    def _course_of(self, block: Block, plan: Plan) -> _Course | None:
        """What of the plan is sent; None if the block is too short for that."""
        count = len(plan.samples)
        if self._ended:
            return _Course(block, plan, count, block.sending(plan.samples, plan.setpoints), rests=True, ends=True)
        if plan.final == 0:
            return None
        then = block.copy()
        return _Course(block, plan, then.commit(plan), then)

    def _to_line_end(self, block: Block) -> _Course | None:
        """To rest where the program's next line ends that can be reached at rest."""
        for path in block.line_ends():
            plan = _attempt(block.until(path))
            if plan is not None:
                return _resting(block, plan, block_ends=True)
        return None

    def _fill(self, block: Block, wanted: int) -> list[Piece]:
        """Take pieces until there are `wanted` cells, or the motion's last; return them."""
        taken = []
        while not self._ended and len(block.cells) < wanted:
            group = []
            for piece in islice(self._pieces, GROUP):
                group.append(piece)
                self._ended = piece.stop
                if piece.stop:
                    break
            block.append(group)
            taken += group
        return taken

    def _redirect(self, demand: Demand) -> bool:
        """Leave the course for what is demanded, if the limits can be kept."""
        course, done = self._course, self._done
        now = course.block.sending(course.plan.samples[:done], course.plan.setpoints[:done])
        if demand.scale == 0.0:
            found = _stopping(now)
        else:
            ended, block = self._ended, now.redirected(demand.scale)
            taken = self._fill(block, BLOCK)
            found = self._to_line_end(block) if demand.single_block else None
            found = found or self._entering(now, block)
            if found is None:
                self._ended, self._pieces = ended, chain(taken, self._pieces)
        if found is not None:
            self._course, self._done = found, 0
        return found is not None

    def _entering(self, now: Block, block: Block) -> _Course | None:
        """To `block`, which has other limits: by braking as far as it wants that."""
        for strength in STRENGTHS:
            goal = block.copy()
            for _ in range(ENTRIES):
                braking = _braking_to(now, goal, strength)
                setpoints = now.setpoints_of(braking or [])
                if braking is None or (setpoints and max(now.excess(setpoints)) > 1.0 + LIMIT_EXCESS):
                    break
                entered = goal.entered(braking, setpoints)
                plan = _attempt(entered, self._ended)
                following = None if plan is None else self._course_of(entered, plan)
                if following is not None:
                    return _Course(now, Plan([], 0, braking, setpoints), len(braking), entered, following=following)
                goal.slow_as(entered)
        return None


def _attempt(block: Block, ends: bool = False) -> Plan | None:
    try:
        return block.plan(ends, TRANSITION_ROUNDS)
    except MachineFault:
        return None


def _too_fast(block: Block) -> NoReturn:
    raise MachineFault(
        f"line {block.cells[0].piece.line}: what comes is too slow for the speed that is reached (motion.jerk, limits)"
    )


def _resting(block: Block, plan: Plan, block_ends: bool = False) -> _Course:
    then = block.sending(plan.samples, plan.setpoints)
    return _Course(block, plan, len(plan.samples), then, rests=True, block_ends=block_ends)


def _stopping(now: Block) -> _Course | None:
    """To rest as soon as possible."""
    for strength in STRENGTHS:
        samples = now.braking(strength)
        setpoints = now.setpoints_of(samples)
        if samples and max(now.excess(setpoints)) <= 1.0 + LIMIT_EXCESS:
            return _resting(now, Plan([], 0, samples, setpoints))
    return None


def _braking_to(now: Block, block: Block, strength: float) -> list[Sample] | None:
    """As few cycles of braking as entering `block` needs, the last one no stronger than needed; None: it cannot."""
    reachable = block.reachable()
    if block.enterable(now.history[-1], reachable):
        return []
    samples = now.braking(strength)
    count = bisect_left(samples, True, key=lambda sample: block.enterable(sample, reachable)) + 1
    if count > len(samples):
        return None
    before = samples[count - 2] if count > 1 else now.history[-1]
    low, high = samples[count - 1].v, before.v
    for _ in range(REFINEMENTS):
        v = 0.5 * (low + high)
        if block.enterable(now.slower(before, v), reachable):
            low = v
        else:
            high = v
    return [*samples[: count - 1], now.slower(before, low)]
