"""From pieces of the path to cells with limits: what TCP and drives allow at each place, whatever the speed before.

Along the path a drive has du/dt = u' v and d2u/dt2 = u' a + u'' v^2, its derivatives by the path length u' = J t and
u'' = J c + (dJ/ds) t with tangent t and curvature c. So its limits are v <= vmax / |u'|, |u' a + u'' w| <= amax, and at
a steady speed |u'''| v^3 <= jmax. The TCP has v <= feed, |c| v^2 <= centripetal acceleration, |a| <= acceleration and
|dc/ds| v^3 <= jerk.

Where two pieces meet, the velocity may jump by no more than an acceleration changes it within one servo period, and the
acceleration by no more than a jerk does; with a limit of jerk the jump of the velocity by no more than both do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.motion.feed_profile import Cell
from pkm_cnc.motion.limits import DriveLimits, MotionParameters
from pkm_cnc.motion.piece import Curve, Piece
from pkm_cnc.program import Arc, Line

__all__ = ["PieceEnd", "PlannedCell", "cells_of"]

Array = NDArray[np.float64]

SPACING = 0.25e-3
"""m. Longest cell where a drive or a jerk limits: limits are taken as constant over it."""
TURN = 0.02
"""rad. Longest cell of an arc: what the drives do changes with the direction of travel."""
CURVE_CELLS, LEAST_CELLS = 8, 2
"""Cells of a curve, on which the curvature rises and falls, and of any other piece, at least."""
NEAR_LIMIT = 0.999
"""1. Below this part of its limits all along, a drive cannot limit a piece between the nodes either."""
ACCELERATION_PART = 0.9995
"""1. What of its acceleration a drive is planned for: the rest is for how u' and u'' differ within a cell."""
LITTLE = 1e-9
"""1, 1/m. Jumps of direction and curvature below this are rounding."""


class PlannedCell(NamedTuple):
    """A cell, its piece, the path length on the piece's shape at its start, m, and what w may be at its start."""

    cell: Cell
    piece: Piece
    begin: float
    node: float


class PieceEnd(NamedTuple):
    """At one end of a piece: tangent, curvature (3,), u', u'' (n,); largest w there; the piece's length, m."""

    tangent: Array
    curvature: Array
    first: Array
    second: Array
    node: float
    length: float


def cells_of(
    group: Sequence[Piece],
    motion: MotionParameters,
    drives: DriveLimits,
    period: float,
    before: PieceEnd | None,
    scale: float = 1.0,
) -> tuple[list[PlannedCell], PieceEnd]:
    """The cells of successive pieces, and what the next call needs as `before`; None where the TCP starts from rest.

    `scale` > 0 is the override: the feeds are multiplied by it, nothing else is. `period` is the servo period, s.
    Raises UnreachableError for a place that the machine does not reach.
    """
    counts = [_count(piece) for piece in group]
    samples = _samples(group, counts, drives)
    result: list[PlannedCell] = []
    row = 0
    for piece, count in zip(group, counts, strict=True):
        here = _Samples(*(part[row : row + 2 * count + 1] for part in samples))
        row += 2 * count + 1
        planned, start, end = _piece_cells(piece, here, motion, drives, piece.feed * scale)
        if before is not None:
            node = min(before.node, start.node, _jump_limit(before, start, motion, drives, period))
            planned[0] = planned[0]._replace(node=node)
        result += planned
        before = end
    assert before is not None
    return result, before


class _Samples(NamedTuple):
    """At the nodes of cells and between them in turn (2 n + 1 rows): tangent, curvature; u', u'' of the drives."""

    tangent: Array
    curvature: Array
    first: Array
    second: Array


def _count(piece: Piece) -> int:
    least = CURVE_CELLS if isinstance(piece.shape, Curve) else LEAST_CELLS
    longest = min(SPACING, TURN * piece.shape.radius) if isinstance(piece.shape, Arc) else SPACING
    return max(least, math.ceil(piece.length / longest))


def _samples(group: Sequence[Piece], counts: Sequence[int], drives: DriveLimits) -> _Samples:
    position, tangent, curvature = (np.concatenate(parts) for parts in zip(*map(_places, group, counts), strict=True))
    _, first, second = drives.motion(position, tangent, curvature)
    return _Samples(tangent, curvature, first, second)


def _places(piece: Piece, count: int) -> tuple[Array, Array, Array]:
    """Position, tangent, curvature (2 n + 1, 3) at the nodes and middles of n cells."""
    shape, rows = piece.shape, 2 * count + 1
    if isinstance(shape, Line):  # long ones have many cells: all at once
        s = piece.begin + piece.length * np.arange(rows)[:, None] / (rows - 1)
        tangent = np.array(shape.tangent(0.0))
        return np.array(shape.start) + s * tangent, np.tile(tangent, (rows, 1)), np.zeros((rows, 3))
    step = piece.length / (rows - 1)
    table = np.array([shape.frame(piece.begin + k * step) for k in range(rows)])
    return table[:, 0], table[:, 1], table[:, 2]


