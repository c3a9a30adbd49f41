"""What crosses from one stage to the next in every servo cycle, as named tuples of plain numbers.

Each record has the fields of its message in `pkm_cnc_msgs`, in the same order, after `header` and `cycle`, nested
points and vectors written out. SI units; positions of the TCP in `base_link`.
"""

from typing import NamedTuple

__all__ = [
    "CMD_ABORT",
    "CMD_FEED_OVERRIDE",
    "CMD_HOLD",
    "CMD_RAPID_OVERRIDE",
    "CMD_RESET",
    "CMD_RESUME",
    "CMD_SINGLE_BLOCK",
    "CMD_START",
    "NANOSECONDS",
    "PHASE_END",
    "PHASE_HOLD",
    "PHASE_MOVE",
    "STATE_ABORTED",
    "STATE_ABORTING",
    "STATE_FINISHED",
    "STATE_HELD",
    "STATE_HOLDING",
    "STATE_PROGRAM_STOP",
    "STATE_READY",
    "STATE_RUNNING",
    "STATUS_NORMAL",
    "STATUS_TRAVEL_END",
    "AxisCommand",
    "AxisCorrection",
    "AxisSetpoint",
    "AxisState",
    "Command",
    "ContourError",
    "TcpSetpoint",
    "TcpState",
    "Vector",
]

NANOSECONDS = 1_000_000_000
"""ns in a second: stamps are whole nanoseconds."""

Vector = tuple[float, float, float]
"""A point or a vector in `base_link`, x y z."""

PHASE_MOVE, PHASE_HOLD, PHASE_END = 0, 1, 2
"""The setpoint moves (or starts or stops here) | rests until the TCP is in position | is the last one of the run."""

STATUS_NORMAL, STATUS_TRAVEL_END = 0, 1
"""The slider is within its travel | the slider is at or beyond an end of its travel."""

CMD_START, CMD_HOLD, CMD_RESUME, CMD_ABORT, CMD_RESET, CMD_SINGLE_BLOCK, CMD_FEED_OVERRIDE, CMD_RAPID_OVERRIDE = range(
    8
)
"""What an operator commands: begin the program | stop on the path | go on | stop on the path and give the program up |
be ready after that | stop after each block (1) or not (0) | scale the feeds | scale the rapids (both by 0 to 2)."""

(
    STATE_READY,
    STATE_RUNNING,
    STATE_HOLDING,
    STATE_HELD,
    STATE_PROGRAM_STOP,
    STATE_ABORTING,
    STATE_ABORTED,
    STATE_FINISHED,
) = range(8)
"""Waits for start | runs the program | stops for a hold | rests until resume | rests at M0 or M1 until resume | stops
for an abort | rests until reset | the program's last setpoint is out."""


class Command(NamedTuple):
    """A command of the operator: CMD_*, and its number where the kind has one (0 where not)."""

    kind: int
    value: float = 0.0


class TcpSetpoint(NamedTuple):
    """Commanded TCP of one cycle: m, m/s, m/s^2; `path_length` m from the contour's start; `feed` programmed, m/s."""

    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float
    ax: float
    ay: float
    az: float
    path_length: float
    feed: float
    segment: int
    phase: int


class AxisSetpoint(NamedTuple):
    """Commanded joint coordinate of one drive: m, m/s, m/s^2."""

    position: float
    velocity: float
    acceleration: float


class AxisCommand(NamedTuple):
    """What the drive asks of the plant over [k, k+1): velocity command m/s; tracking error setpoint - actual, m."""

    velocity: float
    tracking_error: float


class AxisCorrection(NamedTuple):
    """What a controller at the TCP adds to a drive's velocity command, m/s."""

    velocity: float


class AxisState(NamedTuple):
    """One axis at t_k: m as the scale reads it, m as it truly is, m/s, rad/s, A, N m, STATUS_*."""

    position: float
    slider_position: float
    slider_velocity: float
    motor_speed: float
    current: float
    torque: float
    status: int


class TcpState(NamedTuple):
    """TCP as the controller believes it, as it truly is, and setpoint - true, all m."""

    believed_x: float
    believed_y: float
    believed_z: float
    x: float
    y: float
    z: float
    tracking_error_x: float
    tracking_error_y: float
    tracking_error_z: float


class ContourError(NamedTuple):
    """Shortest vector from the contour to the true TCP (m), its left and up parts, the foot's place on the contour."""

    x: float
    y: float
    z: float
    left: float
    up: float
    magnitude: float
    path_length: float
    segment: int
