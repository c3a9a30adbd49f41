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
from pkm_cnc.motion.piece import Curve, Piece, frames_of
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
    rows = np.array([2 * _count(piece) + 1 for piece in group])
    begins = np.cumsum(rows) - rows
    samples = _samples(group, rows, drives)
    feeds = np.array([piece.feed for piece in group]) * scale
    bend = np.sqrt((samples.curvature**2).sum(axis=1))
    top = np.minimum(np.repeat(feeds * feeds, rows), _over(motion.centripetal_acceleration, bend))
    free = _free(samples, top, begins, motion, drives)
    found = [
        _free_cell(piece, float(top[begin]), motion)
        if alone
        else _limited_cells(piece, samples.at(slice(begin, begin + count)), top[begin : begin + count], motion, drives)
        for piece, begin, count, alone in zip(group, begins.tolist(), rows.tolist(), free.tolist(), strict=True)
    ]
    firsts, lasts = samples.at(begins), samples.at(begins + rows - 1)
    ends = [
        PieceEnd(tangent, curvature, first, second, node, piece.length)
        for piece, (_, node), tangent, curvature, first, second in zip(group, found, *lasts, strict=True)
    ]
    earlier = ends[:-1] if before is None else [before, *ends[:-1]]
    if earlier:
        later = slice(len(group) - len(earlier), None)
        lengths = np.array([piece.length for piece in group[later]])
        limits = _jump_limits(earlier, firsts.at(later), lengths, motion, drives, period).tolist()
        for (planned, _), end, limit in zip(found[later], earlier, limits, strict=True):
            planned[0] = planned[0]._replace(node=min(end.node, planned[0].node, limit))
    return [cell for planned, _ in found for cell in planned], ends[-1]


class _Samples(NamedTuple):
    """At the nodes of n cells a piece and between them in turn, 2 n + 1 rows: tangent, curvature; drives' u', u''."""

    tangent: Array
    curvature: Array
    first: Array
    second: Array

    def at(self, rows: slice | NDArray[np.intp]) -> _Samples:
        """Some of the rows."""
        return _Samples(*(part[rows] for part in self))


def _count(piece: Piece) -> int:
    least = CURVE_CELLS if isinstance(piece.shape, Curve) else LEAST_CELLS
    longest = min(SPACING, TURN * piece.shape.radius) if isinstance(piece.shape, Arc) else SPACING
    return max(least, math.ceil(piece.length / longest))


def _samples(group: Sequence[Piece], rows: NDArray[np.intp], drives: DriveLimits) -> _Samples:
    which = np.repeat(np.arange(len(group)), rows)
    number = np.arange(len(which)) - (np.cumsum(rows) - rows)[which]
    begins, lengths = np.array([(piece.begin, piece.length) for piece in group]).T
    straight = np.array([isinstance(piece.shape, Line) for piece in group])  # long ones have many cells
    along = np.where(
        straight[which], lengths[which] * number / (rows - 1)[which], number * (lengths / (rows - 1))[which]
    )
    s = begins[which] + along
    position, tangent, curvature = frames_of([piece.shape for piece in group], which, s).transpose(0, 2, 1)
    _, first, second = drives.motion(position, tangent, curvature)
    return _Samples(tangent, curvature, first, second)


def _free(
    samples: _Samples, top: Array, begins: NDArray[np.intp], motion: MotionParameters, drives: DriveLimits
) -> NDArray[np.bool_]:
    """Which of the pieces that begin in these rows nothing limits but feed and acceleration along the path."""
    if motion.jerk > 0.0 or bool(np.isfinite(drives.jerk).any()):
        return np.zeros(len(begins), dtype=bool)
    worst = np.maximum.reduceat(top, begins)
    w = np.repeat(worst, np.diff(begins, append=len(top)))[:, None]
    drive = np.abs(samples.first) * motion.acceleration + np.abs(samples.second) * w
    kept = (drive <= NEAR_LIMIT * drives.acceleration).all(axis=1)
    kept &= (np.abs(samples.first) * np.sqrt(w) <= NEAR_LIMIT * drives.velocity).all(axis=1)
    return np.asarray((worst == np.minimum.reduceat(top, begins)) & np.logical_and.reduceat(kept, begins))


def _free_cell(piece: Piece, limit: float, motion: MotionParameters) -> tuple[list[PlannedCell], float]:
    cell = Cell(piece.length, limit, ((0.0, motion.acceleration),))
    return [PlannedCell(cell, piece, piece.begin, limit)], limit


def _limited_cells(
    piece: Piece, samples: _Samples, top: Array, motion: MotionParameters, drives: DriveLimits
) -> tuple[list[PlannedCell], float]:
    """The cells of a piece, and what w may be at its end; `top` is the largest w by feed and curvature."""
    count = len(top) // 2
    length = piece.length / count
    top = np.minimum(top, (_over(drives.velocity, np.abs(samples.first)) ** 2).min(axis=1))
    limits, lines = _cell_limits(samples, length, motion, drives)
    nodes = np.minimum(top[::2], np.minimum(np.append(limits, np.inf), np.append(np.inf, limits))).tolist()
    planned = [
        PlannedCell(Cell(length, nodes[k], lines[k]), piece, piece.begin + k * length, nodes[k]) for k in range(count)
    ]
    return planned, nodes[-1]


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


def _jump_limits(
    before: Sequence[PieceEnd],
    after: _Samples,
    lengths: Array,
    motion: MotionParameters,
    drives: DriveLimits,
    period: float,
) -> Array:
    """Largest w at junctions, (m/s)^2; `after` has a row, and `lengths` (m) a number, for each piece behind one."""
    tangent, curvature, first, second = (np.array([end[part] for end in before]) for part in range(4))
    turn, bend = _length(after.tangent - tangent), _length(after.curvature - curvature)
    first, second = np.abs(after.first - first), np.abs(after.second - second)
    shorter = np.minimum([end.length for end in before], lengths)
    across = motion.centripetal_acceleration
    turning = [
        _over(across * period, turn) ** 2,
        _over(across * shorter, turn),
        _over(drives.acceleration * period, first).min(axis=1) ** 2,
        _over(drives.jerk * period * period, first).min(axis=1) ** 2,
    ]
    bending = [_over(drives.jerk * period, second).min(axis=1)]
    if motion.jerk > 0.0:
        turning.append(_over(motion.jerk * period * period, turn) ** 2)
        bending.append(_over(motion.jerk * period, bend))
    by_turn = np.where(turn > LITTLE, np.min(turning, axis=0), np.inf)
    by_bend = np.where(bend > LITTLE, np.min(bending, axis=0), np.inf)
    return np.asarray(np.minimum(by_turn, by_bend))


def _length(vectors: Array) -> Array:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _over(limit: float | Array, value: Array) -> Array:
    """`limit` / `value`, without limit where `value` is 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.where(value > 0.0, limit / np.where(value > 0.0, value, 1.0), np.inf)
