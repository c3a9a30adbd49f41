"""One axis alone, as it runs in the machine: drive and plant stepped together over given setpoints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.plant import AxisPlant
from pkm_cnc.records import AxisSetpoint
from pkm_cnc.servo import ServoDrive

__all__ = ["AxisResponse", "Lag", "follow", "steady_lag"]

Array = NDArray[np.float64]

_ACCELERATION = 0.02  # m/s^2, of the parabola that tells the lag: slow enough for any limit of the drive
_SECONDS = 3.0  # till it is read; what the default drive's slow poles do later is far below what a machine shows


class AxisResponse(NamedTuple):
    """What an axis does, one row a cycle: slider position m, its velocity m/s, tracking error by the scale m; (n,)."""

    position: Array
    velocity: Array
    tracking_error: Array


class Lag(NamedTuple):
    """How an axis follows u(t): u(t - mean) + kappa d2u/dt2, mean in s and kappa in s^2."""

    mean: float
    kappa: float


def follow(
    setup: Setup,
    axis: str,
    position: ArrayLike,
    velocity: ArrayLike = 0.0,
    acceleration: ArrayLike = 0.0,
    ripple: ArrayLike = 0.0,
) -> AxisResponse:
    """The response of `axis` to setpoints (n,), m, m/s, m/s^2, a servo period apart, from rest at 0.

    `ripple` (n,), m, is what the scale reads too much. The travel is left out, for a displacement has no place in it.
    Raises MachineFault as a run does.
    """
    parts = setup.axes[axis]
    drive = ServoDrive(parts.drive, setup.servo_period)
    travel = type(parts.travel)(minimum=-1e3, maximum=1e3)
    if by := setup.imperfect(axis):
        raise InputError(f"{by}: the axis is not ideal by it, and this experiment is about the drive alone")
    plant = AxisPlant(parts.drive, parts.screw, parts.scale, travel, setup.servo_period, 0.0, axis)
    inputs = np.broadcast_arrays(*np.atleast_1d(position, velocity, acceleration, ripple))
    rows = []
    for *setpoint, excess in np.stack(inputs, axis=-1).astype(float).tolist():
        actual = plant.state._replace(position=plant.state.position + excess)
        command = drive.step(AxisSetpoint(*setpoint), actual)
        rows.append((plant.state.slider_position, plant.state.slider_velocity, command.tracking_error))
        plant.step(command)
    return AxisResponse(*np.array(rows).T)


def steady_lag(setup: Setup, axis: str) -> Lag:
    """Mean and half the variance of the impulse response of `axis`, from its lag behind a parabola after 3 s.

    Behind u = a t^2 / 2 it lags by a (mean t - mean^2 / 2 - kappa) when the transient has died away.
    """
    times = np.arange(0.0, _SECONDS, setup.servo_period)
    ramp = _ACCELERATION * times
    position = 0.5 * ramp * times
    lag = (position - follow(setup, axis, position, ramp, _ACCELERATION).position) / _ACCELERATION
    before = len(times) // 2
    mean = float((lag[-1] - lag[before]) / (times[-1] - times[before]))
    return Lag(mean, float(mean * times[-1] - lag[-1]) - 0.5 * mean * mean)
