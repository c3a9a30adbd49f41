"""What every machine of the package must answer, nominal and perturbed: against its vector chain, solved by mpmath.

A machine joins by its file in `config/`; only its chain must be written down in CHAINS.
"""

import dataclasses
import math

import mpmath
import numpy as np
import pytest
from command_line import refused

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup, machine_files
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics import in_space
from pkm_cnc.parameters import parameters_of
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulated_cycles
from pkm_cnc.tolerances import OFF_MACHINE

STEP = mpmath.mpf("1e-10")
"""m. Central differences at 40 digits: truncated at 1e-20, rounded at 1e-20 in the second one."""


@pytest.fixture(autouse=True)
def forty_digits():
    with mpmath.workdps(40):
        yield


NAMES = sorted(name for name in machine_files() if load_setup(name).machine_name == name)
KEPT = {"monopod": {"start_u", "strut_length_error"}}
"""Geometry that is not varied: what follows from the rest."""


def perturbed(name, seed):
    """The geometry with every number off by some percent or millimetres or milliradians; seed 0 is the nominal one."""
    geometry = load_setup(name).kinematics.geometry
    rng = np.random.default_rng(seed)

    def varied(value):
        return value * (1.0 + rng.normal(scale=0.02)) if value else rng.normal(scale=0.004)

    changes = {}
    for spec in parameters_of(type(geometry)):
        value = getattr(geometry, spec.name)
        if seed and type(value) in (float, tuple) and spec.name not in KEPT.get(name, ()):
            changes[spec.name] = varied(value) if type(value) is float else tuple(map(varied, value))
    return dataclasses.replace(geometry, **changes)


@pytest.fixture(params=[(name, seed) for name in NAMES for seed in (0, 1, 2)], ids=lambda it: f"{it[0]}-{it[1]}")
def machine(request):
    name, seed = request.param
    found = type(load_setup(name).kinematics)(perturbed(name, seed))
    found.name = name
    return found


