"""The star experiment: zero headings where they must be, and nothing where there is nothing to find."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

from pkm_cnc.config import load_setup
from pkm_cnc.contour import star_program
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Lab, load_experiment, simulated
from pkm_cnc.experiments._law import drift, kappa
from pkm_cnc.experiments.star import _zeros
from pkm_cnc.program import Program


def run(machine: str, *, overrides: tuple[str, ...] = (), **options: Any) -> dict[str, Any]:
    star = load_experiment("star")
    findings = star.run(Lab(machine, overrides, simulated), star.options(**options))
    assert findings.tables
    assert findings.remarks
    return findings.to_json()


@functools.cache
def tripod(pivot: tuple[float, float], headings: tuple[float, ...]) -> dict[str, Any]:
    (star,) = run("tripod", headings=headings, feeds=(6000.0,), pivot=pivot)["stars"]
    return star


@pytest.mark.parametrize(
    ("pivot", "headings", "zero"), [((50.0, 0.0), (45.0, 60.0), 52.0), ((0.0, 50.0), (30.0, 45.0), 38.0)]
)
def test_zero_headings_of_the_tripod(pivot: tuple[float, float], headings: tuple[float, ...], zero: float) -> None:
    star = tripod(pivot, headings)
    assert star["zero_headings_deg"] == pytest.approx([zero], abs=0.5)
    assert star["law_zero_headings_deg"] == pytest.approx(star["zero_headings_deg"], abs=0.1)


def test_pivots_that_are_mirror_images_have_zeros_that_are() -> None:
    """The machine is symmetric about the plane of its column at 45 deg."""
    (one,) = tripod((50.0, 0.0), (45.0, 60.0))["zero_headings_deg"]
    (other,) = tripod((0.0, 50.0), (30.0, 45.0))["zero_headings_deg"]
    assert one + other == pytest.approx(90.0, abs=0.02)


def test_the_error_changes_side_within_a_hundredth_of_a_degree_of_the_zero() -> None:
    (zero,) = tripod((50.0, 0.0), (45.0, 60.0))["zero_headings_deg"]
    text = star_program(6000.0, [zero - 0.01, zero + 0.01], (50.0, 0.0), 200.0)
    below, above = simulated(load_setup("tripod"), Program("star", text)).evaluation.summaries.values()
    assert below.left_mean < 0.0 < above.left_mean


def test_zero_headings_of_the_bipod() -> None:
    (star,) = run("bipod", headings=(75.0, 105.0, 255.0, 285.0), feeds=(9000.0,), pivot=(0.0, 0.0))["stars"]
    assert star["zero_headings_deg"] == pytest.approx([90.0, 270.0], abs=0.05)


def test_equal_gains_on_straight_axes_leave_no_error() -> None:
    (star,) = run("cartesian", headings=(0.0, 30.0, 75.0), feeds=(6000.0,), pivot=(0.0, 0.0))["stars"]
    assert max(line["contour_error_um"]["max_abs"] for line in star["lines"]) < 1e-6
    assert max(line["contour_error_z_um"]["max_abs"] for line in star["lines"]) < 1e-6
    assert star["zero_headings_deg"] == []


def test_a_machine_that_moves_in_x_only_is_refused_by_its_reason() -> None:
    with pytest.raises(InputError, match="moves its TCP in x and y; monopod moves it in x only"):
        run("monopod")


def test_unequal_drives_have_no_law() -> None:
    data = run("tripod", overrides=("u1.drive.kv=21",), headings=(0.0,), feeds=(9000.0,), pivot=(0.0, 0.0))
    assert data["kappa_s2"] is None
    assert data["stars"][0]["law_um"] is None


def test_zeros_of_a_third_harmonic() -> None:
    """Sampled on zeros and between them; the widest gap is not followed up."""

    def error(heading: float) -> float:
        return 10.0 * math.sin(3.0 * math.radians(heading - 15.0))

    headings = [0.0, 15.0, 40.0, 100.0, 130.0, 140.0]
    found = _zeros(headings, np.array(list(map(error, headings))), error)
    assert found == pytest.approx([15.0, 135.0], abs=0.005)
    assert _zeros(headings, np.full(6, 1e-4), error) == []


@pytest.mark.parametrize("period", [0.001, 0.0005])
@pytest.mark.parametrize("kv", [20.0, 35.0])
def test_kappa_of_a_sampled_first_order_lag(kv: float, period: float) -> None:
    setup = load_setup("tripod", ["drive.kind=first_order", f"drive.kv={kv}", f"servo_period={period}"])
    assert kappa(setup) == pytest.approx((1.0 - kv * period) / (2.0 * kv * kv), rel=1e-9)


def test_kappa_of_the_default_drive_is_that_of_its_step_response_over_three_seconds() -> None:
    assert kappa(load_setup("tripod")) == pytest.approx(0.00118391, rel=1e-5)


def test_drift_of_the_bipod() -> None:
    """u = y -+ sqrt(L^2 - (b -+ x)^2): at x = 0 both sliders are alike, and x is left by nothing, y by their mean."""
    setup = load_setup("bipod")
    b, length = 0.200, 0.600
    height = math.sqrt(length * length - b * b)
    curvature = 1.0 / height + b * b / height**3  # d2/dx2 of -sqrt(L^2 - (b - x)^2) at 0
    assert drift(setup.machine, [[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])[0] == pytest.approx([0.0, curvature, 0.0])
