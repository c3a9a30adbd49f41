"""Contour error of single points: signs, exactness, which element has the foot."""

import gc
import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.contour import ContourTracker
from pkm_cnc.errors import MachineFault
from pkm_cnc.program import Arc, Line
from pkm_cnc.tolerances import TIE

HEADINGS = [0.0, 30.0, 45.0, 90.0, 135.0, 180.0, 210.0, 225.0, -90.0, -15.0]


def line(start, end):
    return Line(1, start, end, 0.1, False, True)


def arc(center, radius, start_deg, sweep_deg):
    def at(degrees):
        x, y = radius * math.cos(math.radians(degrees)), radius * math.sin(math.radians(degrees))
        return center[0] + x, center[1] + y, center[2]

    start = at(start_deg)
    end = start if abs(sweep_deg) == 360.0 else at(start_deg + sweep_deg)
    return Arc(1, start, end, 0.1, False, True, center, math.radians(sweep_deg))


def tracker_of(*elements):
    tracker = ContourTracker()
    path_start = 0.0
    for index, element in enumerate(elements):
        tracker.add(index, element, path_start)
        path_start += element.length
    return tracker


def polyline(*points):
    return [line(a, b) for a, b in pairwise(points)]


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize(("left", "up"), [(30e-6, 0.0), (-20e-6, 5e-6), (0.0, -7e-6), (1e-3, 2e-3)])
def test_offset_from_a_line_is_returned_with_its_sides(heading, left, up):
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    element = line((-0.1 * c, -0.1 * s, 0.02), (0.1 * c, 0.1 * s, 0.02))
    tool = (0.03 * c - left * s, 0.03 * s + left * c, 0.02 + up)  # left of travel = travel turned by +90 deg
    error = tracker_of(element).step(tool, 0)
    assert error.left == pytest.approx(left, abs=1e-16)
    assert error.up == pytest.approx(up, abs=1e-16)
    assert error.magnitude == pytest.approx(math.hypot(left, up), abs=1e-16)
    assert (error.x, error.y, error.z) == pytest.approx((-left * s, left * c, up), abs=1e-16)
    assert error.path_length == pytest.approx(0.13, abs=1e-15)


@pytest.mark.parametrize("sweep", [90.0, -90.0, 360.0, -360.0, 250.0])
@pytest.mark.parametrize("inward", [25e-6, -40e-6])
def test_offset_from_an_arc_is_left_on_the_inner_side_counter_clockwise(sweep, inward):
    element = arc((0.01, -0.02, 0.03), 0.1, 20.0, sweep)
    angle = math.radians(20.0 + sweep / 3.0)
    x, y = (0.1 - inward) * math.cos(angle), (0.1 - inward) * math.sin(angle)
    error = tracker_of(element).step((0.01 + x, -0.02 + y, 0.03 + 4e-6), 0)
    assert error.left == pytest.approx(math.copysign(1.0, sweep) * inward, abs=1e-16)
    assert error.up == pytest.approx(4e-6, abs=1e-16)
    assert error.path_length == pytest.approx(element.length / 3.0, abs=1e-15)


def test_offset_from_a_sloping_line_splits_along_its_own_left_and_up():
    tangent = np.array([2.0, 1.0, 2.0]) / 3.0
    left = np.cross([0.0, 0.0, 1.0], tangent)
    left /= np.linalg.norm(left)
    up = np.cross(tangent, left)
    assert up[2] > 0.0
    tool = 0.04 * tangent + 11e-6 * left - 7e-6 * up
    error = tracker_of(line((0.0, 0.0, 0.0), tuple((0.1 * tangent).tolist()))).step(tuple(tool.tolist()), 0)
    assert (error.left, error.up) == pytest.approx((11e-6, -7e-6), abs=1e-16)


@pytest.mark.parametrize("top", [0.1, -0.1])
def test_a_vertical_line_has_no_sides_but_a_magnitude(top):
    error = tracker_of(line((0.0, 0.0, 0.0), (0.0, 0.0, top))).step((3e-6, 4e-6, 0.5 * top), 0)
    assert math.isnan(error.left)
    assert math.isnan(error.up)
    assert error.magnitude == pytest.approx(5e-6, abs=1e-18)


