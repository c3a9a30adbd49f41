"""The path speed over a row of cells: as fast as their limits allow.

With w = v^2 and the acceleration a along the path, dw/ds = 2 a, and over a cell of the path every limit is a straight
line in w and a: w <= limit, and |a + r w| <= h (the path's own acceleration with r = 0; that of a drive, du/ds a +
d2u/ds2 w, with r and h divided by du/ds). One pass backward gives at each node the largest w from which the end can be
reached, one forward the largest that is reached without passing it, and that is the time optimum on the grid of the
nodes (Pham and Pham, TOPP-RA, 2018; here in closed form, because there are two unknowns). A cell that only the path's
own acceleration limits may be of any length: inside it the fastest way is to speed up, to go at its limit if that is
reached, to brake.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.tolerances import SPEED_ROUNDING

__all__ = ["Cell", "FeedProfile", "entry_squared", "reachable_squared", "speeds_squared"]

Array = NDArray[np.float64]

Phase = tuple[int, float, float, float, float]
"""Index of the cell, path length from the cell's start where the phase begins and where it ends, v0, a."""


class Cell(NamedTuple):
    """A part of the path over which limits are taken as constant.

    `length` m > 0; `limit` (m/s)^2 > 0, largest w inside; `lines` the pairs (r 1/m, h m/s^2 > 0) of |a + r w| <= h, w
    that at the cell's start. `free`: the one line is r = 0.
    """

    length: float
    limit: float
    lines: tuple[tuple[float, float], ...]

    @property
    def free(self) -> bool:
        """Nothing but a constant acceleration limits the cell, which may then be long."""
        return len(self.lines) == 1 and self.lines[0][0] == 0.0


def speeds_squared(cells: Sequence[Cell], nodes: Sequence[float], start: float, end: float) -> tuple[list[float], bool]:
    """Largest w, (m/s)^2, at the ends of the cells, one more than these, and whether `start` was not too fast for it.

    `nodes` are limits of w at the ends of the cells; `start` and `end` w at both ends of the row.
    """
    reachable = reachable_squared(cells, nodes, end)
    held = start <= reachable[0] * (1.0 + 1e-12)
    squares = [min(start, reachable[0])]
    for cell, bound in zip(cells, reachable[1:], strict=True):
        w = squares[-1]
        a = min([h - r * w for r, h in cell.lines])
        squares.append(max(min(w + 2.0 * cell.length * a, bound), 0.0))
    return squares, held


def reachable_squared(cells: Sequence[Cell], nodes: Sequence[float], end: float) -> list[float]:
    """Largest w, (m/s)^2, at the ends of the cells from which `end` can be reached within the limits `nodes`."""
    reachable = list(nodes)
    reachable[-1] = min(reachable[-1], end)
    for i in range(len(cells) - 1, -1, -1):
        reachable[i] = min(reachable[i], entry_squared(cells[i].lines, cells[i].length, reachable[i + 1]))
    return reachable


def entry_squared(lines: Sequence[tuple[float, float]], length: float, end: float) -> float:
    """Largest w, (m/s)^2, from which `end` is reached within `length` m of a cell with these lines."""
    step, bound = 2.0 * length, math.inf
    for r, h in lines:
        slope = 1.0 - step * r
        if slope > 0.0:
            bound = min(bound, (end + step * h) / slope)
    return bound


class FeedProfile:
    """The path speed over `cells` with w = v^2, (m/s)^2, at their ends, of which there is one more than cells.

    `squares` are as `speeds_squared` gives them. `duration` is in s.
    """

    def __init__(self, cells: Sequence[Cell], squares: Sequence[float]) -> None:
        times, phases = list[float](), list[Phase]()
        time = rest = 0.0
        for duration, phase in _phases(cells, squares):
            times.append(time)
            phases.append(phase)
            end = time + (duration + rest)
            rest += duration - (end - time)  # Kahan summation: the error of the sum does not grow with its terms
            time = end
        self.duration = time
        self._times = np.array(times)
        self._phases = [np.array(column) for column in zip(*phases, strict=True)]
        self._end = len(cells) - 1, cells[-1].length, math.sqrt(squares[-1]), 0.0

    def at(self, t: NDArray[Any]) -> tuple[NDArray[np.intp], Array, Array, Array]:
        """Cell, path length from the cell's start (m), path speed (m/s) and acceleration (m/s^2) at t >= 0 s, (k,).

        From `duration` on it is the end, exactly. The path length is counted within the cell, so that it is as exact
        after many cells as in the first.
        """
        phase = np.searchsorted(self._times, t, side="right") - 1
        cell, begin, end, v, a = (column[phase] for column in self._phases)
        dt = t - self._times[phase]
        found = cell, np.minimum(begin + dt * (v + 0.5 * a * dt), end), np.maximum(v + a * dt, 0.0), a
        index, s, v, a = (np.where(t >= self.duration, last, here) for last, here in zip(self._end, found, strict=True))
        return index, s, v, a


def _phases(cells: Sequence[Cell], squares: Sequence[float]) -> Iterator[tuple[float, Phase]]:
    """Duration and phase, in order.

    A cell that only speeds up, or only brakes, gets that one phase: a sliver of the opposite sign left by rounding
    would show in the acceleration of a cycle that falls on it.
    """
    for index, (cell, (w0, w1)) in enumerate(zip(cells, pairwise(squares), strict=True)):
        length = cell.length
        if not cell.free:
            v0, v1 = math.sqrt(w0), math.sqrt(w1)
            yield 2.0 * length / (v0 + v1), (index, 0.0, length, v0, (w1 - w0) / (2.0 * length))
            continue
        acceleration = cell.lines[0][1]
        peak = max(w0, w1, min(cell.limit, 0.5 * (w0 + w1) + acceleration * length))
        v0, v, v1 = math.sqrt(w0), math.sqrt(peak), math.sqrt(w1)
        speeds_up = v - v0 > SPEED_ROUNDING * v
        brakes = v - v1 > SPEED_ROUNDING * v
        cruise = min((peak - w0) / (2.0 * acceleration), length) if speeds_up else 0.0
        brake = max(length - (peak - w1) / (2.0 * acceleration), cruise) if brakes else length
        if speeds_up:
            yield (v - v0) / acceleration, (index, 0.0, cruise, v0, acceleration)
        if peak == cell.limit or not (speeds_up or brakes):
            yield (brake - cruise) / v, (index, cruise, brake, v, 0.0)
        if brakes:
            yield (v - v1) / acceleration, (index, brake, length, v, -acceleration)
