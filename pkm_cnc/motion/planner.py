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

import dataclasses
import math
from bisect import bisect_right
from collections.abc import Iterator
from itertools import chain, islice, pairwise
from typing import NamedTuple

from pkm_cnc.errors import MachineFault
from pkm_cnc.motion.feed_profile import Cell, FeedProfile, speeds_squared
from pkm_cnc.motion.limits import DriveLimits, MotionParameters
from pkm_cnc.motion.path_limits import PieceEnd, PlannedCell, cells_of
from pkm_cnc.motion.piece import Piece
from pkm_cnc.motion.sampling import Sample, exact_setpoints, mean_setpoints
from pkm_cnc.motion.verification import BEFORE, slow_downs
from pkm_cnc.records import TcpSetpoint
from pkm_cnc.tolerances import LIMIT_EXCESS

__all__ = ["Planner"]

BLOCK = 1024
"""Cells planned together, at least: enough to brake in from usual feeds, few enough to be planned in a moment."""
GROUP = 32
"""Pieces cut into cells together, at most."""
BLOCK_TIME = 10.0
"""s. A block is no longer than it needs to be either: at 1 mm/min a thousand cells would be millions of cycles."""
LOCAL_ROUNDS, ROUNDS = 30, 60
"""Rounds of slowing down where a limit is exceeded; then of all of the block; more are a fault."""
FIRMNESS = 2.4
"""1. w falls with this power of the factor by which a place is too fast: with 2 the rounds end as well, but there are
twice as many, because the acceleration falls with w, and with it a smoothed jerk, not with the power 1.5 of w."""
TAPER = 0.2
"""1. The part of the acceleration that is spent on entering and leaving a place that is slowed down."""


class Planner:
    """Plans each motion from a stop to the next; nothing is kept from one to the next.

    `taps` is n, the number of cycles over which a motion is smoothed: 1 without a limit of jerk.
    """

    def __init__(self, motion: MotionParameters, drives: DriveLimits, period: float) -> None:
        self.motion = motion
        self.drives = drives
        self.period = period
        ramps = [motion.acceleration / motion.jerk] if motion.jerk else []
        ramps += [
            a / j for a, j in zip(drives.acceleration.tolist(), drives.jerk.tolist(), strict=True) if j < math.inf
        ]
        self.taps = max(math.ceil(max(ramps) / period), 2) if ramps else 1

    def move(self, first: Piece, others: Iterator[Piece]) -> Iterator[TcpSetpoint]:
        """The setpoints after the one that rests at the start of `first`, to the one that rests at the next stop.

        Takes from `others` what the path ahead needs, and no piece after the one that has `stop`.
        Raises MachineFault for limits that cannot be kept, UnreachableError for a place outside the workspace.
        """
        return _Move(self, first, others).setpoints()

    def duration(self, first: Piece, others: Iterator[Piece]) -> float:
        """What `move` takes, s, but for what verification makes slower: found from the cells, not cycle by cycle."""
        return _Move(self, first, others).duration()


def _parts(pieces: Iterator[Piece]) -> Iterator[Piece]:
    """The pieces, those that take longer than BLOCK_TIME in parts."""
    for piece in pieces:
        count = max(math.ceil(piece.length / (piece.feed * BLOCK_TIME)), 1)
        part = piece.length / count
        for k in range(count - 1):
            yield dataclasses.replace(piece, begin=piece.begin + k * part, length=part, stop=False)
        begin = piece.begin + (count - 1) * part
        yield piece if count == 1 else dataclasses.replace(piece, begin=begin, length=part)


class _Plan(NamedTuple):
    """A block: w at its nodes, how many of its cells are final, the profile by cycle, and the setpoints."""

    squares: list[float]
    final: int
    samples: list[Sample]
    setpoints: list[TcpSetpoint]


