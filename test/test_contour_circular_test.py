"""The circular test: its part program as the interpreter reads it, its figures on paths known in closed form."""

import math
from itertools import pairwise

import numpy as np
import pytest

from pkm_cnc.contour import (
    SegmentStatistics,
    arc_report,
    circle_pair_report,
    circle_pairs,
    circle_path,
    circle_program,
    circle_report,
    is_full_circle,
    least_squares_circle,
)
from pkm_cnc.errors import InputError
from pkm_cnc.program import Arc, Program, interpret

TEST = {
    "feed_mm_min": 3000.0,
    "radius_mm": 100.0,
    "center_mm": (0.0, 0.0),
    "direction": "both",
    "overshoot_deg": 180.0,
    "acceleration_mm_s2": 1000.0,
}


def toolpath_of(**changes):
    text = circle_program(**{**TEST, **changes})
    return interpret(Program("circle.ngc", text), start=(0.0, 0.0, 0.0), zero=(0.0, 0.0, 0.0), rapid=0.5)


def data_arc(sense=1.0, center=(0.0, 0.0, 0.0), radius=0.1, feed=0.05):
    start = (center[0] + radius, center[1], center[2])
    return Arc(4, start, start, feed, False, True, center, sense * math.tau)


def path_of(deviation, count=12566, sense=1.0, **changes):
    """A path with dR = deviation(actual angle), in metres."""
    arc = data_arc(sense, **changes)
    angle = sense * np.linspace(0.0, math.tau, count)
    radius = arc.radius - deviation(angle)
    return circle_path(
        arc, np.stack([arc.center[0] + radius * np.cos(angle), arc.center[1] + radius * np.sin(angle)], axis=1)
    )


@pytest.mark.parametrize("direction", ["ccw", "cw"])
@pytest.mark.parametrize("overshoot", [180.0, 10.0, 333.3])
@pytest.mark.parametrize(("center", "radius"), [((0.0, 0.0), 100.0), ((-31.7, 12.3456789), 7.7)])
def test_the_program_is_feed_in_overshoot_circle_overshoot_feed_out(direction, overshoot, center, radius):
    elements = list(toolpath_of(direction=direction, overshoot_deg=overshoot, center_mm=center, radius_mm=radius))
    sense = 1.0 if direction == "ccw" else -1.0
    assert [each.traverse for each in elements] == [True] + [False] * 5
    assert [each.evaluated for each in elements] == [False, False, False, True, False, False]
    _, feed_in, before, circle, after, feed_out = elements
    assert is_full_circle(circle)
    assert [each.sweep for each in (before, after)] == pytest.approx([sense * math.radians(overshoot)] * 2, abs=1e-5)
    assert circle.sweep == sense * math.tau
    assert circle.start == pytest.approx((1e-3 * (center[0] + radius), 1e-3 * center[1], 0.0), abs=1e-9)
    for arc in (before, circle, after):
        assert arc.radius == pytest.approx(1e-3 * radius, abs=2e-9)
        assert arc.center == pytest.approx((1e-3 * center[0], 1e-3 * center[1], 0.0), abs=2e-9)
    assert (feed_in.length, feed_out.length) == pytest.approx((0.01, 0.01), abs=2e-9)
    for one, other in pairwise(elements[1:]):
        assert math.dist(one.tangent(one.length), other.tangent(0.0)) < 1e-6
        assert one.feed == other.feed == pytest.approx(0.05)


def test_a_fast_feed_gets_the_way_it_needs():
    elements = list(toolpath_of(direction="ccw", feed_mm_min=12000.0))
    assert elements[1].length == pytest.approx(0.04, abs=2e-9)  # v^2/a: twice the way to 0.2 m/s at 1 m/s^2


def test_both_directions_are_two_circles_counter_clockwise_first():
    circles = [each for each in toolpath_of() if each.evaluated]
    assert [each.sweep for each in circles] == [math.tau, -math.tau]
    assert circles[0].start == circles[1].start


