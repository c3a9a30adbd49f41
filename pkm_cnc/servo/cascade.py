"""The cascade inside the position loop, as one linear system: PI velocity controller, PI current controller, motor.

    velocity command -> [speed] -> (+) -> [PI velocity] -> (+) -> [PI current] -> [L, R] -> [Km] -> [1/J] -> [screw]
                                    ^ - motor speed         ^ - current

Thesis fig. 7-5 without the position controller, which runs at the servo clock (`ServoDrive`). There is no back-EMF in
eq. 7-1, and the power stage is ideal.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.servo.drive_parameters import DriveParameters
from pkm_cnc.servo.pid import PidGains

__all__ = ["CASCADE_STATES", "StateSpace", "cascade_state_space"]

CASCADE_STATES = ("velocity_integrator", "current_integrator", "current", "motor_speed", "slider_position")
"""The states in order: A (part of the current command), V (part of the voltage), A, rad/s, m."""


class StateSpace(NamedTuple):
    """dx/dt = A x + B u. A: shape (n, n). B: shape (n,), one input."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]


def cascade_state_space(drive: DriveParameters, pitch: float) -> StateSpace:
    """The cascade of `drive` on a rigid screw of `pitch` (m/rev): states CASCADE_STATES, input velocity command, m/s.

    Each signal is a row: its coefficients over the five states and the command, so the lines below are the equations.
    """
    velocity_integrator, current_integrator, current, motor_speed, _, velocity_command = np.eye(6)
    screw = pitch / (2.0 * math.pi)  # m/rad

    speed_error = velocity_command / screw - motor_speed
    velocity_controller = PidGains(drive.velocity_gain, drive.velocity_integral).continuous()
    current_command, velocity_integration = velocity_controller.connect(speed_error, velocity_integrator[np.newaxis])
    current_error = current_command - current
    current_controller = PidGains(drive.current_gain, drive.current_integral).continuous()
    voltage, current_integration = current_controller.connect(current_error, current_integrator[np.newaxis])
    torque = drive.torque_constant * current

    derivatives = np.array(
        [
            *velocity_integration,
            *current_integration,
            (voltage - drive.resistance * current) / drive.inductance,
            torque / drive.inertia,
            screw * motor_speed,
        ]
    )
    return StateSpace(derivatives[:, :5], derivatives[:, 5])
