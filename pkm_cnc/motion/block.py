"""The path that is planned together, and the state from which: one time-optimal profile, smoothed and verified.

See `planner` for what is done with it.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pkm_cnc.errors import MachineFault
from pkm_cnc.motion.feed_profile import Cell, FeedProfile, entry_squared, reachable_squared, speeds_squared
from pkm_cnc.motion.limits import DriveLimits, MotionParameters
from pkm_cnc.motion.path_limits import PieceEnd, PlannedCell, cells_of
from pkm_cnc.motion.piece import Piece
from pkm_cnc.motion.sampling import Sample, exact_setpoints, mean_setpoints
from pkm_cnc.motion.verification import BEFORE, slow_downs
from pkm_cnc.records import TcpSetpoint
from pkm_cnc.tolerances import LIMIT_EXCESS, ZERO_LENGTH

__all__ = ["Block", "Plan", "Settings"]

LOCAL_ROUNDS, ROUNDS = 30, 60
"""Rounds of slowing down where a limit is exceeded; then of all of the block; more are a fault."""
FIRMNESS = 2.4
"""1. w falls with this power of the factor by which a place is too fast: with 2 the rounds end as well, but there are
twice as many, because the acceleration falls with w, and with it a smoothed jerk, not with the power 1.5 of w."""
TAPER = 0.2
"""1. The part of the acceleration that is spent on entering and leaving a place that is slowed down."""


class Settings(NamedTuple):
    """Limits of TCP and drives; servo period, s; over how many cycles a motion is smoothed (1: not at all)."""

    motion: MotionParameters
    drives: DriveLimits
    period: float
    taps: int


class Plan(NamedTuple):
    """w at the nodes, how many of the cells are final, the profile by cycle, and the setpoints."""

    squares: list[float]
    final: int
    samples: list[Sample]
    setpoints: list[TcpSetpoint]


class Block:
    """Cells ahead, and how the TCP comes to the first of them. It begins at rest at the start of `first`.

    `scale` is the override of the feeds, above 0.
    """

    def __init__(self, settings: Settings, first: Piece, scale: float) -> None:
        self._settings = settings
        self.scale = scale
        self.cells: list[PlannedCell] = []
        self.starts = [0.0]
        """By node: path length from the last stop of the path, m."""
        self._slow: list[float] = []  # by cell: what its w is lowered by
        self._end: PieceEnd | None = None
        self._places: list[tuple[float, Piece]] = []  # path length at which the pieces begin that are not passed
        self._square, self._time, self._cycle = 0.0, 0.0, 1  # w and time at the first node; the next cycle
        self._cut = False  # whether the first node lies within what was a cell
        self._until: float | None = None  # s on its shape where the last cell was cut, m
        self._ceiling, self._ceiling_end = scale, 0  # the override that was higher, and the cycle from which it is not
        rest = Sample(0.0, 0.0, 0.0, first, first.begin)
        self.history = [rest] * (settings.taps + 1)
        """The profile in the last cycles."""
        self.sent = exact_setpoints([rest] * BEFORE)
        """The last setpoints."""

    def append(self, group: Sequence[Piece]) -> None:
        """Put pieces behind the others."""
        cells, self._end = cells_of(
            group, self._settings.motion, self._settings.drives, self._settings.period, self._end, self.scale
        )
        for planned in cells:
            if not self._places or planned.piece is not self._places[-1][1]:
                self._places.append((self.starts[-1], planned.piece))
            self.cells.append(planned)
            self._slow.append(1.0)
            self.starts.append(self.starts[-1] + planned.cell.length)

    def plan(self, ends: bool, rounds: int | None = None) -> Plan | None:
        """From the state of the block to rest at its end, with all limits kept; None if it begins too fast for that.

        `ends`: the TCP stops there, nothing follows. Raises MachineFault where `rounds` of slowing down do not help.
        """
        settings, first = self._settings, self.cells[0].cell
        if self._cut and first.free and self._square > first.limit * self._slow[0]:
            return None
        if settings.taps == 1 and self._cycle >= self._ceiling_end and all(planned.cell.free for planned in self.cells):
            return self._unverified(ends)
        for attempt in range(rounds or ROUNDS):
            cells, nodes = self._limits()
            squares, held = speeds_squared(cells, nodes, self._square, 0.0)
            if not held:
                return None
            samples = self._sampled(FeedProfile(cells, squares), ends, to_rest=True)
            setpoints = self.setpoints_of(samples)
            excess = self.excess(setpoints)
            worst = max(excess)
            if worst <= 1.0 + LIMIT_EXCESS:
                return Plan(squares, self._final(cells, nodes, squares) // 2, samples, setpoints)
            self._slow_down(samples, [worst] * len(excess) if attempt >= LOCAL_ROUNDS else excess, squares)
        raise MachineFault(
            f"line {self.cells[0].piece.line}: from here on the limits cannot be kept (motion.jerk, limits): after "
            f"{rounds or ROUNDS} attempts the motion is still {100.0 * (worst - 1.0):.3g} % too fast"
        )

    def skip(self, ends: bool) -> int:
        """Leave behind the cells that are final before verification; return how many."""
        cells, nodes = self._limits()
        squares, _ = speeds_squared(cells, nodes, self._square, 0.0)
        final = len(cells) if ends else self._final(cells, nodes, squares)
        if final:
            self.commit(Plan(squares, final, [], []))
            del self._places[:-1]
        return final

    @property
    def duration(self) -> float:
        """Time from rest to rest at the end of the cells that are left behind, s."""
        cycles = math.ceil(self._time / self._settings.period) - 1 + len(self._at_rest(self.history[-1]))
        return cycles * self._settings.period

    def excess(self, setpoints: list[TcpSetpoint]) -> list[float]:
        """By what factor each of the next setpoints is too fast for the limits: see `slow_downs`."""
        settings, scales = self._settings, np.full(BEFORE + len(setpoints), self.scale)
        scales[: BEFORE + max(self._ceiling_end - self._cycle, 0)] = self._ceiling
        found = slow_downs([*self.sent, *setpoints], settings.motion, settings.drives, settings.period, scales)
        return [float(value) for value in found.tolist()]

    def _unverified(self, ends: bool) -> Plan | None:
        """The block where nothing limits but feeds and the path's acceleration, which the profile keeps."""
        cells, nodes = self._limits()
        squares, held = speeds_squared(cells, nodes, self._square, 0.0)
        if self._cut and not held:
            return None
        whole = ends or self._until is not None
        final = len(cells) if whole else self._final(cells, nodes, squares)
        if final == 0:
            return Plan(squares, 0, [], [])
        samples = self._sampled(FeedProfile(cells[:final], squares[: final + 1]), ends, to_rest=whole)
        return Plan(squares, final, samples, exact_setpoints(samples))

    def _limits(self) -> tuple[list[Cell], list[float]]:
        """The cells and the limits of w at their ends, as far as they are slowed down."""
        assert self._end is not None
        nodes = [*(planned.node for planned in self.cells), self._end.node]
        if self._settings.taps > 1:
            nodes = self._extended(nodes)
        cells = [planned.cell for planned in self.cells]
        if min(self._slow) < 1.0:
            cells = [
                Cell(cell.length, cell.limit * slow, tuple([(r, h * slow) for r, h in cell.lines]))
                for cell, slow in zip(cells, self._slow, strict=True)
            ]
            lowest = map(min, [1.0, *self._slow], [*self._slow, 1.0])
            nodes = [node * slow for node, slow in zip(nodes, lowest, strict=True)]
        if self._cut:  # what is ahead decides whether the TCP is too fast there
            nodes[0] = max(nodes[0], self._square)
        return cells, nodes

    def _extended(self, nodes: list[float]) -> list[float]:
        """Limits of w that the mean over `taps` cycles keeps: each reaches as far as the TCP goes in half that time."""
        half = 0.5 * (self._settings.taps - 1) * self._settings.period
        further = self._settings.motion.acceleration * half * half / 6.0
        result, starts = list(nodes), self.starts
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

    def _sampled(self, profile: FeedProfile, ends: bool, to_rest: bool) -> list[Sample]:
        """The profile in the cycles up to its end; `to_rest`: on until its mean rests at the end.

        With a limit of jerk for two cycles, so that the jerk of stopping is over before the next motion begins.
        """
        period = self._settings.period
        last = math.ceil((self._time + profile.duration) / period) + 1  # or one or two before
        times = np.arange(self._cycle, max(last, self._cycle) + 1) * period - self._time
        cells, s, v, a = profile.at(np.maximum(times[times < profile.duration], 0.0))
        paths, begins = np.array(self.starts), np.array([planned.begin for planned in self.cells])
        samples = [
            *map(
                Sample,
                (paths[cells] + s).tolist(),
                v.tolist(),
                a.tolist(),
                [self.cells[index].piece for index in cells.tolist()],
                (begins[cells] + s).tolist(),
            )
        ]
        if to_rest:
            planned = self.cells[-1]
            if self._until is not None:
                end = self._until
            else:
                end = planned.piece.shape.length if ends else planned.piece.begin + planned.piece.length
            samples += self._at_rest(Sample(self.starts[-1], 0.0, 0.0, planned.piece, end))
        return samples

    def _at_rest(self, sample: Sample) -> list[Sample]:
        """As often as the mean needs to rest there, too, and its jerk to be over."""
        return [sample] * (self._settings.taps + 1 if self._settings.taps > 1 else 1)

    def setpoints_of(self, samples: list[Sample]) -> list[TcpSetpoint]:
        """Of the profile in the next cycles."""
        if self._settings.taps == 1:
            return exact_setpoints(samples)
        return mean_setpoints([*self._past, *samples], self._settings.taps, self._places)

    def _slow_down(self, samples: list[Sample], excess: list[float], squares: list[float]) -> None:
        """Lower the limits of the cells in which the setpoints are made that exceed theirs, and less and less beside.

        A step in the limits would cost an acceleration there and be the next place to exceed one.
        """
        taps, last = self._settings.taps, len(samples) - 1
        paths = [sample.path for sample in (*self._past, *samples)]  # the mean of cycle k is of k to k + taps - 1
        lowered = [1.0] * len(self._slow)
        for k, factor in enumerate(excess):
            if factor > 1.0:
                begin = bisect_right(self.starts, paths[max(k - BEFORE, 0)]) - 1
                end = bisect_right(self.starts, paths[min(k + 1, last) + taps - 1])
                for index in range(max(begin, 0), min(end, len(lowered))):
                    lowered[index] = min(lowered[index], factor**-FIRMNESS)
        slope = 2.0 * TAPER * self._settings.motion.acceleration
        rises = [
            slope * (end - begin) / max(w0, w1)
            for (begin, end), (w0, w1) in zip(pairwise(self.starts), pairwise(squares), strict=True)
        ]
        for order in (range(1, len(lowered)), range(len(lowered) - 2, -1, -1)):
            for index in order:
                neighbour = lowered[index - order.step]
                if neighbour < 1.0:
                    lowered[index] = min(lowered[index], neighbour + rises[index])
        self._slow = [slow * factor for slow, factor in zip(self._slow, lowered, strict=True)]

    def commit(self, plan: Plan) -> int:
        """Leave the final cells behind; return how many setpoints that makes."""
        cells, _ = self._limits()
        final = plan.final
        self._time += FeedProfile(cells[:final], plan.squares[: final + 1]).duration
        count = max(math.ceil(self._time / self._settings.period) - self._cycle, 0)
        self._drop(final)
        self._send(plan.samples[:count], plan.setpoints[:count])
        self._square, self._cut = plan.squares[final], False
        return count

    def rest(self, refuge: Plan) -> None:
        """Go on from the stop at a node, at which `refuge` ends."""
        self._drop(self.starts.index(refuge.samples[-1].path))
        self._send(refuge.samples, refuge.setpoints)
        self._square, self._time, self._cut = 0.0, (self._cycle - 1) * self._settings.period, False

    def _drop(self, cells: int) -> None:
        del self.cells[:cells], self._slow[:cells], self.starts[:cells]

    def _send(self, samples: list[Sample], setpoints: list[TcpSetpoint]) -> None:
        self._cycle += len(samples)
        self.history = [*self.history, *samples][len(samples) :]
        self.sent = [*self.sent, *setpoints][-BEFORE:]
        behind = (self._past or self.history[-1:])[0].path
        while len(self._places) > 1 and self._places[1][0] <= behind:
            del self._places[0]

    @property
    def _past(self) -> list[Sample]:
        """What the mean of the next cycle holds besides it."""
        return self.history[2:]

    # going on otherwise than planned

    def copy(self) -> Block:
        """One that can go another way."""
        block = copy.copy(self)
        block.cells, block.starts, block._slow = list(self.cells), list(self.starts), list(self._slow)
        block._places = list(self._places)
        return block

    def sending(self, samples: list[Sample], setpoints: list[TcpSetpoint]) -> Block:
        """When these are sent. The cells are still the same: to be planned from there it must be `redirected`."""
        block = self.copy()
        block._send(samples, setpoints)
        return block

    def beginning(self, scale: float) -> Block:
        """One without cells yet, to begin now."""
        block = self.copy()
        block.scale = block._ceiling = scale
        block._time = (self._cycle - 1) * self._settings.period
        return block

    def redirected(self, scale: float) -> Block:
        """To be planned from the last cycle on, with another override; its limits are new."""
        block = self.copy()
        settings = self._settings
        block._ceiling, block._ceiling_end = max(self._ceiling, scale), self._cycle + settings.taps - 1
        block.scale, block._until = scale, None
        pieces = [piece for _, piece in self._places]
        block.cells, block._end = cells_of(pieces, settings.motion, settings.drives, settings.period, None, scale)
        block.starts = []
        begins, piece, end = iter(self._places), None, 0.0
        for planned in block.cells:
            if planned.piece is not piece:
                end, piece = next(begins)
            block.starts.append(end)
            end += planned.cell.length
        block.starts.append(end)
        block._slow = [1.0] * len(block.cells)
        block._begin()
        return block

    def _begin(self) -> None:
        """Cut the cells where the profile was in the last cycle, and begin there."""
        state = self.history[-1]
        self._square, self._time = state.v * state.v, (self._cycle - 1) * self._settings.period
        index = max(min(bisect_right(self.starts, state.path) - 1, len(self.cells) - 1), 0)
        if self.starts[index + 1] - state.path <= ZERO_LENGTH and index + 1 < len(self.cells):
            index += 1
        self._drop(index)
        gone = state.path - self.starts[0]
        if gone > 0.0 and self.starts[1] > state.path:
            cell, piece, begin, node = self.cells[0]
            following = self.cells[1].node if len(self.cells) > 1 else node
            node += gone / cell.length * (following - node)
            self.cells[0] = PlannedCell(cell._replace(length=cell.length - gone), piece, begin + gone, node)
            self.starts[0] = state.path
            self._cut = True
        self._halve()

    def _halve(self) -> None:
        """Make two cells of one that is alone: the profile needs a node between two rests."""
        if len(self.cells) == 1 and not self.cells[0].cell.free:
            cell, piece, begin, node = self.cells[0]
            half = cell._replace(length=0.5 * cell.length)
            self.cells = [PlannedCell(half, piece, begin, node), PlannedCell(half, piece, begin + half.length, node)]
            self.starts.insert(1, self.starts[0] + half.length)
            self._slow *= 2

    def entered(self, samples: list[Sample], setpoints: list[TcpSetpoint]) -> Block:
        """A redirected block entered after these samples only."""
        block = self.copy()
        block._send(samples, setpoints)
        block._ceiling_end = block._cycle + self._settings.taps - 1
        block._begin()
        return block

    def slow_as(self, entered: Block) -> None:
        """Take over by how much the limits ahead of a block entered later had to be lowered."""
        count = len(entered._slow)
        self._slow[-count:] = map(min, self._slow[-count:], entered._slow)

    def until(self, path: float) -> Block:
        """The same, but to rest at `path` (m), which lies ahead."""
        block = self.copy()
        count = bisect_left(self.starts, path)
        del block.cells[count:], block._slow[count:], block.starts[count + 1 :]
        cell, piece, begin, node = block.cells[-1]
        length = path - block.starts[-2]
        block.cells[-1] = PlannedCell(cell._replace(length=length), piece, begin, node)
        block.starts[-1], block._until = path, begin + length
        block._halve()
        return block

    def line_ends(self) -> Iterator[float]:
        """Where ahead, m, a line of the part program ends; the end of the motion is none."""
        line = None
        for begin, piece in self._places:
            for mark in piece.marks:
                s = max(mark.s - piece.begin, 0.0)
                if s <= piece.length:
                    if line is not None and mark.line != line and begin + s > self.starts[0] + ZERO_LENGTH:
                        yield begin + s
                    line = mark.line

    def reachable(self) -> list[float]:
        """Largest w at the nodes, (m/s)^2, from which all limits ahead can be kept, jerk not considered."""
        cells, nodes = self._limits()
        return reachable_squared(cells, nodes, 0.0)

    def enterable(self, state: Sample, reachable: list[float]) -> bool:
        """Whether `state` is slow enough to go on from there, by what is reachable at the nodes."""
        if state.path >= self.starts[-1] - ZERO_LENGTH:
            return False
        index = max(min(bisect_right(self.starts, state.path) - 1, len(self.cells) - 1), 0)
        cell, w, left = self.cells[index].cell, state.v * state.v, max(self.starts[index + 1] - state.path, 0.0)
        if cell.free:
            return w <= min(cell.limit * self._slow[index], entry_squared(cell.lines, left, reachable[index + 1]))
        w0, w1 = reachable[index], reachable[index + 1]
        return w <= w1 + min(left / cell.length, 1.0) * (w0 - w1)

    def braking(self, strength: float) -> list[Sample]:
        """The profile in the next cycles down to rest, with `strength` (up to 1) of what the limits allow.

        The acceleration of a cycle may be below that of n cycles before by what the jerk allows in n cycles; then the
        mean keeps it. Empty if that needs all that is ahead.
        """
        settings = self._settings
        period, most = settings.period, strength * settings.motion.acceleration
        samples = list(self.history)
        while (state := samples[-1]).v > 0.0:
            index = min(max(bisect_right(self.starts, state.path) - 1, 0), len(self.cells) - 1)
            w, lines = state.v * state.v, self.cells[index].cell.lines
            a = max(-most, *(-h - r * w for r, h in lines))
            if settings.taps > 1:
                before = (samples[-settings.taps].v - samples[-settings.taps - 1].v) / period
                a = max(a, before - min(h for _, h in lines))
            a = min(a, 0.0)
            v = max(state.v + a * period, 0.0)
            path = state.path + (0.5 * (state.v + v) * period if v > 0.0 else -0.5 * w / a)
            if path >= self.starts[-1] - ZERO_LENGTH:
                return []
            samples.append(self._sample(path, v))
        found = [
            sample._replace(a=(after.v - sample.v) / period) for sample, after in pairwise(samples[len(self.history) :])
        ]
        return found + self._at_rest(samples[-1])

    def slower(self, state: Sample, v: float) -> Sample:
        """One cycle after `state` with the speed `v` (m/s), not above that of `state`."""
        return self._sample(state.path + 0.5 * (state.v + v) * self._settings.period, v)

    def _sample(self, path: float, v: float) -> Sample:
        begin, piece = self._places[max(bisect_right(self._places, path, key=lambda place: place[0]) - 1, 0)]
        return Sample(path, v, 0.0, piece, piece.begin + (path - begin))
