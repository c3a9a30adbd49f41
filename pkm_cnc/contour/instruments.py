"""What a measuring instrument at the TCP reads of a run: probe on a straightedge, ball bar.

An instrument is at the true TCP. It reads `RATE` times a second, in the nearest cycle, in steps of `RESOLUTION`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.program import Arc, Line

__all__ = ["BALL_BAR_RANGE", "PROBE_RANGE", "RATE", "RESOLUTION", "Readings", "ball_bar", "straightedge"]

Array = NDArray[np.float64]

RATE = 100.0
"""1/s, readings of the thesis' probe at most (6.4.1.1)."""
RESOLUTION = 0.1e-6
"""m, of the thesis' probe, Millimar 1318 (6.4.1.1); ball bars have the same."""
PROBE_RANGE = 1e-3
"""m, to either side of the probe's zero (6.4.1.1)."""
BALL_BAR_RANGE = 1e-3
"""m, to either side of its length: that of usual ball bars."""


class Readings(NamedTuple):
    """Where (m along the line, or rad about the centre) it read what (m); a reading out of range is NaN."""

    place: Array
    value: Array


def straightedge(line: Line, tcp: Array, period: float) -> Readings:
    """A probe at the TCP on a straightedge along `line`: how far it is to the left of it, by the way along it.

    `tcp` (n, 3), m, are the true TCPs of successive cycles, `period` (s) apart. A vertical line has no left.
    """
    tangent = np.array(line.tangent(0.0))
    along, rest = (tcp - np.array(line.start)) @ tangent, tcp - np.array(line.start)
    left = np.array([-tangent[1], tangent[0], 0.0]) / math.hypot(tangent[0], tangent[1])
    return _read(along, rest @ left, PROBE_RANGE, period)


def ball_bar(circle: Arc, tcp: Array, period: float) -> Readings:
    """A ball bar between TCP and programmed centre: radius less programmed radius (so -dR), by the actual angle."""
    x, y, z = (tcp - np.array(circle.center)).T
    distance = np.sqrt(x * x + y * y + z * z)
    return _read(np.unwrap(np.arctan2(y, x)), distance - circle.radius, BALL_BAR_RANGE, period)


def _read(place: Array, value: Array, reach: float, period: float) -> Readings:
    rows = np.rint(np.arange(0.0, len(value) * period, 1.0 / RATE) / period).astype(int)
    rows = rows[rows < len(value)]
    steps = np.floor(value[rows] / RESOLUTION + 0.5) * RESOLUTION
    return Readings(place[rows], np.where(np.abs(steps) <= reach, steps, np.nan))
