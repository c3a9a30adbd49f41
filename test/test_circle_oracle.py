"""The circular test on the Tripod, R 100 mm at 3000 mm/min about the axis, against figures and theory from outside."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import tripod_oracle
from numpy.typing import NDArray

from pkm_cnc.contour import CirclePath, circle_path, circle_program, circle_report, is_full_circle
from pkm_cnc.program import Arc

UM = 1e-6
SENSE = {"ccw": 1.0, "cw": -1.0}


@functools.cache
def circles(overrides: tuple[str, ...] = ()) -> dict[str, CirclePath]:
    """The data arcs of one program with both directions."""
    program = circle_program(
        feed_mm_min=3000.0,
        radius_mm=100.0,
        center_mm=(0.0, 0.0),
        direction="both",
        overshoot_deg=180.0,
        acceleration_mm_s2=2000.0,
    )
    toolpath, cycles = tripod_oracle.run(program, overrides)
    found = {}
    for index, element in enumerate(toolpath.elements):
        if isinstance(element, Arc) and is_full_circle(element):
            points = np.array([cycle.tcp[3:6] for cycle in cycles if cycle.error.segment == index])
            found["ccw" if element.sweep > 0.0 else "cw"] = circle_path(element, points)
    return found


@pytest.mark.parametrize("direction", ["ccw", "cw"])
def test_radial_deviation(direction: str) -> None:
    path = circles()[direction]
    assert path.deviation.min() == pytest.approx(25.04 * UM, rel=0.01)
    assert path.deviation.max() == pytest.approx(29.87 * UM, rel=0.01)


@pytest.mark.parametrize(("direction", "maxima"), [("ccw", (106.0, 226.0, 346.0)), ("cw", (104.0, 224.0, 344.0))])
def test_three_maxima(direction: str, maxima: tuple[float, ...]) -> None:
    assert sorted(_maxima(direction)) == pytest.approx(maxima, abs=0.5)


def test_maxima_of_both_directions_lie_evenly_about_the_middle_between_two_columns() -> None:
    means = [(one + other) / 2.0 for one, other in zip(sorted(_maxima("ccw")), sorted(_maxima("cw")), strict=True)]
    assert means == pytest.approx([105.0, 225.0, 345.0], abs=0.2)


def _maxima(direction: str) -> list[float]:
    found = circle_report(circles()[direction])["extrema_deg"]
    assert isinstance(found, list)
    return found


@pytest.mark.parametrize("direction", ["ccw", "cw"])
def test_maxima_are_those_of_a_plain_fit_of_the_third_harmonic(direction: str) -> None:
    path = circles()[direction]
    basis = [np.ones_like(path.angle)]
    for order in (3, 6, 9, 12):
        basis += [np.cos(order * path.angle), np.sin(order * path.angle)]
    weights = np.linalg.lstsq(np.column_stack(basis), path.deviation, rcond=None)[0]
    fine = np.radians(np.arange(0.0, 120.0, 0.001))
    columns = [np.ones_like(fine)]
    for order in (3, 6, 9, 12):
        columns += [np.cos(order * fine), np.sin(order * fine)]
    peak = math.degrees(fine[np.argmax(np.column_stack(columns) @ weights)])
    assert sorted(_maxima(direction)) == pytest.approx([peak, peak + 120.0, peak + 240.0], abs=0.1)


@pytest.mark.parametrize("direction", ["ccw", "cw"])
def test_first_order_drives_follow_the_law_all_around(direction: str) -> None:
    """dR = - kappa v^2 (J^-1 d2u/ds2) . r, d2u/ds2 along the circle: within 1 % of the largest at every 10 deg."""
    path = circles(("drive.kind=first_order",))[direction]
    scale = tripod_oracle.sampled_kappa(20.0, 0.001) * 0.05**2
    angles = np.radians(np.arange(0.0, 360.0, 10.0))
    law = np.array([_inward(angle, SENSE[direction]) for angle in angles]) * scale
    measured = np.interp(angles, path.angle, path.deviation, period=math.tau)
    assert measured == pytest.approx(law, abs=0.01 * law.max())


def _inward(angle: float, sense: float) -> float:
    def circle(s: np.longdouble) -> NDArray[np.longdouble]:
        turned = np.longdouble(angle) + sense * s / np.longdouble(0.100)
        return np.array([np.cos(turned), np.sin(turned), 0.0], dtype=np.longdouble) * np.longdouble(0.100)

    x, y, _ = tripod_oracle.drift(circle, 0.0)
    return -(x * math.cos(angle) + y * math.sin(angle))
