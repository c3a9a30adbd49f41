"""What all axes carry together, and that the controller knows nothing of what is imperfect."""

import math
from dataclasses import fields

import numpy as np
import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import TiltParameters, load_setup
from pkm_cnc.plant import (
    DisturbanceParameters,
    FrictionParameters,
    LoadParameters,
    PlantParameters,
    PlatformLoad,
    ScaleParameters,
    ScrewParameters,
    SliderParameters,
)
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
TOGETHER = {
    "screw.pitch=0.005": ["friction.viscous=900"],
    "screw.stiffness=5e7": ["slider.mass=50"],
    "screw.damping=1e5": ["slider.mass=50", "screw.stiffness=5e7"],
    "screw.pitch_error=[0.0, 0.001]": ["screw.pitch_error=[0.0, 0.0]", "screw.error_positions=[0.4, 0.6]"],
    "screw.error_positions=[0.3, 0.6]": ["screw.pitch_error=[0.0, 0.001]", "screw.error_positions=[0.4, 0.6]"],
    "plant.steps=3": ["friction.coulomb=200", "friction.static=300"],
    "actual.geometry.strut_length_error=[0.0001, 0.0, 0.0]": [],
}
"""Changes that need something else set beside them, or a neutral value that is not 0."""


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


def test_a_moving_platform_is_felt_by_its_inertia_late_by_one_and_a_half_periods_at_most():
    """Against inverse dynamics on a path known in closed form, all the time that a load is held."""
    machine, mass, radius, omega = load_setup("tripod").machine, 20.0, 0.05, 12.0
    load = PlatformLoad(machine, mass, T)

    def motion(t):
        position = np.array([radius * math.cos(omega * t), radius * math.sin(omega * t), 0.0])
        return position, omega * np.array([-position[1], position[0], 0.0]), -(omega**2) * position

    def at_the_tcp(t, forces):
        return np.linalg.solve(machine.inverse_jacobian(motion(t)[0]).T, forces)

    worst = 0.0
    for k in range(400):
        joints, speeds, _ = machine.motion(*motion(k * T))
        force = at_the_tcp(k * T, load.step(states(joints.tolist(), speeds.tolist())))
        for t in (k * T, (k + 0.5) * T, (k + 1) * T):
            exact = -mass * (motion(t)[2] + np.array([0.0, 0.0, GRAVITY]))
            worst = max(worst, float(np.linalg.norm(force - exact))) if k else 0.0
    jerk = radius * omega**3
    assert worst == pytest.approx(1.5 * mass * T * jerk, rel=1e-3)


def test_more_load_takes_more_torque():
    light, heavy = (
        [cycle.states[0].torque for cycle in run("load.mass=1", f"load.mass={mass}")] for mass in (10.0, 40.0)
    )
    assert np.mean(heavy) > 2.0 * np.mean(light) > 0.0


def run(*overrides):
    setup = load_setup("tripod", overrides)
    program = prepare(setup, Program("line.ngc", "G1 X2 Y1 F6000\nM2\n"))
    return list(simulated_cycles(setup, program))


def walked():
    """(key, change, what is set beside it) for every parameter of the plant."""
    for section, given in IMPERFECT.items():
        for name, value in given.items():
            beside = [f"{section}.{other}={set_to}" for other, set_to in given.items() if other != name]
            yield f"{section}.{name}", f"{section}.{name}={value}", beside
    for change, beside in TOGETHER.items():
        yield change.partition("=")[0], change, beside


def test_no_parameter_of_the_plant_is_forgotten():
    sections = {
        "screw": ScrewParameters,
        "slider": SliderParameters,
        "friction": FrictionParameters,
        "disturbance": DisturbanceParameters,
        "scale": ScaleParameters,
        "load": LoadParameters,
        "plant": PlantParameters,
        "actual.tilt": TiltParameters,
    }
    every = {f"{section}.{field.name}" for section, kind in sections.items() for field in fields(kind)}
    assert every <= {key for key, _, _ in walked()}


@pytest.mark.parametrize(("key", "change", "beside"), list(walked()))
def test_the_controller_knows_nothing_of_what_is_imperfect(key, change, beside):
    """Whatever changes in the plant: setpoints stay, and so does the first command, before any plant answered."""
    section = key.rpartition(".")[0]
    neutral = run(*beside)
    other = run(*beside, change)
    assert any(a.tcp != b.tcp for a, b in zip(neutral, other, strict=False))
    for a, b in zip(neutral[:100], other[:100], strict=False):
        assert a.setpoint == b.setpoint
        assert a.axis_setpoints == b.axis_setpoints
    assert section == "scale" or neutral[0].commands == other[0].commands
