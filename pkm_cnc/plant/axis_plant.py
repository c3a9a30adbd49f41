"""One axis between two ticks of the servo clock: velocity loop, ball screw, slider, linear scale."""

import math

from pkm_cnc.errors import MachineFault
from pkm_cnc.plant.linear_scale import LinearScale
from pkm_cnc.plant.plant_parameters import ScaleParameters, ScrewParameters, TravelParameters
from pkm_cnc.plant.velocity_loop import CascadeVelocityLoop, IdealVelocityLoop, VelocityLoop
from pkm_cnc.records import STATUS_NORMAL, STATUS_TRAVEL_END, AxisCommand, AxisState
from pkm_cnc.servo import DriveParameters

__all__ = ["AxisPlant"]


class AxisPlant:
    """The ideal axis `name`: integrates what is faster than the servo period (s), exactly.

    It starts at rest at `start_position` (m). An end of travel is reported by the status and stops nothing.
    Raises InputError when `start_position` is not within the travel.
    """

    def __init__(
        self,
        drive: DriveParameters,
        screw: ScrewParameters,
        scale: ScaleParameters,
        travel: TravelParameters,
        servo_period: float,
        start_position: float,
        name: str = "",
    ) -> None:
        travel.require(start_position)
        self._scale = LinearScale(scale, name)
        self._travel = travel
        self._torque_constant = drive.torque_constant
        self._loop: VelocityLoop
        if drive.kind == "cascade":
            self._loop = CascadeVelocityLoop(drive, screw.pitch, servo_period)
            motor_at_rest = 0.0
        else:
            self._loop = IdealVelocityLoop(servo_period)
            motor_at_rest = math.nan
        self._position = start_position
        self._position_rest = 0.0
        self.state = self._state(0.0, motor_at_rest, motor_at_rest)
        """The axis at the present instant t_k."""

    def step(self, command: AxisCommand, load: float = 0.0) -> AxisState:
        """Hold `command` over [t_k, t_k+1) and return the state at t_k+1. A `load` is no matter of this axis.

        Raises MachineFault when the velocity command is not a finite number.
        """
        if not math.isfinite(command.velocity):
            raise MachineFault(f"velocity command {command.velocity} m/s is not a finite number")
        displacement, slider_velocity, motor_speed, current = self._loop.step(command.velocity)
        # Compensated sum: at constant speed a plain one rounds every step the same way, and a long run drifts.
        displacement += self._position_rest
        position = self._position + displacement
        self._position_rest = displacement - (position - self._position)
        self._position = position
        self.state = self._state(slider_velocity, motor_speed, current)
        return self.state

    def _state(self, slider_velocity: float, motor_speed: float, current: float) -> AxisState:
        position = self._position
        return AxisState(
            self._scale.read(position),
            position,
            slider_velocity,
            motor_speed,
            current,
            self._torque_constant * current,
            STATUS_NORMAL if self._travel.minimum < position < self._travel.maximum else STATUS_TRAVEL_END,
        )
