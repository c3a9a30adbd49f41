"""With jerk limits off a motion takes at most 1.02 times the time optimum, which toppra finds independently."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
import toppra
from motion import PERIOD, arc, line, moved, used
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraintVarying

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Arc, Line
from pkm_cnc.records import Vector

MOTION = MotionParameters(acceleration=5.0, centripetal_acceleration=4.0)
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


def optimum(setup: Setup, elements: Sequence[Line | Arc]) -> float:
    """s. The feed, and on arcs the centripetal acceleration, are a limit of the path's speed that changes along it."""
    limits = setup.drive_limits
    path = _DrivesAndPath(setup, elements)
    length = float(path.path_interval[1])

    def limit(s: float) -> np.ndarray:
        bend = math.hypot(*path._shape(s)[2])
        feed = min(elements[0].feed, math.sqrt(MOTION.centripetal_acceleration / bend) if bend else math.inf)
        velocity = np.append(limits.velocity, feed)
        return np.column_stack((-velocity, velocity))

    acceleration = np.append(limits.acceleration, MOTION.acceleration)
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


def _slot(x: float, y: float, length: float, radius: float) -> list[Line | Arc]:
    """Round a slot of two lines and two half circles, all of which are tangent: no stop."""
    start, ends = (x, y, 0.0), (x + length, y, 0.0)
    right = arc(ends, (x + length, y + radius, 0.0), math.pi, feed=1.0)
    back = line(right.end, (x, right.end[1], 0.0), feed=1.0)
    left = arc(back.end, (x, y + radius, 0.0), math.pi, feed=1.0)
    return [line(start, ends, feed=1.0), right, back, left, line(left.end, ends, feed=1.0)]


def _parted(element: Line, count: int) -> list[Line | Arc]:
    ends = [element.position(element.length * k / count) for k in range(count + 1)]
    return [line(before, after, feed=element.feed) for before, after in itertools.pairwise(ends)]


ACROSS = line((-0.15, -0.1, 0.0), (0.2, 0.12, 0.05), feed=1.0)
ELEMENTS: dict[str, list[Line | Arc]] = {
    "across": [ACROSS],
    "in 500 lines": _parted(ACROSS, 500),
    "to the edge": [line((0.0, 0.0, 0.0), (0.0, 0.21, 0.0), feed=1.0)],
    "to the last millimetres": [line((0.0, 0.1, 0.0), (0.0, 0.238, 0.0), feed=1.0)],
    "along the edge": [line((-0.12, 0.2, 0.0), (0.14, 0.215, 0.0), feed=1.0)],
    "at a feed": [line((-0.05, -0.1, 0.0), (0.1, 0.12, 0.0), feed=0.1)],
    "circle": [arc((0.15, 0.0, 0.0), (0.0, 0.0, 0.0), 2.0 * math.pi, feed=1.0)],
    "small arc": [arc((0.1, 0.1, 0.0), (0.1, 0.11, 0.0), math.pi, feed=1.0)],
    "tight arc at the edge": [arc((0.0, 0.23, 0.0), (0.0, 0.227, 0.0), 2.0 * math.pi, feed=1.0)],
    "slot at the edge": _slot(-0.04, 0.2, 0.08, 0.015),
}


@pytest.mark.parametrize("name", ELEMENTS)
@pytest.mark.parametrize(
    "limits",
    [("limits.velocity=0.4", "limits.acceleration=3.0"), ("limits.acceleration=20.0",), ("u2.limits.velocity=0.2",)],
    ids=["tight", "acceleration", "one drive"],
)
def test_within_two_percent_of_the_optimum(name: str, limits: tuple[str, ...]) -> None:
    setup, elements = load_setup("tripod", limits), ELEMENTS[name]
    setpoints = moved(setup, elements, MOTION)
    ideal = optimum(setup, elements)
    assert ideal * 0.999 <= (len(setpoints) - 4) * PERIOD <= 1.02 * ideal
    assert max(used(setup, setpoints, MOTION).values()) < 1.001
