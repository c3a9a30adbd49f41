"""Frequency response of a drive from the setpoint to the actual position, with coherence, from an ordinary run.

By Welch's method (IEEE Trans. Audio Electroacoustics 15 (1967) 70): H1 = P_xy / P_xx, coherence = |P_xy|^2 /
(P_xx P_yy), of the increments of both, because positions wander and velocities do not; the factor between them cancels.
Coherence below 1 means noise or nonlinearity, or that the run does not excite the frequency: believe nothing there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import InputError

__all__ = ["FrequencyResponse", "frequency_response"]

Array = NDArray[np.float64]

SEGMENT = 1.024
"""s of one segment: a resolution of 1 Hz, and long beside 1/Kv."""
HIGHEST = 100.0
"""Hz. The drives of these machines answer up to some 10 Hz; above this setpoints have nothing."""


@dataclass(frozen=True)
class FrequencyResponse:
    """At `frequency` (n,), Hz: complex `response` (n,), 1, and `coherence` (n,), 0 to 1."""

    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array

    @property
    def gain_db(self) -> Array:
        """(n,), dB."""
        return np.asarray(20.0 * np.log10(np.abs(self.response)))

    @property
    def phase_deg(self) -> Array:
        """(n,), deg, - = behind, without jumps."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.response))))


def frequency_response(setpoint: ArrayLike, actual: ArrayLike, period: float) -> FrequencyResponse:
    """Response of `actual` to `setpoint`, (n,) each, m, `period` (s) apart, from the resolution up to 100 Hz.

    Raises InputError for series of other shapes, too short for one segment, not finite, or constant.
    """
    from scipy import signal

    x, y = np.asarray(setpoint, dtype=float), np.asarray(actual, dtype=float)
    length = round(SEGMENT / period)
    if x.ndim != 1 or x.shape != y.shape or len(x) <= length:
        raise InputError(
            f"frequency response: series of shapes {x.shape} and {y.shape}; wanted are two of one length, more than "
            f"{length} cycles ({SEGMENT:g} s)"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("frequency response: a position is no finite number")
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        raise InputError("frequency response: a position is constant")
    moved, answered = np.diff(x), np.diff(y)
    options = {"fs": 1.0 / period, "window": "hann", "nperseg": length, "detrend": False}
    frequency, input_power = signal.welch(moved, **options)
    _, output_power = signal.welch(answered, **options)
    _, cross = signal.csd(moved, answered, **options)
    shown = (frequency > 0.0) & (frequency <= HIGHEST) & (input_power > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.abs(cross[shown]) ** 2 / (input_power[shown] * output_power[shown])
    return FrequencyResponse(frequency[shown], cross[shown] / input_power[shown], coherence)
