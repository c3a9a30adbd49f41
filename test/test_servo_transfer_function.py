"""The closed position loop: eq. 7-1 against section 7.6 and the state space, responses, the recursion 7-4..7-9."""

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from pkm_cnc.errors import InputError
from pkm_cnc.servo import (
    CASCADE_STATES,
    DriveParameters,
    cascade_state_space,
    filter_setpoints,
    impulse_response,
    poles,
    position_loop,
    ramp_lag,
    ramp_response,
    recursion,
    response_figures,
    step_response,
)

PITCH = 0.010
DEFAULT = position_loop(DriveParameters())
LAG = position_loop(DriveParameters(kind="first_order"))


def closed_state_space(drive):
    """The cascade with its position loop closed, input setpoint."""
    a, b = cascade_state_space(drive, PITCH)
    a = a.copy()
    a[:, CASCADE_STATES.index("slider_position")] -= drive.kv * b
    return a, drive.kv * b


def test_the_coefficients_are_those_of_section_7_6():
    last_digit = {3.483e3: 1.0, 3.599: 1e-3, 5.805e-4: 1e-7, 6.264e-5: 1e-8, 0.143: 1e-3, 1.741e2: 0.1}
    printed_numerator = (3.483e3, 3.599, 5.805e-4)
    printed_denominator = (6.264e-5, 0.143, 1.741e2, 3.483e3, 3.599, 5.805e-4)
    assert len(DEFAULT.numerator) == len(printed_numerator)
    assert len(DEFAULT.denominator) == len(printed_denominator)
    for computed, printed in zip(
        DEFAULT.numerator + DEFAULT.denominator, printed_numerator + printed_denominator, strict=True
    ):
        assert -1e-12 < computed - printed < last_digit[printed]  # printed truncated, not rounded
    assert DEFAULT.numerator[2] == DEFAULT.denominator[5] == pytest.approx(5.8057e-4, abs=5e-9)


def test_the_poles_are_the_eigenvalues_of_the_closed_cascade():
    eigenvalues = np.linalg.eigvals(closed_state_space(DriveParameters())[0])
    for pole in poles(DEFAULT):
        assert np.min(np.abs(eigenvalues - pole)) < 1e-9 * max(1.0, abs(pole))
    assert poles(DEFAULT)[2:].real == pytest.approx([-20.3368323, -8.3333e-4, -2.0e-4], rel=1e-4)
    assert np.all(np.diff(np.abs(poles(DEFAULT))) <= 1e-9)
    assert poles(LAG) == pytest.approx([-20.0])


NUMBERS = {"kv", "velocity_gain", "velocity_integral", "current_gain", "current_integral"}
NUMBERS |= {"inductance", "resistance", "torque_constant", "inertia"}
FACTORS = st.lists(st.floats(0.2, 5.0), min_size=len(NUMBERS), max_size=len(NUMBERS))


@settings(derandomize=True, max_examples=50)
@given(factors=FACTORS, frequency=st.floats(-2.0, 4.0), pitch=st.floats(0.002, 0.1))
def test_transfer_function_and_state_space_are_one_system_at_any_frequency(factors, frequency, pitch):
    numbers = {name: value for name, value in dataclasses.asdict(DriveParameters()).items() if name in NUMBERS}
    drive = DriveParameters(**{name: f * value for f, (name, value) in zip(factors, numbers.items(), strict=True)})
    s = 1j * 10.0**frequency
    a, b = cascade_state_space(drive, pitch)
    opened = drive.kv * np.linalg.solve(s * np.eye(5) - a, b.astype(complex))[4]
    numerator, denominator = position_loop(drive)
    ratio = np.polyval(numerator, s) / np.polyval(denominator, s)
    assert abs(opened / (1.0 + opened) - ratio) < 1e-9 * abs(ratio)


@pytest.mark.parametrize(
    "zero", [["velocity_integral"], ["current_integral"], ["velocity_integral", "current_integral"]]
)
def test_a_loop_without_integral_gains_has_a_lower_order_and_the_same_end_value(zero):
    loop = position_loop(DriveParameters(**dict.fromkeys(zero, 0.0)))
    assert len(loop.denominator) == 6 - len(zero)
    assert loop.numerator[-1] == loop.denominator[-1] > 0.0
    times = np.linspace(0.0, 0.5, 101)
    assert step_response(loop, times) == pytest.approx(step_response(DEFAULT, times), abs=1e-4)