@pytest.mark.parametrize(
    "wrong",
    [
        {"feed_mm_min": 0.0},
        {"radius_mm": -1.0},
        {"acceleration_mm_s2": math.inf},
        {"direction": "left"},
        {"overshoot_deg": 0.0},
        {"overshoot_deg": 360.0},
        {"overshoot_deg": 1e-6},
        {"overshoot_deg": math.nan},
    ],
)
def test_nonsense_is_refused_by_name(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        circle_program(**{**TEST, **wrong})


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("count", [628, 12566])
@pytest.mark.parametrize("phase", [105.9, 0.003, 119.999])
def test_maxima_of_a_three_lobed_path(sense, count, phase):
    lobes = [phase % 120.0 + 120.0 * k for k in range(3)]
    path = path_of(lambda a: 27e-6 + 2.4e-6 * np.cos(3.0 * (a - math.radians(phase))), count, sense)
    report = circle_report(path)
    assert sorted(report["extrema_deg"]) == pytest.approx(lobes, abs=0.01)
    assert report["radial_deviation_um"] == pytest.approx({"mean": 27.0, "min": 24.6, "max": 29.4}, abs=1e-3)
    assert report["circularity_um"] == pytest.approx(4.8, abs=1e-3)
    assert report["iso230_4"] == pytest.approx({"G_um": 4.8, "F_max_um": -24.6, "F_min_um": -29.4}, abs=1e-3)


def test_maxima_come_largest_first():
    """2 cos 3a + 0.3 cos(a - 230 deg): the zeros of its derivative, found by bisection here."""

    def slope(a):
        return -6.0 * math.sin(3.0 * a) - 0.3 * math.sin(a - math.radians(230.0))

    def root(low, high):
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if slope(middle) > 0.0 else (low, middle)
        return math.degrees(low) % 360.0

    path = path_of(lambda a: 1e-6 * (2.0 * np.cos(3.0 * a) + 0.3 * np.cos(a - math.radians(230.0))))
    expected = [root(math.radians(c - 20.0), math.radians(c + 20.0)) for c in (240.0, 120.0, 0.0)]
    assert circle_report(path)["extrema_deg"] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("step", "within"), [(1e-7, 0.05), (1e-6, 1.0)])
def test_quantisation_and_noise_make_no_maxima_and_hardly_move_them(step, within):
    random = np.random.default_rng(3)
    lobes = [105.0, 225.0, 345.0]

    def rippled(a):
        clean = 27e-6 + 2.4e-6 * np.cos(3.0 * (a - math.radians(105.0)))
        return step * np.round((clean + 0.2 * step * random.normal(size=a.size)) / step)

    assert sorted(circle_report(path_of(rippled))["extrema_deg"]) == pytest.approx(lobes, abs=within)


def test_a_constant_deviation_has_no_maximum():
    report = circle_report(path_of(lambda a: np.full_like(a, 12e-6)))
    assert report["extrema_deg"] == []
    assert report["radial_deviation_um"] == pytest.approx({"mean": 12.0, "min": 12.0, "max": 12.0})
    assert report["circularity_um"] == pytest.approx(0.0, abs=1e-6)
    assert report["iso230_4"] == pytest.approx({"G_um": 0.0, "F_max_um": -12.0, "F_min_um": -12.0}, abs=1e-6)


def test_a_shifted_circle_is_round_about_its_own_centre():
    """Centre off by (3, 4) um: F from -5 to +5 um, its zone has no width; dR is largest opposite the shift."""
    arc = data_arc()
    angle = np.linspace(0.0, math.tau, 5000)
    points = np.stack([3e-6 + 0.1 * np.cos(angle), 4e-6 + 0.1 * np.sin(angle), np.zeros(5000)], axis=1)
    report = circle_report(circle_path(arc, points))
    assert report["iso230_4"] == pytest.approx({"G_um": 0.0, "F_max_um": 5.0, "F_min_um": -5.0}, abs=1e-3)
    assert report["circularity_um"] == pytest.approx(10.0, abs=1e-3)
    assert report["extrema_deg"] == pytest.approx([math.degrees(math.atan2(4.0, 3.0)) + 180.0], abs=0.01)


