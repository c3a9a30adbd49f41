"""What lets a velocity feed-forward act without the position controller working against it.

Fig. 2-14 of the thesis. The feed-forward is ahead: the slider follows it through the velocity loop, which answers late.
Were the position controller given the setpoint at once, it would see an error, act, and the slider would overshoot. So
it is given the setpoint as late as the velocity loop will follow it, by the balancing filter

    F(s) = exp(-s T_Gn) / (1 + s T_En),

T_En the equivalent delay of the closed velocity loop and T_Gn the delay of the velocity setpoint on its way there: the
drive holds it for a servo period T, which delays it by T/2.
"""

import math
from collections import deque
from typing import Any, NamedTuple

from pkm_cnc.servo.drive_parameters import DriveParameters

__all__ = ["BalancingFilter", "FilterStep", "equivalent_delay", "filter_step"]


def equivalent_delay(drive: DriveParameters) -> float:
    """T_En, s, of the drive's velocity loop: its lag behind a ramp of the velocity command over the times of a motion.

    (R + K_pi) J / (K_m K_p K_pi), the integral gains left out: what they add lasts for hours and is 1e-9 of the motion
    for the default drive (see `transfer_function`). 0 for first_order.
    """
    if drive.kind == "first_order":
        return 0.0
    stiffness = drive.torque_constant * drive.velocity_gain * drive.current_gain
    return (drive.resistance + drive.current_gain) * drive.inertia / stiffness


class FilterStep(NamedTuple):
    """The balancing filter per period.

    The delay is `whole` periods and a rest that lies between two setpoints, taken from the cubic through both positions
    and velocities, so a setpoint of constant jerk is delayed exactly. The lag is exact for a setpoint that moves evenly
    from one period to the next: lag[k] = decay lag[k-1] + gain (delayed[k] - delayed[k-1]).
    """

    whole: int
    earlier_position: float
    earlier_velocity: float
    later_velocity: float
    decay: float
    gain: float

    def between(self, earlier: Any, earlier_velocity: Any, later: Any, later_velocity: Any) -> Any:
        """The delayed setpoint, m, from the two setpoints around it, m and m/s: floats or arrays of one shape."""
        return later + (
            (earlier - later) * self.earlier_position
            + (earlier_velocity * self.earlier_velocity + later_velocity * self.later_velocity)
        )


def filter_step(drive: DriveParameters, period: float) -> FilterStep | None:
    """The balancing filter of `drive` for setpoints `period` (s) apart. None without either delay."""
    if drive.setpoint_delay == drive.equivalent_delay == 0.0:
        return None
    whole = math.floor(drive.setpoint_delay / period)
    back = drive.setpoint_delay / period - whole  # from the later setpoint, in periods
    lag = drive.equivalent_delay
    decay = math.exp(-period / lag) if lag > 0.0 else 0.0
    gain = -lag / period * math.expm1(-period / lag) if lag > 0.0 else 0.0
    return FilterStep(
        whole,
        back * back * (3.0 - 2.0 * back),
        period * (1.0 - back) * back * back,
        -period * (1.0 - back) * (1.0 - back) * back,
        decay,
        gain,
    )


class BalancingFilter:
    """The balancing filter cycle by cycle; the axis rests on the first setpoint, whatever velocity that has."""

    def __init__(self, step: FilterStep) -> None:
        self._step = step
        self._setpoints: deque[tuple[float, float]] = deque(maxlen=step.whole + 2)
        self._delayed = 0.0
        self._lag = 0.0

    def step(self, position: float, velocity: float) -> float:
        """The position (m) that the position controller is given, for the setpoint of this cycle, m and m/s."""
        if not self._setpoints:
            self._setpoints.extend([(position, 0.0)] * (self._step.whole + 2))
            self._delayed = position
            return position
        self._setpoints.append((position, velocity))
        delayed: float = self._step.between(*self._setpoints[0], *self._setpoints[1])
        self._lag = self._step.decay * self._lag + self._step.gain * (delayed - self._delayed)
        self._delayed = delayed
        return delayed - self._lag
