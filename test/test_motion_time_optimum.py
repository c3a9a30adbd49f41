"""With jerk limits off a motion takes at most 1.02 times the time optimum, which toppra finds independently."""

from __future__ import annotations

import math

import numpy as np
import pytest
import toppra
from motion import PERIOD, arc, line, moved, used
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Arc, Line

MOTION = MotionParameters(acceleration=5.0, centripetal_acceleration=4.0)
GRID = 1001


class _DrivesAndPath(toppra.interpolator.AbstractGeometricPath):
    """The drives by path length, and the path length itself as one more drive, whose limits are those of the TCP."""

    waypoints = None

    def __init__(self, setup: Setup, element: Line | Arc) -> None:
        self._machine, self._element = setup.machine, element

    @property
    def dof(self) -> int:
        return len(self._machine.axes) + 1

    @property
    def path_interval(self) -> np.ndarray:
        return np.array([0.0, self._element.length])

    def __call__(self, path_positions: object, order: int = 0) -> np.ndarray:
        s = np.atleast_1d(np.asarray(path_positions, dtype=float))
        shape = [(self._element.position(x), self._element.tangent(x), self._element.curvature(x)) for x in s.tolist()]
        drives = self._machine.motion(*(np.array(part) for part in zip(*shape, strict=True)))[order]
        path = (s, np.ones_like(s), np.zeros_like(s))[order]
        values = np.column_stack((drives, path))
        return values if np.ndim(path_positions) else values[0]


def optimum(setup: Setup, element: Line | Arc) -> float:
    limits = setup.drive_limits
    feed = element.feed
    if isinstance(element, Arc):
        feed = min(feed, math.sqrt(MOTION.centripetal_acceleration * element.radius))
    velocity = np.append(limits.velocity, feed)
    acceleration = np.append(limits.acceleration, MOTION.acceleration)
    grid = np.linspace(0.0, element.length, GRID)
    solver = TOPPRA(
        [
            JointVelocityConstraint(np.column_stack((-velocity, velocity))),
            JointAccelerationConstraint(np.column_stack((-acceleration, acceleration))),
        ],
        _DrivesAndPath(setup, element),
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    speed = solver.compute_parameterization(0.0, 0.0)[1]
    return float((2.0 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())


ELEMENTS = {
    "across": line((-0.15, -0.1, 0.0), (0.2, 0.12, 0.05), feed=1.0),
    "to the edge": line((0.0, 0.0, 0.0), (0.0, 0.21, 0.0), feed=1.0),
    "at a feed": line((-0.05, -0.1, 0.0), (0.1, 0.12, 0.0), feed=0.1),
    "circle": arc((0.15, 0.0, 0.0), (0.0, 0.0, 0.0), 2.0 * math.pi, feed=1.0),
    "small arc": arc((0.1, 0.1, 0.0), (0.1, 0.11, 0.0), math.pi, feed=1.0),
}


@pytest.mark.parametrize("name", ELEMENTS)
@pytest.mark.parametrize(
    "limits",
    [("limits.velocity=0.4", "limits.acceleration=3.0"), ("limits.acceleration=20.0",), ("u2.limits.velocity=0.2",)],
    ids=["tight", "acceleration", "one drive"],
)
def test_within_two_percent_of_the_optimum(name: str, limits: tuple[str, ...]) -> None:
    setup, element = load_setup("tripod", limits), ELEMENTS[name]
    setpoints = moved(setup, [element], MOTION)
    ideal = optimum(setup, element)
    assert ideal * 0.999 <= (len(setpoints) - 4) * PERIOD <= 1.02 * ideal
    assert max(used(setup, setpoints, MOTION).values()) < 1.001
