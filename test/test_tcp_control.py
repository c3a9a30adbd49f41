"""Controllers that look at the TCP, against what the theory of equal first-order drives says of them."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import Program
from pkm_cnc.records import AxisSetpoint, TcpSetpoint
from pkm_cnc.simulation import simulated_cycles
from pkm_cnc.tcp_control import LaggingPlace

CORNERS = "G1 X60 Y20 F9000\nX0 Y0\nG2 X0 Y0 I30 J0 F6000\nG1 Z-20 X10\nM2\n"
LINE = "G1 X-100 Y-30 F6000\nX100 Y30\nM2\n"
IDEAL = "drive.kind=first_order"


def cycles(program, *overrides, machine="tripod"):
    setup = load_setup(machine, overrides)
    return list(simulated_cycles(setup, prepare(setup, Program("test.ngc", program))))


def worst(done):
    return max(cycle.error.magnitude for cycle in done)


def middle(done, segment):
    """Largest contour error on the middle half of a segment, m."""
    own = [cycle.error for cycle in done if cycle.error.segment == segment]
    low, high = own[0].path_length, own[-1].path_length
    quarter = 0.25 * (high - low)
    return max(error.magnitude for error in own if low + quarter < error.path_length < high - quarter)


@pytest.mark.parametrize("machine", ["tripod", "bipod", "cartesian"])
def test_with_an_ideal_velocity_loop_the_adapted_gain_leaves_no_contour_error(machine):
    """On lines, arcs and in the corners between them, where ordinary drives cut a millimetre off."""
    program = CORNERS if machine != "bipod" else "G1 X20 Y-20 F9000\nX0 Y0\nG2 X0 Y0 I15 J0 F6000\nM2\n"
    alone, adapted = (
        cycles(program, IDEAL, *extra, machine=machine) for extra in ([], ["tcp_control.adapted_gain=true"])
    )
    assert worst(alone) > 5e-4
    assert worst(adapted) < 1e-9


def test_unequal_gains_are_adapted_too():
    """The slowest decides how far the TCP lags."""
    kv = ["u1.drive.kv=15", "u2.drive.kv=20", "u3.drive.kv=23"]
    assert worst(cycles(CORNERS, IDEAL, *kv, "tcp_control.adapted_gain=true")) < 1e-9


def test_the_tcp_lags_by_speed_over_kv():
    done = cycles(LINE, IDEAL, "tcp_control.adapted_gain=true")
    steady = [cycle for cycle in done if cycle.setpoint.segment == 1 and 0.25 < cycle.setpoint.path_length < 0.3]
    lags = [cycle.setpoint.path_length - cycle.error.path_length for cycle in steady]
    assert lags == pytest.approx([0.1 / 20.0] * 500, abs=1e-9)


@pytest.mark.parametrize("gain", [20.0, 60.0, 180.0])
def test_cross_coupling_divides_the_contour_error_of_a_line(gain):
    """A first-order loop of gain Kv along and Kv + K across: the same disturbance leaves Kv / (Kv + K) of it."""
    alone, coupled = cycles(LINE, IDEAL), cycles(LINE, IDEAL, f"tcp_control.cross_coupling={gain}")
    assert middle(coupled, 1) / middle(alone, 1) == pytest.approx(20.0 / (20.0 + gain), rel=0.01)


def test_cross_coupling_keeps_corners_stable():
    """The nearest point of the contour would be one behind the corner too soon, and the error grow with the gain."""
    assert worst(cycles(CORNERS, "tcp_control.cross_coupling=300")) < worst(cycles(CORNERS))


def test_direct_feedback_closes_the_loop_at_the_tcp():
    """A strut that is longer than the controller knows shows with scales, not with a measuring system at the TCP."""
    geometry = "actual.geometry.strut_length_error=[0.0002, 0, 0]"
    alone = cycles(LINE, IDEAL, geometry)
    closed = cycles(LINE, IDEAL, geometry, "tcp_control.direct_feedback=true")
    assert middle(alone, 1) > 1e-4
    assert middle(closed, 1) < 2e-6
    assert math.dist(closed[-1].setpoint[:3], closed[-1].tcp[3:6]) < 40e-6


def test_off_means_no_controller():
    assert all(cycle.corrections == [None] * 3 for cycle in cycles("G1 X1 F1000\nM2\n"))


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        (["tcp_control.adapted_gain=true", "drive.velocity_feed_forward=1"], "not together with drive.velocity_feed"),
        (["tcp_control.adapted_gain=true", "tcp_control.direct_feedback=true"], "not together with tcp_control.direct"),
        (["tcp_control.cross_coupling=990"], "1010 1/s, more than 1 / servo_period = 1000 1/s"),
        (["tcp_control.cross_coupling=-1"], "tcp_control.cross_coupling: -1.0 1/s is below"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides, says):
    with pytest.raises(InputError, match=says):
        load_setup("tripod", overrides)


@settings(derandomize=True, max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 0.3), st.integers(1, 40)), min_size=1, max_size=6),
    st.floats(1.0, 100.0),
)
def test_the_lagging_place_is_a_first_order_lag_on_the_path(speeds, kv):
    """Any speeds along a circle: the place is on it, and where a lag of the path length puts it."""
    period, radius = 0.001, 0.05
    s, lag = 0.0, 0.0
    place = LaggingPlace(kv, period)
    given_speeds = itertools.chain.from_iterable([speed] * count for speed, count in speeds)
    for speed in itertools.chain([0.0], given_speeds):
        s += period * speed
        angle = s / radius
        x, y, vx, vy = math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle)
        tcp = TcpSetpoint(radius * x, radius * y, 0.0, speed * vx, speed * vy, 0.0, *(0.0,) * 6, 0)
        here, _ = place.step(tcp, [AxisSetpoint(radius * x, speed * vx, 0.0)])
        assert np.hypot(*here.tcp[:2]) == pytest.approx(radius, abs=2e-9)
        assert here.joints[0] == pytest.approx(here.tcp[0], abs=1e-15)
        assert math.atan2(here.tcp[1], here.tcp[0]) % math.tau * radius == pytest.approx(lag, abs=1e-6)
        lag += kv * period * (s - lag)