def usable(machine, count, seed):
    """Poses all over the workspace, but where J is next to singular; (count, coordinates)."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform(-0.6, 0.6, (30 + 30 * count, len(machine.coordinates)))
    bad = {violation.row for violation in machine.violations(poses)}
    poses = poses[[row for row in range(len(poses)) if row not in bad]]
    stretch = np.linalg.svd(machine.jacobian(poses), compute_uv=False)
    poses = poses[(stretch.max(axis=1) < 10.0) & (stretch.min(axis=1) > 0.1)][:count]
    assert len(poses) == count
    return poses


# The vector chains: what is zero for joint i at u while the TCP is at p, in mpmath numbers. ---------------------------


def cartesian_chain(g, i, u, p):
    """The carried axes from the TCP back, each by what the ones behind it leave of P."""
    a, b, c = (mpmath.mpf(getattr(g, f"squareness_{pair}")) for pair in ("yz", "xz", "xy"))
    axes = mpmath.matrix(
        [
            [1, -mpmath.sin(c), -mpmath.sin(b)],
            [0, mpmath.cos(c), -mpmath.sin(a) * mpmath.cos(b)],
            [0, 0, mpmath.cos(a) * mpmath.cos(b)],
        ]
    )
    return u * (1 + mpmath.mpf(g.scale_error[i])) - mpmath.lu_solve(axes, mpmath.matrix(p))[i]


def monopod_chain(g, i, u, p):
    """Distance of slider and TCP as points of the plane, against that at the start point."""

    def distance(u, x):
        turn = mpmath.pi / 2 + mpmath.mpf(g.inclination)
        slider = mpmath.expj(turn) * (u + mpmath.mpf(g.slider_offset))
        return abs(slider - (x + mpmath.mpf(g.tcp_offset)))

    x0, length = mpmath.mpf(g.start_x), mpmath.mpf(g.strut_length)
    return distance(u, p[0]) - distance(mpmath.sqrt(length**2 - x0**2), x0)


def bipod_chain(g, i, u, p):
    foot = (1, -1)[i] * mpmath.mpf(g.base_half_distance) + mpmath.mpf(g.base_offset[i])
    joint = u + mpmath.mpf(g.base_height[i])
    return mpmath.hypot(p[0] - foot, p[1] - joint) - mpmath.mpf(g.strut_length) - mpmath.mpf(g.strut_length_error[i])


def tripod_chain(g, i, u, p):
    """B + E + L - A + W - P = 0 (6-1)."""

    def own(name):
        return mpmath.mpf(getattr(g, name)[i])

    azimuth, turned = mpmath.mpf(g.azimuth[i]), mpmath.mpf(g.azimuth[i]) + own("azimuth_error")
    base, platform = mpmath.mpf(g.base_radius) + own("base_radius_error"), mpmath.mpf(g.platform_radius)
    x = p[0] - mpmath.mpf(g.tool[0]) + platform * mpmath.cos(azimuth) - base * mpmath.cos(turned)
    y = p[1] - mpmath.mpf(g.tool[1]) + platform * mpmath.sin(azimuth) - base * mpmath.sin(turned)
    z = p[2] - mpmath.mpf(g.tool[2]) - (u + own("base_height"))
    return mpmath.sqrt(x**2 + y**2 + z**2) - mpmath.mpf(g.strut_length) - own("strut_length_error")


def hybrid_chain(g, i, u, p):
    """The table gives way by its share; the Tripod stands over the point of the table that is left."""
    split = mpmath.mpf(g.split)
    if i >= 3:
        return u + (1 - split) * p[i - 3]
    return tripod_chain(g, i, u, (split * p[0], split * p[1], p[2]))


CHAINS = {
    "cartesian": cartesian_chain,
    "monopod": monopod_chain,
    "bipod": bipod_chain,
    "tripod": tripod_chain,
    "hybrid": hybrid_chain,
}


def solved(machine, pose, near):
    """The joints that close the chains at `pose`, on the branch of the joints `near`."""
    chain = CHAINS[machine.name]
    return [
        mpmath.findroot(lambda u, i=i: chain(machine.geometry, i, u, pose), (start, start + 1e-6), tol=1e-36)
        for i, start in enumerate(near)
    ]


def moved(pose, direction, s):
    return [mpmath.mpf(value) + s * mpmath.mpf(part) for value, part in zip(pose, direction, strict=True)]


def largest(differences):
    return float(max(abs(difference) for difference in differences))


def test_every_machine_of_the_package_has_its_chain():
    assert {load_setup(name).machine_name for name in machine_files()} == set(NAMES) <= set(CHAINS)


def test_inverse_and_derivatives_are_those_of_the_vector_chain(machine):
    directions = np.random.default_rng(5).normal(size=(3, len(machine.coordinates)))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    poses = usable(machine, 3, seed=4)
    joints, jacobians = machine.inverse(poses), machine.jacobian(poses)
    bends = machine.second_derivative(poses, directions)
    for pose, direction, u, jacobian, bend in zip(
        *(array.tolist() for array in (poses, directions, joints, jacobians, bends)), strict=True
    ):
        here = solved(machine, moved(pose, direction, 0), u)
        assert largest(a - b for a, b in zip(here, u, strict=True)) < 1e-14
        for column in range(len(pose)):
            unit = [float(column == place) for place in range(len(pose))]
            ahead, behind = (solved(machine, moved(pose, unit, s), u) for s in (STEP, -STEP))
            slopes = [(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)]
            assert largest(slope - row[column] for slope, row in zip(slopes, jacobian, strict=True)) < 1e-12
        ahead, behind = (solved(machine, moved(pose, direction, s), u) for s in (STEP, -STEP))
        second = [(a - 2 * b + c) / STEP**2 for a, b, c in zip(ahead, here, behind, strict=True)]
        scale = 1.0 + largest(second)
        assert largest(a - b for a, b in zip(second, bend, strict=True)) < 1e-12 * scale


def test_round_trips_both_ways(machine):
    poses = usable(machine, 200, seed=1)
    joints = machine.inverse(poses)
    assert np.abs(machine.forward(joints) - poses).max() < 1e-12
    assert np.abs(machine.forward_newton(joints) - poses).max() < 1e-12
    assert np.abs(machine.forward_newton(joints, poses + 1e-3) - poses).max() < 1e-12
    assert np.abs(machine.inverse(machine.forward(joints)) - joints).max() < 1e-12
    assert machine.joint_violations(joints) == []


def test_both_jacobians_undo_each_other(machine):
    poses = usable(machine, 100, seed=2)
    jacobian, inverse = machine.jacobian(poses), machine.inverse_jacobian(poses)
    n, m = len(machine.axes), len(machine.coordinates)
    assert (jacobian.shape, inverse.shape) == ((100, n, m), (100, m, n))
    assert np.abs(inverse @ jacobian - np.eye(m)).max() < 1e-12
    condition, values = machine.reciprocal_condition(poses), np.linalg.svd(jacobian, compute_uv=False)
    assert ((condition > 0.0) & (condition <= 1.0)).all()
    if n == m:  # a redundant machine speaks of that part of it which can be singular
        assert condition == pytest.approx(values[:, -1] / values[:, 0], rel=1e-12)


def test_inverse_jacobian_is_the_derivative_of_forward(machine):
    poses = usable(machine, 20, seed=8)
    joints, inverse = machine.inverse(poses), machine.inverse_jacobian(poses)
    for column, unit in enumerate(np.eye(len(machine.axes))):
        ahead, behind = (machine.forward(joints + step * unit) for step in (1e-6, -1e-6))
        assert inverse[..., column] == pytest.approx((ahead - behind) / 2e-6, rel=1e-6, abs=1e-7)


def test_motion_is_the_chain_rule(machine):
    poses = usable(machine, 100, seed=6)
    velocity, acceleration = np.random.default_rng(7).normal(size=(2, *poses.shape))
    position, speed, rate = machine.motion(poses, velocity, acceleration)
    jacobian = machine.jacobian(poses)
    length = np.linalg.norm(velocity, axis=1)[:, None]
    bend = machine.second_derivative(poses, velocity / length) * length**2
    assert np.array_equal(position, machine.inverse(poses))
    assert speed == pytest.approx((jacobian @ velocity[..., None])[..., 0], rel=1e-12, abs=1e-13)
    assert rate == pytest.approx((jacobian @ acceleration[..., None])[..., 0] + bend, rel=1e-10, abs=1e-11)


def test_a_row_equals_the_single_pose_bit_for_bit(machine):
    poses = usable(machine, 20, seed=3)
    velocity, acceleration = np.random.default_rng(9).normal(size=(2, *poses.shape))
    joints = machine.inverse(poses)
    for function, *arguments in [
        (machine.inverse, poses),
        (machine.forward, joints),
        (machine.forward_newton, joints),
        (machine.forward_newton, joints, poses + 0.01),
        (machine.jacobian, poses),
        (machine.inverse_jacobian, poses),
        (machine.second_derivative, poses, velocity),
        (lambda *pva: np.stack(machine.motion(*pva), axis=-2), poses, velocity, acceleration),
        (machine.reciprocal_condition, poses),
    ]:
        rows = function(*arguments)
        for row in range(len(poses)):
            single = function(*[argument[row].tolist() for argument in arguments])
            assert np.asarray(single).tobytes() == np.ascontiguousarray(rows[row]).tobytes()


def test_setpoints_in_blocks_move_as_setpoints_one_by_one(machine):
    start = usable(machine, 1, seed=10)[0]
    s = np.linspace(0.0, 0.01, 21)[:, None]
    poses, velocity, acceleration = start + s * s, 2.0 * s + 0.0 * start, 2.0 + 0.0 * s + 0.0 * start
    block = machine.setpoint_motion(start, 0.001)(poses, velocity, acceleration)
    step = machine.setpoint_motion(start, 0.001)
    for row in range(len(poses)):
        single = step(poses[row].tolist(), velocity[row].tolist(), acceleration[row].tolist())
        assert [one.tobytes() for one in single] == [np.ascontiguousarray(some[row]).tobytes() for some in block]


def test_shapes_broadcast_and_results_are_new_arrays(machine):
    n, m = len(machine.axes), len(machine.coordinates)
    poses = usable(machine, 1, seed=11)[0] + 0.01 * np.arange(6.0).reshape(2, 3, 1) * np.ones(m)
    kept = poses.copy()
    joints = machine.inverse(poses)
    assert machine.forward_newton(joints, poses[0, 0]).shape == (2, 3, m)
    assert machine.jacobian(poses).shape == (2, 3, n, m)
    assert machine.reciprocal_condition(poses).shape == (2, 3)
    assert [part.shape for part in machine.motion(poses, np.ones(m), np.zeros(m))] == [(2, 3, n)] * 3
    for result in (joints, machine.forward(joints), machine.jacobian(poses), machine.inverse_jacobian(poses)):
        result += 1.0
    assert np.array_equal(poses, kept)
    assert machine.inverse(np.empty((0, m))).shape == (0, n)
    assert machine.forward_newton(np.empty((0, n))).shape == (0, m)


def test_what_violations_name_is_what_inverse_refuses(machine):
    poses = np.random.default_rng(12).uniform(-1.5, 1.5, (100, len(machine.coordinates)))
    reasons = {}
    for violation in machine.violations(poses):
        reasons.setdefault(violation.row, violation)
    assert machine.name == "cartesian" or 20 < len(reasons) < 100
    for row, pose in enumerate(poses):
        if row in reasons:
            assert reasons[row].axis in machine.axes + machine.coordinates
            assert reasons[row].excess > 0.0
            assert " mm" in reasons[row].reason
            for function in (machine.inverse, machine.jacobian, machine.reciprocal_condition):
                with pytest.raises(UnreachableError) as caught:
                    function(pose)
                assert str(caught.value).startswith(reasons[row].reason)
        else:
            assert np.isfinite(machine.inverse(pose)).all()


def test_what_joint_violations_name_is_what_forward_refuses(machine):
    """And what forward returns, inverse takes back: never a pose of another assembly branch."""
    middle = machine.inverse(usable(machine, 1, seed=13)[0])
    joints = middle + np.random.default_rng(14).uniform(-1.5, 1.5, (80, len(machine.axes)))
    reasons = {violation.row: violation for violation in reversed(machine.joint_violations(joints))}
    assert machine.name == "cartesian" or 10 < len(reasons) < 80
    for row, sliders in enumerate(joints):
        if row in reasons:
            assert reasons[row].axis in machine.axes
            assert " mm" in reasons[row].reason
            for function in (machine.forward, machine.forward_newton):
                with pytest.raises(UnreachableError) as caught:
                    function(sliders)
                assert str(caught.value).startswith(reasons[row].reason)
        else:
            tcp = machine.forward(sliders)
            assert machine.forward_newton(sliders) == pytest.approx(tcp, abs=1e-9)
            if len(machine.axes) == len(machine.coordinates):  # else there are other joints for the same TCP
                assert machine.inverse(tcp) == pytest.approx(sliders, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_refused_by_name(machine, bad):
    good = usable(machine, 1, seed=15)[0]
    joints, still = machine.inverse(good), np.zeros_like(good)
    for column, name in enumerate(machine.coordinates):
        pose = np.where(np.arange(good.size) == column, bad, good)
        with pytest.raises(UnreachableError, match=f"^{name}: {bad} is not a finite number$"):
            machine.inverse(pose)
        with pytest.raises(UnreachableError, match=f"^row 1: {name}: {bad} is not a finite number$"):
            machine.motion([good, pose], still, still)
        with pytest.raises(UnreachableError, match=f"^v{name}: {bad} is not a finite number$"):
            machine.motion(good, pose, still)
        with pytest.raises(UnreachableError, match=f"^row 0: a{name}: {bad} is not a finite number"):
            machine.motion([good, good], still, pose)
    for column, name in enumerate(machine.axes):
        sliders = np.where(np.arange(joints.size) == column, bad, joints)
        for forward in (machine.forward, machine.forward_newton):
            with pytest.raises(UnreachableError, match=f"^row 1: {name}: {bad} is not a finite number$"):
                forward([joints, sliders])


def test_not_a_number_in_the_geometry_is_refused_by_name(machine):
    for spec in parameters_of(type(machine.geometry)):
        value = getattr(machine.geometry, spec.name)
        if type(value) in (float, tuple):
            bad = math.nan if type(value) is float else (*value[:-1], math.nan)
            place = "" if type(value) is float else rf"\[{len(value) - 1}\]"
            with pytest.raises(InputError, match=rf"^geometry\.{spec.name}{place}: nan is not a finite number$"):
                type(machine)(dataclasses.replace(machine.geometry, **{spec.name: bad}))


def test_every_geometry_parameter_has_its_meaning(machine):
    for spec in parameters_of(type(machine.geometry)):
        assert spec.doc
        assert spec.choices or spec.unit in ("m", "rad", "", "1/s", "Hz")


def test_sketch_ends_at_the_tcp_and_its_struts_begin_at_the_sliders(machine):
    pose = usable(machine, 1, seed=16)[0]
    joints = machine.inverse(pose)
    lines = dict(machine.sketch(joints, pose))
    assert all(points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all() for points in lines.values())
    slid = {axis: lines[f"strut {axis}"][0] for axis in machine.axes if f"strut {axis}" in lines}
    assert slid
    for axis, before in slid.items():
        moved_joints = joints + 0.01 * np.array([axis == other for other in machine.axes])
        after = dict(machine.sketch(moved_joints, pose))[f"strut {axis}"][0]
        assert np.linalg.norm(after - before) == pytest.approx(0.01, rel=0.1)
    space = in_space(machine)
    tcp = space.forward(joints)
    ends = np.array([points[-1] for points in dict(space.sketch(joints, tcp)).values()])
    if machine.name not in ("tripod", "hybrid"):  # whose platform stands between
        assert np.abs(ends - tcp).sum(axis=1).min() < 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_the_machine_file_stands_at_a_good_place(name):
    setup = load_setup(name)
    joints = setup.machine.inverse(setup.start_pose)
    assert setup.machine.violations(setup.start_pose) == []
    for u, axis in zip(joints, setup.axes.values(), strict=True):
        assert axis.travel.minimum + 0.05 < u < axis.travel.maximum - 0.05


KINEMATICS = {name: load_setup(name).kinematics for name in NAMES}
FLAT = [name for name, machine in KINEMATICS.items() if len(machine.coordinates) < 3]
NOT_REDUNDANT = [name for name, machine in KINEMATICS.items() if len(machine.coordinates) == len(machine.axes)]


@pytest.mark.parametrize("name", NOT_REDUNDANT)
def test_the_true_machine_closes_the_chain_of_its_own_geometry(name):
    """Nominal and actual apart: the controller believes the programmed pose, the true TCP hangs on the true machine."""
    actual = perturbed(name, 1)
    given = {spec.name: getattr(actual, spec.name) for spec in parameters_of(type(actual))}
    overrides = [
        f"actual.geometry.{key}={list(value) if type(value) is tuple else value}"
        for key, value in given.items()
        if key not in KEPT.get(name, ())
    ]
    setup = load_setup(name, [*overrides, "drive.kind=first_order"])
    x = setup.start_pose[0] + 0.002
    program = Program("there.ngc", f"G21 G90\nG1 X{1e3 * x:.6f} F6000\nM30\n")
    last = list(simulated_cycles(setup, prepare(setup, program)))[-1]
    believed, true = (last.tcp.believed_x, last.tcp.believed_y, last.tcp.believed_z), last.tcp[3:6]
    assert believed == pytest.approx((x, *setup.start_pose[1:]), abs=setup.motion.in_position_tolerance)
    assert math.dist(believed, true) > 10e-6
    for i, state in enumerate(last.states):
        pose = [mpmath.mpf(value) for value in true]
        assert abs(CHAINS[name](actual, i, mpmath.mpf(state.slider_position), pose)) < 1e-14


@pytest.mark.parametrize("name", FLAT)
def test_a_program_that_leaves_the_line_or_plane_of_the_machine_is_refused(name, tmp_path):
    setup = load_setup(name)
    program = tmp_path / "up.ngc"
    program.write_text(f"G21 G90\nG1 X{1e3 * setup.start_pose[0] + 1.0} F600\nG1 Z5\nM30\n")
    line = refused("check", program, "--machine", name)
    moved = " and ".join(setup.kinematics.coordinates)
    assert line.startswith(f"pkm_cnc: {program}:3: outside the workspace at X")
    assert line.endswith(f"Z5.000: z: 5 mm is not 0: this machine moves the TCP in {moved} only")


@pytest.mark.parametrize("name", FLAT)
def test_a_flat_machine_in_space_is_the_machine_with_zeros(name):
    machine = KINEMATICS[name]
    space, own, n = in_space(machine), usable(machine, 20, seed=17), len(machine.axes)
    velocity, acceleration = np.random.default_rng(18).normal(size=(2, *own.shape))
    filled, still = (np.pad(part, ((0, 0), (0, 3 - own.shape[1]))) for part in (own, np.zeros_like(own)))
    joints = machine.inverse(own)
    assert space.inverse(filled).tobytes() == joints.tobytes()
    assert np.array_equal(space.forward(joints)[:, : own.shape[1]], machine.forward(joints))
    assert not space.forward(joints)[:, own.shape[1] :].any()
    assert space.jacobian(filled).shape == (20, n, 3)
    assert np.array_equal(space.inverse_jacobian(filled[0])[: own.shape[1]], machine.inverse_jacobian(own[0]))
    assert not space.inverse_jacobian(filled)[:, own.shape[1] :].any()
    given = [np.pad(part, ((0, 0), (0, 3 - own.shape[1]))) for part in (velocity, acceleration)]
    for ours, theirs in zip(space.motion(filled, *given), machine.motion(own, velocity, acceleration), strict=True):
        assert ours.tobytes() == theirs.tobytes()
    with pytest.raises(UnreachableError, match=r"^row 1: vz: 2 mm/s is not 0: this machine moves the TCP in "):
        space.motion(filled[:2], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.002)], still[:2])
    with pytest.raises(UnreachableError, match=r"^az: 3 mm/s\^2 is not 0"):
        space.motion(filled[0], still[0], (0.0, 0.0, 0.003))
    with pytest.raises(UnreachableError, match=r"^z: 1e-06 mm is not 0"):
        space.inverse(filled[0] + (0.0, 0.0, 1e-9))
    [violation] = space.violations([filled[0], filled[1] + (0.0, 0.0, -0.004)])
    assert (violation.row, violation.axis, violation.excess) == (1, "z", 0.004)


@pytest.mark.parametrize("name", FLAT)
@pytest.mark.parametrize("off", ["0.000001", "0.0000001", "0.000000001", "0.00000000001"])
def test_what_a_flat_machine_lets_pass_as_a_path_it_can_run(name, off):
    """A path that leaves the machine's plane by a hair is refused before anything moves, or runs to its end."""
    setup = load_setup(name)
    x = 1e3 * setup.start_pose[0]
    program = Program("hair.ngc", f"G21 G90\nG1 X{x + 0.01} Z{off} F6000\nX{x + 1} Z0\nM2\n")
    if 1e-3 * float(off) > 2.0 * OFF_MACHINE:
        with pytest.raises(InputError, match="is not 0: this machine moves the TCP in"):
            prepare(setup, program)
    else:
        assert sum(1 for _ in simulated_cycles(setup, prepare(setup, program))) > 100
