"""What a servo drive does once per servo period: the position controller and its following-error supervision."""

import math

from pkm_cnc.errors import MachineFault
from pkm_cnc.records import AxisCommand, AxisSetpoint, AxisState
from pkm_cnc.servo.drive_parameters import DriveParameters

__all__ = ["ServoDrive"]


class ServoDrive:
    """Proportional position controller: velocity command = Kv * (setpoint - actual), without state."""

    def __init__(self, parameters: DriveParameters) -> None:
        self._kv = parameters.kv
        self._limit = parameters.following_error_limit

    def step(self, setpoint: AxisSetpoint, actual: AxisState) -> AxisCommand:
        """Command (m/s) for the period that begins at t_k, from setpoint and scale value (m) at t_k.

        Raises MachineFault when the tracking error is over its limit or a position is not a finite number.
        """
        tracking_error = setpoint.position - actual.position
        if not -self._limit <= tracking_error <= self._limit:  # refuses NaN too
            raise self._fault(setpoint.position, actual.position)
        return AxisCommand(self._kv * tracking_error, tracking_error)

    def _fault(self, setpoint: float, actual: float) -> MachineFault:
        for name, position in (("scale value", actual), ("setpoint", setpoint)):
            if not math.isfinite(position):
                return MachineFault(f"{name} {position} is not a finite position")
        return MachineFault(
            f"following error {(setpoint - actual) * 1e3:.6g} mm (setpoint {setpoint * 1e3:.6g} mm, actual "
            f"{actual * 1e3:.6g} mm) is over its limit of {self._limit * 1e3:.6g} mm (drive.following_error_limit)"
        )
