"""A profile cycle by cycle, its moving mean, and the setpoints of either."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pkm_cnc.motion.piece import Piece
from pkm_cnc.records import PHASE_MOVE, TcpSetpoint

__all__ = ["Sample", "exact_setpoints", "mean_setpoints"]


class Sample(NamedTuple):
    """The profile in one cycle: path length from the last stop m, v m/s, a m/s^2; the piece, and s on its shape, m."""

    path: float
    v: float
    a: float
    piece: Piece
    s: float


def exact_setpoints(samples: Sequence[Sample]) -> list[TcpSetpoint]:
    """The setpoint of each sample."""
    return [_setpoint(sample.piece, sample.s, sample.v, sample.a) for sample in samples]


def mean_setpoints(samples: Sequence[Sample], taps: int, places: Sequence[tuple[float, Piece]]) -> list[TcpSetpoint]:
    """The setpoint of the mean of each sample but the first `taps` - 1 and of as many before it.

    `places` are the pieces with the path length, m, at which they begin, from the first of the samples on. The mean of
    path lengths is a path length, so it is on the path; v and a are means too, which makes them its derivatives. A
    sample at rest that follows `taps` - 1 others is its own mean.
    """
    table = np.array([sample[:3] for sample in samples])
    table[:, 0] -= samples[0].path
    sums = np.concatenate((np.zeros((1, 3)), np.cumsum(table, axis=0)))
    means = (sums[taps:] - sums[:-taps]) / taps
    begins = [begin for begin, _ in places]
    result = []
    for (path, v, a), first, last in zip(means.tolist(), samples, samples[taps - 1 :], strict=False):
        if first.path == last.path:
            result.append(_setpoint(last.piece, last.s, 0.0, 0.0))
            continue
        path += samples[0].path
        begin, piece = places[max(bisect_right(begins, path) - 1, 0)]
        result.append(_setpoint(piece, piece.begin + (path - begin), v, a))
    return result


def _setpoint(piece: Piece, s: float, v: float, a: float) -> TcpSetpoint:
    segment, path_length = piece.place(s)
    if v == 0.0 and a == 0.0:
        x, y, z = piece.shape.position(s)
        return TcpSetpoint(x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, path_length, piece.feed, segment, PHASE_MOVE)
    (x, y, z), (tx, ty, tz), (cx, cy, cz) = piece.frame(s)
    w = v * v
    ax, ay, az = a * tx + w * cx, a * ty + w * cy, a * tz + w * cz
    return TcpSetpoint(x, y, z, v * tx, v * ty, v * tz, ax, ay, az, path_length, piece.feed, segment, PHASE_MOVE)
