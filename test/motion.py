"""Motions for the tests: toolpaths, their setpoints, and what a machine's drives do along them, by differences."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from pkm_cnc.config import Setup
from pkm_cnc.motion import Interpolator, MotionParameters
from pkm_cnc.program import EXACT_PATH, Arc, Line, PathMode, Toolpath
from pkm_cnc.records import PHASE_MOVE, TcpSetpoint, Vector

PERIOD = 0.001


def line(start: Vector, end: Vector, feed: float = 0.1, mode: PathMode = EXACT_PATH, number: int = 1) -> Line:
    return Line(number, start, end, feed, traverse=False, evaluated=True, path_mode=mode)


def polyline(points: Sequence[Vector], feed: float = 0.1, mode: PathMode = EXACT_PATH) -> Toolpath:
    pairs = itertools.pairwise(points)
    return Toolpath(tuple(line(*ends, feed, mode, number) for number, ends in enumerate(pairs, 1)))


def arc(start: Vector, center: Vector, sweep: float, feed: float = 0.1, mode: PathMode = EXACT_PATH) -> Arc:
    """In the x-y plane; where it ends follows."""
    x, y = start[0] - center[0], start[1] - center[1]
    cosine, sine = math.cos(sweep), math.sin(sweep)
    end = (center[0] + x * cosine - y * sine, center[1] + x * sine + y * cosine, start[2])
    return Arc(1, start, end, feed, traverse=False, evaluated=True, center=center, sweep=sweep, path_mode=mode)


def moved(setup: Setup, elements: Iterable[Line | Arc], motion: MotionParameters) -> list[TcpSetpoint]:
    """The setpoints of the machine, hold and end left out, the rest at the start repeated before them."""
    interpolator = Interpolator(Toolpath(tuple(elements)), motion, PERIOD, setup.drive_limits)
    setpoints = []
    while not interpolator.finished:
        setpoints.append(interpolator.step())
    return [setpoints[0]] * 3 + [setpoint for setpoint in setpoints if setpoint.phase == PHASE_MOVE]


def used(setup: Setup, setpoints: Sequence[TcpSetpoint], motion: MotionParameters) -> dict[str, float]:
    """The largest part of each limit that is used in any cycle.

    Speeds and accelerations are those of the setpoints, and jerks the differences of the latter's differences; what is
    across the path is taken apart by the direction of travel.
    """
    table = np.array([setpoint[:9] for setpoint in setpoints])
    feeds = np.array([setpoint.feed for setpoint in setpoints])
    position, velocity, acceleration = table[:, :3], table[:, 3:6], table[:, 6:9]
    joints, speeds, rates = setup.machine.motion(position, velocity, acceleration)
    np.testing.assert_allclose(joints, setup.machine.inverse(position), atol=1e-15)
    limits = [axis.limits for axis in setup.axes.values()]
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed > 1e-9
    along = (velocity[moving] * acceleration[moving]).sum(axis=1) / speed[moving]
    across = np.linalg.norm(acceleration[moving] - along[:, None] * velocity[moving] / speed[moving][:, None], axis=1)
    changes = np.diff(speeds, axis=0) / PERIOD
    result = {
        "feed": float((speed / feeds).max()),
        "acceleration": float(np.abs(along).max()) / motion.acceleration,
        "centripetal": float(across.max()) / motion.centripetal_acceleration,
        "drive velocity": max(np.abs(speeds).max(axis=0) / [limit.velocity for limit in limits]),
        "drive acceleration": max(np.abs(rates).max(axis=0) / [limit.acceleration for limit in limits]),
        "drive change of speed": max(np.abs(changes).max(axis=0) / [limit.acceleration for limit in limits]),
    }
    if motion.jerk:
        jerk = np.diff(velocity, n=2, axis=0) / PERIOD**2
        result["jerk"] = float(np.linalg.norm(jerk, axis=1).max()) / motion.jerk
    if limits[0].jerk:
        jerks = np.diff(changes, axis=0) / PERIOD
        result["drive jerk"] = max(np.abs(jerks).max(axis=0) / [limit.jerk for limit in limits])
    return result
