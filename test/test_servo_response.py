"""The figures of a step response against the closed forms of first- and second-order systems."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import InputError
from pkm_cnc.servo import DriveParameters, position_loop, response_figures, step_response


def first_order(t, time_constant):
    return 1.0 - np.exp(-t / time_constant)


def second_order(t, damping, w):
    root = math.sqrt(1.0 - damping**2)
    return 1.0 - np.exp(-damping * w * t) / root * np.sin(w * root * t + math.acos(damping))


@pytest.mark.parametrize("band", [0.02, 0.05])
def test_a_first_order_system(band):
    t = np.linspace(0.0, 2.0, 20_001)
    figures = response_figures(t, first_order(t, 0.05), 1.0, band)
    assert figures.delay_time == pytest.approx(0.05 * math.log(2.0), abs=1e-7)
    assert figures.rise_time == pytest.approx(0.05 * math.log(9.0), abs=1e-7)
    assert figures.settling_time == pytest.approx(0.05 * math.log(1.0 / band), abs=1e-7)
    assert math.isnan(figures.peak_time)
    assert figures.overshoot == 0.0
    assert figures.steady_state_error == pytest.approx(0.0, abs=1e-15)
    assert figures.band == band


@pytest.mark.parametrize("damping", [0.1, 0.4, 0.7])
def test_a_second_order_system_by_the_formulas_of_the_textbook(damping):
    w = 30.0
    t = np.linspace(0.0, 12.0, 60_001)
    figures = response_figures(t, second_order(t, damping, w), 1.0)
    root = math.sqrt(1.0 - damping**2)
    assert figures.peak_time == pytest.approx(math.pi / (w * root), abs=5e-7)  # 1/400 of a sample
    assert figures.overshoot == pytest.approx(math.exp(-math.pi * damping / root), abs=1e-7)
    # the envelope settles last; the response itself up to half an oscillation before
    envelope = -math.log(0.02 * root) / (damping * w)
    assert envelope - math.pi / (w * root) < figures.settling_time <= envelope + 1e-9
    at_settling = second_order(figures.settling_time, damping, w)
    assert abs(at_settling - 1.0) == pytest.approx(0.02, abs=1e-6)
    assert second_order(figures.delay_time, damping, w) == pytest.approx(0.5, abs=5e-6)  # a chord of 0.2 ms


def test_coarse_samples_are_interpolated():
    t = np.arange(0.0, 3.0, 0.01)
    figures = response_figures(t, second_order(t, 0.4, 12.0), 1.0)
    root = math.sqrt(1.0 - 0.4**2)
    assert figures.peak_time == pytest.approx(math.pi / (12.0 * root), abs=2e-4)  # a fiftieth of a sample
    assert figures.overshoot == pytest.approx(math.exp(-math.pi * 0.4 / root), abs=2e-4)
    assert second_order(figures.delay_time, 0.4, 12.0) == pytest.approx(0.5, abs=1e-3)


@settings(derandomize=True, max_examples=30)
@given(start=st.floats(-1.0, 1.0), height=st.sampled_from([-0.2, 1e-3, 5.0]), begin=st.floats(-3.0, 3.0))
def test_neither_place_nor_sign_nor_begin_of_a_step_change_its_figures(start, height, begin):
    t = np.linspace(0.0, 3.0, 3001)
    level = second_order(t, 0.3, 20.0)
    expected = dataclasses.asdict(response_figures(t, level, 1.0))
    moved = dataclasses.asdict(response_figures(begin + t, start + height * level, start + 1.1 * height))
    assert moved.pop("steady_state_error") == pytest.approx(0.1 * height + height * (1.0 - level[-1]), abs=1e-9)
    expected.pop("steady_state_error")
    assert moved == pytest.approx(expected, abs=1e-9)


def test_the_default_drive_reaches_half_after_0_035_s_and_does_not_overshoot():
    """Thesis section 7.4."""
    t = np.linspace(0.0, 2.0, 8001)
    figures = response_figures(t, step_response(position_loop(DriveParameters()), t), 1.0)
    assert figures.delay_time == pytest.approx(0.0349, abs=5e-5)
    assert figures.overshoot == 0.0
    assert figures.steady_state_error == pytest.approx(0.0, abs=1e-9)


T = np.linspace(0.0, 10.0, 1001)


@pytest.mark.parametrize(
    ("times", "values", "band", "reason"),
    [
        (T, np.sin(3.0 * T), 0.02, "not settled"),
        (T, T, 0.02, r"not settled, .* until 9\.8 s of 10 s"),
        (T, second_order(T, 0.01, 20.0), 0.02, "not settled"),
        (T, 0.0 * T, 0.02, "it ends at 0, where it began"),
        (T[::-1], T, 0.02, "times do not increase after 10 s"),
        (T, T[:-1], 0.02, r"times of shape \(1001,\) and values of shape \(1000,\)"),
        (T[:2], T[:2], 0.02, "n of 3 or more"),
        (T, np.where(T > 5.0, math.nan, T), 0.02, "not a finite number"),
        (T, first_order(T, 0.1), 0.0, "a band of 0.0 is not between"),
        (T, first_order(T, 0.1), math.nan, "a band of nan is not between"),
    ],
)
def test_what_has_no_figures_is_refused_with_the_reason(times, values, band, reason):
    with pytest.raises(InputError, match=reason):
        response_figures(times, values, 1.0, band)
