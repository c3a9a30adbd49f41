"""Lines and arcs against dense sampling, bounded minimisation, finite differences and circles as complex numbers."""

import cmath
import math
import random
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from pkm_cnc import run_messages
from pkm_cnc.contour import ContourTracker
from pkm_cnc.messages import deserialize
from pkm_cnc.program import Arc, Element, Line, Plane, Toolpath
from pkm_cnc.records import Vector


def make_line(start: Vector, end: Vector) -> Line:
    return Line(line=1, start=start, end=end, feed=0.1, traverse=False, evaluated=True)


def make_arc(center: Vector, radius: float, angle: float, sweep: float) -> Arc:
    start, end = (
        (center[0] + radius * math.cos(a), center[1] + radius * math.sin(a), center[2]) for a in (angle, angle + sweep)
    )
    end = start if abs(sweep) == math.tau else end
    return Arc(1, start, end, 0.1, False, True, center, sweep)


def random_point(rng: random.Random, size: float = 0.3) -> Vector:
    return rng.uniform(-size, size), rng.uniform(-size, size), rng.uniform(-size, size)


def random_arc(rng: random.Random) -> Arc:
    sweep = rng.choice((-1.0, 1.0)) * rng.uniform(0.01, math.tau - 0.01)
    return make_arc(random_point(rng), rng.uniform(0.001, 0.3), rng.uniform(-4.0, 4.0), sweep)


def random_elements(count: int) -> list[Element]:
    rng = random.Random(1)
    lines: list[Element] = [make_line(random_point(rng), random_point(rng)) for _ in range(count)]
    return lines + [random_arc(rng) for _ in range(count)]


ELEMENTS = random_elements(60)
FULL_CIRCLES = [
    make_arc((0.01, -0.02, 0.3), 0.1, angle, turn) for angle in (0.0, 2.5) for turn in (math.tau, -math.tau)
]


@pytest.mark.parametrize("element", ELEMENTS + FULL_CIRCLES)
def test_ends_are_exact(element: Element) -> None:
    length = element.length
    assert element.position(0.0) == element.position(-1.0) == element.start
    assert element.position(length) == element.position(length + 1.0) == element.end
    for vector in (element.tangent, element.curvature):
        assert vector(-1.0) == vector(0.0)
        assert vector(length + 1.0) == vector(length)
    assert element.position(length * 1e-13) == pytest.approx(element.start, abs=1e-12)
    assert element.position(length * (1.0 - 1e-13)) == pytest.approx(element.end, abs=1e-12)


@pytest.mark.parametrize("element", ELEMENTS + FULL_CIRCLES)
def test_tangent_and_curvature_are_the_derivatives(element: Element) -> None:
    step = 1e-5 * element.length
    for part in (0.01, 0.3, 0.5, 0.77, 0.99):
        s = part * element.length
        ahead, behind = np.array(element.position(s + step)), np.array(element.position(s - step))
        tangent = np.array(element.tangent(s))
        assert np.allclose((ahead - behind) / (2 * step), tangent, rtol=0, atol=1e-8)
        assert math.hypot(*tangent) == pytest.approx(1.0, abs=1e-15)
        turn = np.array(element.tangent(s + step)) - np.array(element.tangent(s - step))
        # a difference of tangents carries 2e-16 / (2 step), and its own error is the third derivative's
        assert np.allclose(turn / (2 * step), element.curvature(s), rtol=1e-8, atol=1e-9 / element.length)


@pytest.mark.parametrize("arc", [element for element in ELEMENTS if isinstance(element, Arc)] + FULL_CIRCLES)
def test_arcs_as_complex_numbers(arc: Arc) -> None:
    center, start = complex(*arc.center[:2]), complex(*arc.start[:2])
    assert arc.radius == pytest.approx(abs(start - center), rel=1e-15)
    assert arc.length == pytest.approx(abs(start - center) * abs(arc.sweep), rel=1e-15)
    for part in (0.0, 0.1, 0.5, 0.9, 1.0):
        spoke = (start - center) * cmath.exp(1j * arc.sweep * part)
        travel = spoke * 1j * math.copysign(1.0, arc.sweep) / arc.radius
        inward = -spoke / arc.radius**2
        s = part * arc.length
        assert arc.position(s) == pytest.approx((*_xy(center + spoke), arc.center[2]), abs=1e-15)
        assert arc.tangent(s) == pytest.approx((*_xy(travel), 0.0), abs=3e-15)
        assert arc.curvature(s) == pytest.approx((*_xy(inward), 0.0), rel=1e-11, abs=3e-15 / arc.radius)


def _xy(number: complex) -> tuple[float, float]:
    return number.real, number.imag


