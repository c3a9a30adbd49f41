"""The closed position loops of the drives turned round: filters that ask of a drive what makes it go as wanted.

A drive answers its setpoint u late and rounded off: y = G u. What all drives have in common of the delay, m cycles,
only delays the tool along its path and stays; the filters ask for y[k + m] = u[k]. They look ahead, which a
preprocessor can: they are applied to a whole run at once, in the frequency domain.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.array_path import axis_loop
from pkm_cnc.compensation.drive_response import drive_responses
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError

__all__ = ["DriveInverse", "drive_inverse"]

Array = NDArray[np.float64]

NEAR_MINUS_ONE = 0.9
"""1. Zeros with a negative real part beyond this ring at half the servo rate when they are cancelled."""


@dataclass(frozen=True)
class DriveInverse:
    """`responses` (m axes, n) to a unit impulse; `lags` (m,), cycles, their means; `period` s; zeros not to cancel."""

    responses: Array
    lags: Array
    period: float
    zeros: tuple[NDArray[np.complex128], ...]

    @property
    def delay(self) -> float:
        """The common delay m, cycles."""
        return float(self.lags.mean())

    def inverse(self, series: Array, cutoff: float) -> Array:
        """`series` (n, m axes) by 1 + F (1/G - 1), with a Gaussian low-pass F of `cutoff` (Hz, -3 dB) and no phase."""
        return self._filtered(series, lambda axis, turn, g: 1.0 + self._low_pass(turn, cutoff) * (1.0 / g - 1.0))

    def learning(self, series: Array, cutoff: float) -> Array:
        """`series` (n, m axes) by F / G, F as of `inverse`."""
        return self._filtered(series, lambda axis, turn, g: self._low_pass(turn, cutoff) / g)

    def zero_phase(self, series: Array) -> Array:
        """`series` (n, m axes) by Z / G, where Z = |B(z)|^2 / B(1)^2 has the zeros that must not be cancelled."""

        def filter_of(axis: int, turn: Array, g: NDArray[np.complex128]) -> NDArray[np.complex128]:
            around = np.exp(-1j * turn)
            gain = np.ones_like(turn)
            for zero in self.zeros[axis]:
                gain = gain * np.abs(1.0 - zero * around) ** 2 / abs(1.0 - zero) ** 2
            return np.asarray(gain / g)

        return self._filtered(series, filter_of)

    def _low_pass(self, turn: Array, cutoff: float) -> Array:
        return np.asarray(np.exp(-0.5 * np.log(2.0) * (turn / (2.0 * np.pi * self.period * cutoff)) ** 2))

    def _filtered(self, series: Array, filter_of: object) -> Array:
        """Each column by its filter; before the first and behind the last row the series rests.

        Its end is led back to its start far behind, so that it is periodic.
        """
        count, rest = len(series), self.responses.shape[1]
        result = np.empty_like(series)
        for axis, column in enumerate(series.T):
            whole = np.concatenate(
                [column, np.full(rest, column[-1]), np.linspace(column[-1], column[0], rest), np.full(rest, column[0])]
            )
            turn = 2.0 * np.pi * np.fft.rfftfreq(len(whole))
            response = np.fft.rfft(self.responses[axis], len(whole)) * np.exp(1j * turn * self.delay)
            spectrum = np.fft.rfft(whole) * filter_of(axis, turn, response)  # type: ignore[operator]
            result[:, axis] = np.fft.irfft(spectrum, len(whole))[:count]
        return result


def drive_inverse(model: Setup) -> DriveInverse:
    """Of the drives of `model`, taken as linear. Raises InputError where they are unstable or have feed-forward."""
    for axis, parts in model.axes.items():
        for name in ("velocity_feed_forward", "acceleration_feed_forward"):
            if getattr(parts.drive, name) != 0.0:
                raise InputError(
                    f"{axis}.drive.{name}: the inverse of the drives is that of the position loop alone: set it to 0, "
                    "or take --method mirror"
                )
    table = drive_responses(model)
    lags = table @ np.arange(table.shape[1])
    return DriveInverse(table, lags, model.servo_period, tuple(_zeros(model, axis) for axis in model.axes))


def _zeros(model: Setup, axis: str) -> NDArray[np.complex128]:
    """Zeros of the sampled position loop on or outside of the unit circle, or ringing near -1."""
    from scipy.linalg import eigvals

    parts = model.axes[axis]
    drive = dataclasses.replace(parts.drive, dead_time=0.0)  # as in the responses: it adds zeros at infinity alone
    system = axis_loop(drive, parts.screw.pitch, model.servo_period)
    size = len(system.A)
    pencil = np.zeros((size + 2, size + 2))  # states, setpoint; input: its increment
    pencil[:size, :size], pencil[:size, -1] = system.A, system.B[:, 0]
    pencil[size, size] = pencil[size, -1] = 1.0
    pencil[-1, :size], pencil[-1, size] = -system.C[0], 1.0
    mask = np.diag([1.0] * (size + 1) + [0.0])
    zeros = eigvals(pencil, mask)
    zeros = zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e6)]
    ringing = (zeros.real < 0.0) & (np.abs(zeros) >= NEAR_MINUS_ONE)
    outside = np.abs(zeros) >= 1.0 + 1e-6
    return np.asarray(zeros[ringing | outside], dtype=np.complex128)
