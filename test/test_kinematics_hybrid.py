"""The hybrid machine against closures and filters that are not the package's, and what it must show in a run."""

import dataclasses
import math
from functools import cache, partial

import mpmath
import numpy as np
import pytest
import tripod_oracle
from graph import run_in_one_process
from hypothesis import given, settings
from hypothesis import strategies as st
from running import messages
from scipy import signal

from pkm_cnc.bag import BagWriter
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.contour import star_program
from pkm_cnc.errors import InputError, MachineFault, UnreachableError
from pkm_cnc.kinematics import load_kinematics
from pkm_cnc.program import Program, read_program
from pkm_cnc.simulation import simulate, simulated_cycles
from pkm_cnc.topics import recorded_topics

Hybrid, Tripod = load_kinematics("hybrid"), load_kinematics("tripod")
HALF = Hybrid(Hybrid.Geometry())
BUILT = Hybrid(
    Hybrid.Geometry(
        split=0.3,
        tool=(0.031, -0.017, -0.09),
        strut_length_error=(0.013, -0.021, 0.007),
        base_radius_error=(-0.009, 0.016, 0.011),
        azimuth_error=(0.04, -0.02, 0.03),
        base_height=(0.12, -0.07, 0.03),
    )
)
TABLE = Hybrid(Hybrid.Geometry(split=0.0))
SLOW = Hybrid(Hybrid.Geometry(divide="frequency", crossover=0.7))
MACHINES = pytest.mark.parametrize("machine", [HALF, BUILT, TABLE, SLOW], ids=["half", "built", "table", "slow"])
PERIOD = 0.001


def share(machine):
    return machine.geometry.split if machine.geometry.divide == "share" else 0.0


def reachable(count, seed, reach=0.2):
    rng = np.random.default_rng(seed)
    return rng.uniform((-reach, -reach, -0.3), (reach, reach, 0.3), (count, 3))


def exact_joints(machine, tcp):
    """The five joints of a pose: |B + E - (T - W + A)| = L of every strut with T = S P, and T - P of the table."""
    geometry, part = machine.geometry, mpmath.mpf(share(machine))
    x, y, z = tcp
    tool = [p - mpmath.mpf(w) for p, w in zip((part * x, part * y, z), geometry.tool, strict=True)]
    joints = []
    for strut in range(3):
        azimuth = mpmath.mpf(geometry.azimuth[strut])
        turned = azimuth + geometry.azimuth_error[strut]
        radius = mpmath.mpf(geometry.base_radius) + geometry.base_radius_error[strut]
        length = mpmath.mpf(geometry.strut_length) + geometry.strut_length_error[strut]
        across = [
            tool[0] + geometry.platform_radius * mpmath.cos(azimuth) - radius * mpmath.cos(turned),
            tool[1] + geometry.platform_radius * mpmath.sin(azimuth) - radius * mpmath.sin(turned),
        ]
        height = mpmath.sqrt(length**2 - across[0] ** 2 - across[1] ** 2)
        joints.append(tool[2] + height - mpmath.mpf(geometry.base_height[strut]))
    return [*joints, part * x - x, part * y - y]


def struts(machine, joints, tcp):
    """How long the struts would be that join sliders and platform, by the lines that are drawn."""
    lines = dict(machine.sketch(joints, tcp))
    return [float(np.linalg.norm(np.subtract(*lines[f"strut u{strut}"]))) for strut in (1, 2, 3)]


# Geometry -------------------------------------------------------------------------------------------------------------


@MACHINES
def test_round_trip(machine):
    poses = reachable(20_000, seed=1)
    joints = machine.inverse(poses)
    assert joints.shape == (20_000, 5)
    assert np.abs(machine.forward(joints) - poses).max() <= 1e-12
    assert np.abs(machine.forward_newton(joints) - poses).max() <= 1e-12
    assert np.abs(machine.forward_newton(joints, poses + (0.01, -0.02, -0.03)) - poses).max() <= 1e-12
    assert machine.violations(poses[:1000]) == machine.joint_violations(joints[:1000]) == []


