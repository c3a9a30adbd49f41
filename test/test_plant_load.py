"""What all axes carry together, and that the controller knows nothing of what is imperfect."""

import math

import numpy as np
import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.plant import PlatformLoad
from pkm_cnc.program import Program
from pkm_cnc.records import AxisState
from pkm_cnc.simulation import simulated_cycles

T = 0.001
GRAVITY = 9.80665
IMPERFECT = {
    "drive": {"back_emf": 0.5, "current_limit": 4.0, "voltage_limit": 8.0, "dead_time": 0.0007},
    "screw": {"backlash": 1e-5},
    "slider": {"mass": 50.0, "incline": 1.5},
    "friction": {"coulomb": 200.0, "static": 300.0, "stribeck_velocity": 0.02, "viscous": 900.0},
    "disturbance": {"torque": 0.3, "cogging": 0.2, "cogging_periods": 11},
    "scale": {"resolution": 1e-6, "noise": 1e-6, "seed": 7},
    "load": {"mass": 30.0},
    "actual.tilt": {"about_y": 0.01, "about_x": 0.01, "lever": 0.1},
}


def states(joints, velocities):
    return [AxisState(u, u, v, 0.0, 0.0, 0.0, 0) for u, v in zip(joints, velocities, strict=True)]


def test_at_rest_the_sliders_carry_the_weight():
    """Lifting all sliders by dz lifts the platform by dz: the forces sum to the weight, alike on the axis."""
    machine = load_setup("tripod").machine
    for pose in ((0.0, 0.0, 0.0), (0.08, -0.05, 0.02)):
        forces = PlatformLoad(machine, 20.0, T).at_rest(machine.inverse(pose).tolist())
        assert sum(forces) == pytest.approx(-20.0 * GRAVITY, rel=1e-12)
    assert PlatformLoad(machine, 20.0, T).at_rest(machine.inverse((0.0, 0.0, 0.0)).tolist()) == pytest.approx(
        [-20.0 * GRAVITY / 3.0] * 3
    )


def test_a_moving_platform_is_felt_by_its_inertia_one_period_late_at_most():
    """Against inverse dynamics on a path known in closed form; the bound is that of the docstring."""
    machine, mass = load_setup("tripod").machine, 20.0
    load = PlatformLoad(machine, mass, T)
    radius, omega = 0.05, 12.0
    jerk, found, exact = radius * omega**3, [], []
    for k in range(400):
        t = k * T
        position = np.array([radius * math.cos(omega * t), radius * math.sin(omega * t), 0.0])
        velocity = omega * np.array([-position[1], position[0], 0.0])
        joints, speeds, _ = machine.motion(position, velocity, -(omega**2) * position)
        found.append(load.step(states(joints.tolist(), speeds.tolist())))
        force = mass * (omega**2 * position - np.array([0.0, 0.0, GRAVITY]))
        exact.append(machine.inverse_jacobian(position).T @ force)
    gain = max(np.abs(machine.inverse_jacobian((radius, 0.0, 0.0))).sum(axis=0))
    error = np.abs(np.array(found) - np.array(exact))[1:].max()
    assert 0.0 < error < mass * jerk * T * gain


def test_more_load_takes_more_torque():
    light, heavy = (
        [cycle.states[0].torque for cycle in run("load.mass=1", f"load.mass={mass}")] for mass in (10.0, 40.0)
    )
    assert np.mean(heavy) > 2.0 * np.mean(light) > 0.0


def run(*overrides):
    setup = load_setup("tripod", overrides)
    program = prepare(setup, Program("line.ngc", "G1 X2 Y1 F6000\nM2\n"))
    return list(simulated_cycles(setup, program))


@pytest.mark.parametrize("key", [f"{section}.{name}" for section, given in IMPERFECT.items() for name in given])
def test_the_controller_knows_nothing_of_what_is_imperfect(key):
    """Whatever changes in the plant: setpoints stay, and so does the first command, before any plant answered."""
    section, _, name = key.rpartition(".")
    others = [f"{section}.{other}={value}" for other, value in IMPERFECT[section].items() if other != name]
    changed = f"{key}={IMPERFECT[section][name]}"
    neutral = run(*others)
    other = run(*others, changed)
    assert any(a.tcp != b.tcp for a, b in zip(neutral, other, strict=False))
    for a, b in zip(neutral[:100], other[:100], strict=False):
        assert a.setpoint == b.setpoint
        assert a.axis_setpoints == b.axis_setpoints
    assert section == "scale" or neutral[0].commands == other[0].commands
