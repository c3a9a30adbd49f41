"""What a motion does in every servo cycle, against the limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.motion.limits import DriveLimits, MotionParameters
from pkm_cnc.records import TcpSetpoint

__all__ = ["BEFORE", "slow_downs"]

Array = NDArray[np.float64]

BEFORE = 3
"""Setpoints before the first that is judged: the jerk of a cycle takes the positions of four."""
ROUNDING = 1e-15
"""1. What positions and speeds are off by rounding, relative to the largest: at short servo periods it would be taken
for a jerk."""


def slow_downs(
    setpoints: Sequence[TcpSetpoint],
    motion: MotionParameters,
    drives: DriveLimits,
    period: float,
    scales: Array | float = 1.0,
) -> Array:
    """The factor by which to stretch the time of each setpoint but the first three to keep all limits; shape (k - 3,).

    Stretched by f, speeds fall by f, accelerations by f^2 and jerks by f^3. 1 or less: kept. Speed and acceleration of
    a drive are those of the setpoint, and what its position and its speed change by from cycle to cycle; a jerk is what
    the changes change by, also of the TCP, as a vector. `scales` are the overrides of the feed, of each setpoint (k,)
    or of all. Raises UnreachableError for a place outside the workspace.
    """
    table = np.array([setpoint[:9] for setpoint in setpoints])
    feeds = np.array([setpoint.feed for setpoint in setpoints]) * scales
    position, velocity, acceleration = table[:, 0:3], table[:, 3:6], table[:, 6:9]
    drive, speed, rate = drives.motion(position, velocity, acceleration)

    def change(values: Array, order: int) -> Array:
        differences = np.abs(np.diff(values, n=order, axis=0)[BEFORE - order :])
        rounding = 2.0**order * ROUNDING * np.abs(values).max()
        return np.asarray(np.maximum(differences - rounding, 0.0) / period**order)

    found = np.maximum(_norm(velocity)[BEFORE:] / feeds[BEFORE:], _worst(np.abs(speed[BEFORE:]), drives.velocity))
    for measured in (np.abs(rate[BEFORE:]), change(speed, 1), change(drive, 2)):
        np.maximum(found, np.sqrt(_worst(measured, drives.acceleration)), out=found)
    across = _across(velocity, acceleration)[BEFORE:] / motion.centripetal_acceleration
    np.maximum(found, np.sqrt(across), out=found)
    if np.isfinite(drives.jerk).any():
        for measured in (change(speed, 2), change(drive, 3)):
            np.maximum(found, np.cbrt(_worst(measured, drives.jerk)), out=found)
    if motion.jerk > 0.0:
        for measured in (change(velocity, 2), change(position, 3)):
            np.maximum(found, np.cbrt(_norm(measured) / motion.jerk), out=found)
    return np.asarray(found)


def _worst(values: Array, limits: Array) -> Array:
    return np.asarray((values / limits).max(axis=1))


def _across(velocity: Array, acceleration: Array) -> Array:
    """The acceleration's part that is normal to the velocity, m/s^2; 0 at rest."""
    cross = np.cross(velocity, acceleration)
    speed = _norm(velocity)
    return np.asarray(_norm(cross) / np.where(speed > 0.0, speed, np.inf))


def _norm(vectors: NDArray[Any]) -> Array:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))