@pytest.mark.parametrize("element", ELEMENTS)
def test_nearest_is_the_nearest(element: Element) -> None:
    """Against sampling, and a bounded minimisation from the best sample on; the hint has no influence."""
    rng = random.Random(hash(element.start))
    samples = np.linspace(0.0, element.length, 400)
    points = np.array([element.position(s) for s in samples])
    for _ in range(20):
        point = random_point(rng)
        s = element.nearest(point, rng.uniform(-1.0, 1.0))
        assert 0.0 <= s <= element.length
        distance = math.dist(point, element.position(s))
        best = int(np.argmin(np.sum((points - point) ** 2, axis=1)))
        around = samples[max(best - 1, 0)], samples[min(best + 1, 399)]
        found = minimize_scalar(
            lambda t, point=point: math.dist(point, element.position(t)), bounds=around, method="bounded"
        )
        reference = min(found.fun, math.dist(point, points[best]))
        assert distance <= reference + 1e-15
        assert distance == pytest.approx(reference, abs=1e-9)


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_known_offset_is_returned_exactly(element: Element) -> None:
    """A point set off along the normal (and along z from an arc) has its foot where it was set off."""
    rng = random.Random(2)
    for _ in range(20):
        s = rng.uniform(0.0, element.length)
        x, y, z = element.position(s)
        tx, ty, _ = element.tangent(s)
        off = rng.uniform(-0.9, 0.9) * (element.radius if isinstance(element, Arc) else 0.1)
        up = rng.uniform(-0.1, 0.1) if isinstance(element, Arc) else 0.0
        foot = element.nearest((x - off * ty, y + off * tx, z + up), 0.0)
        assert foot == pytest.approx(s, abs=1e-13)


@pytest.mark.parametrize("element", ELEMENTS)
def test_the_ends_are_nearest_to_themselves(element: Element) -> None:
    assert element.nearest(element.start, 0.0) == pytest.approx(0.0, abs=1e-15)
    assert element.nearest(element.end, 0.0) == pytest.approx(element.length, abs=1e-15)


