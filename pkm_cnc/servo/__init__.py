"""Servo drives: what runs at the servo clock, and the description of the loops that are faster.

`ServoDrive` closes the position loop once per period. `cascade_state_space` describes what lies inside it, for an axis
plant to integrate; `position_loop` is the whole closed loop as the transfer function of thesis section 7.4.
"""

from pkm_cnc.servo.cascade import CASCADE_STATES, StateSpace, cascade_state_space
from pkm_cnc.servo.drive_parameters import DriveParameters
from pkm_cnc.servo.feed_forward import BalancingFilter, FilterStep, equivalent_delay, filter_step
from pkm_cnc.servo.pid import PID_FORMS, Controller, Pid, PidController, PidGains, SampledPid
from pkm_cnc.servo.servo_drive import ServoDrive
from pkm_cnc.servo.transfer_function import (
    TransferFunction,
    delay_time,
    filter_setpoints,
    impulse_response,
    poles,
    position_loop,
    ramp_lag,
    ramp_response,
    recursion,
    rise_time,
    step_response,
)

__all__ = [
    "CASCADE_STATES",
    "PID_FORMS",
    "BalancingFilter",
    "Controller",
    "DriveParameters",
    "FilterStep",
    "Pid",
    "PidController",
    "PidGains",
    "SampledPid",
    "ServoDrive",
    "StateSpace",
    "TransferFunction",
    "cascade_state_space",
    "delay_time",
    "equivalent_delay",
    "filter_setpoints",
    "filter_step",
    "impulse_response",
    "poles",
    "position_loop",
    "ramp_lag",
    "ramp_response",
    "recursion",
    "rise_time",
    "step_response",
]
