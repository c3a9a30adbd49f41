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

BEFORE = 2
"""Setpoints before the first that is judged: the jerk of a cycle takes three."""


def slow_downs(
    setpoints: Sequence[TcpSetpoint],
    motion: MotionParameters,
    drives: DriveLimits,
    period: float,
    scales: Array | float = 1.0,
) -> Array:
    """By what factor the time of each setpoint but the first two must be stretched to keep all limits; shape (k - 2,).

    Stretched by f, speeds fall by f, accelerations by f^2 and jerks by f^3. 1 or less: kept. Speed and acceleration of
    a drive are those of the setpoint, and what the speed changes by from cycle to cycle; a jerk is what the latter
    changes by, also of the TCP, as a vector. `scales` are the overrides of the feed, of each setpoint (k,) or of all.
    Raises UnreachableError for a place outside the workspace.
    """
    table = np.array([setpoint[:9] for setpoint in setpoints])
    feeds = np.array([setpoint.feed for setpoint in setpoints]) * scales
    velocity, acceleration = table[:, 3:6], table[:, 6:9]
    _, speed, rate = drives.motion(table[:, 0:3], velocity, acceleration)
    change = np.diff(speed, axis=0) / period
    found = np.maximum(_norm(velocity)[BEFORE:] / feeds[BEFORE:], _worst(speed[BEFORE:], drives.velocity))
    for measured in (rate[BEFORE:], change[BEFORE - 1 :]):
        np.maximum(found, np.sqrt(_worst(measured, drives.acceleration)), out=found)
    across = _across(velocity, acceleration)[BEFORE:] / motion.centripetal_acceleration
    np.maximum(found, np.sqrt(across), out=found)
    np.maximum(found, np.cbrt(_worst(np.diff(change, axis=0) / period, drives.jerk)), out=found)
    if motion.jerk > 0.0:
        jerk = np.diff(velocity, n=2, axis=0) / (period * period)
        np.maximum(found, np.cbrt(_norm(jerk) / motion.jerk), out=found)
    return np.asarray(found)


def _worst(values: Array, limits: Array) -> Array:
    return np.asarray((np.abs(values) / limits).max(axis=1))


def _across(velocity: Array, acceleration: Array) -> Array:
    """The acceleration's part that is normal to the velocity, m/s^2; 0 at rest."""
    cross = np.cross(velocity, acceleration)
    speed = _norm(velocity)
    return np.asarray(_norm(cross) / np.where(speed > 0.0, speed, np.inf))


def _norm(vectors: NDArray[Any]) -> Array:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))
