"""The imperfect axis against textbook signatures, closed forms and an independent integration."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pkm_cnc.errors import InputError
from pkm_cnc.plant import (
    AxisParts,
    AxisPlant,
    DisturbanceParameters,
    FrictionParameters,
    ImperfectAxis,
    LinearScale,
    ScaleParameters,
    ScrewParameters,
    SliderParameters,
    TravelParameters,
)
from pkm_cnc.records import AxisCommand
from pkm_cnc.servo import DriveParameters

T = 0.001
TURN = 0.010 / math.tau
HELD_CURRENT = 15.0 / (15.0 + 1.45)
"""What of its command the current controller holds against the winding's resistance, but for its slow integral part."""
SECTIONS = {
    "drive": DriveParameters,
    "screw": ScrewParameters,
    "slider": SliderParameters,
    "friction": FrictionParameters,
    "disturbance": DisturbanceParameters,
    "scale": ScaleParameters,
    "travel": TravelParameters,
}


def parts(**given):
    """Axis parts; `given` are sections by name, each a dict."""
    return AxisParts(**{name: kind(**given.get(name, {})) for name, kind in SECTIONS.items()})


def axis(steps=10, load=0.0, **given):
    return ImperfectAxis("u1", parts(**given), T, steps, 0.5, load)


def run(plant, commands, load=0.0):
    """Slider positions from the start on, and the last state."""
    positions = [plant.state.slider_position]
    for velocity in commands:
        plant.step(AxisCommand(velocity, 0.0), load)
        positions.append(plant.state.slider_position)
    return np.array(positions), plant.state


def ideal(commands):
    drive = DriveParameters()
    return run(AxisPlant(drive, ScrewParameters(), ScaleParameters(), TravelParameters(), T, 0.5), commands)


def test_without_effects_it_is_the_ideal_axis():
    """However many steps: the linear system is solved exactly."""
    commands = [0.1 * math.sin(0.02 * k) for k in range(300)]
    for steps in (1, 7):
        assert np.abs(run(axis(steps), commands)[0] - ideal(commands)[0]).max() < 1e-13


def test_viscous_friction_and_back_emf_agree_with_an_independent_integration():
    drive = {"back_emf": 0.77}
    commands = [0.1] * 40 + [-0.05] * 40
    mine, _ = run(axis(1, drive=drive, friction={"viscous": 3000.0}), commands)
    d = DriveParameters(**drive)

    def rates(t, x):
        integral, inner, current, speed, _ = x
        error = commands[min(int(t / T), 79)] / TURN - speed
        wanted = d.velocity_gain * error + integral
        voltage = d.current_gain * (wanted - current) + inner
        return [
            d.velocity_integral * error,
            d.current_integral * (wanted - current),
            (voltage - d.resistance * current - d.back_emf * speed) / d.inductance,
            (d.torque_constant * current - TURN * 3000.0 * TURN * speed) / d.inertia,
            TURN * speed,
        ]

    x = np.array([0.0, 0.0, 0.0, 0.0, 0.5])
    theirs = [0.5]
    for k in range(80):  # from tick to tick: the command jumps there
        x = solve_ivp(rates, (k * T, (k + 1) * T * (1 - 1e-12)), x, rtol=1e-11, atol=1e-13).y[:, -1]
        theirs.append(x[4])
    assert mine == pytest.approx(theirs, abs=1e-9)


def test_coulomb_friction_asks_for_its_torque_at_any_speed():
    """At a steady speed the current is that of the friction force, F pitch / 2 pi / K_m."""
    for speed in (0.01, 0.1, -0.1):
        _, state = run(axis(friction={"coulomb": 300.0}), [speed] * 400)
        assert state.torque == pytest.approx(math.copysign(300.0 * TURN, speed), rel=1e-4)


def test_the_stribeck_curve_falls_from_static_to_kinetic_friction():
    friction = {"coulomb": 200.0, "static": 500.0, "stribeck_velocity": 0.01}
    for speed in (0.001, 0.01, 0.1):
        _, state = run(axis(100, friction=friction), [speed] * 600)
        force = 200.0 + 300.0 * math.exp(-((state.slider_velocity / 0.01) ** 2))
        assert state.slider_velocity == pytest.approx(speed, rel=0.15)
        assert state.torque == pytest.approx(force * TURN, rel=1e-3)