@MACHINES
def test_the_table_is_in_the_closure_of_forward(machine):
    """Any sliders over any table, not only as `inverse` divides them: the struts that are drawn keep their lengths."""
    rng = np.random.default_rng(2)
    lengths = machine.geometry.strut_length + np.array(machine.geometry.strut_length_error)
    for joints in np.hstack((rng.uniform(0.4, 0.5, (50, 3)), rng.uniform(-0.5, 0.5, (50, 2)))):
        tcp = machine.forward(joints)
        assert struts(machine, joints, tcp) == pytest.approx(lengths.tolist(), abs=1e-14)
        assert machine.forward(joints + (0.0, 0.0, 0.0, 0.1, -0.2)) == pytest.approx(tcp - (0.1, -0.2, 0.0), abs=1e-15)
        assert machine.forward_newton(joints, tcp) == pytest.approx(tcp, abs=1e-13)


@MACHINES
def test_derivatives_against_differences_of_the_closure_in_40_digits(machine):
    rng = np.random.default_rng(3)
    for pose, direction in zip(reachable(4, seed=4), rng.normal(size=(4, 3)), strict=True):
        unit = direction / np.linalg.norm(direction)
        joints, jacobian = machine.inverse(pose), machine.jacobian(pose)
        second, reverse = machine.second_derivative(pose, unit), machine.inverse_jacobian(pose)
        with mpmath.workdps(40):

            def along(s, axis, way, pose=pose):
                point = [mpmath.mpf(float(p)) + s * mpmath.mpf(float(w)) for p, w in zip(pose, way, strict=True)]
                return exact_joints(machine, point)[axis]

            for axis in range(5):
                assert joints[axis] == pytest.approx(float(along(0, axis, (0, 0, 0))), abs=1e-15)
                for column, coordinate in enumerate(np.eye(3)):
                    slope = mpmath.diff(partial(along, axis=axis, way=coordinate), 0)
                    assert jacobian[axis, column] == pytest.approx(float(slope), abs=1e-13)
                bend = mpmath.diff(partial(along, axis=axis, way=unit), 0, 2)
                assert second[axis] == pytest.approx(float(bend), abs=1e-12)
        assert np.abs(reverse @ jacobian - np.eye(3)).max() < 1e-13
        for axis, one in enumerate(np.eye(5)):
            moved = [machine.forward(joints + sign * 1e-5 * one) for sign in (1.0, -1.0)]
            assert np.abs(reverse[:, axis] - (moved[0] - moved[1]) / 2e-5).max() < 1e-7


@MACHINES
def test_motion_agrees_with_differences_of_a_curved_path(machine):
    rng = np.random.default_rng(5)
    for pose in reachable(3, seed=6):
        velocity, acceleration = rng.normal(scale=((0.3,), (1.0,)), size=(2, 3))
        position, speed, rate = machine.motion(pose, velocity, acceleration)
        with mpmath.workdps(40):

            def joint(t, axis, start=pose, v=velocity, a=acceleration):
                path = [p + t * mpmath.mpf(w) + t * t / 2 * mpmath.mpf(b) for p, w, b in zip(start, v, a, strict=True)]
                return exact_joints(machine, path)[axis]

            for axis in range(5):
                assert position[axis] == machine.inverse(pose)[axis]
                assert speed[axis] == pytest.approx(float(mpmath.diff(partial(joint, axis=axis), 0)), abs=1e-13)
                assert rate[axis] == pytest.approx(float(mpmath.diff(partial(joint, axis=axis), 0, 2)), abs=1e-12)


@settings(derandomize=True, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-1.0, 1.0))
def test_the_share_is_the_tripods_part_of_x_and_y(split, x, y, z):
    machine = Hybrid(Hybrid.Geometry(split=split))
    joints = machine.inverse((x, y, z))
    assert joints[3:] == pytest.approx([-(1.0 - split) * x, -(1.0 - split) * y], abs=1e-16)
    assert Tripod(Tripod.Geometry()).forward(joints[:3]) == pytest.approx([split * x, split * y, z], abs=1e-13)
    assert machine.forward(joints) == pytest.approx([x, y, z], abs=1e-13)


def test_with_all_by_the_tripod_it_is_the_tripod_to_the_last_bit():
    machine, tripod = Hybrid(Hybrid.Geometry(split=1.0)), Tripod(Tripod.Geometry())
    poses = reachable(500, seed=7, reach=0.15)
    joints = machine.inverse(poses)
    assert joints[:, :3].tobytes() == tripod.inverse(poses).tobytes()
    assert not joints[:, 3:].any()
    assert machine.forward(joints).tobytes() == tripod.forward(joints[:, :3]).tobytes()


