"""Unequal gains against closed forms, equal gains on the Tripod against what 6-21 cannot do, 2-12 in its limit."""

from __future__ import annotations

import functools
import math
from typing import Any

import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated

FEED = 9000.0 / 60e3


@functools.cache
def findings() -> Findings:
    experiment = load_experiment("kv-mismatch")
    options = experiment.options(headings=(30.0, 120.0, 210.0), radius=25.0, periods=(4.0, 2.0))
    return experiment.run(Lab("cartesian", (), simulated), options)


def data() -> dict[str, Any]:
    return findings().to_json()


def test_unequal_gains_shift_lines_as_6_21_says_with_the_opposite_sign() -> None:
    """Kvy is lower: along 30 deg the tool lags more in y than in x, so it runs right of it, and right along 210 deg."""
    ramp_lag = FEED * math.sin(math.radians(60.0)) / 2.0 * (1.0 / 20.0 - 1.0 / 16.4)
    assert data()["expected_um"] == pytest.approx([1e6 * ramp_lag, -1e6 * ramp_lag, 1e6 * ramp_lag])
    assert ramp_lag < 0.0
    assert data()["unequal_gains"]["at_twice_the_feed_um"] == pytest.approx(data()["expected_um"], rel=1e-3)


def test_unequal_gains_are_linear_and_change_side_while_the_tripod_is_square_and_does_not() -> None:
    serial, parallel = data()["unequal_gains"], data()["equal_gains"]
    assert serial["ratio_on_doubled_feed"] == pytest.approx(2.0, rel=0.01)
    assert parallel["ratio_on_doubled_feed"] == pytest.approx(4.0, rel=0.01)
    assert serial["ratio_on_reversal"] == pytest.approx(1.0, rel=0.001)
    assert parallel["ratio_on_reversal"] == pytest.approx(-1.0, rel=0.001)
    assert "contradicted" in findings().remarks[-1]


def test_a_circle_becomes_an_ellipse_at_45_deg_by_direction() -> None:
    """dR = v (1/Kvy - 1/Kvx) / 2 sin(2 angle), turned by the lag of v / (R Kv) = 6 deg in the direction of travel."""
    ellipse = data()["ellipse"]
    assert ellipse["expected_um"] == pytest.approx(1e6 * 0.05 * (1.0 / 16.4 - 1.0 / 20.0) / 2.0)
    for direction, angle in (("ccw", 45.0), ("cw", 135.0)):
        assert ellipse["second_harmonic_um"][direction] == pytest.approx(ellipse["expected_um"], rel=0.02)
        assert ellipse["largest_dR_at_deg"][direction] == pytest.approx(angle, abs=6.0)


def test_the_radial_error_is_that_of_the_sampled_loop_and_2_12_in_the_limit() -> None:
    """Continuous loop: R (1 - 1 / sqrt(1 + (v / (R Kv))^2)); 2-12 is its first term."""
    radial = data()["radial_error"]
    for row in radial["by_period"]:
        assert row["simulated_um"] == pytest.approx(row["sampled_response_um"], abs=1e-4)
    exact = 25e3 * (1.0 - 1.0 / math.sqrt(1.0 + (0.05 / (0.025 * 20.0)) ** 2))
    assert radial["extrapolated_um"] == pytest.approx(exact, rel=1e-3)
    assert radial["eq_2_12_um"] == pytest.approx(125.0)


def test_2_12_at_the_radius_of_the_thesis() -> None:
    experiment = load_experiment("kv-mismatch")
    from pkm_cnc.experiments.kv_mismatch import _limit, _radial

    radial = _radial(Lab("cartesian", (), simulated), experiment.options(periods=(4.0,)))
    assert _limit(experiment.options()) == pytest.approx(31.25)
    assert radial[0]["simulated_um"] == pytest.approx(radial[0]["sampled_response_um"], abs=1e-4)


def test_a_machine_without_axes_x_and_y_is_refused() -> None:
    experiment = load_experiment("kv-mismatch")
    with pytest.raises(InputError, match="tripod has u1, u2, u3"):
        experiment.run(Lab("tripod", (), simulated), experiment.options())


def test_a_servo_period_that_cannot_be_is_refused_before_anything_is_run() -> None:
    def runner(setup: Any, program: Any) -> Any:
        raise AssertionError("a program was run")

    experiment = load_experiment("kv-mismatch")
    with pytest.raises(InputError, match="servo_period"):
        experiment.run(Lab("cartesian", (), runner), experiment.options(periods=(4.0, 1e-9)))
