"""With jerk limits off a motion takes at most 1.02 times the time optimum, which toppra finds independently."""

from __future__ import annotations

import itertools
import math

import pytest
from motion import PERIOD, arc, line, moved, used
from time_optimum import optimum

from pkm_cnc.config import load_setup
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Arc, Line

MOTION = MotionParameters(acceleration=5.0, centripetal_acceleration=4.0)


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
    ideal = optimum(setup, elements, MOTION)
    assert ideal * 0.999 <= (len(setpoints) - 4) * PERIOD <= 1.02 * ideal
    assert max(used(setup, setpoints, MOTION).values()) < 1.001