def test_an_ellipse_has_the_difference_of_its_half_axes():
    arc = data_arc()
    angle = np.linspace(0.0, math.tau, 5001)
    points = np.stack([(0.1 + 10e-6) * np.cos(angle), (0.1 - 6e-6) * np.sin(angle)], axis=1)
    report = circle_report(circle_path(arc, points))
    assert report["iso230_4"] == pytest.approx({"G_um": 16.0, "F_max_um": 10.0, "F_min_um": -6.0}, abs=1e-3)
    assert sorted(report["extrema_deg"]) == pytest.approx([90.0, 270.0], abs=0.01)


def test_the_mean_weighs_angles_not_cycles():
    """A tool that dwells on one side: many cycles there, the same mean by angle."""
    arc = data_arc()
    u = np.linspace(0.0, math.tau, 20000)
    angle = u - 0.8 * np.sin(u)
    radius = 0.1 - 10e-6 * (1.0 + np.cos(angle))
    path = circle_path(arc, np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    assert circle_report(path)["radial_deviation_um"]["mean"] == pytest.approx(10.0, abs=1e-3)


def test_least_squares_circle_of_an_offset_circle_is_exact():
    angle = np.linspace(0.0, math.tau, 100, endpoint=False)
    points = np.stack([0.3 + 0.1 * np.cos(angle), -0.2 + 0.1 * np.sin(angle)], axis=1)
    assert least_squares_circle(points) == pytest.approx((0.3, -0.2, 0.1), abs=1e-15)


def test_both_directions_together():
    """Radii 20 um and 30 um too small: mean -25, zone 10; shifting both alike changes neither."""
    for center in ((0.0, 0.0, 0.0), (0.02, -0.01, 0.0)):
        forth = path_of(lambda a: np.full_like(a, 20e-6) + 5e-6 * np.cos(a), center=center)
        back = path_of(lambda a: np.full_like(a, 30e-6) + 5e-6 * np.cos(a), sense=-1.0, center=center)
        report = circle_pair_report(forth, back)
        assert report["kind"] == "circle_pair"
        assert report["iso230_4"] == pytest.approx({"Gb_um": 10.0, "D_um": -25.0}, abs=2e-3)


def test_pairs_are_of_one_circle_and_one_feed():
    def deviation(a):
        return np.zeros_like(a)

    ccw, cw = path_of(deviation, 100), path_of(deviation, 100, -1.0)
    slow, small = path_of(deviation, 100, -1.0, feed=0.02), path_of(deviation, 100, -1.0, radius=0.05)
    other = path_of(deviation, 100)
    assert circle_pairs([slow, ccw, small, cw, other]) == [(ccw, cw)]
    assert circle_pairs([ccw]) == []


def test_an_incomplete_circle_is_refused_with_its_gap():
    arc = data_arc()
    angle = np.radians(np.arange(0.0, 300.5, 0.5))
    with pytest.raises(InputError, match=r"line 4: the circle is incomplete, 60\.0 deg"):
        circle_path(arc, 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    with pytest.raises(InputError, match=r"incomplete, 360\.0 deg"):
        circle_path(arc, np.empty((0, 3)))


def test_an_arc_is_no_circle():
    arc = Arc(9, (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), 0.05, False, True, (0.0, 0.0, 0.0), 0.5 * math.pi)
    with pytest.raises(InputError, match="line 9: an arc of 90 deg is no full circle"):
        circle_path(arc, np.zeros((3, 2)))
    report = arc_report(arc, SegmentStatistics(0, arc, 0.0).summary())
    assert (report["kind"], report["direction"], report["radius_mm"]) == ("arc", "ccw", 100.0)
    assert report["length_mm"] == pytest.approx(157.079633)
    assert report["contour_error_3d_um"] == {"mean": None, "rms": None, "max": None}