def test_beyond_an_end_the_magnitude_is_the_whole_and_the_sides_are_components():
    error = tracker_of(line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))).step((0.103, 0.004, 0.012), 0)
    assert (error.left, error.up, error.magnitude) == pytest.approx((0.004, 0.012, 0.013), abs=1e-16)
    assert error.path_length == 0.1


def test_at_a_crossing_the_tool_stays_on_its_own_line():
    elements = polyline((-0.1, 0, 0), (0.1, 0, 0), (0, -0.1, 0), (0, 0.1, 0))
    tracker = tracker_of(*elements)
    assert tracker.step((0.0, 0.0, 0.0), 2).segment == 0
    assert tracker.step((1e-6, 0.0, 0.0), 2).segment == 0


def test_a_cut_corner_changes_element_on_its_bisector():
    tracker = tracker_of(*polyline((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0)))
    assert tracker.step((0.0978, 0.002, 0.0), 1)[3:] == pytest.approx((0.002, 0.0, 0.002, 0.0978, 0))
    assert tracker.step((0.0982, 0.002, 0.0), 1)[3:] == pytest.approx((0.0018, 0.0, 0.0018, 0.102, 1))
    assert tracker.step((0.0978, 0.002, 0.0), 1).segment == 1  # what is behind is behind


def test_the_element_ahead_of_the_setpoint_is_no_candidate():
    tracker = tracker_of(*polyline((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0)))
    error = tracker.step((0.1, 0.01, 0.0), 0)
    assert (error.segment, error.magnitude) == (0, pytest.approx(0.01))


def test_turning_back_on_the_same_line_changes_element_and_side():
    """The tool lags 5 mm, turns short of the corner and comes back 20 um beside the line: same side, other sign."""
    tracker = tracker_of(*polyline((0, 0, 0), (0.1, 0, 0), (0, 0, 0)))
    out = [(x, 0) for x in np.linspace(0.05, 0.0999, 500)]
    back = [(x, 1) for x in np.linspace(0.0999, 0.02, 500)]
    errors = [tracker.step((float(x), 20e-6, 0.0), 0 if x < 0.095 and not way else 1) for x, way in out + back]
    assert [e.segment for e in errors[:500]] == [0] * 500
    assert [e.segment for e in errors[501:]] == [1] * 499
    assert {round(e.left * 1e9) for e in errors[:500]} == {20000}
    assert {round(e.left * 1e9) for e in errors[501:]} == {-20000}
    assert all(b.path_length >= a.path_length for a, b in pairwise(errors))


@pytest.mark.parametrize("beside", [5e-6, 25e-6, 60e-6])
def test_turning_back_beside_the_line_changes_element_although_the_one_before_is_nearer(beside):
    """The way back is `beside` the way out; the tool stays 1 um from the way out all the time."""
    tracker = tracker_of(*polyline((0, 0, 0), (0.1, 0, 0), (0, -beside, 0)))
    places = np.concatenate([np.linspace(0.05, 0.0999, 500), np.linspace(0.0999, 0.02, 800)])
    errors = [tracker.step((float(x), 1e-6, 0.0), int(k > 450)) for k, x in enumerate(places)]
    assert [e.segment for e in errors[:500]] == [0] * 500
    assert [e.segment for e in errors[501:]] == [1] * 799  # 0.1 mm a cycle: further back than beside
    assert errors[-1].left == pytest.approx(-(1e-6 + 0.8 * beside), rel=1e-6)


def test_a_tool_that_swings_back_at_a_corner_stays_on_the_line_before():
    """At rest in the corner it overshot, and swings 30 um back while the setpoint goes on around the corner."""
    tracker = tracker_of(*polyline((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0)))
    assert tracker.step((0.10003, 0.0, 0.0), 1).segment == 0
    error = tracker.step((0.09997, 2e-6, 0.0), 1)
    assert (error.segment, error.magnitude) == (0, pytest.approx(2e-6))


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("circles", [1, 2])
@pytest.mark.parametrize("overshoot", [180.0, 300.0])
def test_full_circles_between_overshoot_arcs_neither_hold_nor_skip_the_progress(sense, circles, overshoot):
    radius, lag, inward = 0.02, 2.5e-3, 30e-6
    center = (0.0, 0.0, 0.0)
    arcs = [arc(center, radius, -sense * overshoot, sense * overshoot)]
    arcs += [arc(center, radius, 0.0, sense * 360.0)] * circles
    arcs += [arc(center, radius, 0.0, sense * overshoot)]
    tracker = tracker_of(*arcs)
    ends = np.cumsum([a.length for a in arcs])
    step = 1e-4
    for setpoint in np.arange(lag, ends[-1], step):
        s = setpoint - lag
        angle = sense * (s / radius - math.radians(overshoot))
        point = ((radius - inward) * math.cos(angle), (radius - inward) * math.sin(angle), 0.0)
        error = tracker.step(point, int(np.searchsorted(ends, setpoint)))
        assert error.path_length == pytest.approx(s, abs=1e-6)  # at a junction up to sqrt(2 inward TIE) behind
        assert error.left == pytest.approx(sense * inward, abs=1e-9)


