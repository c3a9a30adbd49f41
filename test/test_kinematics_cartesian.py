"""The Cartesian machine: what a serial machine must show, and what axes that are not square do."""

import math

import numpy as np
import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.contour import circle_program
from pkm_cnc.kinematics.cartesian import Cartesian
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulated_cycles

NOMINAL = Cartesian(Cartesian.Geometry())
SKEW = Cartesian(
    Cartesian.Geometry(squareness_xy=0.02, squareness_xz=-0.03, squareness_yz=0.04, scale_error=(0.001, -0.002, 0.003))
)


def run(text, *overrides):
    setup = load_setup("cartesian", overrides)
    return list(simulated_cycles(setup, prepare(setup, Program("test.ngc", text))))


def test_perfect_axes_are_the_coordinates_to_the_last_bit():
    poses = np.random.default_rng(1).normal(size=(100, 3))
    assert NOMINAL.inverse(poses).tobytes() == NOMINAL.forward(poses).tobytes() == poses.tobytes()


def test_axes_stand_at_the_angles_that_squareness_says():
    x, y, z = (SKEW.forward(unit) - SKEW.forward(np.zeros(3)) for unit in np.eye(3))
    lengths = [float(np.linalg.norm(axis)) for axis in (x, y, z)]
    assert lengths == pytest.approx([1.001, 0.998, 1.003], abs=1e-15)
    angle_xy, angle_xz = (
        math.acos(axis @ x / np.linalg.norm(axis) / np.linalg.norm(x)) - math.radians(90.0) for axis in (y, z)
    )
    assert (angle_xy, angle_xz) == pytest.approx((0.02, -0.03), abs=1e-14)
    assert math.atan2(-z[1], z[2]) == pytest.approx(0.04, abs=1e-15)


@pytest.mark.parametrize("heading", [0.0, 30.0, 75.0, 135.0, 270.0])
def test_a_line_from_rest_with_equal_drives_has_no_contour_error(heading):
    """From rest: in a star the rapid before a line, at another heading, takes some while to fade out along it."""
    x, y = 100.0 * math.cos(math.radians(heading)), 100.0 * math.sin(math.radians(heading))
    errors = [cycle.error for cycle in run(f"G21 G90\nG1 X{x:.6f} Y{y:.6f} F6000\nM30\n")]
    assert max(abs(error.left) for error in errors) < 1e-12
    assert {error.up for error in errors} == {0.0}


def test_a_circle_comes_out_too_small_by_what_the_lag_says():
    """2-12: v^2 / (2 R Kv^2) = 31.25 um; the sampled loop leaves the share 1 - Kv T of it."""
    text = circle_program(
        feed_mm_min=3000.0,
        radius_mm=100.0,
        center_mm=(0.0, 0.0),
        direction="ccw",
        overshoot_deg=90.0,
        acceleration_mm_s2=2000.0,
    )
    cycles = run(text, "drive.kind=first_order")
    middle = cycles[len(cycles) // 2 :][:100]
    shrunk = [0.1 - math.hypot(cycle.tcp.x, cycle.tcp.y) for cycle in middle]
    assert shrunk == pytest.approx([31.25e-6 * (1.0 - 20.0 * 0.001)] * 100, rel=1e-3)


def test_a_true_machine_out_of_square_leaves_the_programmed_line():
    """Along y the TCP drifts to -x by the squareness, which the controller does not see."""
    cycles = run("G21 G90\nG1 Y100 F3000\nM30\n", "actual.geometry.squareness_xy=0.001")
    last = cycles[-1].tcp
    assert abs(last.believed_x) < 1e-15
    assert (last.x, last.y) == pytest.approx((-math.sin(0.001) * last.believed_y, math.cos(0.001) * last.believed_y))
    assert cycles[-1].error.left == pytest.approx(-last.x, rel=1e-3)  # travelling along +y, -x is left


def test_sketch_carries_each_axis_on_the_one_before():
    joints = np.array((0.1, -0.2, 0.3))
    lines = dict(SKEW.sketch(joints, SKEW.forward(joints)))
    assert list(lines) == [f"{part} {axis}" for part in ("column", "strut") for axis in "xyz"]
    for axis, u in zip("xyz", joints, strict=True):
        low, high = lines[f"column {axis}"]
        slider = lines[f"strut {axis}"][0]
        scale = 1.0 + SKEW.geometry.scale_error["xyz".index(axis)]
        assert slider == pytest.approx((low + high) / 2.0 + scale * u * (high - low), abs=1e-15)  # drawn 1 m long
    assert np.allclose(lines["strut y"][1], lines["strut z"][0], rtol=0.0, atol=0.0)
    assert lines["strut z"][1] == pytest.approx(SKEW.forward(joints), abs=1e-15)
