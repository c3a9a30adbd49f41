"""Contour error from joint signals alone: thesis 5-10, 5-19..5-27 as corrected, with this project's signs.

The drives know their setpoint U_s, its rate dU_s/dt and their tracking error Delta-U = U_s - U_a. Forward kinematics
and its Jacobian J = dP/dU turn these into the tool's deviation, without the programmed contour: the setpoint is on it,
and J dU_s/dt has its direction. Nothing is linearised in Delta-U, so with the recorded Delta-U a line's contour error
and a circle's radial deviation are exact while setpoint and tool are on the same element.

What the thesis prints differs by misprints: 5-21 divides by J U_s and lacks its last vector; 5-27 adds the J_1 term,
takes the actual drive velocity Kv Delta-U for the direction of the setpoint, and holds for counter-clockwise circles
alone. Its contour error points from the tool to the contour, ours from the contour to the tool.

All functions work on arrays: joints (..., n), m, TCP (..., 3), m, in `base_link`; leading shapes broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.kinematics import Machine
from pkm_cnc.tolerances import VERTICAL

__all__ = [
    "circle_radial_deviation",
    "circle_radial_deviation_by_velocity",
    "estimated_tracking_error",
    "left_and_up",
    "line_contour_error",
    "tcp_tracking_error",
    "tcp_velocity",
]

Array = NDArray[np.float64]


def estimated_tracking_error(joint_velocity: ArrayLike, kv: ArrayLike) -> Array:
    """Delta-U (..., n), m, that 4-15 expects of drives with the velocity gains `kv` (n,), 1/s: dU_s/dt / Kv.

    It is the lag of a drive at constant velocity. Of one that accelerates it misses -(1/(2 Kv^2) + kappa) d2U_s/dt2,
    with kappa half the variance of the drive's impulse response.
    """
    return np.asarray(np.asarray(joint_velocity, dtype=float) / np.asarray(kv, dtype=float))


def tcp_tracking_error(machine: Machine, joints: ArrayLike, tracking_error: ArrayLike) -> Array:
    """Setpoint less actual TCP (..., 3), m: FK(U_s) - FK(U_s - Delta-U), 5-10.

    Raises UnreachableError if there is no such pose.
    """
    setpoint = np.asarray(joints, dtype=float)
    return machine.forward(setpoint) - machine.forward(setpoint - np.asarray(tracking_error, dtype=float))


def tcp_velocity(machine: Machine, joints: ArrayLike, joint_velocity: ArrayLike) -> Array:
    """Velocity of the TCP (..., 3), m/s: J dU/dt at the pose of `joints`, 5-11 and 5-13. Raises UnreachableError."""
    jacobian = machine.inverse_jacobian(machine.forward(joints))
    return np.asarray((jacobian * np.asarray(joint_velocity, dtype=float)[..., None, :]).sum(axis=-1))


def line_contour_error(
    machine: Machine, joints: ArrayLike, joint_velocity: ArrayLike, tracking_error: ArrayLike
) -> Array:
    """Shortest vector from a straight contour to the tool (..., 3), m: 5-19 and 5-21, in three dimensions.

    `joints` and `joint_velocity` are the setpoint's, m and m/s. With X = FK(U_s) - FK(U_s - Delta-U) and
    v = J dU_s/dt it is (X . v / v . v) v - X; NaN where the setpoint rests. Raises UnreachableError.
    """
    deviation = tcp_tracking_error(machine, joints, tracking_error)
    velocity = tcp_velocity(machine, joints, joint_velocity)
    square = _dot(velocity, velocity)
    along = np.divide(_dot(deviation, velocity), square, out=np.full(square.shape, np.nan), where=square > 0.0)
    return np.asarray(along[..., None] * velocity - deviation)


def left_and_up(contour_error: ArrayLike, direction: ArrayLike) -> tuple[Array, Array]:
    """Parts of a contour error (..., 3), m, left of the direction of travel (..., 3) and up, each (...).

    left = (z x t)/|z x t|, up = t x left with t = direction/|direction|; NaN where the direction is vertical or zero.
    `direction` may have any length and unit.
    """
    x, y, z = np.moveaxis(np.asarray(contour_error, dtype=float), -1, 0)
    tx, ty, tz = np.moveaxis(np.asarray(direction, dtype=float), -1, 0)
    horizontal = np.hypot(tx, ty)
    length = np.hypot(horizontal, tz)
    horizontal = np.where(horizontal > VERTICAL * length, horizontal, np.nan)
    with np.errstate(invalid="ignore"):
        left = (tx * y - ty * x) / horizontal
        up = (z * horizontal - tz * ((tx * x + ty * y) / horizontal)) / length
    return left, up


def circle_radial_deviation(
    machine: Machine, joints: ArrayLike, tracking_error: ArrayLike, center: ArrayLike, radius: float
) -> Array:
    """Radial deviation dR (...), m, + = the circle is too small, of a circle about `center` (x, y or x, y, z), m: 5-26.

    The angle alpha of the setpoint is that of FK(U_s) about the centre, so it holds for both directions of travel.
    `radius` in m. Raises UnreachableError.
    """
    x, y = np.moveaxis(machine.forward(joints), -1, 0)[:2]
    middle = np.asarray(center, dtype=float)
    spoke_x, spoke_y = x - middle[..., 0], y - middle[..., 1]
    distance = np.hypot(spoke_x, spoke_y)
    deviation = tcp_tracking_error(machine, joints, tracking_error)
    return _radial_deviation(spoke_x / distance, spoke_y / distance, deviation, radius)


def circle_radial_deviation_by_velocity(
    machine: Machine,
    joints: ArrayLike,
    joint_velocity: ArrayLike,
    tracking_error: ArrayLike,
    radius: float,
    clockwise: bool,
) -> Array:
    """The same without knowing where the circle is, from the direction of the setpoint's velocity: 5-27.

    Counter-clockwise cos(alpha) = v_y/v and sin(alpha) = -v_x/v with v = J dU_s/dt (5-24); clockwise both change sign.
    NaN where the setpoint rests. Raises UnreachableError.
    """
    vx, vy = np.moveaxis(tcp_velocity(machine, joints, joint_velocity), -1, 0)[:2]
    speed = np.hypot(vx, vy) * (-1.0 if clockwise else 1.0)
    deviation = tcp_tracking_error(machine, joints, tracking_error)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _radial_deviation(vy / speed, -vx / speed, deviation, radius)


def _radial_deviation(cosine: Array, sine: Array, deviation: Array, radius: float) -> Array:
    """dR of the actual point R (cos, sin) - deviation: 5-25."""
    return radius - np.hypot(radius * cosine - deviation[..., 0], radius * sine - deviation[..., 1])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))
