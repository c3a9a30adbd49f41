"""The PID controller against the formulas of its forms, against calculus, and at its limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import InputError
from pkm_cnc.servo import PID_FORMS, Pid, PidController, PidGains

T = 1e-3
GAINS = st.floats(0.01, 100.0)
TIMES = st.floats(1e-3, 10.0)


def frequency_response(pid, s):
    a, b, c, d = pid.gains.continuous()
    return c @ np.linalg.solve(s * np.eye(len(a)) - a, b.astype(complex)) + d


def formula(form, gain, integral_time, derivative, s):
    """Eq. 2-3..2-5 with s for the derivative operator, `derivative` = Td s as far as it is filtered."""
    if form == "ideal":
        return gain * (1.0 + 1.0 / (integral_time * s) + derivative)
    if form == "parallel":
        return gain + 1.0 / (integral_time * s) + derivative
    return gain * (1.0 + 1.0 / (integral_time * s)) * (1.0 + derivative)


@settings(derandomize=True)
@given(form=st.sampled_from(PID_FORMS), gain=GAINS, ti=TIMES, td=TIMES, frequency=st.floats(-3.0, 3.0))
def test_each_form_is_its_formula_below_the_filter_of_its_derivative(form, gain, ti, td, frequency):
    s, filter_time = 1j * 10.0**frequency, 1e-9
    response = frequency_response(Pid(form, gain, ti, td, filter_time), s)
    assert response == pytest.approx(formula(form, gain, ti, td * s, s), rel=2e-5)


@settings(derandomize=True)
@given(form=st.sampled_from(("ideal", "parallel")), gain=GAINS, ti=TIMES, td=TIMES, filter_time=TIMES)
def test_the_filter_is_a_lag_on_the_derivative_alone(form, gain, ti, td, filter_time):
    s = 3.0j
    response = frequency_response(Pid(form, gain, ti, td, filter_time), s)
    assert response == pytest.approx(formula(form, gain, ti, td * s / (1.0 + filter_time * s), s), rel=1e-9)


@pytest.mark.parametrize("form", PID_FORMS)
def test_a_proportional_controller_is_its_gain_in_every_form(form):
    assert Pid(form, 20.0).gains == PidGains(20.0)
    assert Pid(form, 20.0).to_form("serial").gains == PidGains(20.0)


@settings(derandomize=True)
@given(gain=GAINS, td=TIMES, ratio=st.one_of(st.just(1.0), st.floats(1.0, 100.0)), between=st.sampled_from(PID_FORMS))
def test_a_serial_controller_is_the_same_by_way_of_any_form(gain, td, ratio, between):
    serial = Pid("serial", gain, ratio * td, td, 0.01)
    again = serial.to_form(between).to_form("serial")
    # where both times are nearly equal they are a double root: half the digits
    near = 1e-6 if ratio < 1.1 else 1e-11
    assert (again.gain, again.integral_time, again.derivative_time) == pytest.approx((gain, ratio * td, td), rel=near)
    for value, expected in zip(vars(serial.to_form(between).gains).values(), vars(serial.gains).values(), strict=True):
        assert value == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("times", [(math.inf, 0.0), (0.5, 0.0), (math.inf, 0.1)])
@pytest.mark.parametrize("form", PID_FORMS)
def test_p_pi_and_pd_have_every_form(form, times):
    pid = Pid("ideal", 3.0, *times, 0.01)
    assert vars(pid.to_form(form).gains) == pytest.approx(vars(pid.gains))


def test_a_form_that_does_not_exist_is_refused_with_the_reason():
    with pytest.raises(InputError, match=r"integral_time 0\.39 s .* below 4 times its derivative_time 0\.1 s"):
        Pid("ideal", 2.0, 0.39, 0.1, 0.01).to_form("serial")
    with pytest.raises(InputError, match="without a proportional part there is no ideal form"):
        Pid("parallel", 0.0, 0.5).to_form("ideal")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (("standard", 1.0), "'standard' is not one of ideal, parallel, serial"),
        (("ideal", -1.0), "gain: -1.0"),
        (("ideal", math.nan), "gain: nan"),
        (("ideal", 1.0, 0.0), "integral_time: 0.0 is not above 0; inf is no integral action"),
        (("ideal", 1.0, math.nan), "integral_time: nan"),
        (("ideal", 1.0, 1.0, math.inf, 0.1), "derivative_time: inf"),
        (("serial", 1.0, 1.0, 0.1), "filter_time: 0 s given"),
    ],
)
def test_a_value_out_of_bounds_is_refused_by_name(values, reason):
    with pytest.raises(InputError) as refused:
        Pid(*values)
    assert reason in str(refused.value)


# ---- sampled


def run(controller, errors):
    return np.array([controller.step(error) for error in errors.tolist()])


@pytest.mark.parametrize("gains", [PidGains(2.0, 3.0), PidGains(2.0, 3.0, 0.5, 0.02), PidGains(0.0, 0.0, 0.5, 0.02)])
def test_it_converges_to_calculus_in_first_order(gains):
    deviations = []
    for period in (1e-3, 5e-4, 2.5e-4):
        t = np.arange(round(0.2 / period)) * period
        lag = gains.filter_time
        # of e = t^2: filtered derivative of a lag to the ramp 2 t
        slope = 2.0 * t - 2.0 * lag * (1.0 - np.exp(-t / lag)) if lag else 0.0 * t
        exact = gains.proportional * t**2 + gains.integral * t**3 / 3.0 + gains.derivative * slope
        deviations.append(np.max(np.abs(run(PidController(gains.sampled(period)), t**2) - exact)))
    assert deviations[0] < 2e-3
    assert 0.45 < deviations[1] / deviations[0] < 0.55
    assert 0.45 < deviations[2] / deviations[1] < 0.55


def test_the_derivative_of_a_step_decays_and_never_rings_however_short_its_filter():
    for filter_time in (1e-6, 1e-4, 1e-3):
        controller = PidController(PidGains(0.0, 0.0, 1.0, filter_time).sampled(T))
        output = run(controller, np.r_[0.0, np.ones(50)])[1:]
        assert np.all(output > 0.0)
        assert np.all(np.diff(output) < 0.0)
        assert T * output.sum() == pytest.approx(1.0, rel=1e-9)  # the step itself


def test_a_gain_alone_is_a_product_to_the_bit():
    errors = np.random.default_rng(5).normal(size=200)
    assert run(PidController(PidGains(20.0).sampled(T)), errors).tolist() == [20.0 * error for error in errors.tolist()]


@settings(derandomize=True, max_examples=50)
@given(errors=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=40))
def test_inside_its_limit_it_is_the_linear_law_to_the_bit(errors):
    sampled = PidGains(2.0, 30.0, 0.01, 0.005).sampled(T)
    free, limited = PidController(sampled), PidController(sampled, 100.0)
    assert [free.step(e) for e in errors] == [limited.step(e) for e in errors]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_long_time_at_the_limit_winds_nothing_up(side):
    controller = PidController(PidGains(2.0, 4.0).sampled(T), 1.0)
    assert np.all(run(controller, side * np.ones(10_000)) == side)
    # the integral part is still none: the output leaves the limit where the gain alone does, without a jump
    assert controller.step(side * 0.5) == side * 1.0
    assert controller.step(side * 0.25) == pytest.approx(side * (2.0 * 0.25 + 4.0 * T * 0.5), rel=1e-12)


def test_what_brings_the_output_back_is_integrated_at_the_limit_too():
    controller = PidController(PidGains(0.0, 1.0).sampled(T), 0.5)
    run(controller, np.ones(2000))  # to the limit, 0.5, and no further than one period beyond
    errors = -np.ones(100)
    assert run(controller, errors)[-1] == pytest.approx(0.5 - 0.1, abs=3.0 * T)


def test_the_feed_forward_counts_towards_the_limit():
    controller = PidController(PidGains(1.0, 10.0).sampled(T), 1.0)
    for _ in range(1000):
        assert controller.step(0.1, 5.0) == 1.0
    assert controller.step(0.1) == pytest.approx(0.1, abs=1e-12)


def test_an_error_that_stands_from_the_start_does_not_kick_the_derivative():
    controller = PidController(PidGains(2.0, 0.0, 1.0, 0.001).sampled(T))
    assert [controller.step(0.3) for _ in range(3)] == [0.6, 0.6, 0.6]
