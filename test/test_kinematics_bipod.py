"""The Bipod against the thesis' formulas in many digits, known poses, and made-up machines that can be singular."""

import dataclasses
import math

import mpmath
import numpy as np
import pytest

from pkm_cnc import tolerances
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.contour import star_program
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics.bipod import Bipod
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulated_cycles

NOMINAL = Bipod(Bipod.Geometry())
UNEQUAL = Bipod(Bipod.Geometry(strut_length_error=(0.03, -0.02)))


def thesis_forward(geometry, u1, u2):
    """5-5..5-7 with n as the errata have it, in 50 digits; the upper root."""
    with mpmath.workdps(50):
        u1, u2, b = mpmath.mpf(u1), mpmath.mpf(u2), mpmath.mpf(geometry.base_half_distance)
        l1, l2 = (mpmath.mpf(geometry.strut_length) + mpmath.mpf(error) for error in geometry.strut_length_error)
        m = 2 * (u2 - u1)
        n = u1**2 - u2**2 + l2**2 - l1**2
        q = 1 + m**2 / (16 * b**2)
        r = -2 * u1 + 2 * m * n / (16 * b**2) - m / 2
        s = u1**2 - l1**2 + b**2 + n**2 / (16 * b**2) - n / 2
        y = -r / (2 * q) + mpmath.sqrt(r**2 / (4 * q**2) - s / q)
        return float((m * y + n) / (4 * b)), float(y)


@pytest.mark.parametrize("machine", [NOMINAL, UNEQUAL], ids=["equal", "unequal"])
@pytest.mark.parametrize("height", [0.0, 1000.0])
def test_forward_is_the_thesis_formula_wherever_the_sliders_stand(machine, height):
    """Also for sliders that differ little, far from zero: the formula itself would lose eight digits there."""
    joints = height - 0.55 + np.random.default_rng(1).uniform(-0.1, 0.1, (50, 2))
    joints[:10, 1] = joints[:10, 0] + 1e-9
    expected = np.array([thesis_forward(machine.geometry, *row) for row in joints.tolist()])
    assert np.abs(machine.forward(joints) - expected).max() < 1e-15 * (1.0 + height)


def test_known_poses():
    centre = -math.sqrt(0.6**2 - 0.2**2)
    assert NOMINAL.inverse((0.0, 0.0)) == pytest.approx([centre, centre], abs=1e-15)
    assert NOMINAL.inverse((0.2, 0.1)) == pytest.approx([0.1 - 0.6, 0.1 - math.sqrt(0.6**2 - 0.4**2)], abs=1e-15)
    assert NOMINAL.forward((centre, centre)) == pytest.approx([0.0, 0.0], abs=1e-15)


def test_guides_and_slider_zeros_that_are_off():
    machine = Bipod(Bipod.Geometry(base_offset=(0.003, -0.004), base_height=(0.005, -0.006)))
    u1, u2 = machine.inverse((0.05, 0.02)).tolist()
    assert math.hypot(0.05 - 0.203, 0.02 - (u1 + 0.005)) == pytest.approx(0.6, abs=1e-15)
    assert math.hypot(0.05 + 0.204, 0.02 - (u2 - 0.006)) == pytest.approx(0.6, abs=1e-15)


def test_the_mirror_image_exchanges_the_sliders():
    poses = np.random.default_rng(2).uniform((-0.35, -1.0), (0.35, 1.0), (100, 2))
    assert NOMINAL.inverse(poses * (-1.0, 1.0)) == pytest.approx(NOMINAL.inverse(poses)[:, ::-1], abs=1e-15)


def test_equal_struts_never_come_into_one_line():
    x = np.linspace(-0.399, 0.399, 999)
    poses = np.column_stack((x, 0.3 * x))
    assert NOMINAL.violations(poses) == []
    determinants = np.linalg.det(NOMINAL.jacobian(poses))
    assert len(set(np.sign(determinants))) == 1
    assert (NOMINAL.reciprocal_condition(poses) > 0.01).all()


def test_unequal_struts_in_one_line_are_singular_and_what_is_beyond_is_refused():
    """Strut 2, 0.9 m long, runs through slider joint 1: guides 0.4 m apart, strut 1 of 0.4 m."""
    machine = Bipod(Bipod.Geometry(strut_length_error=(-0.2, 0.3)))
    # from slider joint 2 the other is 0.5 m away, what strut 1 leaves of strut 2: the cosine of both is 0.4 / 0.5
    along = 0.8 * 0.9 - 0.2
    poses = [(along - 1e-4, 0.0), (along + 1e-4, 0.0)]
    [violation] = machine.violations(poses)
    assert violation.row == 1
    assert violation.reason.startswith("strut u1: wrong assembly branch: the TCP is ")
    assert machine.forward(machine.inverse(poses[0])) == pytest.approx(poses[0], abs=1e-12)
    with pytest.raises(UnreachableError, match=r"^row 1: strut u1: wrong assembly branch: .* below the line"):
        machine.inverse(poses)
    [near] = machine.violations((along - 1e-10, 0.0))
    assert near.reason.startswith("strut u1: singular pose: reciprocal condition ")
    assert 0.0 < near.excess <= tolerances.SINGULAR


