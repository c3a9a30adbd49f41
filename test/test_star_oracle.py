"""The star test on the Tripod against theory and against drives and kinematics that are not the package's.

Default: pivot 0 0, lines of 200 mm, headings -15:105:15, 6000 mm/min, servo period 1 ms.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import pytest
import tripod_oracle
from numpy.typing import NDArray
from scipy import signal

from pkm_cnc.contour import heading_deg, parse_headings, star_program
from pkm_cnc.program import Line

HEADINGS = [-15.0, 0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0]
UM = 1e-6


class StarLine(NamedTuple):
    """What the monitor says of one line: its summary's means, and left and up cycle by cycle in the middle half, m."""

    left: float
    up: float
    left_max_abs: float
    up_max_abs: float
    below_feed: int
    lefts: NDArray[np.float64]
    ups: NDArray[np.float64]


@functools.cache
def star(feed: float = 6000.0, headings: str = "-15:105:15", overrides: tuple[str, ...] = ()) -> dict[float, StarLine]:
    program = star_program(feed, parse_headings(headings), (0.0, 0.0), 200.0)
    toolpath, cycles = tripod_oracle.run(program, overrides)
    lines = {}
    for summary in (summary for cycle in cycles for summary in cycle.summaries):
        line, start = toolpath.elements[summary.segment], toolpath.starts[summary.segment]
        assert isinstance(line, Line)
        middle = [
            cycle.error
            for cycle in cycles
            if cycle.error.segment == summary.segment
            and 0.25 * line.length <= cycle.error.path_length - start <= 0.75 * line.length
        ]
        heading = heading_deg(line)
        assert heading is not None
        lines[heading] = StarLine(
            summary.left_mean,
            summary.up_mean,
            summary.left_max_abs,
            summary.up_max_abs,
            summary.below_feed,
            np.array([error.left for error in middle]),
            np.array([error.up for error in middle]),
        )
    return lines


def test_every_heading_is_there_and_at_full_feed_in_its_middle_half() -> None:
    lines = star()
    assert list(lines) == HEADINGS
    for line in lines.values():
        assert line.below_feed == 0
        assert len(line.lefts) == pytest.approx(1000, abs=2)  # 100 mm at 0.1 mm a period


def test_summaries_are_those_of_the_cycles() -> None:
    for line in star().values():
        assert line.left == pytest.approx(line.lefts.mean(), abs=1e-15)
        assert line.up == pytest.approx(line.ups.mean(), abs=1e-15)
        assert line.left_max_abs == np.abs(line.lefts).max()
        assert line.up_max_abs == np.abs(line.ups).max()


@pytest.mark.parametrize("heading", [-15.0, 45.0, 105.0])
def test_no_contour_error_where_a_line_passes_under_a_column(heading: float) -> None:
    assert star()[heading].left_max_abs < 0.01 * UM


def test_the_tool_is_right_of_travel_below_45_deg_and_left_above() -> None:
    for heading, line in star().items():
        if -15.0 < heading < 45.0:
            assert (line.lefts < 0.0).all()
        if 45.0 < heading < 105.0:
            assert (line.lefts > 0.0).all()


def test_sides_hold_between_the_usual_headings_too() -> None:
    lines = star(headings="-14,-8,8,22,38,44,46,52,68,82,98,104")
    for heading, line in lines.items():
        assert math.copysign(1.0, line.left) == math.copysign(1.0, heading - 45.0), heading
        assert abs(line.left) > 0.1 * UM


def test_symmetric_about_45_deg() -> None:
    lines = star()
    for away in (15.0, 30.0, 45.0, 60.0):
        assert lines[45.0 + away].left == pytest.approx(-lines[45.0 - away].left, abs=0.001 * UM)
        assert lines[45.0 + away].up == pytest.approx(lines[45.0 - away].up, abs=0.001 * UM)


def test_reversed_lines_are_off_to_the_same_geometric_side() -> None:
    """Left of travel becomes right of travel; z stays but for terms of higher order in the feed, which turn with it."""
    forward, backward = star(), star(headings="165:285:15")
    assert len(backward) == len(forward)
    for heading, line in forward.items():
        reverse = backward[heading + 180.0 if heading <= 0.0 else heading - 180.0]
        assert reverse.left == pytest.approx(-line.left, abs=0.005 * UM)
        assert reverse.up == pytest.approx(line.up, rel=0.005)


@pytest.mark.parametrize("feed", [3000.0, 9000.0])
def test_the_error_goes_with_the_square_of_the_feed(feed: float) -> None:
    reference, lines = star(), star(feed)
    for heading, line in lines.items():
        scale = (feed / 6000.0) ** 2
        assert line.below_feed == 0
        assert line.up == pytest.approx(scale * reference[heading].up, rel=0.005)
        if heading not in (-15.0, 45.0, 105.0):
            assert line.left == pytest.approx(scale * reference[heading].left, rel=0.005)