def test_a_stuck_slider_stands_still_until_the_static_friction_is_overcome():
    plant = axis(friction={"coulomb": 300.0, "static": 400.0})
    below = 0.9 * 400.0 * TURN / (HELD_CURRENT * DriveParameters().velocity_gain * 0.77 / TURN)  # 90 % of breakaway
    positions, state = run(plant, [below] * 200)
    assert np.all(positions == 0.5)
    assert (state.slider_velocity, state.motor_speed) == (0.0, 0.0)
    positions, _ = run(plant, [1.2 * below] * 200)
    assert positions[-1] > 0.5 + 1e-9


def test_steps_converge():
    """Halving the steps halves what friction, backlash and limits are wrong by, or better."""
    effects = {
        "friction": {"coulomb": 200.0, "static": 300.0},
        "screw": {"backlash": 5e-6, "stiffness": 1e8, "damping": 2e4},
        "slider": {"mass": 60.0},
    }
    commands = [0.05 * math.sin(0.03 * k) for k in range(400)]
    fine, _ = run(axis(320, **effects), commands)
    errors = [np.abs(run(axis(steps, **effects), commands)[0] - fine).max() for steps in (10, 20, 40)]
    assert errors[0] < 1e-6
    assert errors[2] < 0.6 * errors[0]


@pytest.mark.parametrize("stiffness", [0.0, 2e8])
def test_backlash_is_lost_motion_at_a_reversal(stiffness):
    """Against an axis without, the slider is half of it behind on the way there, and on the way back."""
    screw, viscous = {"stiffness": stiffness, "damping": 2e4}, {"viscous": 2000.0}
    commands = [0.05] * 200 + [-0.05] * 200
    tight, _ = run(axis(screw=screw, slider={"mass": 50.0}, friction=viscous), commands)
    loose, _ = run(axis(screw={**screw, "backlash": 20e-6}, slider={"mass": 50.0}, friction=viscous), commands)
    assert (loose - tight)[190] == pytest.approx(-10e-6, abs=0.2e-6)
    assert (loose - tight)[390] == pytest.approx(10e-6, abs=0.2e-6)


def test_compliance_rings_at_its_frequency():
    """Motor held by its loop, the slider on the screw is a spring and a mass: sqrt(k / m)."""
    stiffness, mass = 4e6, 40.0
    plant = axis(screw={"stiffness": stiffness}, slider={"mass": mass})
    positions, _ = run(plant, [0.1] * 3 + [0.0] * 400)
    ringing = positions[100:] - positions[100:].mean()
    spectrum = np.abs(np.fft.rfft(ringing * np.hanning(len(ringing)), 1 << 15))
    found = np.argmax(spectrum) / (1 << 15) / T
    assert found == pytest.approx(math.sqrt(stiffness / mass) / math.tau, rel=0.02)


def test_a_force_strains_the_screw_by_force_over_stiffness():
    plant = axis(screw={"stiffness": 1e8, "damping": 1e5}, slider={"mass": 50.0})
    run(plant, [0.0] * 50, load=-500.0)
    motor = plant._x[4]
    assert plant.state.slider_position - motor == pytest.approx(-500.0 / 1e8, rel=1e-3)


def test_weight_is_held_from_the_start():
    """At rest nothing moves, and the torque is that of the weight."""
    plant = axis(slider={"mass": 80.0, "incline": math.pi / 2})
    positions, state = run(plant, [0.0] * 100)
    assert np.abs(positions - 0.5).max() < 1e-15
    assert state.torque == pytest.approx(80.0 * 9.80665 * TURN, rel=1e-12)


def test_pitch_error_is_added_to_the_screws_travel():
    screw = {"error_positions": (0.4, 0.5, 0.6), "pitch_error": (0.0, 0.0, 50e-6)}
    commands = [0.05] * 1000 + [0.0] * 100
    with_error, without = run(axis(screw=screw), commands)[0][-1], ideal(commands)[0][-1]
    assert with_error - without == pytest.approx((without - 0.5) / 0.1 * 50e-6, rel=1e-3)


def test_a_current_limit_bounds_the_acceleration():
    """K_m I / J of the motor, and no overshoot from a wound-up integrator."""
    plant = axis(drive={"current_limit": 5.0, "velocity_integral": 300.0})
    positions, state = run(plant, [0.2] * 60)
    speeds = np.diff(positions) / T
    expected = 0.77 * 5.0 * HELD_CURRENT / 0.0087 * TURN
    assert np.diff(speeds)[5:40] / T == pytest.approx([expected] * 35, rel=1e-3)
    speeds = np.diff(run(plant, [0.2] * 600)[0]) / T
    assert speeds.max() < 0.2 * 1.35
    assert abs(state.current) <= 5.001


