"""The parameters of one servo drive: position loop, supervision, current and velocity controllers, motor.

The defaults are the drive of thesis section 7.4, eq. 7-3, with these readings: `T_p` and `T_pi` are integral gains
(K + T/s), J_e is 0.0087 kg m^2, and the factor 2 pi that the printed K1*K2 brings in stands in the velocity
controller, so that torque, inertia and screw keep their physical units. Then eq. 7-1 has the coefficients of
section 7.6.
"""

import math
from dataclasses import dataclass

from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter
from pkm_cnc.servo.pid import PID_FORMS, Pid

__all__ = ["DriveParameters"]

SHORTEST_INTEGRAL_TIME = 1e-6
"""s, in the parallel form s^2: far below any of use, a slip for 0."""


@dataclass(frozen=True)
class DriveParameters:
    """Section `drive.*` of a machine, for all axes or for one.

    `cascade` is PI velocity, PI current and motor inside the position loop; `first_order` is an ideal velocity loop,
    so the position loop is a first-order lag 1/(1 + s/Kv) and the parameters from `velocity_gain` on are unused.

    Raises InputError for an integral time that is a slip for 0.
    """

    kind: str = parameter(
        "cascade",
        "inside the position loop: cascade = PI velocity, PI current, motor; first_order = an ideal velocity loop",
        choices=("cascade", "first_order"),
    )
    kv: float = parameter(20.0, "velocity gain of the position controller (1.2 m/min per mm)", unit="1/s", above=0.0)
    following_error_limit: float = parameter(
        0.020,
        "tracking error at which the machine stops; a sound drive lags by slider speed / Kv, that is 9.1 mm at "
        "9000 mm/min where a Tripod's slider moves 1.21 times as fast as the TCP (100 mm off centre): twice the lag "
        "of the fastest ordinary motion, and a slider that stops dead at 6000 mm/min trips it in about 0.15 s",
        unit="m",
        above=0.0,
    )
    velocity_feed_forward: float = parameter(
        0.0, "K_nV, the share of the setpoint's velocity that is added to the velocity command", unit="1", minimum=0.0
    )
    acceleration_feed_forward: float = parameter(
        0.0,
        "the setpoint's acceleration times this is added to the velocity command: it makes up for what the velocity "
        "loop falls behind by while it accelerates",
        unit="s",
        minimum=0.0,
        maximum=0.1,
    )
    setpoint_delay: float = parameter(
        0.0,
        "T_Gn of the balancing filter: delay of the velocity setpoint, for which the position controller's setpoint "
        "waits; half a servo period is what the drive holds a command for on average",
        unit="s",
        minimum=0.0,
        maximum=0.1,
    )
    equivalent_delay: float = parameter(
        0.0,
        "T_En of the balancing filter: equivalent delay of the velocity loop, by which the position controller's "
        "setpoint lags; 0.00082 s balances the default cascade, 0 a first_order drive",
        unit="s",
        minimum=0.0,
        maximum=0.1,
    )
    position_form: str = parameter(
        "ideal", "form of the position controller's PID algorithm, whose gain is kv", choices=PID_FORMS
    )
    position_integral_time: float = parameter(
        0.0, "of the position controller; 0 = no integral action", unit="s (parallel form: s^2)", minimum=0.0
    )
    position_derivative_time: float = parameter(
        0.0, "of the position controller; 0 = none", unit="s (parallel form: 1)", minimum=0.0
    )
    position_derivative_filter: float = parameter(
        0.001, "time constant of the lag on the position controller's derivative part", unit="s", above=0.0
    )
    velocity_limit: float = parameter(
        0.0,
        "largest velocity command, which stops the integral action while it lasts; 0 = none",
        unit="m/s",
        minimum=0.0,
    )
    velocity_gain: float = parameter(
        2.0 * math.pi * 2.4, "proportional gain of the velocity controller", unit="A s/rad", above=0.0
    )
    velocity_integral: float = parameter(
        2.0 * math.pi * 0.002, "integral gain of the velocity controller", unit="A/rad", minimum=0.0
    )
    current_gain: float = parameter(15.0, "proportional gain of the current controller", unit="V/A", above=0.0)
    current_integral: float = parameter(0.003, "integral gain of the current controller", unit="V/(A s)", minimum=0.0)
    inductance: float = parameter(0.0072, "of the motor's winding", unit="H", above=0.0)
    resistance: float = parameter(1.45, "of the motor's winding", unit="Ohm", minimum=0.0)
    torque_constant: float = parameter(0.77, "torque per current", unit="N m/A", above=0.0)
    inertia: float = parameter(
        0.0087, "of motor, screw and slider together, at the motor's shaft", unit="kg m^2", above=0.0
    )

    back_emf: float = parameter(
        0.0,
        "voltage per speed that the turning motor induces; eq. 7-1 has none. Of an ideal motor it is torque_constant",
        unit="V s/rad",
        minimum=0.0,
    )
    current_limit: float = parameter(0.0, "largest current command; 0 = none", unit="A", minimum=0.0)
    voltage_limit: float = parameter(0.0, "largest voltage at the winding; 0 = none", unit="V", minimum=0.0)
    dead_time: float = parameter(
        0.0,
        "by how much later than it is given a velocity command acts: transmission and computation in the drive",
        unit="s",
        minimum=0.0,
        maximum=0.1,
    )

    def __post_init__(self) -> None:
        if 0.0 < self.position_integral_time < SHORTEST_INTEGRAL_TIME:
            raise InputError(
                f"position_integral_time: {self.position_integral_time} is below {SHORTEST_INTEGRAL_TIME}; "
                "0 is no integral action"
            )

    @property
    def position_controller(self) -> Pid:
        """The position controller: from position error (m) to velocity command (m/s)."""
        return Pid(
            self.position_form,
            self.kv,
            self.position_integral_time or math.inf,
            self.position_derivative_time,
            self.position_derivative_filter,
        )
