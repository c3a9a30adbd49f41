"""Gear ratio and deviations of the Monopod against its closed form, 4-8..4-13."""

from __future__ import annotations

import math

import mpmath
import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Lab, load_experiment, simulated

EXPERIMENT = load_experiment("gear-ratio")


def find(machine: str = "monopod", **options):
    return EXPERIMENT.run(Lab(machine, [], simulated), EXPERIMENT.options(**options)).data


def slider(x_mm: float, gamma_deg: float):
    """U in mm: the triangle with the strut that closes at the start point x0 = 300 mm, u0 = sqrt(L^2 - x0^2)."""
    with mpmath.workdps(40):
        sine, x0 = mpmath.sin(mpmath.radians(gamma_deg)), mpmath.mpf(300)
        u0 = mpmath.sqrt(mpmath.mpf(600) ** 2 - x0**2)
        square = u0**2 + 2 * u0 * x0 * sine + x0**2
        return -x_mm * sine + mpmath.sqrt(x_mm**2 * sine**2 - x_mm**2 + square)


@pytest.mark.parametrize("gamma", [0.0, 2.0, -5.0])
def test_curves_are_those_of_the_triangle(gamma):
    (curves,) = find(gammas=(gamma,))["curves"]
    for place in (0, 70, 200):
        x = curves["x_mm"][place]
        expected = mpmath.diff(lambda position: slider(position, gamma), x)
        assert curves["u_mm"][place] == pytest.approx(float(slider(x, gamma)), abs=1e-9)
        assert curves["gear_ratio"][place] == pytest.approx(float(expected), rel=1e-10)
        dx = mpmath.mpf(10000) / 60 / 50
        left, right = (abs(slider(x + side * dx, gamma) - slider(x, gamma)) for side in (-1, 1))
        assert curves["du_left_mm"][place] == pytest.approx(float(left), rel=1e-9)
        assert curves["du_right_mm"][place] == pytest.approx(float(right), rel=1e-9)
        assert curves["du_left_by_du_right"][place] == pytest.approx(float(left / right), rel=1e-9)


def test_statements_of_the_thesis():
    data = find()
    assert data["deviation_mm"] == pytest.approx(10.0 / 3.0)
    (curves,) = data["curves"]
    assert all(left < right for left, right in zip(curves["du_left_mm"], curves["du_right_mm"], strict=True))
    first, second = curves["stations"]
    assert first["du_left_by_du_right"] != pytest.approx(second["du_left_by_du_right"], abs=1e-3)
    assert math.tan(math.radians(first["beta_deg"])) == pytest.approx(-first["gear_ratio"], rel=1e-12)


@pytest.mark.parametrize(
    ("machine", "options", "words"),
    [
        ("tripod", {}, "gear-ratio: it is about the monopod"),
        ("monopod", {"end": 599.0}, "begin and end, with dx: 602.333 mm"),
        ("monopod", {"stations": (700.0,)}, "stations, with dx: 696.667 mm"),
        ("monopod", {"begin": 500.0, "end": 400.0}, "begin: 500 mm is not below end 400 mm"),
    ],
)
def test_what_cannot_be_answered_is_refused(machine, options, words):
    with pytest.raises(InputError, match=words):
        find(machine, **options)
