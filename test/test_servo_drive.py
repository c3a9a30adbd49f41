"""The position controller, its supervision, the parameters of a drive and the door of the room."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pkm_cnc.servo
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.parameters import parameters_of, read_section
from pkm_cnc.records import STATUS_NORMAL, AxisSetpoint, AxisState
from pkm_cnc.servo import DriveParameters, ServoDrive

T = 1e-3


def setpoint(position):
    return AxisSetpoint(position, 0.0, 0.0)


def actual(position, slider_position=0.0):
    return AxisState(position, slider_position, 0.0, math.nan, math.nan, math.nan, STATUS_NORMAL)


@settings(derandomize=True)
@given(
    kv=st.floats(0.1, 100.0),
    commanded=st.floats(-1.0, 1.0),
    error=st.floats(-0.019, 0.019),
)
def test_the_velocity_command_is_kv_times_the_tracking_error(kv, commanded, error):
    command = ServoDrive(DriveParameters(kv=kv), T).step(setpoint(commanded), actual(commanded - error))
    assert command.tracking_error == commanded - (commanded - error)
    assert command.velocity == pytest.approx(kv * command.tracking_error, rel=1e-15)


def test_the_drive_closes_its_loop_on_the_scale_and_not_on_the_slider():
    command = ServoDrive(DriveParameters(), T).step(setpoint(0.5), actual(0.499, slider_position=0.3))
    assert command.velocity == pytest.approx(20.0 * 0.001)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_following_error_at_its_limit_passes_and_one_over_it_is_a_fault_in_mm(side):
    drive = ServoDrive(DriveParameters(following_error_limit=0.25), T)
    assert drive.step(setpoint(0.25 * side), actual(0.0)).tracking_error == 0.25 * side
    with pytest.raises(MachineFault) as fault:
        drive.step(setpoint(0.2505 * side), actual(0.0))
    message = str(fault.value)
    assert f"{250.5 * side:g} mm" in message
    assert "limit of 250 mm" in message
    assert "drive.following_error_limit" in message
    assert "\n" not in message


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_position_that_is_not_finite_is_a_fault_that_says_which(value):
    drive = ServoDrive(DriveParameters(), T)
    with pytest.raises(MachineFault, match="scale value"):
        drive.step(setpoint(0.5), actual(value))
    with pytest.raises(MachineFault, match="setpoint"):
        drive.step(setpoint(value), actual(0.5))


def test_the_default_limit_is_twice_the_lag_of_the_fastest_ordinary_motion():
    radius = 0.513 - 0.150 + 0.100  # of the strut's foot from its drive's axis, TCP 100 mm away from the drive
    slope = radius / math.sqrt(0.600**2 - radius**2)
    lag = slope * 9.0 / 60.0 / DriveParameters().kv
    assert lag == pytest.approx(0.0091, abs=5e-5)
    assert 2.0 < DriveParameters().following_error_limit / lag < 2.5


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("kv", 0.0, "not above 0.0 1/s"),
        ("kv", -1.0, "not above 0.0 1/s"),
        ("kind", "cascaded", "not one of cascade, first_order"),
        ("velocity_integral", -1e-9, "below its minimum"),
        ("inertia", math.nan, "not a finite number"),
        ("resistance", "low", "not a number"),
        ("Kv", 20.0, "unknown parameter"),
        ("velocity_feed_forward", -0.1, "below its minimum"),
        ("setpoint_delay", 0.2, "over its maximum 0.1 s"),
        ("position_form", "pid", "not one of ideal, parallel, serial"),
        ("position_derivative_filter", 0.0, "not above 0.0 s"),
        ("velocity_limit", math.inf, "not a finite number"),
    ],
)
def test_a_bad_drive_parameter_is_refused_with_its_key(key, value, reason):
    with pytest.raises(InputError, match=reason) as refused:
        read_section(DriveParameters, {key: value}, "u1.drive.")
    assert f"u1.drive.{key}" in str(refused.value)


def test_an_integral_time_that_is_a_slip_for_none_is_refused():
    with pytest.raises(InputError, match=r"^position_integral_time: 1e-09 is below 1e-06; 0 is no integral action"):
        DriveParameters(position_integral_time=1e-9)


def test_every_parameter_of_a_drive_says_what_it_is():
    for spec in parameters_of(DriveParameters):
        assert spec.doc
        assert spec.unit or spec.choices


def test_the_door_opens_to_documented_names():
    for name in pkm_cnc.servo.__all__:
        assert getattr(pkm_cnc.servo, name).__doc__