def test_the_step_response_has_no_overshoot_and_reaches_half_after_0_0349_s():
    times = np.linspace(0.0, 2.0, 4001)
    response = step_response(DEFAULT, times)
    assert response[0] == 0.0
    assert response.max() < 1.0 + 1e-9
    assert response[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.diff(response) > -1e-12)
    assert np.interp(0.5, response, times) == pytest.approx(0.0349, abs=5e-5)
    assert response_figures(times, response, 1.0).delay_time == pytest.approx(0.0349, abs=5e-5)


def test_the_responses_are_those_of_the_state_space():
    a, b = closed_state_space(DriveParameters())
    augmented = np.zeros((7, 7))  # states, ramp, one
    augmented[:5, :5] = a
    augmented[:5, 5] = b
    augmented[5, 6] = 1.0
    times = np.linspace(0.0, 0.3, 31)
    transitions = [expm(augmented * time) for time in times]
    assert step_response(DEFAULT, times) == pytest.approx([e[4, 5] for e in transitions], abs=1e-9)
    assert ramp_response(DEFAULT, times) == pytest.approx([e[4, 6] for e in transitions], abs=1e-9)
    assert impulse_response(DEFAULT, times) == pytest.approx([(e[:5, :5] @ b)[4] for e in transitions], abs=1e-7)


def test_the_first_order_loop_is_the_exponential_lag():
    times = np.linspace(0.0, 0.5, 101)
    assert step_response(LAG, times) == pytest.approx(1.0 - np.exp(-20.0 * times), abs=1e-13)
    assert impulse_response(LAG, times) == pytest.approx(20.0 * np.exp(-20.0 * times), abs=1e-12)
    assert ramp_response(LAG, times) == pytest.approx(times - (1.0 - np.exp(-20.0 * times)) / 20.0, abs=1e-13)
    assert ramp_lag(LAG) == 1.0 / 20.0


@pytest.mark.parametrize("kv", [5.0, 20.0, 50.0])
def test_the_ramp_lag_is_1_over_kv(kv):
    loop = position_loop(DriveParameters(kv=kv))
    assert ramp_lag(loop) == pytest.approx(1.0 / kv, rel=1e-9)
    times = np.linspace(0.0, 5.0, 5001)
    assert times[-1] - ramp_response(loop, times)[-1] == pytest.approx(1.0 / kv, rel=1e-5)


@pytest.mark.parametrize("name", ["velocity_feed_forward", "equivalent_delay", "position_integral_time"])
def test_a_position_controller_that_eq_7_1_does_not_know_is_refused(name):
    with pytest.raises(InputError, match=f"drive.{name}: 0.05; eq. 7-1 knows"):
        position_loop(DriveParameters(**{name: 0.05}))


def test_the_recursion_coefficients_are_the_binomial_expansion_of_7_5():
    dt = 1e-3
    (n1, n2, n3), (d1, d2, d3, d4, d5, d6) = DEFAULT
    a, b = recursion(DEFAULT, dt)
    assert a == pytest.approx((n1 / dt**2 + n2 / dt + n3, -2 * n1 / dt**2 - n2 / dt, n1 / dt**2), rel=1e-14)
    assert b == pytest.approx(
        (
            d1 / dt**5 + d2 / dt**4 + d3 / dt**3 + d4 / dt**2 + d5 / dt + d6,
            -5 * d1 / dt**5 - 4 * d2 / dt**4 - 3 * d3 / dt**3 - 2 * d4 / dt**2 - d5 / dt,
            10 * d1 / dt**5 + 6 * d2 / dt**4 + 3 * d3 / dt**3 + d4 / dt**2,
            -10 * d1 / dt**5 - 4 * d2 / dt**4 - d3 / dt**3,
            5 * d1 / dt**5 + d2 / dt**4,
            -d1 / dt**5,
        ),
        rel=1e-14,
    )


