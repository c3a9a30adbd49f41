"""The array path against the step loop that it stands for."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from pkm_cnc.array_path import linear, respond
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.plant import AxisPlant, ImperfectAxis
from pkm_cnc.records import AxisSetpoint
from pkm_cnc.servo import ServoDrive

T = 1e-3
START = 0.47  # m, near the start pose of the Tripod


def wave(cycles, start=START, size=0.040):
    """Position, velocity, acceleration of a motion that starts from rest and turns often."""
    times = np.arange(cycles) * T
    position, velocity, acceleration = np.full(cycles, start), np.zeros(cycles), np.zeros(cycles)
    for share, w in ((0.8, 2.1), (0.15, 7.3), (0.01, 41.0)):
        position += share * size * (1.0 - np.cos(w * times))
        velocity += share * size * w * np.sin(w * times)
        acceleration += share * size * w**2 * np.cos(w * times)
    return position, velocity, acceleration


def step_loop(setup, axis, setpoint):
    """Slider position, slider velocity and tracking error by the objects that the simulation steps; shape (3, n)."""
    start = float(setpoint[0][0])
    drive, parts = ServoDrive(setup.axes[axis].drive, setup.servo_period), setup.axes[axis].parts
    if setup.imperfect(axis):
        plant = ImperfectAxis(axis, parts, setup.servo_period, setup.plant.steps, start)
    else:
        plant = AxisPlant(parts.drive, parts.screw, parts.scale, parts.travel, setup.servo_period, start)
    rows = []
    for values in zip(*(part.tolist() for part in setpoint), strict=True):
        state = plant.state
        command = drive.step(AxisSetpoint(*values), state)
        rows.append((state.slider_position, state.slider_velocity, command.tracking_error))
        plant.step(command)
    return np.array(rows).T


def assert_equal_to_the_step_loop(setup, axis, setpoint, within=1e-12):
    expected = step_loop(setup, axis, setpoint)
    response = respond(setup, axis, *setpoint)
    assert np.max(np.abs(response.position - expected[0])) < within
    assert np.max(np.abs(response.velocity - expected[1])) < 10.0 * within
    assert np.max(np.abs(response.tracking_error - expected[2])) < within


@pytest.mark.parametrize("kind", ["cascade", "first_order"])
def test_a_minute_of_motion_is_that_of_the_step_loop(kind):
    setup = load_setup("tripod", [f"drive.kind={kind}"])
    assert_equal_to_the_step_loop(setup, "u2", wave(60_000))


def test_a_minute_of_motion_with_everything_on_is_that_of_the_step_loop():
    overrides = (
        "velocity_feed_forward=0.9 acceleration_feed_forward=0.0004 setpoint_delay=0.0017 equivalent_delay=0.0006"
    )
    overrides += " position_form=serial position_integral_time=0.3 position_derivative_time=0.002"
    setup = load_setup("tripod", [f"drive.{override}" for override in overrides.split()])
    assert_equal_to_the_step_loop(setup, "u3", wave(60_000))


@pytest.mark.parametrize(
    "overrides",
    [
        ["u1.drive.kv=50", "servo_period=0.0005"],
        ["u1.drive.kv=80", "drive.velocity_integral=40.0"],
        ["drive.velocity_feed_forward=1.0", "drive.setpoint_delay=0.0005", "drive.equivalent_delay=0.00082"],
        ["drive.kind=first_order", "drive.velocity_feed_forward=1.0", "drive.setpoint_delay=0.003"],
        ["drive.kind=first_order", "drive.equivalent_delay=0.02", "drive.acceleration_feed_forward=0.01"],
        ["drive.position_integral_time=0.1"],
        ["drive.velocity_integral=0.0", "drive.current_integral=0.0", "u1.screw.pitch=0.02"],
    ],
)
def test_other_drives_are_those_of_the_step_loop(overrides):
    assert_equal_to_the_step_loop(load_setup("tripod", overrides), "u1", wave(3000))


@pytest.mark.parametrize("periods", [0.25, 1.0, 1.7, 3.0, 12.5])
def test_a_dead_time_is_that_of_the_step_loop(periods):
    """The plant of an axis with a dead time adds up no rests: its rounding grows with the number of cycles."""
    overrides = [f"drive.dead_time={periods * T}", "drive.velocity_feed_forward=0.7", "drive.setpoint_delay=0.0013"]
    assert_equal_to_the_step_loop(load_setup("tripod", overrides), "u1", wave(3000), 1e-11)


@pytest.mark.parametrize("dead_time", [0.0004, 0.002, 0.0033])
def test_a_dead_time_of_an_ideal_velocity_loop_by_hand(dead_time):
    """The slider moves with the command that was given a dead time ago: an integral over pieces."""
    kv = 30.0
    setup = load_setup("tripod", ["drive.kind=first_order", f"drive.kv={kv}", f"drive.dead_time={dead_time}"])
    commanded = wave(400)
    whole, rest = divmod(dead_time, T)
    commands, slider, errors = [0.0] * 10, START, []
    for setpoint in commanded[0]:
        errors.append(setpoint - slider)
        commands.append(kv * errors[-1])
        age = -1 - round(whole)
        slider += rest * commands[age - 1] + (T - rest) * commands[age]
    response = respond(setup, "u1", *commanded)
    assert response.tracking_error == pytest.approx(np.array(errors), abs=1e-13)


def test_the_response_has_a_derivative_by_the_dead_time_at_none():
    """From above and below alike, which an identification needs at a drive without dead time."""

    def response(dead_time, kind):
        setup = load_setup("tripod", [f"drive.kind={kind}"])
        parts = setup.axes["u1"]
        drive = dataclasses.replace(parts.drive, dead_time=dead_time)
        setup = dataclasses.replace(setup, axes={**setup.axes, "u1": dataclasses.replace(parts, drive=drive)})
        return respond(setup, "u1", *wave(500)).position

    for kind in ("cascade", "first_order"):
        at, step = response(0.0, kind), 1e-6
        above, below = response(step, kind) - at, at - response(-step, kind)
        assert np.abs(above - below).max() < 1e-2 * np.abs(above).max()


def test_a_setpoint_that_starts_at_speed_is_that_of_the_step_loop():
    overrides = "velocity_feed_forward=1.0 setpoint_delay=0.0013 equivalent_delay=0.0008 position_derivative_time=0.002"
    setup = load_setup("tripod", [f"drive.{override}" for override in overrides.split()])
    ramp = START + 0.1 * T * np.arange(500)
    assert_equal_to_the_step_loop(setup, "u1", (ramp, np.full(500, 0.1), np.zeros(500)))


def test_many_lines_are_each_as_alone_whatever_their_shape():
    setup = load_setup("tripod")
    cases = [wave(n, START + 0.01 * n / 500, 0.03) for n in (500, 501, 502, 503, 504, 505)]
    lines = [np.array([case[part][:500] for case in cases]).reshape(2, 3, 500) for part in range(3)]
    response = respond(setup, "u1", *lines)
    assert all(part.shape == (2, 3, 500) for part in response)
    for index in np.ndindex(2, 3):
        alone = respond(setup, "u1", *(part[index] for part in lines))
        for together, single in zip(response, alone, strict=True):
            assert together[index] == pytest.approx(single, abs=1e-15)


@pytest.mark.parametrize("cycles", [0, 1, 2, 31, 32, 33, 65])
def test_any_length_is_taken(cycles):
    whole = respond(load_setup("tripod"), "u1", *wave(200))
    part = respond(load_setup("tripod"), "u1", *(values[:cycles] for values in wave(200)))
    for short, long in zip(part, whole, strict=True):
        assert short == pytest.approx(long[:cycles], abs=1e-16)


def test_more_series_than_are_advanced_together_are_each_as_alone():
    setup = load_setup("tripod")
    cases = [wave(100, START + 1e-4 * index, 0.03) for index in range(130)]
    response = respond(setup, "u1", *np.stack(cases, axis=1))
    for index in (0, 63, 64, 129):
        assert response.position[index] == pytest.approx(respond(setup, "u1", *cases[index]).position, abs=1e-15)


def test_an_axis_at_rest_stays_exactly_there():
    rest = np.full((2, 300), 0.123)
    response = respond(load_setup("tripod"), "u1", rest, 0.0 * rest, 0.0 * rest)
    assert np.array_equal(response.position, rest)
    assert not response.velocity.any()
    assert not response.tracking_error.any()


def test_a_setup_that_is_not_linear_is_refused_by_parameter():
    setup = load_setup("tripod", ["u2.scale.resolution=1.0e-6"])
    with pytest.raises(InputError, match=r"u2\.scale\.resolution: 1e-06 m"):
        linear(setup)
    with pytest.raises(InputError, match=r"u2\.scale\.resolution"):
        respond(setup, "u1", *wave(10))


def test_what_is_imperfect_is_refused_by_parameter_also_beside_a_dead_time():
    linear(load_setup("tripod", ["drive.dead_time=0.001"]))
    with pytest.raises(InputError, match=r"u3: screw\.backlash makes the axis imperfect"):
        linear(load_setup("tripod", ["drive.dead_time=0.001", "u3.screw.backlash=1.0e-6"]))


def test_a_velocity_limit_is_refused_by_parameter():
    with pytest.raises(InputError, match=r"u1\.drive\.velocity_limit: 0\.5 m/s"):
        linear(load_setup("tripod", ["u1.drive.velocity_limit=0.5"]))


def test_bad_setpoints_are_refused_in_one_line():
    setup = load_setup("tripod")
    position, velocity, acceleration = wave(10)
    with pytest.raises(InputError, match="axis 'u7' is unknown; tripod has u1, u2, u3"):
        respond(setup, "u7", position, velocity, acceleration)
    with pytest.raises(InputError, match=r"u1: setpoints of shapes .*\(9,\)"):
        respond(setup, "u1", position, velocity[:9], acceleration)
    velocity[3] = np.inf
    with pytest.raises(InputError, match="u1: velocity setpoint inf is not a finite number"):
        respond(setup, "u1", position, velocity, acceleration)


def test_a_following_error_over_its_limit_is_the_fault_of_the_step_loop():
    position = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.525]])
    with pytest.raises(MachineFault, match=r"cycle 2 of series \[1\]: u1: following error 25 mm .* limit of 20 mm"):
        respond(load_setup("tripod"), "u1", position, 0.0 * position, 0.0 * position)
    with pytest.raises(MachineFault, match=r"cycle 2: u1: following error 25 mm"):
        respond(load_setup("tripod"), "u1", position[1], 0.0 * position[1], 0.0 * position[1])


def test_an_unstable_drive_is_a_following_error_and_no_warning():
    setup = load_setup("tripod", ["drive.kv=5000"])
    times = np.arange(3000) * setup.servo_period
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(MachineFault, match="following error"):
            respond(setup, "u1", 0.05 * times, np.full_like(times, 0.05), np.zeros_like(times))
