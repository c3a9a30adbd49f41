"""G61, G61.1, G64: what is rounded, how far from the programmed path, and where the TCP stops."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion import arc, line, moved, polyline

from pkm_cnc.config import load_setup
from pkm_cnc.motion import Curve, MotionParameters, Piece, pieces
from pkm_cnc.program import Arc, Line, PathMode, Toolpath
from pkm_cnc.records import Vector

DEFAULT = MotionParameters()
SETUP = load_setup("cartesian")
FINE = 200
"""Places of a piece that are looked at."""


def pieces_of(elements: tuple[Line | Arc, ...], smooth: bool = False) -> list[Piece]:
    return list(pieces(elements, DEFAULT, smooth))


def points(piece: Piece) -> list[Vector]:
    return [piece.shape.position(piece.begin + piece.length * k / FINE) for k in range(FINE + 1)]


def distance(point: Vector, elements: tuple[Line | Arc, ...]) -> float:
    feet = (element.position(element.nearest(point, 0.5 * element.length)) for element in elements)
    return min(math.dist(foot, point) for foot in feet)


def deviation(elements: tuple[Line | Arc, ...], path: list[Piece]) -> float:
    """Both ways: of the pieces from the elements, and of the ends of these, the far points, from the pieces."""
    out = max(distance(point, elements) for piece in path for point in points(piece))
    back = max(min(apart(element.end, piece) for piece in path) for element in elements)
    return max(out, back)


def apart(point: Vector, piece: Piece) -> float:
    if isinstance(piece.shape, Curve):
        return min(math.dist(point, other) for other in points(piece))
    s = min(max(piece.shape.nearest(point, piece.begin), piece.begin), piece.begin + piece.length)
    return math.dist(point, piece.shape.position(s))


places = st.tuples(*(st.integers(-9000, 9000) for _ in range(3))).map(
    lambda micrometres: tuple(1e-6 * number for number in micrometres)
)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.lists(places, min_size=3, max_size=5, unique=True), st.sampled_from([1e-6, 2e-5, 5e-4]), st.booleans())
def test_corners_of_lines_deviate_by_p_at_most(corners: list[Vector], tolerance: float, joining: bool) -> None:
    mode = PathMode("G64", tolerance, tolerance if joining else 0.0)
    elements = polyline(corners, mode=mode).elements
    path = pieces_of(elements)
    assert deviation(elements, path) <= tolerance * (1.0 + 1e-9)
    for before, after in itertools.pairwise(path):
        assert math.dist(points(before)[-1], points(after)[0]) < 1e-12


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(-3.0, 3.0), st.floats(0.002, 0.02), st.floats(0.3, 3.0), st.sampled_from([2e-6, 5e-5]))
def test_corners_with_arcs_deviate_by_p_at_most(angle: float, radius: float, sweep: float, tolerance: float) -> None:
    mode = PathMode("G64", tolerance)
    bow = arc((0.0, 0.0, 0.0), (radius * math.cos(angle), radius * math.sin(angle), 0.0), sweep, mode=mode)
    elements = (line((-0.01, 0.0, 0.0), bow.start, mode=mode), bow, line(bow.end, (0.03, 0.02, 0.01), mode=mode))
    path = pieces_of(elements, smooth=True)
    assert deviation(elements, path) <= tolerance * (1.0 + 1e-6)


@pytest.mark.parametrize("mode", [PathMode("G64", 5e-5), PathMode("G64", 5e-5, 5e-5), PathMode("G64", 5e-5, 0.0)])
def test_a_right_angle_uses_the_tolerance(mode: PathMode) -> None:
    """All of it, for nothing was joined."""
    elements = polyline([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.01, 0.01, 0.0)], mode=mode).elements
    path = pieces_of(elements)
    assert [type(piece.shape).__name__ for piece in path] == ["Line", "Curve", "Line"]
    assert deviation(elements, path) == pytest.approx(5e-5, rel=1e-3)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_curve_has_tangent_and_curvature_of_what_it_joins(smooth: bool) -> None:
    mode = PathMode("G64", 2e-5)
    bow = arc((0.0, 0.0, 0.0), (0.0, 0.005, 0.0), 1.0, mode=mode)
    path = pieces_of((line((-0.01, 0.0, 0.0), (0.0, 0.0, 0.0), mode=mode), bow), smooth)
    assert [isinstance(piece.shape, Curve) for piece in path] == ([False, True, False] if smooth else [False, False])
    if smooth:
        before, curve, after = path
        for (one, s), (other, t) in (
            ((before, before.length), (curve, 0.0)),
            ((curve, curve.length), (after, after.begin)),
        ):
            assert one.shape.tangent(s) == pytest.approx(other.shape.tangent(t), abs=1e-12)
            assert one.shape.curvature(s) == pytest.approx(other.shape.curvature(t), abs=1e-6)


def test_a_curves_derivatives_are_those_of_its_position() -> None:
    corner = polyline([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.012, 0.01, 0.004)], mode=PathMode("G64", 1e-3)).elements
    shape = pieces_of(corner)[1].shape
    h = 1e-5
    for s in np.linspace(0.1, 0.9, 9) * shape.length:
        low, middle, high = (np.array(shape.position(s + d)) for d in (-h, 0.0, h))
        np.testing.assert_allclose((high - low) / (2.0 * h), shape.tangent(s), atol=1e-4)
        np.testing.assert_allclose((high - 2.0 * middle + low) / h**2, shape.curvature(s), rtol=1e-2, atol=1.0)
        assert math.hypot(*shape.tangent(s)) == pytest.approx(1.0, abs=1e-12)
    lengths = [
        math.dist(shape.position(a), shape.position(b))
        for a, b in itertools.pairwise(np.linspace(0, shape.length, 2001))
    ]
    assert sum(lengths) == pytest.approx(shape.length, rel=1e-6)
    np.testing.assert_allclose(lengths, shape.length / 2000, rtol=1e-4)


@pytest.mark.parametrize(
    ("mode", "stops"),
    [("G61", [True, False, True]), ("G61.1", [True, True, True]), ("G64", [False, False, True])],
)
def test_where_the_tcp_stops(mode: str, stops: list[bool]) -> None:
    """A corner, a straight junction, a reversal."""
    corners = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.01, 0.01, 0.0), (0.01, 0.02, 0.0), (0.01, 0.005, 0.0)]
    path = [piece for piece in pieces_of(polyline(corners, mode=PathMode(mode, None, 0.0)).elements) if piece.marks]
    lines = [piece for piece in path if isinstance(piece.shape, Line)]
    assert [piece.stop for piece in lines] == [*stops, True]


def test_a_rapid_stops_at_both_ends_under_g64() -> None:
    mode = PathMode("G64", 1e-4)
    rapid = Line(2, (0.01, 0.0, 0.0), (0.01, 0.01, 0.0), 0.1, traverse=True, evaluated=False, path_mode=mode)
    elements = (line((0.0, 0.0, 0.0), rapid.start, mode=mode), rapid, line(rapid.end, (0.02, 0.01, 0.0), mode=mode))
    assert [piece.stop for piece in pieces_of(elements)] == [True, True, True]


def test_points_in_a_line_are_joined_and_keep_their_segments() -> None:
    corners = [(1e-4 * k, 3e-6 * (-1) ** k, 0.0) for k in range(31)]
    path = polyline(corners, mode=PathMode("G64", 2e-5, 1e-5))
    joined = pieces_of(path.elements)
    assert len(joined) == 1
    setpoints = moved(SETUP, path.elements, DEFAULT)
    assert {setpoint.segment for setpoint in setpoints} == set(range(30))
    for setpoint in setpoints:
        assert (
            abs(setpoint.path_length - path.starts[setpoint.segment]) <= path.elements[setpoint.segment].length + 1e-9
        )
        assert distance(setpoint[:3], path.elements) < 1e-5
    assert setpoints[-1].path_length == pytest.approx(path.length, rel=1e-12)
    without = polyline(corners, mode=PathMode("G64", 2e-5, 0.0))
    assert len(pieces_of(without.elements)) > 30


def test_without_p_the_machine_has_a_tolerance_and_p0_is_g61() -> None:
    corners = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.01, 0.01, 0.0)]
    elements = polyline(corners, mode=PathMode("G64")).elements
    assert deviation(elements, pieces_of(elements)) == pytest.approx(DEFAULT.blend_tolerance, rel=1e-3)
    exact = polyline(corners, mode=PathMode("G64", 0.0, 0.0)).elements
    assert [piece.stop for piece in pieces_of(exact)] == [True, True]


def test_the_setpoints_on_a_curve_change_their_segment_in_its_middle() -> None:
    path = polyline([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.01, 0.01, 0.0)], mode=PathMode("G64", 5e-4))
    setpoints = moved(SETUP, path.elements, DEFAULT)
    for setpoint in setpoints:
        x, y = 0.01 - setpoint.x, setpoint.y
        if abs(x - y) > 1e-6:
            assert setpoint.segment == (0 if x > y else 1)
    assert np.all(np.diff([setpoint.path_length for setpoint in setpoints]) >= 0.0)
    assert Toolpath(path.elements).length == pytest.approx(setpoints[-1].path_length)