def _piece_cells(
    piece: Piece, samples: _Samples, motion: MotionParameters, drives: DriveLimits, feed: float
) -> tuple[list[PlannedCell], PieceEnd, PieceEnd]:
    count = len(samples.tangent) // 2
    length = piece.length / count
    bend = np.sqrt((samples.curvature**2).sum(axis=1))
    top = np.full(len(bend), feed * feed)
    np.minimum(top, _over(motion.centripetal_acceleration, bend), out=top)
    smooth = motion.jerk > 0.0 or bool(np.isfinite(drives.jerk).any())
    worst = float(top.max())
    drive = np.abs(samples.first) * motion.acceleration + np.abs(samples.second) * worst
    free = (
        not smooth
        and worst == float(top.min())
        and bool((drive <= NEAR_LIMIT * drives.acceleration).all())
        and bool((np.abs(samples.first) * math.sqrt(worst) <= NEAR_LIMIT * drives.velocity).all())
    )
    if free:
        cell = Cell(piece.length, worst, ((0.0, motion.acceleration),))
        planned = [PlannedCell(cell, piece, piece.begin, worst)]
        nodes = [worst, worst]
    else:
        np.minimum(top, (_over(drives.velocity, np.abs(samples.first)) ** 2).min(axis=1), out=top)
        limits, lines = _cell_limits(samples, length, motion, drives)
        nodes = np.minimum(top[::2], np.minimum(np.append(limits, np.inf), np.append(np.inf, limits))).tolist()
        planned = [
            PlannedCell(Cell(length, nodes[k], lines[k]), piece, piece.begin + k * length, nodes[k])
            for k in range(count)
        ]
    ends = [
        PieceEnd(
            samples.tangent[row], samples.curvature[row], samples.first[row], samples.second[row], node, piece.length
        )
        for row, node in ((0, nodes[0]), (-1, nodes[-1]))
    ]
    return planned, ends[0], ends[1]


def _cell_limits(
    samples: _Samples, length: float, motion: MotionParameters, drives: DriveLimits
) -> tuple[Array, list[tuple[tuple[float, float], ...]]]:
    """Largest w in each cell, and its lines (see `feed_profile.Cell`).

    Constants are those of the cell's middle, where w is that of its start plus a times the cell's length.
    """
    first, second = samples.first[1::2], samples.second[1::2]
    along = first + second * length
    size = np.maximum(np.abs(along), 1e-9)  # a drive that stands still along the path is limited by w alone
    r = second / np.copysign(size, along)
    h = ACCELERATION_PART * drives.acceleration / size
    r = np.column_stack((np.zeros(len(r)), r))
    h = np.column_stack((np.full(len(h), motion.acceleration), h))
    limit = np.full(len(r), np.inf)
    for i in range(r.shape[1]):
        for j in range(i):
            np.minimum(limit, _over(h[:, i] + h[:, j], np.abs(r[:, i] - r[:, j])), out=limit)
    third = np.abs(np.diff(samples.second[::2], axis=0)) / length
    np.minimum(limit, (_over(drives.jerk, third) ** (2.0 / 3.0)).min(axis=1), out=limit)
    if motion.jerk > 0.0:
        turn = np.sqrt((np.diff(samples.curvature[::2], axis=0) ** 2).sum(axis=1)) / length
        np.minimum(limit, _over(motion.jerk, turn) ** (2.0 / 3.0), out=limit)
    lines = [tuple(zip(*row, strict=True)) for row in zip(r.tolist(), h.tolist(), strict=True)]
    return limit, lines


def _jump_limit(
    before: PieceEnd, after: PieceEnd, motion: MotionParameters, drives: DriveLimits, period: float
) -> float:
    """Largest w at a junction, (m/s)^2."""
    turn, bend = _length(after.tangent - before.tangent), _length(after.curvature - before.curvature)
    first, second = np.abs(after.first - before.first), np.abs(after.second - before.second)
    across = motion.centripetal_acceleration
    limits = [np.inf]
    if turn > LITTLE:
        limits += [(across * period / turn) ** 2, across * min(before.length, after.length) / turn]
        limits.append(float(_over(drives.acceleration * period, first).min()) ** 2)
        limits.append(float(_over(drives.jerk * period * period, first).min()) ** 2)
        if motion.jerk > 0.0:
            limits.append((motion.jerk * period * period / turn) ** 2)
    if bend > LITTLE:
        limits.append(float(_over(drives.jerk * period, second).min()))
        if motion.jerk > 0.0:
            limits.append(motion.jerk * period / bend)
    return float(min(limits))


def _length(vector: Array) -> float:
    return math.sqrt(float(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))


def _over(limit: float | Array, value: Array) -> Array:
    """`limit` / `value`, without limit where `value` is 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.where(value > 0.0, limit / np.where(value > 0.0, value, 1.0), np.inf)