def test_what_the_struts_cannot_reach_names_strut_and_excess():
    with pytest.raises(UnreachableError, match=r"^row 1: strut u2: the TCP is 5 mm too far .*span along x 605\.000 mm"):
        NOMINAL.inverse([(0.0, 0.0), (0.405, 0.0)])
    with pytest.raises(UnreachableError, match=r"^slider u2: the struts do not meet, by 100 mm: .* 1300\.000 mm apart"):
        NOMINAL.forward((0.0, math.sqrt(1.3**2 - 0.4**2)))
    short = Bipod(Bipod.Geometry(strut_length_error=(0.0, -0.45)))
    with pytest.raises(UnreachableError, match=r"less than the struts differ by, 450\.000 mm"):
        short.forward((0.1, 0.0))


@pytest.mark.parametrize("forward", ["forward", "forward_newton"])
@pytest.mark.parametrize("strut", [0, 1])
def test_never_a_tcp_below_a_slider(forward, strut):
    """A slider mirrored to above the TCP holds it there too, but as another assembly."""
    poses = np.random.default_rng(3).uniform((-0.37, -0.1), (0.37, 0.1), (100, 2))
    joints = UNEQUAL.inverse(poses)
    joints[:, strut] = 2.0 * poses[:, 1] - joints[:, strut]
    refused = {violation.row for violation in UNEQUAL.joint_violations(joints)}
    assert 50 < len(refused) <= 100
    for row, sliders in enumerate(joints):
        if row in refused:
            with pytest.raises(UnreachableError, match=f"^slider u{strut + 1}: wrong assembly branch: it would be"):
                getattr(UNEQUAL, forward)(sliders)
        else:
            tcp = getattr(UNEQUAL, forward)(sliders)
            assert tcp[1] > sliders.max()
            assert UNEQUAL.inverse(tcp) == pytest.approx(sliders, abs=1e-9)


def test_newton_takes_any_guess_above_the_sliders_and_refuses_those_below():
    pose = np.array((0.12, -0.05))
    joints = NOMINAL.inverse(pose)
    for guess in ((-3.0, 9.0), (2.0, 9.0), (0.0, 0.0)):
        assert NOMINAL.forward_newton(joints, guess) == pytest.approx(pose, abs=1e-13)
    with pytest.raises(
        UnreachableError, match=r"^Newton's method does not lead from the guess \(0\.000, -2000\.000\) mm"
    ):
        NOMINAL.forward_newton(joints, (0.0, -2.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base_half_distance": 0.0}, r"geometry\.base_half_distance: 0\.0 m is not above 0\.0 m"),
        ({"strut_length": 0.2}, r"geometry\.strut_length: struts of 0\.2 and 0\.2 m do not meet between guides 0\.4 m"),
        ({"strut_length_error": (0.0, -0.6)}, r"geometry\.strut_length_error\[1\]: -0\.6 m leaves nothing"),
        ({"strut_length_error": (0.0,)}, r"geometry\.strut_length_error: 1 numbers given, 2 wanted"),
        (
            {"base_offset": (-0.2, 0.2)},
            r"geometry\.base_offset: -0\.2, 0\.2 m puts the guide of u1 at x = 0 m, not righ",
        ),
        ({"base_height": (math.nan, 0.0)}, r"geometry\.base_height\[0\]: nan is not a finite number"),
    ],
)
def test_geometry_that_cannot_be_built_is_refused_with_its_key(changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Bipod(dataclasses.replace(Bipod.Geometry(), **changes))


def test_star_has_its_zeros_along_y_and_the_size_that_theory_says():
    """kappa v^2 J^-1 d2u/ds2: along x both struts turn alike, which lifts the TCP by L^2 / h^3 at the centre."""
    setup = load_setup("bipod", ["drive.kind=first_order"])
    program = Program("star.ngc", star_program(6000.0, [0.0, 90.0, 180.0, 270.0], (0.0, 0.0), 200.0))
    cycles = list(simulated_cycles(setup, prepare(setup, program)))
    lefts = [summary.left_mean for cycle in cycles for summary in cycle.summaries]
    kappa, bend = (1.0 - 20.0 * 0.001) / (2.0 * 20.0**2), 0.6**2 / (0.6**2 - 0.2**2) ** 1.5
    assert lefts == pytest.approx([0.1**2 * kappa * bend, 0.0, -(0.1**2) * kappa * bend, 0.0], rel=5e-3, abs=1e-8)


def test_sketch_is_the_machine():
    pose = (0.11, -0.03)
    joints = UNEQUAL.inverse(pose)
    lines = dict(UNEQUAL.sketch(joints, pose))
    assert list(lines) == ["column u1", "strut u1", "column u2", "strut u2"]
    for axis, u, foot, length in zip(("u1", "u2"), joints, (0.2, -0.2), (0.63, 0.58), strict=True):
        slider, tcp = lines[f"strut {axis}"]
        assert slider.tolist() == [foot, u, 0.0]
        assert tcp.tolist() == [*pose, 0.0]
        assert np.linalg.norm(slider - tcp) == pytest.approx(length, abs=1e-15)
        low, high = lines[f"column {axis}"]
        assert low[1] <= u <= high[1]