def solve_7_8(transfer_function, period, setpoints):
    """Eq. 7-8 in exact fractions, from rest at zero."""
    dt = Fraction(period)

    def expand(polynomial):
        coefficients = [Fraction(0)] * len(polynomial)
        for power, c in enumerate(reversed(polynomial)):
            for j in range(power + 1):
                coefficients[j] += Fraction(c) * (-1) ** j * math.comb(power, j) / dt**power
        return coefficients

    a, b = expand(transfer_function.numerator), expand(transfer_function.denominator)
    xs = [Fraction(0)] * len(b) + [Fraction(x) for x in setpoints]
    xa = [Fraction(0)] * len(b)
    for i in range(len(b), len(xs)):
        past = sum(b[j] * xa[i - j] for j in range(1, len(b)))
        xa.append((sum(a[j] * xs[i - j] for j in range(len(a))) - past) / b[0])
    return [float(x) for x in xa[len(b) :]]


@pytest.mark.parametrize("transfer_function", [DEFAULT, LAG])
@pytest.mark.parametrize("period", [1e-3, 1e-5])
def test_the_filter_solves_7_8_to_rounding_where_7_8_itself_loses_its_digits(transfer_function, period):
    setpoints = [0.0, *(math.sin(0.3 * i) + 0.1 * i for i in range(30))]
    filtered = filter_setpoints(transfer_function, period, setpoints)
    assert filtered == pytest.approx(solve_7_8(transfer_function, period, setpoints), rel=1e-11, abs=1e-18)


def test_eq_7_8_in_double_precision_drifts_and_the_filter_does_not():
    steps = 20_000
    setpoints = np.ones(steps)
    setpoints[0] = 0.0
    a, b = recursion(DEFAULT, 1e-3)
    xa = [0.0] * 5
    xs = [0.0, 0.0, *setpoints]
    for i in range(2, steps + 2):
        right = a[0] * xs[i] + a[1] * xs[i - 1] + a[2] * xs[i - 2]
        right -= b[1] * xa[-1] + b[2] * xa[-2] + b[3] * xa[-3] + b[4] * xa[-4] + b[5] * xa[-5]
        xa.append(right / b[0])
    filtered = filter_setpoints(DEFAULT, 1e-3, setpoints)
    assert np.max(np.abs(np.array(xa[5:505]) - filtered[:500])) < 1e-8
    assert abs(xa[-1] - 1.0) > 1e-6
    assert abs(filtered[-1] - 1.0) < 1e-9


def test_the_recursion_converges_to_the_exact_step_response_in_first_order():
    errors = []
    for period in (1e-3, 5e-4, 2.5e-4):
        times = np.arange(round(0.3 / period) + 1) * period
        setpoints = np.ones(len(times))
        setpoints[0] = 0.0
        errors.append(np.max(np.abs(filter_setpoints(DEFAULT, period, setpoints) - step_response(DEFAULT, times))))
    assert errors[0] < 4.5e-3
    assert errors[1] / errors[0] < 0.65
    assert errors[2] / errors[1] < 0.65


def test_the_filtered_ramp_lags_by_1_over_kv_and_starts_at_rest_on_the_first_setpoint():
    period, speed, start = 1e-3, 0.1, 0.4
    setpoints = start + speed * np.maximum(0.0, np.arange(2001) - 100) * period
    filtered = filter_setpoints(DEFAULT, period, setpoints)
    assert np.all(filtered[:101] == start)
    assert setpoints[-1] - filtered[-1] == pytest.approx(speed / 20.0, rel=1e-5)


def test_the_filter_is_linear_and_takes_an_empty_series():
    assert filter_setpoints(DEFAULT, 1e-3, []).shape == (0,)
    rng = np.random.default_rng(7)
    first, second = rng.normal(size=(2, 200))
    total = filter_setpoints(DEFAULT, 1e-3, first + 2.0 * second)
    parts = filter_setpoints(DEFAULT, 1e-3, first) + 2.0 * filter_setpoints(DEFAULT, 1e-3, second)
    assert total == pytest.approx(parts, abs=1e-10)
