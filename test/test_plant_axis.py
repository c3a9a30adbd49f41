"""The axis plant alone and in its sampled position loop, against exact arithmetic and scipy's own discrete systems."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import pkm_cnc.plant
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.parameters import parameters_of, read_section
from pkm_cnc.plant import AxisPlant, ScaleParameters, ScrewParameters, TravelParameters
from pkm_cnc.plant.velocity_loop import exact_discretisation
from pkm_cnc.records import STATUS_NORMAL, STATUS_TRAVEL_END, AxisCommand, AxisSetpoint, AxisState
from pkm_cnc.servo import DriveParameters, ServoDrive, cascade_state_space, impulse_response, position_loop

T = 1e-3
KV = 20.0


def make_plant(kind="cascade", start=0.5, resolution=0.0, travel=None, period=T):
    return AxisPlant(
        DriveParameters(kind=kind),
        ScrewParameters(),
        ScaleParameters(resolution),
        travel or TravelParameters(),
        period,
        start,
    )


def hold(plant, velocity):
    return plant.step(AxisCommand(velocity, 0.0))


def run_loop(kind, setpoints, start=0.5, resolution=0.0):
    """The states at t_0.. of the sampled loop that is given `setpoints`, and its tracking errors."""
    plant, drive = make_plant(kind, start, resolution), ServoDrive(DriveParameters(kind=kind), T)
    states, errors = [], []
    for position in setpoints:
        states.append(plant.state)
        command = drive.step(AxisSetpoint(position, 0.0, 0.0), plant.state)
        errors.append(command.tracking_error)
        plant.step(command)
    return states, np.array(errors)


def sampled_step(kind, cycles):
    """Positions after a setpoint step of 10 mm in cycle 0, as a fraction of the step."""
    states, _ = run_loop(kind, [0.510] * cycles)
    return (np.array([state.slider_position for state in states]) - 0.5) / 0.010


def half_variance(times, impulse):
    mass = np.sum(impulse)
    mean = np.sum(impulse * times) / mass
    return 0.5 * (np.sum(impulse * times**2) / mass - mean**2)


# ---- the matrix exponential


def exact_exponential(matrix):
    """exp of a small matrix of floats by its Taylor series in 400-bit fixed point."""
    one = 1 << 400
    size = range(len(matrix))
    fixed = [[int(Fraction(float(value)) * one) for value in row] for row in matrix]
    columns = []
    for j in size:
        term = [one if i == j else 0 for i in size]
        total = list(term)
        for k in range(1, 300):
            term = [sum(fixed[i][m] * term[m] for m in size) // (one * k) for i in size]
            total = [t + d for t, d in zip(total, term, strict=True)]
        columns.append([float(Fraction(t, one)) for t in total])
    return np.array(columns).T


@pytest.mark.parametrize("period", [1e-4, 1e-3, 4e-3])
def test_the_discretisation_is_exact_in_every_element(period):
    system = cascade_state_space(DriveParameters(), 0.010)
    augmented = np.zeros((6, 6))
    augmented[:5, :5], augmented[:5, 5] = system
    exact = exact_exponential(augmented * period)
    a, b = exact_discretisation(system, period)
    assert a == pytest.approx(exact[:5, :5], rel=2e-14, abs=1e-18)
    assert b == pytest.approx(exact[:5, 5], rel=2e-14, abs=0.0)


def test_two_half_periods_are_one_period():
    whole, halves = make_plant(), make_plant(period=T / 2)
    for velocity in (0.1, -0.3, 0.2, 0.2, 0.0):
        expected = hold(whole, velocity)
        hold(halves, velocity)
        assert hold(halves, velocity) == pytest.approx(expected, rel=1e-12, abs=1e-12)


# ---- the plant alone


def test_the_plant_starts_at_rest_and_stays_there():
    plant = make_plant(start=0.478)
    assert plant.state == AxisState(0.478, 0.478, 0.0, 0.0, 0.0, 0.0, STATUS_NORMAL)
    for _ in range(1000):
        hold(plant, 0.0)
    assert plant.state == AxisState(0.478, 0.478, 0.0, 0.0, 0.0, 0.0, STATUS_NORMAL)


def test_motor_screw_and_slider_agree():
    plant = make_plant()
    states = [plant.state] + [hold(plant, 0.1) for _ in range(200)]
    for state in states:
        assert state.slider_velocity == pytest.approx(state.motor_speed * 0.010 / (2.0 * math.pi), rel=1e-15)
        assert state.torque == pytest.approx(0.77 * state.current, rel=1e-15)
        assert state.position == state.slider_position
    assert states[-1].motor_speed == pytest.approx(2.0 * math.pi * 10.0, rel=1e-5)  # 0.1 m/s on 10 mm/rev
    # the torque accelerates the inertia: its time integral, by the trapezoidal rule, is the angular momentum
    fine = make_plant(period=1e-5)
    fine_states = [fine.state] + [hold(fine, 0.1) for _ in range(1000)]
    impulse = 1e-5 * (sum(state.torque for state in fine_states) - 0.5 * fine_states[-1].torque)
    assert impulse == pytest.approx(0.0087 * fine_states[-1].motor_speed, rel=1e-4)


def test_the_first_order_plant_moves_at_the_commanded_velocity_and_has_no_motor():
    plant = make_plant("first_order")
    state = hold(plant, 0.25)
    assert state.slider_position == pytest.approx(0.5 + 0.25 * T, rel=1e-15)
    assert state.slider_velocity == 0.25
    assert all(math.isnan(value) for value in (state.motor_speed, state.current, state.torque))
    assert math.isnan(make_plant("first_order").state.torque)


def test_a_long_run_at_constant_speed_does_not_drift():
    plant, velocity, cycles = make_plant("first_order", 0.3), 1.0 / 3000.0, 1_000_000
    command = AxisCommand(velocity, 0.0)
    for _ in range(cycles):
        plant.step(command)
    exact = Fraction(0.3) + cycles * Fraction(T * velocity)
    assert abs(float(Fraction(plant.state.slider_position) - exact)) <= 6e-17  # half a rounding error of 0.63


def test_a_long_run_of_the_cascade_does_not_drift_from_the_analytic_motion():
    plant, velocity, cycles = make_plant(start=0.1), 0.002, 200_000
    command = AxisCommand(velocity, 0.0)
    for _ in range(cycles):
        plant.step(command)
    numerator, denominator = (np.array(p) for p in position_loop(DriveParameters()))
    denominator[3:] -= numerator  # the position loop opened, one s cancelled: speed over command
    speed_loop = denominator[:5]
    roots = np.roots(speed_loop)
    residues = np.polyval(numerator / KV, roots) / np.polyval(np.polyder(speed_loop), roots)
    time = cycles * T
    displacement = velocity * np.sum(residues / roots**2 * (np.expm1(roots * time) - roots * time)).real
    assert abs(plant.state.slider_position - 0.1 - displacement) < 1e-12


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_velocity_command_that_is_not_finite_is_a_fault(value):
    with pytest.raises(MachineFault, match="velocity command"):
        hold(make_plant(), value)


def test_two_plants_with_the_same_commands_agree_to_the_bit():
    rng = np.random.default_rng(3)
    first, second = make_plant(resolution=1e-6), make_plant(resolution=1e-6)
    for velocity in rng.normal(0.0, 0.1, 500).tolist():
        assert hold(first, velocity) == hold(second, velocity)


# ---- scale and travel


@settings(derandomize=True)
@given(start=st.floats(0.001, 0.999), resolution=st.sampled_from([1e-7, 1e-6, 5e-6, 1e-3]))
def test_the_scale_reads_the_nearest_multiple_of_its_resolution(start, resolution):
    state = make_plant(start=start, resolution=resolution).state
    assert state.slider_position == start
    assert abs(state.position - start) <= 0.5 * resolution * (1.0 + 1e-9)
    assert state.position / resolution == pytest.approx(round(state.position / resolution), abs=1e-8)


def test_the_scale_reads_a_tie_upwards_on_both_sides_of_zero():
    travel = TravelParameters(-1.0, 1.0)
    assert make_plant(start=0.375, resolution=0.25, travel=travel).state.position == 0.5
    assert make_plant(start=-0.375, resolution=0.25, travel=travel).state.position == -0.25


def test_a_quantised_loop_comes_to_rest_within_a_resolution():
    states, errors = run_loop("cascade", [0.5101234] * 1500, resolution=1e-5)
    assert abs(errors[-1]) < 1e-5
    assert states[-1].position != states[-1].slider_position
    assert abs(states[-1].position - states[-1].slider_position) <= 0.5e-5 * (1.0 + 1e-9)


@pytest.mark.parametrize(("start", "velocity"), [(0.4375, -0.5), (0.5625, 0.5)])
def test_the_status_reports_the_slider_at_and_beyond_an_end_of_travel(start, velocity):
    travel = TravelParameters(0.4375, 0.5625)
    plant = make_plant("first_order", start, travel=travel)
    assert plant.state.status == STATUS_TRAVEL_END
    assert hold(plant, velocity).status == STATUS_TRAVEL_END
    for _ in range(2):
        state = hold(plant, -velocity)
    assert state.status == STATUS_NORMAL


@pytest.mark.parametrize("start", [-0.001, 1.001, math.nan])
def test_a_start_outside_the_travel_is_refused(start):
    with pytest.raises(InputError, match=r"start position .* mm .*0 to 1000 mm"):
        make_plant(start=start)


def test_bad_mechanical_parameters_are_refused_by_key():
    with pytest.raises(InputError, match=r"^travel\.minimum: 0\.6 m is not below the maximum of 0\.5 m"):
        read_section(TravelParameters, {"minimum": 0.6, "maximum": 0.5}, "travel.")
    with pytest.raises(InputError, match=r"u2\.screw\.pitch"):
        read_section(ScrewParameters, {"pitch": 0.0}, "u2.screw.")
    with pytest.raises(InputError, match=r"scale\.resolution"):
        read_section(ScaleParameters, {"resolution": -1e-6}, "scale.")


# ---- the sampled position loop


def test_the_sampled_step_has_no_overshoot_and_reaches_half_after_0_0356_s():
    response = sampled_step("cascade", 2000)
    assert response.max() < 1.0 + 1e-9
    assert np.all(np.diff(response) > -1e-12)
    since_first_new_setpoint = np.interp(0.5, response[:100], np.arange(100) * T)
    assert since_first_new_setpoint == pytest.approx(0.0346, abs=5e-5)
    assert since_first_new_setpoint + T == pytest.approx(0.0356, abs=5e-5)  # since the last old setpoint


@pytest.mark.parametrize("kind", ["cascade", "first_order"])
def test_the_sampled_loop_lags_behind_a_ramp_by_1_over_kv(kind):
    speed = 0.1
    states, errors = run_loop(kind, 0.3 + speed * T * np.arange(2001), start=0.3)
    assert errors[-1] == pytest.approx(speed / KV, rel=2e-6)
    assert states[-1].slider_velocity == pytest.approx(speed, rel=1e-6)


def test_the_sampled_loop_is_scipys_discrete_system():
    numerator, denominator = (np.array(p) for p in position_loop(DriveParameters()))
    denominator[3:] -= numerator
    denominator[5] = 0.0
    a, b, c, d = signal.tf2ss(numerator / KV, denominator)  # slider position over velocity command
    a, b, c, d, _ = signal.cont2discrete((a, b, c, d), T, method="zoh")
    closed = (a - KV * b @ c, KV * b, c, d, T)
    setpoints = 0.010 * np.sin(np.arange(3000) * T * 7.0) + 0.004 * (np.arange(3000) > 400)
    _, expected, _ = signal.dlsim(closed, setpoints)
    states, _ = run_loop("cascade", 0.5 + setpoints)
    assert np.array([s.slider_position for s in states]) - 0.5 == pytest.approx(expected[:, 0], abs=1e-12)


def test_kappa_of_the_first_order_loop_is_that_of_theory():
    impulse = np.diff(sampled_step("first_order", 2500))  # the response to a unit pulse in cycle 0, from cycle 1
    times = np.arange(1, 2500) * T
    assert half_variance(times, impulse) == pytest.approx((1.0 - KV * T) / (2.0 * KV**2), rel=1e-9)


def test_kappa_of_the_default_loop_is_the_continuous_one_less_what_sampling_takes():
    impulse = np.diff(sampled_step("cascade", 2500))
    times = np.arange(1, 2500) * T
    fine = np.linspace(0.0, 2.5, 250_001)
    continuous = half_variance(fine, impulse_response(position_loop(DriveParameters()), fine))
    assert continuous == pytest.approx(0.0012089, abs=5e-8)
    sampled = half_variance(times, impulse)
    assert sampled == pytest.approx(0.0011839, abs=5e-8)
    assert sampled == pytest.approx(continuous - T / (2.0 * KV), rel=1e-4)


def test_a_setpoint_that_jumps_trips_the_supervision():
    with pytest.raises(MachineFault, match="following error 25 mm"):
        run_loop("cascade", [0.5, 0.5, 0.525])


def test_the_door_opens_to_documented_names_and_parameters():
    for name in pkm_cnc.plant.__all__:
        assert getattr(pkm_cnc.plant, name).__doc__
    for section in (ScrewParameters, ScaleParameters, TravelParameters):
        assert all(spec.doc and spec.unit for spec in parameters_of(section))