def test_before_the_start_of_a_circle_the_foot_is_its_start():
    tracker = tracker_of(arc((0.0, 0.0, 0.0), 0.1, 0.0, 360.0))
    assert tracker.step((0.1, -1e-6, 0.0), 0).path_length == 0.0
    assert tracker.step((0.1, 1e-6, 0.0), 0).path_length == pytest.approx(1e-6)


def distance_by_samples(elements, point, samples=400):
    """Smallest distance to samples of the elements, and how far a point between two samples may be nearer."""
    clouds = [[e.position(e.length * k / samples) for k in range(samples + 1)] for e in elements]
    spacing = max(e.length for e in elements) / samples
    return float(np.linalg.norm(np.concatenate(clouds) - np.array(point), axis=1).min()), spacing


coordinates = st.floats(-0.05, 0.05).map(lambda value: round(value, 4))
points = st.tuples(coordinates, coordinates, coordinates)


@st.composite
def toolpaths(draw):
    """Connected lines and arcs (below a full turn), of very different lengths."""
    elements = []
    at = draw(points)
    for _ in range(draw(st.integers(1, 12))):
        if draw(st.booleans()):
            scale = draw(st.sampled_from([1.0, 0.1, 0.001]))
            end = tuple(a + scale * (b - a) for a, b in zip(at, draw(points), strict=True))
            if math.dist(at, end) < 1e-6:
                continue
            elements.append(line(at, end))
        else:
            radius, sweep = draw(st.floats(1e-4, 0.03)), draw(st.floats(5.0, 355.0)) * draw(st.sampled_from([1, -1]))
            angle = draw(st.floats(-180.0, 180.0))
            x, y = radius * math.cos(math.radians(angle)), radius * math.sin(math.radians(angle))
            end_angle = math.radians(angle + sweep)
            center = (at[0] - x, at[1] - y, at[2])
            end = (center[0] + radius * math.cos(end_angle), center[1] + radius * math.sin(end_angle), at[2])
            elements.append(Arc(1, at, end, 0.1, False, True, center, math.radians(sweep)))
        at = elements[-1].end
    return elements or [line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))]


@given(elements=toolpaths(), tools=st.lists(points, min_size=1, max_size=5), data=st.data())
@settings(max_examples=150, derandomize=True, deadline=None)
def test_the_foot_is_the_nearest_point_of_what_lies_between_progress_and_setpoint(elements, tools, data):
    tracker = tracker_of(*elements)
    progress = setpoint = 0
    furthest = 0.0
    for tool in tools:
        setpoint = data.draw(st.integers(setpoint, len(elements) - 1))
        window = elements[progress : setpoint + 1]
        error = tracker.step(tool, setpoint)
        feet = [e.nearest(tool, 0.0) for e in window]
        plain = [math.dist(tool, e.position(s)) for e, s in zip(window, feet, strict=True)]
        back = max(0.0, furthest - feet[0])
        weighed = [max(plain[0], back), *plain[1:]]
        passed = next(k for k, distance in enumerate(weighed) if distance <= min(weighed) + TIE)
        assert error.segment == progress + passed
        sampled, spacing = distance_by_samples(window, tool)
        assert sampled - spacing <= error.magnitude <= max(sampled, back) + 2e-9
        furthest = feet[passed] if passed else feet[0] + back
        progress = error.segment


class Counted:
    """A line that counts how often its nearest point was asked for."""

    asked = 0

    def __init__(self, element):
        self._element = element

    def __getattr__(self, name):
        return getattr(self._element, name)

    def nearest(self, point, near):
        Counted.asked += 1
        return self._element.nearest(point, near)