@MACHINES
def test_array_rows_equal_single_poses_bit_for_bit(machine):
    poses = reachable(101, seed=8)
    velocity, acceleration = np.random.default_rng(9).normal(size=(2, *poses.shape))
    joints, guess = machine.inverse(poses), poses + (0.02, 0.01, -0.03)
    for function, *arguments in [
        (machine.inverse, poses),
        (machine.forward, joints),
        (machine.forward_newton, joints),
        (machine.forward_newton, joints, guess),
        (machine.jacobian, poses),
        (machine.inverse_jacobian, poses),
        (machine.second_derivative, poses, velocity),
        (lambda *pva: np.stack(machine.motion(*pva), axis=-2), poses, velocity, acceleration),
        (machine.reciprocal_condition, poses),
    ]:
        rows = function(*arguments)
        for index in range(len(poses)):
            single = function(*[argument[index].tolist() for argument in arguments])
            assert np.asarray(single).tobytes() == np.ascontiguousarray(rows[index]).tobytes()


def test_shapes_broadcast_and_arguments_are_left_alone():
    poses = reachable(24, seed=10).reshape(2, 3, 4, 3)
    joints = HALF.inverse(poses)
    kept = poses.copy(), joints.copy()
    assert joints.shape == (2, 3, 4, 5)
    assert HALF.forward_newton(joints, (0.0, 0.0, -4.0)).shape == HALF.forward(joints).shape == poses.shape
    assert HALF.jacobian(poses).shape == (2, 3, 4, 5, 3)
    assert HALF.inverse_jacobian(poses).shape == (2, 3, 4, 3, 5)
    assert HALF.reciprocal_condition(poses).shape == (2, 3, 4)
    assert HALF.motion(poses, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))[2].shape == joints.shape
    assert HALF.inverse(np.empty((0, 3))).shape == (0, 5)
    assert HALF.violations(np.empty((0, 3))) == HALF.joint_violations(np.empty((0, 5))) == []
    assert np.array_equal(poses, kept[0])
    assert np.array_equal(joints, kept[1])


def test_what_is_out_of_reach_is_so_where_the_tripod_stands():
    """Column 2 is at azimuth 165 deg: away from it along +x, half the way by the table."""
    column = 0.363 * np.array((math.cos(math.radians(165.0)), math.sin(math.radians(165.0))))
    away = -column / np.linalg.norm(column)
    far = np.append(2.0 * (column + 0.61 * away), 0.1)
    assert HALF.violations(far * (0.95, 0.95, 1.0)) == []
    with pytest.raises(UnreachableError, match=r"^row 1: strut u2: the TCP is 10 mm too far from its slider column"):
        HALF.inverse([(0.0, 0.0, 0.0), far])
    [violation] = HALF.violations([(math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), far])[1:]
    assert (violation.row, violation.axis) == (2, "u2")
    assert violation.excess == pytest.approx(0.01, abs=1e-14)
    assert TABLE.violations(far) == SLOW.violations(far) == []


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("machine", [HALF, TABLE, SLOW], ids=["half", "table", "slow"])
def test_what_is_not_finite_is_refused_by_name(machine, bad):
    moving = machine.setpoint_motion((0.0, 0.0, 0.0), PERIOD)
    for column, name in enumerate("xyz"):
        wrong = np.where(np.arange(3) == column, bad, 0.01)
        for function in (machine.inverse, machine.jacobian, machine.inverse_jacobian, machine.reciprocal_condition):
            with pytest.raises(UnreachableError, match=f"^row 1: {name}: {bad} is not a finite number"):
                function([(0.0, 0.0, 0.0), wrong])
        for motion in (machine.motion, moving):
            for place, kind in enumerate(("", "v", "a")):
                vectors = [np.zeros(3)] * 3
                vectors[place] = wrong
                with pytest.raises(UnreachableError, match=f"^{kind}{name}: {bad} is not a finite number$"):
                    motion(*vectors)
    for column, name in enumerate(machine.axes):
        joints = np.where(np.arange(5) == column, bad, 0.5)
        for forward in (machine.forward, machine.forward_newton):
            with pytest.raises(UnreachableError, match=f"^row 1: .*{name}: "):
                forward([[0.5] * 5, joints])


def test_sliders_the_tripod_cannot_have_are_refused():
    [violation] = HALF.joint_violations([(0.5, 0.5, 0.5, 9.0, 9.0), (0.4, 0.4, 1.9, 0.0, 0.0)])
    assert (violation.row, violation.axis) == (1, "u3")
    with pytest.raises(UnreachableError, match=r"^slider u3: the struts do not meet"):
        HALF.forward((0.4, 0.4, 1.9, 0.0, 0.0))


