"""What a servo drive does once per servo period: position controller, feed-forwards, following-error supervision."""

import math

from pkm_cnc.errors import MachineFault
from pkm_cnc.records import AxisCommand, AxisCorrection, AxisSetpoint, AxisState
from pkm_cnc.servo.drive_parameters import DriveParameters
from pkm_cnc.servo.feed_forward import BalancingFilter, filter_step
from pkm_cnc.servo.pid import PidController

__all__ = ["ServoDrive"]


class ServoDrive:
    """Position controller with feed-forwards, stepped once per servo period (s).

        velocity command = limit( PID(F setpoint - actual) + K_nV velocity + T_a acceleration )

    PID is a gain Kv and F passes the setpoint on at once unless the parameters say otherwise. Before its first step the
    axis rests on the first setpoint.
    """

    def __init__(self, parameters: DriveParameters, servo_period: float) -> None:
        self._limit = parameters.following_error_limit
        self._velocity_feed_forward = parameters.velocity_feed_forward
        self._acceleration_feed_forward = parameters.acceleration_feed_forward
        self._controller = PidController(
            parameters.position_controller.gains.sampled(servo_period), parameters.velocity_limit or math.inf
        )
        balancing = filter_step(parameters, servo_period)
        self._balance = BalancingFilter(balancing) if balancing is not None else None

    def step(self, setpoint: AxisSetpoint, actual: AxisState, correction: AxisCorrection | None = None) -> AxisCommand:
        """Command (m/s) for the period that begins at t_k, from setpoint and scale value (m) at t_k.

        `correction` (m/s) of a controller that looks at the TCP is added like a feed-forward.

        The tracking error, which is supervised, is against the setpoint itself, not the one that the balancing filter
        hands to the controller. Raises MachineFault when it is over its limit or a position is not a finite number.
        """
        tracking_error = setpoint.position - actual.position
        if not -self._limit <= tracking_error <= self._limit:  # refuses NaN too
            raise self._fault(setpoint.position, actual.position)
        error = tracking_error
        if self._balance is not None:
            error = self._balance.step(setpoint.position, setpoint.velocity) - actual.position
        feed_forward = (
            self._velocity_feed_forward * setpoint.velocity + self._acceleration_feed_forward * setpoint.acceleration
        )
        if correction is not None:
            feed_forward += correction.velocity
        return AxisCommand(self._controller.step(error, feed_forward), tracking_error)

    def _fault(self, setpoint: float, actual: float) -> MachineFault:
        for name, position in (("scale value", actual), ("setpoint", setpoint)):
            if not math.isfinite(position):
                return MachineFault(f"{name} {position} is not a finite position")
        return MachineFault(
            f"following error {(setpoint - actual) * 1e3:.6g} mm (setpoint {setpoint * 1e3:.6g} mm, actual "
            f"{actual * 1e3:.6g} mm) is over its limit of {self._limit * 1e3:.6g} mm (drive.following_error_limit)"
        )
