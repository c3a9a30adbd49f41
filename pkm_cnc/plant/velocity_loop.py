"""From a velocity command held over one servo period to what the motor does with it, exactly.

Both classes answer `step(command)` with a `Motion`; neither knows where the slider is, because without a mechanical
limit nothing inside the velocity loop depends on it.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.servo import DriveParameters, StateSpace, cascade_state_space

__all__ = ["CascadeVelocityLoop", "IdealVelocityLoop", "Motion", "VelocityLoop", "exact_discretisation"]


class Motion(NamedTuple):
    """Slider displacement over the period, m; at its end slider velocity m/s, motor speed rad/s, current A."""

    displacement: float
    slider_velocity: float
    motor_speed: float
    current: float


class VelocityLoop(Protocol):
    """What an axis plant asks of its velocity loop."""

    def step(self, command: float) -> Motion:
        """Hold the velocity `command` (m/s) for one period."""


class IdealVelocityLoop:
    """The slider has the commanded velocity at once. There is no motor: its speed and current are NaN."""

    def __init__(self, period: float) -> None:
        self._period = period

    def step(self, command: float) -> Motion:
        """Hold the velocity `command` (m/s) for one period."""
        return Motion(self._period * command, command, math.nan, math.nan)


class CascadeVelocityLoop:
    """PI velocity controller, PI current controller and motor on a rigid screw, at rest at first."""

    def __init__(self, drive: DriveParameters, pitch: float, period: float) -> None:
        a, b = exact_discretisation(cascade_state_space(drive, pitch), period)
        self._screw = pitch / (2.0 * math.pi)
        # Per state its weights over the four states before and the command. The slider's position, the last state,
        # moves none of them, so its row gives the displacement.
        self._rows = tuple((*row[:4], gain) for row, gain in zip(a.tolist(), b.tolist(), strict=True))
        self._states = (0.0, 0.0, 0.0, 0.0)

    def step(self, command: float) -> Motion:
        """Hold the velocity `command` (m/s) for one period."""
        w, x, y, z = self._states
        velocity_integrator, current_integrator, current, motor_speed, displacement = [
            a * w + b * x + c * y + d * z + e * command for a, b, c, d, e in self._rows
        ]
        self._states = (velocity_integrator, current_integrator, current, motor_speed)
        return Motion(displacement, self._screw * motor_speed, motor_speed, current)


def exact_discretisation(system: StateSpace, period: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(Ad, Bd) of x[k+1] = Ad x[k] + Bd u[k] for an input held over `period` (s); shapes as `system`.

    The matrix exponential of [[A, B], [0, 0]] * period, which is good to some rounding errors in every element although
    the poles of the default cascade lie between 1e3 and 1e-4 1/s.
    """
    states = len(system.B)
    exponent = np.zeros((states + 1, states + 1))
    exponent[:states, :states] = system.A
    exponent[:states, states] = system.B
    from scipy.linalg import expm  # slow to import, and most processes of a graph have no plant

    power = expm(exponent * period)
    return power[:states, :states], power[:states, states]
