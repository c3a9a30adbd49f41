"""The step object of the controllers that look at the TCP.

The sum of three corrections, each m/s per drive, each added to the velocity command of its position loop,
Kv (setpoint - actual). With J = du/dP where the TCP is:

- *adapted gain*. A position loop alone lets every drive lag by its speed / Kv, and on a parallel kinematic machine the
  point whose joints these are is not on the path. The thesis' outlook (chapter 8) wants drives that lag as the joints
  of a point that lags along the path, delta-u* = IK(P(s)) - IK(P(s - v / Kv)). A gain du/dt / delta-u* has no value
  where a drive reverses; the velocity that it stands for has. With the lagging place u* (`lagging_place`)

      command = (u*[k+1] - u*[k]) / T + Kv (u*[k] - actual),

  so with an ideal velocity loop every drive is at u* in every cycle, exactly.
- *cross coupling* (Koren, Cross-coupled biaxial computer control for manufacturing systems, 1980): the contour error
  of the believed TCP, commanded back as a velocity of the TCP: -K J e. It is taken at the lagging place, normal to the
  path there: at a corner the nearest point of the contour would be one on the wrong side too soon.
- *direct feedback* (thesis 2.1.3): the position loop is closed with the tracking error of the TCP as a measuring system
  at the TCP reads it: Kv J (setpoint - true TCP) in place of Kv (setpoint - actual) of the drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pkm_cnc.errors import InputError
from pkm_cnc.kinematics import Machine
from pkm_cnc.records import AxisCorrection, AxisSetpoint, AxisState, TcpSetpoint, TcpState, Vector
from pkm_cnc.servo import DriveParameters
from pkm_cnc.tcp_control.lagging_place import LaggingPlace, Place
from pkm_cnc.tcp_control.tcp_control_parameters import TcpControlParameters

__all__ = ["TcpController"]


class TcpController:
    """One run's controller: a velocity correction for every drive and cycle.

    `machine` is the nominal one, for poses in space; `drives` are in its order; `period` is the servo period, s.
    Raises InputError for a combination that would count something twice, and for a gain that the servo period cannot
    have.
    """

    def __init__(
        self, parameters: TcpControlParameters, machine: Machine, drives: Sequence[DriveParameters], period: float
    ) -> None:
        _refuse(parameters, drives, period)
        self._parameters = parameters
        self._machine = machine
        self._kv = [drive.kv for drive in drives]
        self._period = period
        self._lagging = LaggingPlace(min(self._kv), period)
        self._tangent: Vector = (0.0, 0.0, 0.0)  # the last one of the lagging place

    def step(
        self,
        setpoint: TcpSetpoint,
        axis_setpoints: Sequence[AxisSetpoint],
        states: Sequence[AxisState],
        tcp: TcpState,
    ) -> list[AxisCorrection]:
        """What is added to each drive's velocity command in this cycle; all arguments are of this cycle.

        What the commands of the cycle before brought about is in `states` and `tcp`.
        Raises UnreachableError where the kinematics have no Jacobian.
        """
        parameters = self._parameters
        sums = [0.0] * len(self._kv)
        if parameters.adapted_gain or parameters.cross_coupling:
            here, later = self._lagging.step(setpoint, axis_setpoints)
            if parameters.adapted_gain:
                sums = _added(sums, self._adapted_gain(here, later, axis_setpoints))
            if parameters.cross_coupling:
                sums = _added(sums, self._cross_coupling(here, later, tcp))
        if parameters.direct_feedback:
            sums = _added(sums, self._direct_feedback(axis_setpoints, states, tcp))
        return [AxisCorrection(velocity) for velocity in sums]

    def _adapted_gain(self, here: Place, later: Place, axis_setpoints: Sequence[AxisSetpoint]) -> list[float]:
        return [
            (after - now) / self._period + kv * (now - wanted.position)
            for kv, now, after, wanted in zip(self._kv, here.joints, later.joints, axis_setpoints, strict=True)
        ]

    def _cross_coupling(self, here: Place, later: Place, tcp: TcpState) -> list[float]:
        dx, dy, dz = (b - a for a, b in zip(here.tcp, later.tcp, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length > 0.0:
            self._tangent = (dx / length, dy / length, dz / length)
        tx, ty, tz = self._tangent
        x, y, z = tcp.believed_x - here.tcp[0], tcp.believed_y - here.tcp[1], tcp.believed_z - here.tcp[2]
        along = x * tx + y * ty + z * tz
        back = -self._parameters.cross_coupling
        return self._in_joints(tcp, (back * (x - along * tx), back * (y - along * ty), back * (z - along * tz)))

    def _direct_feedback(
        self, axis_setpoints: Sequence[AxisSetpoint], states: Sequence[AxisState], tcp: TcpState
    ) -> list[float]:
        missing = self._in_joints(tcp, (tcp.tracking_error_x, tcp.tracking_error_y, tcp.tracking_error_z))
        return [
            kv * (at_tcp - (wanted.position - state.position))
            for kv, at_tcp, wanted, state in zip(self._kv, missing, axis_setpoints, states, strict=True)
        ]

    def _in_joints(self, tcp: TcpState, vector: Vector) -> list[float]:
        """J times `vector` where the TCP is believed to be."""
        x, y, z = vector
        rows = self._machine.jacobian((tcp.believed_x, tcp.believed_y, tcp.believed_z)).tolist()
        return [a * x + b * y + c * z for a, b, c in rows]


def _added(first: list[float], second: list[float]) -> list[float]:
    return [a + b for a, b in zip(first, second, strict=True)]


def _refuse(parameters: TcpControlParameters, drives: Sequence[DriveParameters], period: float) -> None:
    fed_forward = any(drive.velocity_feed_forward or drive.acceleration_feed_forward for drive in drives)
    if parameters.adapted_gain and fed_forward:
        raise InputError(
            "tcp_control.adapted_gain: not together with drive.velocity_feed_forward or "
            "drive.acceleration_feed_forward, which take away the lag that it makes alike"
        )
    if parameters.adapted_gain and parameters.direct_feedback:
        raise InputError(
            "tcp_control.adapted_gain: not together with tcp_control.direct_feedback, which lets the TCP lag along the "
            "path by itself"
        )
    fastest = max(drive.kv for drive in drives) + parameters.cross_coupling
    if parameters.active and fastest * period > 1.0:
        raise InputError(
            f"tcp_control: drive.kv + tcp_control.cross_coupling is {fastest:g} 1/s, more than 1 / servo_period = "
            f"{1.0 / period:g} 1/s: the loop would oscillate"
        )
