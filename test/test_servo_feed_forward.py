"""Feed-forward and balancing filter against what theory says of ramps, of smooth motion and of overshoot."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import MachineFault
from pkm_cnc.plant import AxisPlant, ScaleParameters, ScrewParameters, TravelParameters
from pkm_cnc.records import AxisCommand, AxisSetpoint
from pkm_cnc.servo import BalancingFilter, DriveParameters, ServoDrive, equivalent_delay, filter_step

T = 1e-3
KV = 20.0
BALANCED = {
    "velocity_feed_forward": 1.0,
    "setpoint_delay": T / 2,
    "equivalent_delay": equivalent_delay(DriveParameters()),
}


def make_plant(drive, start, period=T):
    return AxisPlant(drive, ScrewParameters(), ScaleParameters(), TravelParameters(), period, start)


def run_loop(drive, position, velocity, acceleration):
    """Slider positions, tracking errors and velocity commands in every cycle."""
    servo, plant = ServoDrive(drive, T), make_plant(drive, float(position[0]))
    rows = []
    for setpoint in zip(position.tolist(), velocity.tolist(), acceleration.tolist(), strict=True):
        command = servo.step(AxisSetpoint(*setpoint), plant.state)
        rows.append((plant.state.slider_position, command.tracking_error, command.velocity))
        plant.step(command)
    return np.array(rows).T


def ramp(speed=0.1, cycles=1500):
    return 0.3 + speed * T * np.arange(cycles), np.full(cycles, speed), np.zeros(cycles)


def stroke(cycles=1200, acceleration=2.0, speed=0.1, length=0.050):
    """From rest to rest, with constant acceleration up to `speed` and back."""
    ramping = speed / acceleration
    switches = (0.0, ramping, length / speed, length / speed + ramping)
    t = np.arange(cycles) * T
    signs = (1.0, -1.0, -1.0, 1.0)
    after = [np.maximum(0.0, t - switch) for switch in switches]
    return (
        0.3 + sum(0.5 * sign * acceleration * time**2 for sign, time in zip(signs, after, strict=True)),
        sum(sign * acceleration * time for sign, time in zip(signs, after, strict=True)),
        sum(sign * acceleration * (t >= switch) for sign, switch in zip(signs, switches, strict=True)),
    )


@pytest.mark.parametrize("kind", ["cascade", "first_order"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("delays", [(0.0, 0.0), (T / 2, 0.0008), (0.0032, 0.0), (0.0, 0.004)])
def test_behind_a_ramp_the_lag_is_the_filters_delay_and_what_the_feed_forward_leaves(kind, share, delays):
    drive = DriveParameters(
        kind=kind, velocity_feed_forward=share, setpoint_delay=delays[0], equivalent_delay=delays[1]
    )
    _, error, _ = run_loop(drive, *ramp())
    assert error[-1] / 0.1 == pytest.approx(sum(delays) + (1.0 - share) / KV, abs=2e-7)


@pytest.mark.parametrize("form", ["ideal", "serial"])
def test_an_integral_action_leaves_the_delay_of_the_filter_alone(form):
    drive = DriveParameters(setpoint_delay=0.0007, position_form=form, position_integral_time=0.2)
    _, error, _ = run_loop(drive, *ramp(cycles=4000))
    assert error[-1] / 0.1 == pytest.approx(0.0007, abs=1e-7)


def test_without_feed_forward_setpoint_velocity_and_acceleration_change_no_bit():
    position, velocity, acceleration = stroke()
    plain = run_loop(DriveParameters(), position, velocity, acceleration)
    assert np.array_equal(plain, run_loop(DriveParameters(), position, 0.0 * velocity, 0.0 * acceleration))
    assert plain[2].tolist() == [KV * error for error in plain[1].tolist()]


@pytest.mark.parametrize("kind", ["cascade", "first_order"])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_kappa_is_what_theory_says_with_feed_forward_too(kind, share):
    """Under constant acceleration a the slider is at the setpoint of a lag ago, and kappa a off it."""
    drive = DriveParameters(kind=kind, velocity_feed_forward=share)
    late = T / 2 + equivalent_delay(drive)
    t, acceleration = np.arange(1201) * T, 0.1
    setpoint = 0.3 + 0.5 * acceleration * t**2, acceleration * t, np.full(len(t), acceleration)
    actual, _, _ = run_loop(drive, *setpoint)
    kappa = (actual[-1] - 0.3) / acceleration - 0.5 * (t[-1] - (1.0 - share) / KV) ** 2
    assert kappa == pytest.approx((1.0 - share**2) / (2.0 * KV**2) - late / KV, abs=1e-7)


def test_an_ideal_velocity_loop_is_balanced_by_half_a_period():
    drive = DriveParameters(kind="first_order", velocity_feed_forward=1.0, setpoint_delay=T / 2)
    position, velocity, acceleration = stroke()
    actual, _, command = run_loop(drive, position, velocity, acceleration)
    # the held velocity is the chord of a parabola, a T^2/8 off; that is all the position controller sees
    assert np.max(np.abs(command - velocity)) < 1.01 * KV * 2.0 * T**2 / 8.0
    t = np.arange(len(position)) * T
    assert np.max(np.abs(actual[1:] - np.interp(t[1:] - T / 2, t, position))) < 1e-6


def test_unbalanced_it_overshoots_and_balanced_it_does_not():
    motion = stroke()
    unbalanced, _, _ = run_loop(DriveParameters(velocity_feed_forward=1.0), *motion)
    balanced, _, command = run_loop(DriveParameters(**BALANCED), *motion)
    assert unbalanced.max() - motion[0][-1] > 50e-6
    assert balanced.max() - motion[0][-1] < 1e-9
    # the position controller is left with what a lag of first order does not show of the velocity loop
    assert np.max(np.abs(command - motion[1])) < 0.002 * 0.1


def test_acceleration_feed_forward_makes_up_for_the_delays_instead():
    ahead = DriveParameters(
        velocity_feed_forward=1.0, acceleration_feed_forward=T / 2 + equivalent_delay(DriveParameters())
    )
    _, error, _ = run_loop(ahead, *stroke())
    assert np.max(np.abs(error)) < 1e-6
    _, behind, _ = run_loop(DriveParameters(**BALANCED), *stroke())
    assert np.max(np.abs(behind)) == pytest.approx(0.1 * (T / 2 + equivalent_delay(DriveParameters())), rel=1e-3)


def test_the_equivalent_delay_is_the_lag_of_the_velocity_loop():
    drive, period, change = DriveParameters(), 1e-5, 2.0
    plant = make_plant(drive, 0.3, period)
    for cycle in range(2001):
        velocity = plant.state.slider_velocity
        plant.step(AxisCommand(change * period * cycle, 0.0))
    lag = 2000 * period - velocity / change
    assert equivalent_delay(drive) == pytest.approx(lag - period / 2, abs=0.6 * period)
    assert equivalent_delay(drive) == pytest.approx(0.000822, abs=5e-7)
    assert equivalent_delay(dataclasses.replace(drive, kind="first_order")) == 0.0


# ---- the filter alone


def filtered(drive, position, velocity):
    balance = BalancingFilter(filter_step(drive, T))
    return np.array([balance.step(*row) for row in zip(position.tolist(), velocity.tolist(), strict=True)])


@settings(derandomize=True)
@given(delay=st.floats(1e-6, 0.01))
def test_a_setpoint_of_constant_jerk_is_delayed_exactly(delay):
    t = np.arange(60) * T
    moved = filtered(DriveParameters(setpoint_delay=delay), 0.4 + 30.0 * t**3 - 2.0 * t**2, 90.0 * t**2 - 4.0 * t)
    late = np.maximum(0.0, t - delay)
    assert moved == pytest.approx(0.4 + 30.0 * late**3 - 2.0 * late**2, abs=1e-15)


@pytest.mark.parametrize("w", [1.0, 30.0, 150.0])
def test_a_sine_comes_out_as_the_transfer_function_says(w):
    delay, lag = 0.0013, 0.002
    t = np.arange(8000) * T
    out = filtered(DriveParameters(setpoint_delay=delay, equivalent_delay=lag), np.sin(w * t), w * np.cos(w * t))
    transfer = np.exp(-1j * w * delay) / (1.0 + 1j * w * lag)
    expected = np.abs(transfer) * np.sin(w * t + np.angle(transfer))
    assert np.max(np.abs(out - expected)[100:]) < (w * T) ** 2 / 10.0  # the lag takes the setpoint as a polygon


def test_without_delays_there_is_no_filter():
    assert filter_step(DriveParameters(), T) is None


# ---- the drive around them

EVERYTHING = DriveParameters(
    **BALANCED,
    acceleration_feed_forward=0.0003,
    position_integral_time=0.3,
    position_derivative_time=0.002,
    velocity_limit=0.5,
)


def test_it_starts_at_rest_on_the_first_setpoint():
    servo, plant = ServoDrive(EVERYTHING, T), make_plant(EVERYTHING, 0.4)
    for _ in range(50):
        command = servo.step(AxisSetpoint(0.4, 0.0, 0.0), plant.state)
        assert command == AxisCommand(0.0, 0.0)
        assert plant.step(command).slider_position == 0.4


def test_a_scale_that_reads_off_the_setpoint_at_the_start_gives_no_more_than_the_gain():
    state = make_plant(EVERYTHING, 0.4).state
    command = ServoDrive(EVERYTHING, T).step(AxisSetpoint(0.400008, 0.0, 0.0), state)
    assert command.velocity == pytest.approx(KV * 8e-6)


def test_the_supervised_error_is_against_the_setpoint_and_not_the_filtered_one():
    drive = DriveParameters(setpoint_delay=0.05, following_error_limit=0.004)
    servo, state = ServoDrive(drive, T), make_plant(drive, 0.4).state
    assert servo.step(AxisSetpoint(0.4, 0.0, 0.0), state) == AxisCommand(0.0, 0.0)
    command = servo.step(AxisSetpoint(0.403, 0.0, 0.0), state)
    assert command.tracking_error == pytest.approx(0.003)
    assert command.velocity == 0.0
    with pytest.raises(MachineFault, match="following error 5 mm"):
        servo.step(AxisSetpoint(0.405, 0.0, 0.0), state)


def test_a_limited_velocity_command_does_not_wind_the_integral_up():
    """The integral part must not make a limited drive overshoot a long step by more than a free one a small step."""
    overshoot = {}
    for step, limit in ((0.001, 0.0), (0.018, 0.02)):
        drive = DriveParameters(kind="first_order", position_integral_time=1.0, velocity_limit=limit)
        position = np.full(4000, 0.4 + step)
        position[0] = 0.4
        actual, _, command = run_loop(drive, position, 0.0 * position, 0.0 * position)
        assert np.max(np.abs(command)) <= (limit or math.inf)
        overshoot[step] = actual.max() - position[-1]
    assert 0.0 < overshoot[0.018] <= 1.05 * overshoot[0.001]