def test_the_z_deviation_is_3_3_times_the_largest_error_in_the_plane() -> None:
    lines = star().values()
    assert all(line.up < 0.0 for line in lines)
    ratio = max(abs(line.up) for line in lines) / max(abs(line.left) for line in lines)
    assert ratio == pytest.approx(3.3, abs=0.02)


def test_first_order_drives_follow_the_law_at_every_heading() -> None:
    """e = kappa v^2 J^-1 d2u/ds2 at the delayed point, which is where the actual foot is: mean over the middle half."""
    lines = star(overrides=("drive.kind=first_order",))
    assert list(lines) == HEADINGS
    scale = tripod_oracle.sampled_kappa(20.0, 0.001) * 0.1**2
    law = {heading: scale * _mean_drift(heading) for heading in lines}
    for part in ("left", "up"):
        column = ("left", "up").index(part)
        largest = max(abs(vector[column]) for vector in law.values())
        for heading, line in lines.items():
            assert getattr(line, part) == pytest.approx(law[heading][column], abs=0.01 * largest), heading


def _mean_drift(heading: float) -> NDArray[np.float64]:
    """Left and up parts (1/m) of J^-1 d2u/ds2, averaged over the middle half of a line through the origin."""
    angle = np.longdouble(math.radians(heading))
    tangent = np.array([np.cos(angle), np.sin(angle), 0.0], dtype=np.longdouble)
    left = np.array([-math.sin(angle), math.cos(angle), 0.0])
    middle_half = (np.arange(50) + 0.5) / 50 * 0.100 - 0.050
    vectors = np.array([tripod_oracle.drift(lambda s: s * tangent, s) for s in middle_half])
    return np.array([(vectors @ left).mean(), vectors[:, 2].mean()])


def _cascade(period: float) -> signal.dlti:
    """Setpoint to actual of one axis: the position controller at the servo clock around the loops of eq. 7-1..7-3."""
    kv, k_p, t_p, k_pi, t_pi = 20.0, 2.4 * math.tau, 0.002 * math.tau, 15.0, 0.003
    inductance, resistance, k_m, inertia, screw = 0.0072, 1.45, 0.77, 0.0087, 0.010 / math.tau
    # states: integral of speed error (rad), of current error (A s), current (A), speed (rad/s), slider (m)
    # input: velocity command (m/s)
    a = np.zeros((5, 5))
    b = np.array([1.0 / screw, 0.0, 0.0, 0.0, 0.0])
    a[0, 3] = -1.0
    current_error = np.array([t_p, 0.0, -1.0, -k_p, 0.0])
    a[1] = current_error
    b[1] = k_p / screw
    a[2] = (k_pi * current_error + t_pi * np.eye(5)[1] - resistance * np.eye(5)[2]) / inductance
    b[2] = k_pi * b[1] / inductance
    a[3, 2] = k_m / inertia
    a[4, 3] = screw
    slider = np.eye(5)[4:]
    a_d, b_d, *_ = signal.cont2discrete((a, b[:, None], slider, np.zeros((1, 1))), period, method="zoh")
    return signal.dlti(a_d - kv * b_d @ slider, kv * b_d, slider, np.zeros((1, 1)), dt=period)


def test_agrees_with_a_cascade_and_kinematics_that_are_not_ours() -> None:
    """The interpolator's setpoints through another inverse, scipy's dlsim, another forward: the same error to 1 nm."""
    heading = math.radians(15.0)
    toolpath, cycles = tripod_oracle.run(star_program(6000.0, [15.0], (0.0, 0.0), 200.0))
    setpoints = tripod_oracle.inverse([cycle.setpoint[:3] for cycle in cycles])
    loop = _cascade(0.001)
    moved = (setpoints - setpoints[0]).astype(float)
    actual = np.column_stack([signal.dlsim(loop, moved[:, [axis]])[1][:, 0] for axis in range(3)])
    sliders = actual + setpoints[0].astype(float)

    line, start = toolpath.elements[-1], np.array(toolpath.elements[-1].start)
    assert line.evaluated
    on_line = [c.cycle for c in cycles if c.error.segment == len(toolpath.elements) - 1]
    compared = on_line[20:-20:40]
    assert len(compared) > 40
    for number in compared:
        point = tripod_oracle.forward(sliders[number]) - start
        cycle = cycles[number]
        left = math.cos(heading) * point[1] - math.sin(heading) * point[0]
        # the programmed end points are rounded to 1 nm
        assert cycle.error.left == pytest.approx(left, abs=1e-9)
        assert cycle.error.up == pytest.approx(point[2], abs=1e-9)
        assert np.array(cycle.tcp[3:6]) - start == pytest.approx(point, abs=1e-9)
        assert [state.slider_position for state in cycle.states] == pytest.approx(sliders[number], abs=1e-11)