def test_a_voltage_limit_bounds_the_speed_through_the_back_emf():
    """A motor spins up to where its back-EMF is the voltage: U / k_e, less what the friction takes."""
    plant = axis(drive={"voltage_limit": 40.0, "back_emf": 0.77})
    _, state = run(plant, [0.5] * 3000)
    assert state.motor_speed == pytest.approx(40.0 / 0.77, rel=1e-3)
    assert state.slider_velocity < 0.5


@pytest.mark.parametrize(
    ("limit", "given"),
    [
        ("current", {"drive": {"current_limit": 4.0, "velocity_integral": 300.0}, "friction": {"coulomb": 3000.0}}),
        ("voltage", {"drive": {"voltage_limit": 40.0, "back_emf": 0.77, "velocity_integral": 300.0}}),
    ],
)
def test_how_long_a_limit_was_reached_is_forgotten(limit, given):
    """Anti-windup: however long against a stuck slider or at the highest speed, the opposite command acts at once."""
    ends = []
    for cycles in (1000, 10_000):
        plant = axis(steps=2, **given)
        _, limited = run(plant, [0.5] * cycles)
        assert limited.current > 0.0
        ends.append(run(plant, [-0.05] * 100)[1])
    if limit == "current":
        assert [end.current for end in ends] == pytest.approx([-4.0 * HELD_CURRENT] * 2, rel=1e-2)
    else:
        assert [end.slider_velocity < 0.0 for end in ends] == [True, True]
        assert ends[1].slider_velocity == pytest.approx(ends[0].slider_velocity, rel=1e-4)


def test_dead_time_delays_the_command():
    """Whole periods shift the response; a fraction shifts it by as much, where the command changes little."""
    commands = [0.1 * math.sin(0.005 * k) for k in range(600)]
    whole, _ = run(axis(drive={"dead_time": 0.003}), commands)
    plain, _ = ideal(commands)
    assert whole[3:] == pytest.approx(plain[:-3], abs=1e-12)
    part, _ = run(axis(drive={"dead_time": 0.0016}), commands)
    times = np.arange(601) * T
    assert np.interp(times[50:] - 0.0016, times, plain) == pytest.approx(part[50:], abs=2e-7)


def test_cogging_ripples_with_the_motors_turns():
    plant = axis(disturbance={"cogging": 0.5, "cogging_periods": 7})
    positions, _ = run(plant, [0.01] * 4000)
    ripple = np.diff(positions)[1000:3000] / T - 0.01  # two turns of 10 mm
    spectrum = np.abs(np.fft.rfft(ripple - ripple.mean()))
    assert np.argmax(spectrum) == 7 * 2
    assert np.abs(ripple).max() > 1e-5


def test_scale_noise_is_normal_repeatable_and_of_its_own_for_each_axis():
    def readings(axis_name, seed=1):
        scale = LinearScale(ScaleParameters(noise=1e-6, seed=seed), axis_name)
        return np.array([scale.read(0.5) for _ in range(20_000)]) - 0.5

    first = readings("u1")
    assert np.array_equal(first, readings("u1"))
    assert first.mean() == pytest.approx(0.0, abs=3e-8)
    assert first.std() == pytest.approx(1e-6, rel=0.02)
    assert np.mean(np.abs(first) < 1.96e-6) == pytest.approx(0.95, abs=0.006)
    assert abs(np.corrcoef(first[:-1], first[1:])[0, 1]) < 0.03
    for other in (readings("u2"), readings("u1", seed=2)):
        assert abs(np.corrcoef(first, other)[0, 1]) < 0.03


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"drive": {"kind": "first_order"}}, "drive.kind: first_order has no motor"),
        ({"screw": {"stiffness": 1e8}}, "slider.mass: 0.0 kg|slider.mass: 0 kg"),
        ({"slider": {"mass": 4000.0}}, r"slider.mass: 4000.0 kg is 0.0101\d+ kg m\^2 at the shaft, not less"),
    ],
)
def test_what_does_not_go_together_is_refused(given, says):
    with pytest.raises(InputError, match=says):
        axis(**given)


@pytest.mark.parametrize(
    ("kind", "given", "says"),
    [
        (ScrewParameters, {"pitch_error": (0.0, 1e-6)}, "2 values for 1 error_positions"),
        (
            ScrewParameters,
            {"error_positions": (0.1, 0.1), "pitch_error": (0.0, 1e-6)},
            "error_positions: 0.1 m does not rise",
        ),
        (FrictionParameters, {"coulomb": 3.0, "static": 2.0}, "static: 2.0 N is below coulomb"),
    ],
)
def test_sections_refuse_what_is_no_axis(kind, given, says):
    with pytest.raises(InputError, match=says):
        kind(**given)
