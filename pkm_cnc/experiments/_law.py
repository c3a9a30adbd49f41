"""What theory says of the contour error: e = kappa v^2 J^-1 d2u/ds2 at the delayed point, for equal linear drives.

docs/theory.md derives it. It is drawn beside the simulated values, never in their place.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.config import Setup
from pkm_cnc.kinematics import Machine
from pkm_cnc.plant import AxisPlant, ScaleParameters, TravelParameters
from pkm_cnc.records import AxisSetpoint
from pkm_cnc.servo import ServoDrive

__all__ = ["drift", "kappa"]

Array = NDArray[np.float64]

_MEMORY = 3.0
"""s of machine time after which the drive's lag counts as steady: 60 time constants 1/Kv at Kv 20 1/s."""
_ACCELERATION = 0.01
"""m/s^2 of the parabola that the drive follows; it is linear, so the figure is free."""


def kappa(setup: Setup) -> float | None:
    """Half the variance (s^2) of the impulse response of the sampled position loop over 3 s; None if drives differ.

    Behind a parabola a t^2 / 2 a linear drive lags by a (m t - E / 2), with m the mean and E the mean square of the
    delay. Both come from the lag in two cycles, and kappa = (E - m^2) / 2.
    """
    first, *others = setup.axes.values()
    if any(parts.drive != first.drive or parts.screw != first.screw for parts in others):
        return None
    period = setup.servo_period
    cycles = round(_MEMORY / period)
    drive = ServoDrive(dataclasses.replace(first.drive, following_error_limit=1.0))
    plant = AxisPlant(first.drive, first.screw, ScaleParameters(), TravelParameters(-1.0, 1.0), period, 0.0)
    lags = []
    for cycle in range(cycles + 1):
        t = cycle * period
        setpoint = AxisSetpoint(0.5 * _ACCELERATION * t * t, _ACCELERATION * t, _ACCELERATION)
        command = drive.step(setpoint, plant.state)
        lags.append(command.tracking_error / _ACCELERATION)
        plant.step(command)
    span = cycles // 10
    mean = (lags[-1] - lags[-1 - span]) / (span * period)
    half_square = mean * cycles * period - lags[-1]
    return half_square - 0.5 * mean * mean


def drift(machine: Machine, tcp: ArrayLike, tangent: ArrayLike) -> Array:
    """J^-1 d2u/ds2 (..., 3), 1/m, at poses `tcp` (..., 3), m, on straight lines with unit vector `tangent` (..., 3)."""
    second = machine.second_derivative(tcp, tangent)
    return np.asarray((machine.inverse_jacobian(tcp) * second[..., None, :]).sum(axis=-1), dtype=np.float64)
