"""The time optimum of a path under limits of path and drives, as toppra finds it.

Pham and Pham, A new approach to time-optimal path parameterization based on reachability analysis, 2018.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraintVarying

from pkm_cnc.config import Setup
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Arc, Line
from pkm_cnc.records import Vector

GRID = 1001


class _DrivesAndPath(toppra.interpolator.AbstractGeometricPath):
    """The drives by path length, and the path length itself as one more drive, whose limits are those of the TCP."""

    waypoints = None

    def __init__(self, setup: Setup, elements: Sequence[Line | Arc]) -> None:
        self._machine, self._elements = setup.machine, elements
        self._starts = [0.0, *itertools.accumulate(element.length for element in elements)]

    @property
    def dof(self) -> int:
        return len(self._machine.axes) + 1

    @property
    def path_interval(self) -> np.ndarray:
        return np.array([0.0, self._starts[-1]])

    def __call__(self, path_positions: object, order: int = 0) -> np.ndarray:
        s = np.atleast_1d(np.asarray(path_positions, dtype=float))
        shape = [self._shape(x) for x in s.tolist()]
        drives = self._machine.motion(*(np.array(part) for part in zip(*shape, strict=True)))[order]
        path = (s, np.ones_like(s), np.zeros_like(s))[order]
        values = np.column_stack((drives, path))
        return values if np.ndim(path_positions) else values[0]

    def _shape(self, s: float) -> tuple[Vector, Vector, Vector]:
        index = min(max(bisect.bisect_left(self._starts, s) - 1, 0), len(self._elements) - 1)
        element, s = self._elements[index], s - self._starts[index]
        return element.position(s), element.tangent(s), element.curvature(s)


def optimum(setup: Setup, elements: Sequence[Line | Arc], motion: MotionParameters) -> float:
    """s. The feed, and on arcs the centripetal acceleration, are a limit of the path's speed that changes along it."""
    limits = setup.drive_limits
    path = _DrivesAndPath(setup, elements)
    length = float(path.path_interval[1])

    def limit(s: float) -> np.ndarray:
        bend = math.hypot(*path._shape(s)[2])
        feed = min(elements[0].feed, math.sqrt(motion.centripetal_acceleration / bend) if bend else math.inf)
        velocity = np.append(limits.velocity, feed)
        return np.column_stack((-velocity, velocity))

    acceleration = np.append(limits.acceleration, motion.acceleration)
    grid = np.linspace(0.0, length, GRID)
    solver = TOPPRA(
        [
            JointVelocityConstraintVarying(limit),
            JointAccelerationConstraint(np.column_stack((-acceleration, acceleration))),
        ],
        path,
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    speed = solver.compute_parameterization(0.0, 0.0)[1]
    return float((2.0 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())