class _Move:
    """One motion from stop to stop: the state between two blocks."""

    def __init__(self, planner: Planner, first: Piece, others: Iterator[Piece]) -> None:
        self._planner = planner
        self._pieces = _parts(chain((first,), others))
        self._ended = False
        self._end: PieceEnd | None = None
        self._cells: list[PlannedCell] = []
        self._slow: list[float] = []  # by cell: what its w is lowered by
        self._starts = [0.0]  # by node: path length from the last stop, m
        self._places: list[tuple[float, Piece]] = []  # path length at which the pieces begin that are not passed
        self._square, self._time, self._cycle = 0.0, 0.0, 1  # w and time at the first node; the next cycle
        self._past = [Sample(0.0, 0.0, 0.0, first, first.begin)] * (planner.taps - 1)
        self._sent = exact_setpoints([Sample(0.0, 0.0, 0.0, first, first.begin)] * BEFORE)

    def setpoints(self) -> Iterator[TcpSetpoint]:
        """See `Planner.move`."""
        blocks = 1
        refuge: _Plan | None = None  # how what is sent goes on to a stop
        while True:
            self._fill(blocks)
            plan = self._plan()
            if plan is None:  # what came into view is too slow for the speed that is reached: stop before it
                assert refuge is not None
                yield from refuge.setpoints
                self._rest(refuge)
            elif self._ended:
                yield from plan.setpoints
                return
            elif plan.final == 0:
                blocks *= 2
            else:
                blocks = 1
                count = self._commit(plan)
                yield from plan.setpoints[:count]
                refuge = plan._replace(samples=plan.samples[count:], setpoints=plan.setpoints[count:])

    def duration(self) -> float:
        """See `Planner.duration`."""
        blocks = 1
        while True:
            self._fill(blocks)
            cells, nodes = self._limits()
            squares, _ = speeds_squared(cells, nodes, self._square, 0.0)
            final = len(cells) if self._ended else self._final(cells, nodes, squares)
            blocks = 1 if final else 2 * blocks
            if final:
                self._commit(_Plan(squares, final, [], []))
            if self._ended:
                return (math.ceil(self._time / self._planner.period) - 1 + self._rests) * self._planner.period

    def _fill(self, blocks: int) -> None:
        """Take pieces until there are so many times BLOCK cells or BLOCK_TIME, or the motion's last."""
        planner = self._planner
        time = math.fsum(cell.length / math.sqrt(cell.limit) for cell, *_ in self._cells)
        while not self._ended and len(self._cells) < blocks * BLOCK and time < blocks * BLOCK_TIME:
            group = []
            for piece in islice(self._pieces, GROUP):
                group.append(piece)
                time += piece.length / piece.feed
                self._ended = piece.stop
                if piece.stop or time >= blocks * BLOCK_TIME:
                    break
            cells, self._end = cells_of(group, planner.motion, planner.drives, planner.period, self._end)
            for planned in cells:
                if not self._places or planned.piece is not self._places[-1][1]:
                    self._places.append((self._starts[-1], planned.piece))
                self._cells.append(planned)
                self._slow.append(1.0)
                self._starts.append(self._starts[-1] + planned.cell.length)

    def _plan(self) -> _Plan | None:
        """The block with all limits kept; None if it begins too fast for that. Raises MachineFault."""
        planner = self._planner
        if planner.taps == 1 and all(planned.cell.free for planned in self._cells):
            return self._unverified()
        for attempt in range(ROUNDS):
            cells, nodes = self._limits()
            squares, held = speeds_squared(cells, nodes, self._square, 0.0)
            if not held:
                return None
            samples = self._sampled(FeedProfile(cells, squares), to_rest=True)
            setpoints = self._smoothed(samples)
            excess = slow_downs([*self._sent, *setpoints], planner.motion, planner.drives, planner.period).tolist()
            worst = max(excess)
            if worst <= 1.0 + LIMIT_EXCESS:
                return _Plan(squares, self._final(cells, nodes, squares) // 2, samples, setpoints)
            self._slow_down(samples, [worst] * len(excess) if attempt >= LOCAL_ROUNDS else excess, squares)
        raise MachineFault(
            f"line {self._cells[0].piece.line}: from here on the limits cannot be kept (motion.jerk, limits): after "
            f"{ROUNDS} attempts the motion is still {100.0 * (worst - 1.0):.3g} % too fast"
        )

    def _unverified(self) -> _Plan:
        """The block where nothing limits but feeds and the path's acceleration, which the profile keeps."""
        cells, nodes = self._limits()
        squares, _ = speeds_squared(cells, nodes, self._square, 0.0)
        final = len(cells) if self._ended else self._final(cells, nodes, squares)
        if final == 0:
            return _Plan(squares, 0, [], [])
        samples = self._sampled(FeedProfile(cells[:final], squares[: final + 1]), to_rest=self._ended)
        return _Plan(squares, final, samples, exact_setpoints(samples))

    def _limits(self) -> tuple[list[Cell], list[float]]:
        """The cells and the limits of w at their ends, as far as they are slowed down."""
        assert self._end is not None
        nodes = [*(planned.node for planned in self._cells), self._end.node]
        if self._planner.taps > 1:
            nodes = self._extended(nodes)
        if min(self._slow) == 1.0:
            return [planned.cell for planned in self._cells], nodes
        cells = [
            Cell(cell.length, cell.limit * slow, tuple([(r, h * slow) for r, h in cell.lines]))
            for (cell, *_), slow in zip(self._cells, self._slow, strict=True)
        ]
        lowest = map(min, [1.0, *self._slow], [*self._slow, 1.0])
        return cells, [node * slow for node, slow in zip(nodes, lowest, strict=True)]

    def _extended(self, nodes: list[float]) -> list[float]:
        """Limits of w that the mean over `taps` cycles keeps: each reaches as far as the TCP goes in half that time."""
        half = 0.5 * (self._planner.taps - 1) * self._planner.period
        further = self._planner.motion.acceleration * half * half / 6.0
        result, starts = list(nodes), self._starts
        for k, node in enumerate(nodes):
            reach = math.sqrt(node) * half + further
            for direction in (-1, 1):
                j = k + direction
                while 0 <= j < len(nodes) and nodes[j] > node and abs(starts[j] - starts[k]) <= reach:
                    result[j] = min(result[j], node)
                    j += direction
        return result

    def _final(self, cells: list[Cell], nodes: list[float], squares: list[float]) -> int:
        """How many cells are run like that too if the TCP does not stop at the end of the block."""
        onward, _ = speeds_squared(cells, nodes, self._square, math.inf)
        for k, (stopping, going_on) in enumerate(zip(squares, onward, strict=True)):
            if stopping != going_on:
                return max(k - 1, 0)
        return len(cells)

    def _sampled(self, profile: FeedProfile, to_rest: bool) -> list[Sample]:
        """The profile in the cycles up to its end; `to_rest`: on until its mean rests at the end.

        With a limit of jerk for two cycles, so that the jerk of stopping is over before the next motion begins.
        """
        samples = []
        cycle = self._cycle
        while (t := cycle * self._planner.period - self._time) < profile.duration:
            index, s, v, a = profile.at(max(t, 0.0))
            planned = self._cells[index]
            samples.append(Sample(self._starts[index] + s, v, a, planned.piece, planned.begin + s))
            cycle += 1
        if to_rest:
            planned = self._cells[-1]
            end = planned.piece.shape.length if self._ended else planned.piece.begin + planned.piece.length
            samples += [Sample(self._starts[-1], 0.0, 0.0, planned.piece, end)] * self._rests
        return samples

    @property
    def _rests(self) -> int:
        """In how many cycles the profile rests at a stop, so that its mean does, and its jerk is over."""
        taps = self._planner.taps
        return taps + 1 if taps > 1 else 1

    def _smoothed(self, samples: list[Sample]) -> list[TcpSetpoint]:
        if self._planner.taps == 1:
            return exact_setpoints(samples)
        return mean_setpoints([*self._past, *samples], self._planner.taps, self._places)

    def _slow_down(self, samples: list[Sample], excess: list[float], squares: list[float]) -> None:
        """Lower the limits of the cells in which the setpoints are made that exceed theirs, and less and less beside.

        A step in the limits would cost an acceleration there and be the next place to exceed one.
        """
        taps, last = self._planner.taps, len(samples) - 1
        paths = [sample.path for sample in (*self._past, *samples)]  # the mean of cycle k is of k to k + taps - 1
        lowered = [1.0] * len(self._slow)
        for k, factor in enumerate(excess):
            if factor > 1.0:
                begin = bisect_right(self._starts, paths[max(k - BEFORE, 0)]) - 1
                end = bisect_right(self._starts, paths[min(k + 1, last) + taps - 1])
                for index in range(max(begin, 0), min(end, len(lowered))):
                    lowered[index] = min(lowered[index], factor**-FIRMNESS)
        slope = 2.0 * TAPER * self._planner.motion.acceleration
        rises = [
            slope * (end - begin) / max(w0, w1)
            for (begin, end), (w0, w1) in zip(pairwise(self._starts), pairwise(squares), strict=True)
        ]
        for order in (range(1, len(lowered)), range(len(lowered) - 2, -1, -1)):
            for index in order:
                neighbour = lowered[index - order.step]
                if neighbour < 1.0:
                    lowered[index] = min(lowered[index], neighbour + rises[index])
        self._slow = [slow * factor for slow, factor in zip(self._slow, lowered, strict=True)]

    def _commit(self, plan: _Plan) -> int:
        """Leave the final cells behind; return how many setpoints that makes."""
        cells, _ = self._limits()
        final = plan.final
        self._time += FeedProfile(cells[:final], plan.squares[: final + 1]).duration
        count = max(math.ceil(self._time / self._planner.period) - self._cycle, 0)
        self._advance(final, count, plan)
        self._square = plan.squares[final]
        return count

    def _rest(self, refuge: _Plan) -> None:
        """Go on from the stop at which `refuge` ends."""
        end = refuge.samples[-1].path
        self._advance(self._starts.index(end), len(refuge.samples), refuge)
        self._square, self._time = 0.0, (self._cycle - 1) * self._planner.period

    def _advance(self, cells: int, count: int, plan: _Plan) -> None:
        """Drop the first `cells` cells; the first `count` setpoints of `plan` are sent."""
        del self._cells[:cells], self._slow[:cells], self._starts[:cells]
        self._cycle += count
        if self._planner.taps > 1:
            self._past = [*self._past, *plan.samples[:count]][count:]
        self._sent = [*self._sent, *plan.setpoints[:count]][-BEFORE:]
        behind = self._past[0].path if self._past else self._starts[0]
        while len(self._places) > 1 and self._places[1][0] <= behind:
            del self._places[0]
