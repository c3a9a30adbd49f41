"""A profile cycle by cycle, its moving mean, and the setpoints of either."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, repeat
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.motion.piece import Piece, frames_of, places_on
from pkm_cnc.records import PHASE_MOVE, TcpSetpoint

__all__ = ["Sample", "exact_setpoints", "mean_setpoints"]

Array = NDArray[np.float64]


class Sample(NamedTuple):
    """The profile in one cycle: path length from the last stop m, v m/s, a m/s^2; the piece, and s on its shape, m."""

    path: float
    v: float
    a: float
    piece: Piece
    s: float


def exact_setpoints(samples: Sequence[Sample]) -> list[TcpSetpoint]:
    """The setpoint of each sample."""
    if not samples:
        return []
    _, v, a, pieces, s = zip(*samples, strict=True)
    return _setpoints(pieces, np.array(s), np.array(v), np.array(a))


def mean_setpoints(samples: Sequence[Sample], taps: int, places: Sequence[tuple[float, Piece]]) -> list[TcpSetpoint]:
    """The setpoint of the mean of each sample but the first `taps` - 1 and of as many before it.

    `places` are the pieces with the path length, m, at which they begin, from the first of the samples on. The mean of
    path lengths is a path length, so it is on the path; v and a are means too, which makes them its derivatives. A
    sample at rest that follows `taps` - 1 others is its own mean.
    """
    if len(samples) < taps:
        return []
    table = np.array([sample[:3] for sample in samples])
    rests = table[: 1 - taps, 0] == table[taps - 1 :, 0]
    table[:, 0] -= samples[0].path
    sums = np.concatenate((np.zeros((1, 3)), np.cumsum(table, axis=0)))
    path, v, a = ((sums[taps:] - sums[:-taps]) / taps).T
    path += samples[0].path
    begins = np.array([begin for begin, _ in places])
    firsts = np.array([piece.begin for _, piece in places])
    index = np.maximum(np.searchsorted(begins, path, side="right") - 1, 0)
    s = firsts[index] + (path - begins[index])
    pieces = [places[number][1] for number in index.tolist()]
    for row in np.flatnonzero(rests).tolist():
        pieces[row], s[row] = samples[row + taps - 1].piece, samples[row + taps - 1].s
    return _setpoints(pieces, s, np.where(rests, 0.0, v), np.where(rests, 0.0, a))


def _setpoints(pieces: Sequence[Piece], s: Array, v: Array, a: Array) -> list[TcpSetpoint]:
    """Setpoints at `s` (k,) m on the shapes of `pieces` (k,), with v (k,) m/s and a (k,) m/s^2."""
    groups = [[*group] for _, group in groupby(pieces, id)]
    few = [group[0] for group in groups]
    which = np.repeat(np.arange(len(few)), [len(group) for group in groups])
    position, tangent, curvature = frames_of([piece.shape for piece in few], which, s)
    rests = (v == 0.0) & (a == 0.0)
    velocity = np.where(rests, 0.0, v * tangent)
    acceleration = np.where(rests, 0.0, a * tangent + v * v * curvature)
    segments, path_lengths = places_on(few, which, s)
    motion = [row.tolist() for vectors in (position, velocity, acceleration) for row in vectors]
    feeds = [piece.feed for piece in pieces]
    return [*map(TcpSetpoint, *motion, path_lengths.tolist(), feeds, segments.tolist(), repeat(PHASE_MOVE))]