def test_condition_is_the_tripods_where_it_stands():
    tripod, pose = Tripod(Tripod.Geometry()), np.array((0.15, -0.1, 0.05))
    assert HALF.reciprocal_condition(pose) == tripod.reciprocal_condition(pose * (0.5, 0.5, 1.0))
    assert SLOW.reciprocal_condition(pose) == tripod.reciprocal_condition((0.0, 0.0, 0.05))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"split": 1.1}, r"geometry\.split: 1\.1 is over its maximum 1"),
        ({"split": math.nan}, r"geometry\.split: nan is not a finite number"),
        ({"divide": "none"}, r"geometry\.divide: 'none' is not one of share, frequency"),
        ({"crossover": 0.0}, r"geometry\.crossover: 0\.0 Hz is below its minimum 0\.01 Hz"),
        ({"crossover": 1e160}, r"geometry\.crossover: 1e\+160 Hz is over its maximum 1000\.0 Hz"),
        ({"strut_length": 0.3}, r"geometry\.strut_length: 0\.3 m is not above 0\.363 m"),
        ({"base_height": (0.0, math.nan, 0.0)}, r"geometry\.base_height\[1\]: nan is not a finite number"),
    ],
)
def test_geometry_that_cannot_be_built_is_refused_with_its_key(changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Hybrid(dataclasses.replace(Hybrid.Geometry(), **changes))


def test_sketch_shows_table_and_workpiece_where_the_table_is():
    pose = np.array((0.1, -0.06, 0.02))
    joints = HALF.inverse(pose)
    lines = dict(HALF.sketch(joints, pose))
    assert list(lines)[-4:] == ["platform", "tool", "table", "workpiece"]
    assert lines["tool"][1] == pytest.approx([0.05, -0.03, 0.02], abs=1e-16)  # in base_link
    assert lines["workpiece"][1] == pytest.approx([-0.05, 0.03, 0.0], abs=1e-16)
    assert lines["table"][:4].mean(axis=0) == pytest.approx(lines["workpiece"][1], abs=1e-16)
    assert (lines["table"][0] == lines["table"][4]).all()
    assert struts(HALF, joints, pose) == pytest.approx([0.6] * 3, abs=1e-15)


def test_an_actual_machine_of_its_own():
    setup = load_setup("hybrid", ["actual.geometry.strut_length_error=[0.0, 0.0, 0.0005]"])
    joints = setup.machine.inverse((0.05, 0.02, 0.0))
    assert 1e-4 < np.linalg.norm(setup.actual.forward(joints) - (0.05, 0.02, 0.0)) < 2e-3


# Divided by frequency -------------------------------------------------------------------------------------------------


def setpoints(path, count):
    """Rows of position, velocity, acceleration (3, count, 3) of a path t -> (x, y, z) given as three functions."""
    times = np.arange(count) * PERIOD
    return np.array([np.stack(np.broadcast_arrays(*part(times)), axis=-1) for part in path])


def waving(frequency, amplitude=0.02):
    rate = math.tau * frequency
    return setpoints(
        (
            lambda t: (amplitude * np.sin(rate * t), 0.0 * t, 0.01 * t),
            lambda t: (amplitude * rate * np.cos(rate * t), 0.0 * t, 0.01 + 0.0 * t),
            lambda t: (-amplitude * rate * rate * np.sin(rate * t), 0.0 * t, 0.0 * t),
        ),
        6000,
    )


def wandering(count=4000, seed=11):
    """Steps of a random walk: no filter may care what the input is."""
    rng = np.random.default_rng(seed)
    moved = np.cumsum(rng.normal(scale=2e-4, size=(count, 3)), axis=0) * (1.0, 1.0, 0.1)
    return np.array((moved, *rng.normal(size=(2, count, 3))))


def moved(rows, machine=SLOW, start=(0.0, 0.0, 0.0)):
    return machine.setpoint_motion(start, PERIOD)(*rows)


def tools(joints, speeds=None):
    """The Tripod's own TCP, and its velocity, by a Tripod of the package, which is tested elsewhere."""
    tripod = Tripod(Tripod.Geometry())
    points = tripod.forward(joints[:, :3])
    if speeds is None:
        return points
    return points, np.einsum("kij,kj->ki", tripod.inverse_jacobian(points), speeds[:, :3])


def test_table_and_tripod_together_are_the_setpoint():
    rows = wandering()
    position, velocity, acceleration = moved(rows)
    points, speeds = tools(position, velocity)
    assert np.abs(SLOW.forward(position) - rows[0]).max() < 1e-13
    assert np.abs(speeds[:, :2] - velocity[:, 3:] - rows[1][:, :2]).max() < 1e-13
    # accelerations by another way: those of the struts on the Tripod's own motion
    own = rows[2].copy()
    own[:, :2] += acceleration[:, 3:]
    expected = Tripod(Tripod.Geometry()).motion(points, speeds, own)[2]
    assert np.abs(acceleration[:, :3] - expected).max() < 1e-10


def test_the_table_is_the_filter_discretised_exactly_for_a_piecewise_linear_input():
    rows = wandering()
    w = math.tau * 0.7
    a, b = np.array([[0.0, 1.0], [-w * w, -2.0 * w]]), np.array([[0.0], [w * w]])
    outputs = np.array([[1.0, 0.0], [0.0, 1.0], [-w * w, -2.0 * w]]), np.array([[0.0], [0.0], [w * w]])
    system = signal.cont2discrete((a, b, *outputs), PERIOD, method="foh")
    joints = moved(rows, start=rows[0][0])
    for axis in (0, 1):
        values = rows[0][:, axis] - rows[0][0, axis]
        expected = signal.dlsim(system, values[:, None])[1]
        found = np.stack([part[:, 3 + axis] for part in joints], axis=1)
        assert np.abs(found[:, 0] + rows[0][0, axis] + expected[:, 0]).max() < 1e-13
        assert np.abs(found[:, 1] + expected[:, 1]).max() < 1e-12
        assert np.abs(found[:, 2] + expected[:, 2]).max() < 1e-10


@pytest.mark.parametrize("frequency", [0.1, 0.7, 3.0, 10.0])
def test_a_sine_goes_to_the_table_by_the_filters_gain_and_to_the_tripod_by_the_rest(frequency):
    rows = waving(frequency)
    joints = moved(rows)[0]
    times = np.arange(len(joints)) * PERIOD
    ratio = 1j * frequency / 0.7
    gain = 1.0 / (1.0 + ratio) ** 2
    late = times > 3.5  # the start has died away: exp(-3.5 w) is 2e-7
    for found, passed in ((-joints[:, 3], gain), (tools(joints)[:, 0], 1.0 - gain)):
        expected = 0.02 * (passed * np.exp(1j * math.tau * frequency * times)).imag
        assert np.abs(found - expected)[late].max() < 0.02 * 1e-3 * max(abs(passed), 0.01)
    assert abs(gain) == pytest.approx(1.0 / (1.0 + (frequency / 0.7) ** 2), rel=1e-12)


def test_it_starts_at_rest_and_rests_where_the_setpoint_rests():
    start = (0.03, -0.02, 0.01)
    rest = np.array([[start] * 10, np.zeros((10, 3)), np.zeros((10, 3))])
    position, velocity, acceleration = moved(rest, start=start)
    assert (position == SLOW.inverse(start)).all()
    assert not velocity.any()
    assert not acceleration.any()


def test_on_a_ramp_the_tripod_runs_ahead_by_the_speed_over_pi_crossover():
    ramp = setpoints(
        (
            lambda t: (0.1 * t, -0.05 * t, 0.0 * t),
            lambda t: (0.1 + 0.0 * t, -0.05 + 0.0 * t, 0.0 * t),
            lambda t: (0.0 * t, 0.0 * t, 0.0 * t),
        ),
        10_000,
    )
    joints = moved(ramp)[0]
    assert tools(joints)[-1] == pytest.approx([0.1 / (math.pi * 0.7), -0.05 / (math.pi * 0.7), 0.0], abs=1e-12)


def test_blocks_and_single_cycles_give_the_same_bits():
    rows = wandering(400)
    expected = np.stack(moved(rows), axis=1)
    for lengths in ([1] * 400, [7] * 57 + [1], [399, 1]):
        motion = SLOW.setpoint_motion((0.0, 0.0, 0.0), PERIOD)
        found, first = [], 0
        for length in lengths:
            block = rows[:, first : first + length]
            parts = motion(*(block[:, 0] if length == 1 else block))
            found.append(np.stack(parts, axis=-2).reshape(-1, 3, 5))
            first += length
        assert np.concatenate(found).tobytes() == expected.tobytes()


def test_a_refused_call_changes_nothing():
    rows = wandering(60)
    motion = SLOW.setpoint_motion((0.0, 0.0, 0.0), PERIOD)
    before = motion(*rows[:, :30])
    far = rows[:, 30:].copy()
    far[0, 10:, 0] += 1.0
    with pytest.raises(UnreachableError, match=r"^row 10: strut u\d: the TCP is .* too fast for the Tripod"):
        motion(*far)
    after = motion(*rows[:, 30:])
    whole = moved(rows)
    for part, (first, second) in zip(whole, zip(before, after, strict=True), strict=True):
        assert np.concatenate((first, second)).tobytes() == part.tobytes()


def test_two_runs_do_not_know_each_other_and_by_share_there_is_nothing_to_know():
    rows = wandering(50)
    first, second = (SLOW.setpoint_motion((0.0, 0.0, 0.0), PERIOD) for _ in range(2))
    first(*rows)
    assert np.stack(second(*rows)).tobytes() == np.stack(moved(rows)).tobytes()
    assert HALF.setpoint_motion((0.0, 0.0, 0.0), PERIOD) == HALF.motion


# In a run -------------------------------------------------------------------------------------------------------------

FIRST_ORDER = "drive.kind=first_order"


@cache
def star(machine, heading, *overrides):
    """Left and up (n, 2) and place (n,) on one line of 200 mm through 0 at 6000 mm/min over its middle half, m."""
    setup = load_setup(machine, (FIRST_ORDER, *overrides))
    program = Program("star.ngc", star_program(6000.0, [heading], (0.0, 0.0), 200.0))
    checked = prepare(setup, program)
    starts = checked.toolpath().starts
    begin = starts[-1]
    errors = [cycle.error for cycle in simulated_cycles(setup, checked) if cycle.error.segment == len(starts) - 1]
    rows = np.array([(error.left, error.up, error.path_length - begin - 0.1) for error in errors])
    rows = rows[np.abs(rows[:, 2]) <= 0.05]
    return rows[:, :2], rows[:, 2]


def law(split, heading, places):
    """e = kappa v^2 dP/du d2u/ds2 of a Tripod that goes its share of the way: split^2 that at split P."""
    angle = np.longdouble(math.radians(heading))
    tangent = np.array([np.cos(angle), np.sin(angle), 0.0], dtype=np.longdouble)
    left = np.array([-math.sin(angle), math.cos(angle), 0.0])
    scale = tripod_oracle.sampled_kappa(20.0, PERIOD) * 0.1**2 * split**2
    vectors = np.array([tripod_oracle.drift(lambda s: s * tangent, split * place) for place in places])
    return scale * np.column_stack((vectors @ left, vectors[:, 2]))


@pytest.mark.parametrize("heading", [15.0, 75.0, 160.0])
def test_the_tripods_share_of_the_star_error_goes_with_the_square_of_the_split(heading):
    for split in (0.3, 0.5, 1.0):
        errors, places = star("hybrid", heading, f"geometry.split={split}")
        chosen = slice(None, None, 50)
        expected = law(split, heading, places[chosen])
        assert np.abs(errors[chosen] - expected).max() < 0.02 * np.abs(expected).max()
    middle = {
        split: errors[np.abs(places).argmin()]
        for split in (0.3, 0.5, 1.0)
        for errors, places in [star("hybrid", heading, f"geometry.split={split}")]
    }
    for split in (0.3, 0.5):
        assert middle[split] == pytest.approx(split**2 * middle[1.0], rel=0.01)


def test_with_all_by_the_tripod_the_star_error_is_the_tripods():
    errors, places = star("hybrid", 15.0, "geometry.split=1.0")
    expected, there = star("tripod", 15.0)
    assert errors.tobytes() == expected.tobytes()
    assert places.tobytes() == there.tobytes()


@pytest.mark.parametrize("drive", ["cascade", "first_order"])
def test_with_all_by_the_table_there_is_no_star_error(drive):
    """A serial machine with equal drives; from rest, so that no corner before it is still dying away."""
    setup = load_setup("hybrid", ["geometry.split=0.0", f"drive.kind={drive}"])
    for x, y in ((100.0, 40.0), (-30.0, 90.0), (0.0, -80.0)):
        cycles = list(simulated_cycles(setup, prepare(setup, Program("line.ngc", f"G1 X{x} Y{y} F6000\nM2\n"))))
        assert max(cycle.error.magnitude for cycle in cycles) < 1e-12
        assert max(math.hypot(cycle.tcp.tracking_error_x, cycle.tcp.tracking_error_y) for cycle in cycles) > 4.9e-3


FAST = Program("fast.ngc", "G1 X50 F3000\nG1 X400 F20000\nM2\n")
WEAK = ("geometry.divide=frequency", "geometry.crossover=0.05", "drive.following_error_limit=1.0", FIRST_ORDER)
WAITS = (*WEAK, "motion.wait_in_position=true")


def test_check_refuses_a_program_that_is_too_fast_for_the_tripod():
    setup = load_setup("hybrid", WEAK)
    with pytest.raises(
        InputError,
        match=r"^fast\.ngc:2: outside the workspace at X2\d\d\.\d+ Y0\.000 Z0\.000: strut u\d: the TCP is .* mm "
        r"too far .*; it is too fast for the Tripod.* a lower feed or a higher geometry\.crossover helps$",
    ):
        prepare(setup, FAST)
    prepare(setup, Program("slow.ngc", FAST.text.replace("20000", "500").replace("3000", "500")))
    prepare(load_setup("hybrid", ["geometry.split=0.0"]), FAST)


def test_check_knows_where_the_table_goes_by_frequency():
    narrow = ("geometry.divide=frequency", "table_x.travel.minimum=-0.09")
    back = Program("back.ngc", "G1 X85 F6000\nG1 X-20\nM2\n")
    prepare(load_setup("hybrid", narrow), back)
    with pytest.raises(InputError, match=r"^there\.ngc:1: table_x leaves its travel at X9"):
        prepare(load_setup("hybrid", narrow), Program("there.ngc", "G1 X95 F500\nM2\n"))
    high = load_setup("hybrid", ("geometry.divide=frequency", "u2.travel.minimum=0.46"))
    with pytest.raises(InputError, match=r"^back\.ngc:1: u2 leaves its travel at X\d"):  # only while it runs ahead
        prepare(high, back)
    prepare(high, Program("back.ngc", back.text.replace("6000", "1000")))


def fault_of(setup, program):
    """The fault of a simulation and how many cycles came before it."""
    seen = []
    with pytest.raises(MachineFault) as caught:
        simulate(setup, program, prepare(setup, program), watch=seen.append)
    return str(caught.value), len(seen)


def test_a_setpoint_out_of_reach_is_a_fault_that_names_cycle_and_strut_wherever_a_block_ends(monkeypatch):
    setup = load_setup("hybrid", WAITS)
    reason, count = fault_of(setup, FAST)
    assert reason.startswith(f"cycle {count}: strut u")
    assert "too fast for the Tripod" in reason
    monkeypatch.setattr("pkm_cnc.simulation.BLOCK", 1)
    assert fault_of(setup, FAST) == (reason, count)


def test_the_graph_ends_with_the_same_fault(ros_domain, tmp_path):
    path = tmp_path / "fast.ngc"
    path.write_text(FAST.text)
    setup = load_setup("hybrid", WAITS)
    end = run_in_one_process(setup, str(path), str(tmp_path / "bag"), "fast")
    assert not end.completed
    assert (end.node, end.exit_code) == ("inverse_kinematics", MachineFault.exit_code)
    assert end.reason == fault_of(setup, FAST)[0]


@pytest.mark.parametrize("divide", ["share", "frequency"])
def test_the_graph_equals_the_simulation_byte_for_byte(ros_domain, divide, tmp_path):
    path = tmp_path / "short.ngc"
    path.write_text("G1 X6 Y2 F6000\nG3 X6 Y2 I-3 J0\nM2\n")
    setup, program = load_setup("hybrid", [f"geometry.divide={divide}"]), read_program(str(path))
    with BagWriter(tmp_path / "simulated", recorded_topics(tuple(setup.axes))) as sink:
        simulate(setup, program, prepare(setup, program), sink)
    assert run_in_one_process(setup, str(path), str(tmp_path / "run"), "fast").completed
    recorded, simulated = messages(tmp_path / "run"), messages(tmp_path / "simulated")
    assert {"/table_x/setpoint", "/table_y/actual", "/u3/command", "/tcp/state"} <= set(recorded)
    for bag in (recorded, simulated):
        bag.pop("/run_end")  # says who ended the run
    assert recorded == simulated
