"""The path speed over a run of elements: from rest to rest, as fast as feeds and acceleration allow.

Along the path the speed v(s) obeys v <= the feed of the element at s and |dv/dt| <= a. With w = v^2 the acceleration
limit reads |dw/ds| <= 2 a, so one pass forward and one backward over the junctions give the largest speed at each of
them (the whole run is looked ahead), and inside each element the fastest way from speed to speed is to accelerate,
cruise at its feed if that is reached, and decelerate. That is the time optimum: no admissible v(s) is larger anywhere.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise

from pkm_cnc.tolerances import SPEED_ROUNDING

__all__ = ["FeedProfile"]

Phase = tuple[int, float, float, float, float]
"""Index of the element, path length from the element's start where the phase begins and where it ends, v0, a."""


class FeedProfile:
    """Time-optimal path speed from rest to rest over elements of given lengths and feeds.

    `lengths` m and `feeds` m/s, both > 0, one of each per element; `acceleration` m/s^2 > 0 bounds the change of the
    path speed in both directions. `duration` is in s. Planning takes time and memory linear in the number of elements.
    Raises ValueError for no elements, for unequal numbers of lengths and feeds, and for what is not finite and above 0.
    """

    def __init__(self, lengths: Sequence[float], feeds: Sequence[float], acceleration: float) -> None:
        if not lengths or len(lengths) != len(feeds):
            raise ValueError(f"{len(lengths)} lengths and {len(feeds)} feeds: equal numbers of at least one wanted")
        for name, values in (("length", lengths), ("feed", feeds), ("acceleration", (acceleration,))):
            for index, value in enumerate(values):
                if not 0.0 < value < math.inf:
                    raise ValueError(f"{name} {index} is {value}, not a finite number above 0")
        self._times: list[float] = []
        self._phases: list[Phase] = []
        time = rest = 0.0
        for duration, phase in _phases(lengths, feeds, acceleration):
            self._times.append(time)
            self._phases.append(phase)
            end = time + (duration + rest)
            rest += duration - (end - time)  # Kahan summation: the error of the sum does not grow with its terms
            time = end
        self.duration = time
        self._end = len(lengths) - 1, lengths[-1], 0.0, 0.0

    def at(self, t: float) -> tuple[int, float, float, float]:
        """Element, path length from the element's start (m), path speed (m/s) and acceleration (m/s^2) at t >= 0 s.

        From `duration` on it is the end at rest, exactly. The path length is counted within the element, so that it is
        as exact after many elements as in the first.
        """
        if t >= self.duration:
            return self._end
        index = bisect_right(self._times, t) - 1
        element, begin, end, v, a = self._phases[index]
        dt = t - self._times[index]
        return element, min(begin + dt * (v + 0.5 * a * dt), end), max(v + a * dt, 0.0), a


def _phases(lengths: Sequence[float], feeds: Sequence[float], acceleration: float) -> Iterator[tuple[float, Phase]]:
    """Duration and phase, in order.

    An element that only speeds up, or only brakes, gets that one phase: a sliver of the opposite sign left by rounding
    would show in the acceleration of a cycle that falls on it.
    """
    squares = _junction_squares(lengths, feeds, acceleration)
    for element, (length, feed, (w0, w1)) in enumerate(zip(lengths, feeds, pairwise(squares), strict=True)):
        limit = feed * feed
        peak = max(w0, w1, min(limit, 0.5 * (w0 + w1) + acceleration * length))
        v0, v, v1 = math.sqrt(w0), math.sqrt(peak), math.sqrt(w1)
        speeds_up = v - v0 > SPEED_ROUNDING * v
        brakes = v - v1 > SPEED_ROUNDING * v
        cruise = min((peak - w0) / (2.0 * acceleration), length) if speeds_up else 0.0
        brake = max(length - (peak - w1) / (2.0 * acceleration), cruise) if brakes else length
        if speeds_up:
            yield (v - v0) / acceleration, (element, 0.0, cruise, v0, acceleration)
        if peak == limit or not (speeds_up or brakes):
            yield (brake - cruise) / v, (element, cruise, brake, v, 0.0)
        if brakes:
            yield (v - v1) / acceleration, (element, brake, length, v, -acceleration)


def _junction_squares(lengths: Sequence[float], feeds: Sequence[float], acceleration: float) -> list[float]:
    """Squares of the largest speeds at both ends of every element, one more than there are elements."""
    limits = [0.0, *map(min, pairwise(feeds)), 0.0]
    squares = [limit * limit for limit in limits]
    for i, length in enumerate(lengths):
        squares[i + 1] = min(squares[i + 1], squares[i] + 2.0 * acceleration * length)
    for i in range(len(lengths) - 1, -1, -1):
        squares[i] = min(squares[i], squares[i + 1] + 2.0 * acceleration * lengths[i])
    return squares
