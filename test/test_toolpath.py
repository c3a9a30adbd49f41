"""Lines and arcs against dense sampling, bounded minimisation, finite differences and circles as complex numbers."""

import cmath
import math
import random

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from pkm_cnc.program import Arc, Element, Line, Toolpath
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