def test_a_thousand_segments_of_ten_micrometres_behind_the_setpoint_cost_few_looks():
    angles = np.arange(6000) * 1e-4
    vertices = [(0.1 * math.cos(a), 0.1 * math.sin(a), 0.0) for a in angles]
    tracker = tracker_of(*map(Counted, polyline(*vertices)))
    Counted.asked = steps = 0
    for setpoint in range(1000, 5900, 10):
        angle = (setpoint - 1000) * 1e-4 + 0.3e-4
        error = tracker.step((0.09997 * math.cos(angle), 0.09997 * math.sin(angle), 0.0), setpoint)
        assert error.segment == setpoint - 1000
        assert error.left == pytest.approx(30e-6, abs=2e-9)
        steps += 1
    assert Counted.asked / steps < 40


def test_a_spike_of_short_segments_straight_at_the_tool_is_not_passed_over():
    """The contour comes nearer than its beginning by one segment only, as fast as a contour can."""
    far, reach = 0.02, 0.00499
    inwards = [(far - k * 1e-5, 0.0, 0.0) for k in range(round((far - reach) / 1e-5) + 1)]
    vertices = [(0.0, 0.005, 0.0), (far, 0.005, 0.0), *inwards, *reversed(inwards[:-1])]
    error = tracker_of(*polyline(*vertices)).step((0.0, 0.0, 0.0), len(vertices) - 2)
    assert error.magnitude == pytest.approx(reach, abs=1e-12)
    assert error.segment == len(inwards)  # of the two at the tip the earlier: the connecting lines are 0 and 1


def test_elements_behind_the_tool_are_let_go():
    tracker = ContourTracker()
    for index in range(5000):
        tracker.add(index, line((index * 1e-3, 0.0, 0.0), ((index + 1) * 1e-3, 0.0, 0.0)), index * 1e-3)
        tracker.step((index * 1e-3, 0.0, 0.0), index)
    assert sum(isinstance(thing, Line) for thing in gc.get_objects()) < 1000


def test_a_segment_that_was_not_added_is_named():
    tracker = tracker_of(*polyline((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    with pytest.raises(MachineFault, match="segment 2, known are 0 to 1"):
        tracker.step((0.0, 0.0, 0.0), 2)
    tracker.step((1.5, 0.0, 0.0), 1)
    with pytest.raises(MachineFault, match="segment 0, known are 1 to 1"):
        tracker.step((1.5, 0.0, 0.0), 0)
    with pytest.raises(MachineFault, match="segment 0, known are none"):
        ContourTracker().step((0.0, 0.0, 0.0), 0)


def test_a_segment_out_of_order_is_refused():
    tracker = tracker_of(line((0, 0, 0), (1, 0, 0)))
    with pytest.raises(MachineFault, match="segment 2 arrived where segment 1 was expected"):
        tracker.add(2, line((1, 0, 0), (2, 0, 0)), 1.0)


def bits(error):
    """With the signs of zeros, and NaN equal to itself."""
    return struct.pack("<8d", *error)


@given(elements=toolpaths(), data=st.data())
@settings(max_examples=100, derandomize=True, deadline=None)
def test_a_whole_run_is_the_same_to_the_bit_as_its_cycles(elements, data):
    elements = [*elements, line(elements[-1].end, (*elements[-1].end[:2], 0.2))]  # upright: no left and up
    tools = data.draw(st.lists(points, min_size=1, max_size=40))
    segments = sorted(data.draw(st.integers(0, len(elements) - 1)) for _ in tools)
    singly = tracker_of(*elements)
    expected = [singly.step(tool, segment) for tool, segment in zip(tools, segments, strict=True)]
    assert [*map(bits, tracker_of(*elements).follow(np.array(tools), segments))] == [*map(bits, expected)]


def test_a_run_over_more_elements_than_are_kept():
    elements = polyline(*((k * 1e-3, 1e-3 * (k % 2), 0.0) for k in range(1001)))
    tools = np.array([element.position(0.3 * element.length) for element in elements]) + [0.0, 0.0, 2e-6]
    whole, singly = tracker_of(*elements), tracker_of(*elements)
    errors = whole.follow(tools, range(len(elements)))
    assert errors == [singly.step(tuple(tool), segment) for segment, tool in enumerate(tools.tolist())]
    assert [error.segment for error in errors] == [*range(len(elements))]
    assert [error.magnitude for error in errors] == pytest.approx([2e-6] * len(elements), abs=1e-15)
