"""What theory says of the contour error: e = kappa v^2 J^-1 d2u/ds2 at the delayed point, for equal linear drives.

docs/theory.md derives it. It is drawn beside the simulated values, never in their place.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.array_path import respond
from pkm_cnc.config import Setup
from pkm_cnc.kinematics import Machine
from pkm_cnc.plant import ScaleParameters

__all__ = ["drift", "kappa"]

Array = NDArray[np.float64]

_MEMORY = 3.0
"""s of machine time after which the drive's lag counts as steady: 60 time constants 1/Kv at Kv 20 1/s."""
_ACCELERATION = 1e-4
"""m/s^2 of the parabola that the drive follows; it is linear, so this is free but for the following error's limit."""


def kappa(setup: Setup) -> float | None:
    """Half the variance (s^2) of the impulse response of the sampled position loop over 3 s; None if drives differ.

    Behind a parabola a t^2 / 2 a linear drive lags by a (m t - E / 2), with m the mean and E the mean square of the
    delay. Both come from the lag in two cycles, and kappa = (E - m^2) / 2. Scales count as ideal.
    """
    axis, first = next(iter(setup.axes.items()))
    if any(parts.drive != first.drive or parts.screw != first.screw for parts in setup.axes.values()):
        return None
    ideal = dataclasses.replace(setup, axes={axis: dataclasses.replace(first, scale=ScaleParameters())})
    t = np.arange(round(_MEMORY / setup.servo_period) + 1) * setup.servo_period
    motion = 0.5 * _ACCELERATION * t * t, _ACCELERATION * t, np.full_like(t, _ACCELERATION)
    lag = respond(ideal, axis, *motion).tracking_error / _ACCELERATION
    before = 9 * len(t) // 10
    mean = float((lag[-1] - lag[before]) / (t[-1] - t[before]))
    return float(mean * t[-1] - lag[-1]) - 0.5 * mean * mean


def drift(machine: Machine, tcp: ArrayLike, tangent: ArrayLike) -> Array:
    """J^-1 d2u/ds2 (..., 3), 1/m, at poses `tcp` (..., 3), m, on straight lines with unit vector `tangent` (..., 3)."""
    second = machine.second_derivative(tcp, tangent)
    return np.asarray((machine.inverse_jacobian(tcp) * second[..., None, :]).sum(axis=-1), dtype=np.float64)
