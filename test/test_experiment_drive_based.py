"""Contour error from joint signals against geometry that is not the package's, and the experiment around it."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import tripod_oracle
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.config import load_setup
from pkm_cnc.contour import (
    circle_radial_deviation,
    circle_radial_deviation_by_velocity,
    estimated_tracking_error,
    left_and_up,
    line_contour_error,
    tcp_velocity,
)
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated

MACHINE = load_setup("tripod").machine
lags = st.tuples(*[st.floats(-3e-3, 3e-3)] * 3).map(np.array)


def sliders(path, t):
    """Sliders on a path t -> TCP and their rate by differences in long double."""
    step = np.longdouble(1e-5)
    before, at, after = tripod_oracle.inverse([path(np.longdouble(t) + k * step) for k in (-1, 0, 1)])
    return at.astype(float), ((after - before) / (2 * step)).astype(float)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(lag=lags, heading=st.floats(-3.0, 3.0), slope=st.floats(-1.0, 1.0), t=st.floats(-0.05, 0.05))
def test_line_is_the_distance_from_the_line(lag, heading, slope, t):
    tangent = np.array([math.cos(heading) * math.cos(slope), math.sin(heading) * math.cos(slope), math.sin(slope)])
    pivot = np.array([0.01, -0.02, 0.005])
    joints, rate = sliders(lambda s: pivot + s * tangent.astype(np.longdouble), t)
    error = line_contour_error(MACHINE, joints, rate, lag)
    tool = tripod_oracle.forward(joints - lag) - pivot
    assert error == pytest.approx(tool - (tool @ tangent) * tangent, abs=1e-12)
    left, up = left_and_up(error, 0.3 * tangent)
    sideways = np.array([-math.sin(heading), math.cos(heading), 0.0])
    assert float(left) == pytest.approx(error @ sideways, abs=1e-15)
    assert float(up) == pytest.approx(error @ np.cross(tangent, sideways), abs=1e-15)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(lag=lags, angle=st.floats(0.0, 6.28), clockwise=st.booleans())
def test_circle_is_programmed_less_actual_radius(lag, angle, clockwise):
    center, radius, sense = np.array([0.02, -0.01, 0.0]), 0.08, -1.0 if clockwise else 1.0

    def path(t):
        return center + radius * np.array([np.cos(angle + sense * t), np.sin(angle + sense * t), 0.0 * t])

    joints, rate = sliders(path, 0.0)
    tool = tripod_oracle.forward(joints - lag) - center
    expected = radius - math.hypot(tool[0], tool[1])
    assert float(circle_radial_deviation(MACHINE, joints, lag, center, radius)) == pytest.approx(expected, abs=1e-12)
    by_velocity = circle_radial_deviation_by_velocity(MACHINE, joints, rate, lag, radius, clockwise)
    assert float(by_velocity) == pytest.approx(expected, abs=1e-11)  # the rate is one by differences


def test_at_rest_there_is_no_direction():
    joints, _ = sliders(lambda t: np.array([0.0 * t, 0.0 * t, 0.0 * t]), 0.0)
    rest = np.zeros(3)
    assert tcp_velocity(MACHINE, joints, rest).tolist() == [0.0, 0.0, 0.0]
    assert np.isnan(line_contour_error(MACHINE, joints, rest, rest)).all()
    assert np.isnan(circle_radial_deviation_by_velocity(MACHINE, joints, rest, rest, 0.1, False))
    assert np.isnan(left_and_up((1e-6, 0.0, 0.0), (0.0, 0.0, 1.0))).all()


def test_arrays_are_rows():
    joints, rate = zip(
        *[sliders(lambda t: np.array([0.1 * t, t, 0.0 * t]), t) for t in (-0.02, 0.0, 0.03)], strict=True
    )
    lag = estimated_tracking_error(rate, (20.0, 20.0, 25.0))
    assert lag == pytest.approx(np.array(rate) / [20.0, 20.0, 25.0])
    rows = line_contour_error(MACHINE, joints, rate, lag)
    alone = [line_contour_error(MACHINE, *row) for row in zip(joints, rate, lag, strict=True)]
    assert rows.tolist() == [row.tolist() for row in alone]


@functools.cache
def findings(machine: str, *overrides: str) -> Findings:
    experiment = load_experiment("drive-based")
    options = experiment.options(headings=(0.0, 80.0), length=120.0, radius=20.0)
    return experiment.run(Lab(machine, overrides, simulated), options)


def plane_machines() -> list[str]:
    from pkm_cnc.config import machine_files

    setups = {name: load_setup(name) for name in machine_files()}
    ideal = {name: setup for name, setup in setups.items() if not any(map(setup.imperfect, setup.axes))}
    return [name for name, setup in ideal.items() if {"x", "y"} <= set(setup.kinematics.coordinates)]


@pytest.mark.parametrize("machine", plane_machines())
def test_recorded_signals_give_the_nearest_point_value(machine):
    assert findings(machine).data["recorded_largest_difference_pm"] < 1.0
    for entry in findings(machine).data["segments"]:
        if entry["kind"] == "circle":
            assert entry["velocity_largest_difference_pm"]["radial_deviation"] < 1.0


def test_circles_are_recomputed_all_around():
    for panel in findings("tripod").figures[1].panels:
        angle = panel.curves[0].x
        assert np.diff(angle, prepend=angle[-1] - 360.0).max() < 0.5  # deg; a cycle is 0.15 deg


def test_the_estimate_is_the_opposite_of_a_first_order_lag():
    data = findings("tripod", "drive.kind=first_order").data
    expected = -1.0 / (1.0 - 20.0 * 0.001)  # -1/(2 Kv^2) over (1 - Kv T)/(2 Kv^2)
    assert data["expected_ratio_estimated_to_nearest"] == pytest.approx(expected, rel=1e-6)
    for entry in data["segments"]:
        means = entry["z_mean_um"]
        higher_orders = 0.005 if entry["kind"] == "line" else 0.02  # of the small circle
        assert means["estimated"] / means["nearest"] == pytest.approx(expected, rel=higher_orders)


def test_a_machine_without_a_plane_is_refused():
    with pytest.raises(InputError, match="monopod moves in no plane"):
        findings("monopod")
