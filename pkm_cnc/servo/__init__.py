"""Servo drives: what runs at the servo clock, and the description of the loops that are faster.

`ServoDrive` closes the position loop once per period, with a PID controller (`Pid`) and feed-forwards behind a
balancing filter. `cascade_state_space` describes what lies inside it, for an axis plant to integrate; `position_loop`
is the whole closed loop as the transfer function of thesis section 7.4. `response_figures` measures a step response.
"""

from pkm_cnc.servo.cascade import CASCADE_STATES, StateSpace, cascade_state_space
from pkm_cnc.servo.drive_parameters import DriveParameters
from pkm_cnc.servo.feed_forward import BalancingFilter, FilterStep, equivalent_delay, filter_step
from pkm_cnc.servo.pid import PID_FORMS, Controller, Pid, PidController, PidGains, SampledPid
from pkm_cnc.servo.response import ResponseFigures, response_figures
from pkm_cnc.servo.servo_drive import ServoDrive
from pkm_cnc.servo.transfer_function import (
    TransferFunction,
    filter_setpoints,
    impulse_response,
    poles,
    position_loop,
    ramp_lag,
    ramp_response,
    recursion,
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
    "ResponseFigures",
    "SampledPid",
    "ServoDrive",
    "StateSpace",
    "TransferFunction",
    "cascade_state_space",
    "equivalent_delay",
    "filter_setpoints",
    "filter_step",
    "impulse_response",
    "poles",
    "position_loop",
    "ramp_lag",
    "ramp_response",
    "recursion",
    "response_figures",
    "step_response",
]
