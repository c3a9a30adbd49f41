"""The figures of a step response, recorded or computed: thesis section 2.2.2 and fig. 2-2, after Ogata, Modern Control
Engineering, section 5-3.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.tolerances import NO_OVERSHOOT

__all__ = ["ResponseFigures", "response_figures"]

Array = NDArray[np.float64]

REST = 0.25
"""1. Share of a record at its end in which the response must have come to rest."""


@dataclass(frozen=True)
class ResponseFigures:
    """Times in s from the step. Levels are shares of the way from the first value to the final one, the last recorded.

    Between samples the response is taken as straight, its peak as a parabola.
    """

    delay_time: float
    """t_d: to 50 % for the first time."""
    rise_time: float
    """t_r: from 10 % to 90 %, each for the first time."""
    peak_time: float
    """t_p: to the highest point beyond the final value; NaN without overshoot."""
    settling_time: float
    """t_s: until the response stays within `band` of the final value."""
    overshoot: float
    """M_p: how far the highest point is beyond the final value, as a share of the way; 0 if it is not."""
    steady_state_error: float
    """e_ss: target less final value, in the unit of the values."""
    band: float
    """Half width of the band for t_s, as a share of the way."""


def response_figures(times: ArrayLike, values: ArrayLike, target: float, band: float = 0.02) -> ResponseFigures:
    """The figures of `values` (any unit) at `times` (s), both of shape (n,), after a step to `target` at times[0].

    Raises InputError for times that do not increase, numbers that are not finite, a band that is not between 0 and 0.5,
    a response that ends where it began, and one that has not settled: it must be within the band for the last quarter
    of the record.
    """
    t, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    _check(t, y, target, band)
    final = float(y[-1])
    level = (y - y[0]) / (final - y[0])
    settling = _settling(t, level, band)
    if settling > t[-1] - REST * (t[-1] - t[0]):
        raise InputError(
            f"response: not settled, it is outside the band of {band:.6g} of its step about the last value until "
            f"{settling:.6g} s of {t[-1]:.6g} s; record it for longer"
        )
    peak_time, overshoot = _peak(t, level)
    return ResponseFigures(
        delay_time=_reached(t, level, 0.5) - float(t[0]),
        rise_time=_reached(t, level, 0.9) - _reached(t, level, 0.1),
        peak_time=peak_time - float(t[0]),
        settling_time=settling - float(t[0]),
        overshoot=overshoot,
        steady_state_error=target - final,
        band=band,
    )


def _check(t: Array, y: Array, target: float, band: float) -> None:
    if t.ndim != 1 or t.shape != y.shape or len(t) < 3:
        raise InputError(
            f"response: times of shape {t.shape} and values of shape {y.shape}; wanted (n,), n of 3 or more"
        )
    if not (np.isfinite(t).all() and np.isfinite(y).all() and math.isfinite(target)):
        raise InputError("response: a time, a value or the target is not a finite number")
    if not np.all(np.diff(t) > 0.0):
        raise InputError(f"response: times do not increase after {t[int(np.argmax(np.diff(t) <= 0.0))]:.6g} s")
    if not 0.0 < band < 0.5:
        raise InputError(f"response: a band of {band} is not between 0 and 0.5")
    if y[-1] == y[0]:
        raise InputError(f"response: it ends at {y[-1]:.6g}, where it began; there is no step to measure")


def _reached(t: Array, level: Array, share: float) -> float:
    """When `level` first reaches `share`; it begins below and ends above."""
    return _crossing(t, level, int(np.argmax(level >= share)) - 1, share)


def _settling(t: Array, level: Array, band: float) -> float:
    last_outside = int(np.flatnonzero(np.abs(level - 1.0) > band)[-1])
    return _crossing(t, level, last_outside, 1.0 + math.copysign(band, level[last_outside] - 1.0))


def _crossing(t: Array, level: Array, before: int, share: float) -> float:
    """When the straight line from sample `before` to the next is at `share`."""
    start, end = float(level[before]), float(level[before + 1])
    return float(t[before] + (t[before + 1] - t[before]) * (share - start) / (end - start))


def _peak(t: Array, level: Array) -> tuple[float, float]:
    """Time and height above 1 of the parabola through the highest sample and its neighbours; NaN and 0 without one."""
    top = int(np.argmax(level))
    if level[top] - 1.0 <= NO_OVERSHOOT:
        return math.nan, 0.0
    left, right = float(t[top - 1] - t[top]), float(t[top + 1] - t[top])
    down_left, down_right = float(level[top - 1] - level[top]), float(level[top + 1] - level[top])
    # level = level[top] + slope x + bend x^2 through both neighbours
    bend = (down_right / right - down_left / left) / (right - left)
    slope = down_left / left - bend * left
    summit = -slope / (2.0 * bend)
    return float(t[top]) + summit, float(level[top]) + 0.5 * slope * summit - 1.0