def test_nearest_beyond_the_ends_of_an_arc() -> None:
    quarter = make_arc((0.0, 0.0, 0.0), 1.0, 0.0, math.pi / 2)
    assert quarter.nearest((2.0, -1e-9, 5.0), 0.7) == 0.0
    assert quarter.nearest((-1e-9, 2.0, 5.0), 0.7) == quarter.length
    assert quarter.nearest((-1.0, -1.0 + 1e-9, 0.0), 0.7) == quarter.length
    assert quarter.nearest((-1.0 + 1e-9, -1.0, 0.0), 0.7) == 0.0
    half = Arc(1, (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.1, False, True, (0.0, 0.0, 0.0), -math.pi)
    assert half.nearest((0.0, 3.0, 0.0), 3.0) == 0.0  # a tie between the ends
    for near, s in ((-1.0, 0.0), (1.25, 1.25), (9.0, half.length)):
        assert half.nearest((0.0, 0.0, 7.0), near) == s  # on the axis


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_nearest_on_a_full_circle_follows_the_hint(direction: float) -> None:
    circle = Arc(1, (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.1, False, True, (0.0, 0.0, 0.0), direction * math.tau)
    before = (0.1 * math.cos(0.05), -direction * 0.1 * math.sin(0.05), 0.0)
    after = (0.1 * math.cos(0.05), direction * 0.1 * math.sin(0.05), 0.0)
    length = circle.length
    assert circle.nearest(before, 0.0) == 0.0  # still lagging behind the start
    assert circle.nearest(after, 0.0) == pytest.approx(0.005, abs=1e-15)
    assert circle.nearest(before, length - 0.01) == pytest.approx(length - 0.005, abs=1e-15)
    assert circle.nearest(after, length) == length  # overran the end
    foot = 0.0
    for step in range(1, 629):  # one turn, always from the last foot
        angle = direction * 0.01 * step
        foot = circle.nearest((0.12 * math.cos(angle), 0.12 * math.sin(angle), 0.01), foot)
        assert foot == pytest.approx(0.001 * step, abs=1e-14)
    assert circle.nearest((0.0, 0.0, 0.5), 0.3) == 0.3


def test_a_line_without_length() -> None:
    line = make_line((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
    assert line.length == line.nearest((5.0, 5.0, 5.0), 1.0) == 0.0
    assert line.position(0.5) == line.start
    assert line.tangent(0.0) == (0.0, 0.0, 0.0)


def test_toolpath() -> None:
    first = make_line((0.0, 0.0, 0.0), (0.3, 0.4, 0.0))
    second = make_line((0.3, 0.4, 0.0), (0.3, 0.4, 2.0))
    path = Toolpath((first, second))
    assert path.starts == (0.0, 0.5)
    assert path.length == 2.5
    assert list(path) == [first, second]
    with pytest.raises(ValueError, match=r"element 1 starts at \(0\.0, 0\.0, 0\.0\), the one before ends at"):
        Toolpath((first, first))
    with pytest.raises(ValueError, match=r"element 1 has the length 0\.0 m"):
        Toolpath((first, make_line(first.end, first.end)))
    with pytest.raises(ValueError, match="at least one element"):
        Toolpath(())


# --- planes, turns and helices


def make_helix(center: Vector, radius: float, angle: float, sweep: float, rise: float, plane: Plane = Plane.XY) -> Arc:
    a, b, c = plane.coordinates(center)
    points = [
        plane.vector(a + radius * math.cos(t), b + radius * math.sin(t), c + up)
        for t, up in ((angle, 0.0), (angle + sweep, rise))
    ]
    return Arc(1, *points, 0.1, False, True, center, sweep, plane)


def random_helix(rng: random.Random, turns: float) -> Arc:
    sweep = rng.choice((-1.0, 1.0)) * rng.uniform(0.1, turns * math.tau)
    rise = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-5.0, -0.5)
    radius = 10.0 ** rng.uniform(-3.0, -0.5)
    return make_helix(random_point(rng), radius, rng.uniform(-4.0, 4.0), sweep, rise, rng.choice(list(Plane)))


HELICES = [random_helix(random.Random(seed), turns) for seed in range(40) for turns in (0.99, 5.0)]


@pytest.mark.parametrize("helix", HELICES)
def test_helices_against_their_definition(helix: Arc) -> None:
    """The point at angle t of travel, length and derivatives, from cos, sin and finite differences in mpmath."""
    center, start = helix.plane.coordinates(helix.center), helix.plane.coordinates(helix.start)
    rise = helix.plane.coordinates(helix.end)[2] - start[2]

    def position(part: Any) -> list[Any]:
        x, y = start[0] - mpmath.mpf(center[0]), start[1] - mpmath.mpf(center[1])
        cosine, sine = mpmath.cos(part * mpmath.mpf(helix.sweep)), mpmath.sin(part * mpmath.mpf(helix.sweep))
        points = (
            center[0] + x * cosine - y * sine,
            center[1] + x * sine + y * cosine,
            start[2] + part * mpmath.mpf(rise),
        )
        return list(helix.plane.vector(*points))

    def derivative(part: Any, order: int) -> list[Any]:
        return [mpmath.diff(lambda p, axis=axis: position(p)[axis], part, order) for axis in range(3)]

    with mpmath.workdps(40):
        speed = mpmath.norm(derivative(mpmath.mpf("0.3"), 1))
        assert helix.length == pytest.approx(float(speed), rel=1e-14)
        for part in (0.0, 0.25, 0.7, 1.0):
            s = part * helix.length
            assert helix.position(s) == pytest.approx([float(x) for x in position(mpmath.mpf(part))], abs=2e-14)
            tangent = [float(x / speed) for x in derivative(mpmath.mpf(part), 1)]
            assert helix.tangent(s) == pytest.approx(tangent, abs=1e-12)
            curvature = [float(x / speed**2) for x in derivative(mpmath.mpf(part), 2)]
            assert helix.curvature(s) == pytest.approx(curvature, abs=1e-12 / helix.radius)
    assert helix.position(0.0) == helix.start
    assert helix.position(helix.length) == helix.end


@pytest.mark.parametrize("helix", HELICES)
def test_nearest_on_helices_is_the_nearest_within_half_a_turn_of_the_hint(helix: Arc) -> None:
    rng = random.Random(repr(helix.start))
    half_turn = math.pi * helix.length / abs(helix.sweep)
    for _ in range(6):
        near = rng.uniform(0.0, helix.length)
        place = helix.position(near)
        point = tuple(x + rng.choice((1e-5, 0.01, 0.3)) * rng.uniform(-1.0, 1.0) for x in place)
        below_a_turn = abs(helix.sweep) < math.tau
        low = 0.0 if below_a_turn else max(near - half_turn, 0.0)
        high = helix.length if below_a_turn else min(near + half_turn, helix.length)
        s = helix.nearest(point, near)
        assert low - 1e-12 <= s <= high + 1e-12
        samples = np.linspace(low, high, 500)
        distances = [math.dist(point, helix.position(sample)) for sample in samples]
        best = int(np.argmin(distances))
        around = samples[max(best - 1, 0)], samples[min(best + 1, 499)]
        found = minimize_scalar(
            lambda t, point=point: math.dist(point, helix.position(t)), bounds=around, method="bounded"
        )
        assert math.dist(point, helix.position(s)) <= min(found.fun, distances[best]) + 1e-14


@pytest.mark.parametrize("helix", HELICES)
def test_a_known_offset_from_a_helix_is_returned_exactly(helix: Arc) -> None:
    """A point set off along the principal normal, outwards, has its foot where it was set off."""
    rng = random.Random(3)
    for _ in range(10):
        s = rng.uniform(0.0, helix.length)
        off = 0.2 * helix.radius * rng.random()
        inward = helix.curvature(s)
        size = math.hypot(*inward)
        point = tuple(x - off * c / size for x, c in zip(helix.position(s), inward, strict=True))
        rate = helix.length / abs(helix.sweep)
        assert helix.nearest(point, s) == pytest.approx(s, abs=1e-9 * rate)
        foot = np.array(helix.position(helix.nearest(point, s)))
        assert abs(np.dot(np.array(point) - foot, helix.tangent(s))) < 1e-14


@pytest.mark.parametrize("plane", list(Plane))
def test_planes_turn_into_each_other(plane: Plane) -> None:
    """An arc in a plane is the one in x-y with its axes renamed, cyclically: the same numbers."""
    rng = random.Random(5)
    for arc in (random_arc(rng), make_arc((0.1, 0.2, 0.3), 0.05, 1.0, -math.tau)):
        turned = Arc(
            *(1, plane.vector(*arc.start), plane.vector(*arc.end), 0.1, False, True, plane.vector(*arc.center)),
            *(arc.sweep, plane),
        )
        assert (turned.radius, turned.length) == (arc.radius, arc.length)
        for part in (0.0, 0.3, 1.0):
            s = part * arc.length
            assert turned.position(s) == plane.vector(*arc.position(s))
            assert turned.tangent(s) == plane.vector(*arc.tangent(s))
            assert turned.curvature(s) == plane.vector(*arc.curvature(s))
            point = random_point(rng)
            assert turned.nearest(plane.vector(*point), s) == arc.nearest(point, s)


@pytest.mark.parametrize("rise", [0.0, 1e-6, 0.003])
def test_turn_after_turn_the_foot_follows(rise: float) -> None:
    """A tool 0.02 outside, from foot to foot over three turns; with next to no rise the turns lie on each other."""
    spiral = make_helix((0.0, 0.0, 0.0), 0.1, 0.0, -3.0 * math.tau, rise)
    foot, steps = 0.0, 3000
    for step in range(steps + 1):
        s = spiral.length * step / steps
        x, y, z = spiral.position(s)
        foot = spiral.nearest((1.2 * x, 1.2 * y, z), foot)
        assert foot == pytest.approx(s, abs=1e-12)


@pytest.mark.parametrize("element", [HELICES[0], HELICES[1], make_helix((0.0,) * 3, 0.1, 1.0, 2.0, 0.0, Plane.ZX)])
def test_a_message_brings_every_bit_of_an_arc(element: Arc) -> None:
    data = run_messages.segment(3, element, 0.5, 0)
    assert run_messages.element_of(deserialize(data, "pkm_cnc_msgs/msg/ToolpathSegment")) == element


@pytest.mark.parametrize("plane", list(Plane))
@pytest.mark.parametrize("rise", [0.0, 0.05])
def test_contour_error_off_an_arc_in_any_plane(plane: Plane, rise: float) -> None:
    """Set off by a known amount to the left and up, the contour error tells both."""
    arc = make_helix((0.1, 0.2, 0.3), 0.05, 0.3, 4.0, rise, plane)
    tracker = ContourTracker()
    tracker.add(0, arc, 0.0)
    for part in (0.1, 0.35, 0.6, 0.9):
        t = np.array(arc.tangent(part * arc.length))
        left = np.cross((0.0, 0.0, 1.0), t)
        left /= np.linalg.norm(left)
        up = np.cross(t, left)
        normal = np.array(arc.curvature(part * arc.length))
        normal /= np.linalg.norm(normal)
        off = 1e-4 * normal + 2e-5 * np.cross(t, normal)
        error = tracker.step(tuple(np.array(arc.position(part * arc.length)) + off), 0)
        # 1e-4 of the radius off the curve along the binormal of a helix, its foot moves by the second order of that
        assert error.path_length == pytest.approx(part * arc.length, abs=1e-7)
        assert error.left == pytest.approx(np.dot(off, left), abs=1e-8)
        assert error.up == pytest.approx(np.dot(off, up), abs=1e-8)
        assert error.magnitude <= np.linalg.norm(off) + 1e-15
