"""Divides a coordinate by frequency: a slow part that a low-pass filter passes, and the fast rest.

The filter is the critically damped one of second order, G(s) = w^2 / (s + w)^2, w = 2 pi times the crossover frequency:
it overshoots no step, and of a sine of frequency f it passes 1 / (1 + (f / crossover)^2), at the crossover one half. Of
its input x, its output y and the lag e = x - y

    e' = x' - y',   y'' = w^2 e - 2 w y',

and the lag, which is the fast part, is what is kept: it is small, so it is rounded finely, and 0 at rest. Where x runs
with a constant slope g from one cycle to the next, E = e - 2 g / w and Q = y' - g obey E' = -Q, Q' = w^2 E - 2 w Q, and
both eigenvalues are -w, so over a period T, exactly,

    E -> exp(-w T) ((1 + w T) E - T Q),   Q -> exp(-w T) (w^2 T E + (1 - w T) Q).

y, y' and y'' are position, velocity and acceleration of one motion, whose acceleration is continuous.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["Crossover", "Division"]


class Division(NamedTuple):
    """A coordinate divided at an instant: itself, its fast part (m), and the velocity of its slow part (m/s)."""

    value: float
    fast: float
    slow_velocity: float


class Crossover:
    """The filter for one coordinate, in python floats; `frequency` in Hz, `period` from one value to the next in s."""

    def __init__(self, frequency: float, period: float) -> None:
        rate = math.tau * frequency
        decay = math.exp(-rate * period)
        self._period = period
        self._ramp_lag = 2.0 / rate
        self._square, self._twice = rate * rate, 2.0 * rate
        self._fast_fast, self._fast_slow = decay * (1.0 + rate * period), decay * period
        self._slow_fast, self._slow_slow = decay * (self._square * period), decay * (1.0 - rate * period)

    def step(self, before: Division, value: float) -> Division:
        """The division one period later, the coordinate (m) having run straight to `value`."""
        slope = (value - before.value) / self._period
        lag = self._ramp_lag * slope
        fast, slow = before.fast - lag, before.slow_velocity - slope
        return Division(
            value,
            lag + (self._fast_fast * fast - self._fast_slow * slow),
            slope + (self._slow_fast * fast + self._slow_slow * slow),
        )

    def slow_acceleration(self, division: Division) -> float:
        """The acceleration of the slow part, m/s^2."""
        return self._square * division.fast - self._twice * division.slow_velocity
