"""Many places at once against one at a time, to the bit; one at a time is judged by `test_toolpath`."""

from __future__ import annotations

import math
import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.motion import Curve, Piece, frames_of
from pkm_cnc.motion.piece import Mark, places_on
from pkm_cnc.program import EXACT_PATH, Arc, Line, Plane, frames

coordinates = st.floats(-0.3, 0.3)
points = st.tuples(coordinates, coordinates, coordinates)
robust = settings(derandomize=True, deadline=None, max_examples=150)


@st.composite
def lines(draw):
    return Line(1, draw(points), draw(points), 0.1, False, True)


@st.composite
def arcs(draw):
    """Circles and helices in all planes, both ways, up to two turns."""
    plane = draw(st.sampled_from(Plane))
    center, radius = draw(points), draw(st.floats(1e-3, 0.3))
    angle, sweep = draw(st.floats(-math.pi, math.pi)), draw(st.sampled_from((-1, 1))) * draw(st.floats(0.01, 12.0))
    rise = draw(st.sampled_from((0.0, 0.01, -0.2)))
    a, b, c = plane.coordinates(center)
    start, end = (
        plane.vector(a + radius * math.cos(angle + turned), b + radius * math.sin(angle + turned), height)
        for turned, height in ((0.0, c), (sweep, c + rise))
    )
    return Arc(1, start, end, 0.1, False, True, center, sweep, plane)


def curves():
    return st.builds(
        lambda begin, end: Curve(
            (begin, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (end, (0.0, 0.6, 0.8), (3.0, 0.0, 0.0)), 0.01
        ),
        points,
        points,
    )


def places_of(shapes, data):
    """Indices of shapes and path lengths on them: before, at and behind both ends, too."""
    which = data.draw(st.lists(st.integers(0, len(shapes) - 1), min_size=1, max_size=30))
    parts = st.sampled_from((-0.5, 0.0, 1.0, 1.5)) | st.floats(0.0, 1.0)
    s = [data.draw(parts) * shapes[index].length for index in which]
    return np.array(which), np.array(s)


def bits(numbers) -> bytes:
    """With the signs of zeros."""
    return b"".join(struct.pack("<d", float(number)) for number in np.ravel(numbers))


@robust
@given(st.lists(lines() | arcs(), min_size=1, max_size=6), st.data())
def test_many_places_are_the_same_to_the_bit_as_one_at_a_time(elements, data):
    which, s = places_of(elements, data)
    found = frames(elements, which, s)
    for row, (index, place) in enumerate(zip(which.tolist(), s.tolist(), strict=True)):
        assert bits(found[:, :, row]) == bits(elements[index].frame(place))


@robust
@given(st.lists(lines() | arcs() | curves(), min_size=1, max_size=6), st.data())
def test_so_are_those_on_curves_among_them(shapes, data):
    which, s = places_of(shapes, data)
    found = frames_of(shapes, which, s)
    for row, (index, place) in enumerate(zip(which.tolist(), s.tolist(), strict=True)):
        assert bits(found[:, :, row]) == bits(shapes[index].frame(place))


@robust
@given(lines() | arcs(), st.floats(0.01, 0.99))
def test_a_frame_is_position_tangent_and_curvature(element, part):
    """The tangent is the derivative of the position, the curvature that of the tangent (central differences)."""
    s, h = part * element.length, 1e-4 * element.length
    if h == 0.0:
        return
    before, (_, tangent, curvature), after = (np.array(element.frame(place)) for place in (s - h, s, s + h))
    np.testing.assert_allclose((after[0] - before[0]) / (2.0 * h), tangent, atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2.0 * h), curvature, rtol=1e-6, atol=1e-6 / h * 1e-4)


@robust
@given(st.lists(st.lists(st.floats(0.0, 0.1), max_size=4), min_size=1, max_size=5), st.data())
def test_places_on_the_contour_are_those_of_each_piece(knots, data):
    pieces = []
    for number, places in enumerate(knots):
        shape = Line(1, (0.0, 0.0, 0.0), (0.1, 0.0, 0.0), 0.1, False, True)
        marks = [
            Mark(s, 10 * number + k, data.draw(st.floats(0.0, 1.0)), data.draw(st.floats(0.9, 1.1)), k)
            for k, s in enumerate(sorted([data.draw(st.sampled_from((0.0, 0.01))), *places]))
        ]
        pieces.append(Piece(shape, 0.0, 0.1, 0.1, 1, tuple(marks), EXACT_PATH, False))
    which, s = places_of(pieces, data)
    found = zip(*(column.tolist() for column in places_on(pieces, which, s)), strict=True)
    assert [*found] == [pieces[index].place(place) for index, place in zip(which.tolist(), s.tolist(), strict=True)]
