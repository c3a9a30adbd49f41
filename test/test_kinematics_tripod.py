"""The Tripod's kinematics against independent formulas, finite differences in long double, and a general solver."""

import dataclasses
import itertools
import math
from functools import partial

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import fsolve

from pkm_cnc import tolerances
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics import _newton, load_kinematics

Tripod = load_kinematics("tripod")
NOMINAL = Tripod(Tripod.Geometry())
# A skew machine: other lengths, azimuths not 120 deg apart, a tool.
SKEW = Tripod(
    Tripod.Geometry(
        base_radius=0.41, platform_radius=0.12, strut_length=0.77, azimuth=(0.3, 2.1, 4.6), tool=(0.031, -0.017, -0.09)
    )
)
# Both with what an assembled machine has: every strut, column and base point off by its own.
BUILT = Tripod(
    Tripod.Geometry(
        strut_length_error=(0.0013, -0.0021, 0.0007),
        base_radius_error=(-0.0009, 0.0016, 0.0011),
        azimuth_error=(0.004, -0.002, 0.003),
        base_height=(0.012, -0.007, 0.003),
    )
)
WARPED = Tripod(
    dataclasses.replace(
        SKEW.geometry,
        strut_length_error=(0.05, -0.08, 0.02),
        base_radius_error=(-0.06, 0.03, 0.07),
        azimuth_error=(0.2, -0.1, 0.15),
        base_height=(0.3, -0.2, 0.05),
    )
)
MACHINES = pytest.mark.parametrize(
    "machine", [NOMINAL, SKEW, BUILT, WARPED], ids=["nominal", "skew", "built", "warped"]
)


def chain(geometry):
    """Base points B_i (3, 3), platform joints A_i about the platform's centre (3, 3), lengths (3,), in long double."""
    azimuth = np.asarray(geometry.azimuth, dtype=np.longdouble)
    turned = azimuth + np.asarray(geometry.azimuth_error, dtype=np.longdouble)
    radius = np.longdouble(geometry.base_radius) + np.asarray(geometry.base_radius_error, dtype=np.longdouble)
    base = np.stack([radius * np.cos(turned), radius * np.sin(turned), np.asarray(geometry.base_height)], axis=1)
    joints = np.longdouble(geometry.platform_radius) * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    return base, joints, np.longdouble(geometry.strut_length) + np.asarray(geometry.strut_length_error)


def slider_heights(geometry, tcp):
    """Vectors from the thesis' closed chain (6-1), |L_i| by Pythagoras, in long double: u (N, 3) and h (N, 3)."""
    base, joints, lengths = chain(geometry)
    tcp = np.atleast_2d(np.asarray(tcp, dtype=np.longdouble))
    across = (tcp - np.asarray(geometry.tool))[:, None] + joints - base
    with np.errstate(invalid="ignore"):
        heights = np.sqrt(lengths**2 - across[..., 0] ** 2 - across[..., 1] ** 2)
    return across[..., 2] + heights, heights


def reachable(machine, count, seed, margin=0.0):
    """`count` random poses over the whole workspace, all struts at least `margin` high."""
    rng = np.random.default_rng(seed)
    span = machine.geometry.strut_length + max(machine.geometry.strut_length_error)
    poses = rng.uniform((-span, -span, -2.0), (span, span, 2.0), (12 * count, 3)) + machine.geometry.tool
    poses = poses[(slider_heights(machine.geometry, poses)[1] > margin).all(axis=1)][:count]
    assert len(poses) == count
    return poses


def derivative(function, order, step):
    """Sixth-order central difference of `function` of a number at 0, in long double."""
    weights = {1: (0, 45, -9, 1, 60), 2: (-490, 270, -27, 2, 180)}[order]
    step = np.longdouble(step)
    total = np.longdouble(weights[0]) * function(step * 0)
    for k in (1, 2, 3):
        back = function(-k * step)
        total = total + np.longdouble(weights[k]) * (function(k * step) + (back if order == 2 else -back))
    return total / weights[4] / step**order


@MACHINES
def test_round_trip_of_50000_poses(machine):
    poses = reachable(machine, 50_000, seed=1)
    joints = machine.inverse(poses)
    closed, newton = machine.forward(joints), machine.forward_newton(joints)
    assert np.abs(joints - slider_heights(machine.geometry, poses)[0]).max() < 1e-9  # worst at the border
    assert np.abs(closed - poses).max() <= 1e-12
    assert np.abs(newton - poses).max() <= 1e-12
    assert np.abs(machine.inverse(closed) - joints)[machine.reciprocal_condition(poses) > 0.1].max() <= 1e-12
    assert machine.violations(poses[:1000]) == []
    assert machine.joint_violations(joints[:1000]) == []


@MACHINES
def test_inverse_closes_the_vector_chain(machine):
    poses = reachable(machine, 2000, seed=2, margin=0.05)
    assert np.abs(machine.inverse(poses) - slider_heights(machine.geometry, poses)[0]).max() < 1e-14


def test_known_poses():
    height = math.sqrt(0.6**2 - 0.363**2)
    assert NOMINAL.inverse((0.0, 0.0, 0.0)) == pytest.approx([height] * 3, abs=1e-15)
    assert NOMINAL.inverse((0.0, 0.0, -0.25)) == pytest.approx([height - 0.25] * 3, abs=1e-15)
    # 0.1 m along the azimuth of column 1: strut 1 spans 0.263 m, the others the side of a triangle with 120 deg
    x, y = 0.1 * math.cos(math.radians(45.0)), 0.1 * math.sin(math.radians(45.0))
    far = math.sqrt(0.6**2 - (0.363**2 + 0.1**2 + 0.363 * 0.1))
    assert NOMINAL.inverse((x, y, 0.0)) == pytest.approx([math.sqrt(0.6**2 - 0.263**2), far, far], abs=1e-15)
    assert NOMINAL.forward((height, height, height)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)


def test_tool_vector_leads_from_platform_to_tcp():
    tool = (0.02, -0.03, -0.11)
    with_tool = Tripod(Tripod.Geometry(tool=tool))
    poses = reachable(NOMINAL, 100, seed=3, margin=0.1)
    assert np.abs(with_tool.inverse(poses + tool) - NOMINAL.inverse(poses)).max() < 1e-14


@MACHINES
def test_forward_agrees_with_a_general_solver(machine):
    base, platform, lengths = (part.astype(float) for part in chain(machine.geometry))
    for pose in reachable(machine, 10, seed=4, margin=0.1):
        joints = machine.inverse(pose)

        def excess_length(tcp, joints=joints):
            sliders = base + np.outer(joints, (0.0, 0.0, 1.0))
            return np.linalg.norm(tcp - machine.geometry.tool + platform - sliders, axis=1) - lengths

        solution = fsolve(excess_length, pose + np.array((0.01, -0.02, -0.03)), xtol=1e-13)
        assert np.abs(machine.forward(joints) - solution).max() < 1e-11


def test_a_common_height_of_the_sliders_costs_no_accuracy():
    poses = reachable(NOMINAL, 1000, seed=5, margin=0.05)
    joints = NOMINAL.inverse(poses)
    lifted = NOMINAL.forward(joints + 8.0)
    assert np.abs(lifted[:, :2] - poses[:, :2]).max() < 1e-13 / 0.02  # the joints themselves are rounded to 9e-16


@MACHINES
def test_newton_converges_in_four_steps_from_a_centimetre_away(machine, monkeypatch):
    poses = reachable(machine, 1000, seed=6, margin=0.1)
    joints = machine.inverse(poses)
    monkeypatch.setattr(_newton, "NEWTON_STEPS", 4)
    guess = poses + np.array((0.005, -0.005, 0.007))
    assert np.abs(machine.forward_newton(joints, guess) - poses).max() < 1e-12
    monkeypatch.setattr(_newton, "NEWTON_STEPS", 2)
    with pytest.raises(UnreachableError, match=r"^row 0: Newton's method does not lead"):  # unfinished is not returned
        machine.forward_newton(joints, guess)


def test_newton_takes_any_guess_below_the_sliders_and_refuses_those_above():
    pose = np.array((0.12, -0.05, 0.03))
    joints = NOMINAL.inverse(pose)
    for guess in itertools.product((-3.0, 0.0, 2.0), (-1.0, 4.0), (-9.0,)):
        assert NOMINAL.forward_newton(joints, guess) == pytest.approx(pose, abs=1e-13)
    with pytest.raises(UnreachableError, match=r"^row 1: Newton's method does not lead from the guess \(0\.000, 0\.0"):
        NOMINAL.forward_newton([joints, joints], [(0.0, 0.0, -1.0), (0.0, 0.0, 2.0)])


@MACHINES
def test_jacobian_and_its_inverse(machine):
    poses = reachable(machine, 500, seed=7, margin=0.1)
    jacobian, inverse = machine.jacobian(poses), machine.inverse_jacobian(poses)
    for column, unit in enumerate(np.eye(3)):
        expected = derivative(lambda s, e=unit: slider_heights(machine.geometry, poses + s * e)[0], 1, 3e-5)
        assert np.abs(jacobian[:, :, column] - expected).max() < 1e-12
    assert np.abs(np.einsum("kij,kjl->kil", jacobian, inverse) - np.eye(3)).max() < 1e-12
    assert np.abs(np.einsum("kij,kjl->kil", inverse, jacobian) - np.eye(3)).max() < 1e-12
    joints = machine.inverse(poses[:20])
    for column, unit in enumerate(np.eye(3)):
        moved = [machine.forward(joints + sign * 1e-5 * unit) for sign in (1.0, -1.0)]
        assert np.abs(inverse[:20, :, column] - (moved[0] - moved[1]) / 2e-5).max() < 1e-7


@MACHINES
def test_second_derivative_along_straight_lines(machine):
    poses = reachable(machine, 500, seed=8, margin=0.15)
    directions = np.random.default_rng(9).normal(size=poses.shape)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    expected = derivative(lambda s: slider_heights(machine.geometry, poses + s * directions)[0], 2, 1e-4)
    assert np.abs(machine.second_derivative(poses, directions) - expected).max() < 1e-9
    one = machine.second_derivative(poses, (0.0, 0.0, 1.0))
    assert not one.any()  # along the columns the sliders move as the TCP does


@MACHINES
def test_motion_agrees_with_differences_of_a_curved_path(machine):
    poses = reachable(machine, 300, seed=10, margin=0.15)
    rng = np.random.default_rng(11)
    velocity, acceleration, jerk = rng.normal(scale=(0.3, 1.0, 5.0), size=(300, 3, 3)).transpose(2, 0, 1)

    def path(t):
        return slider_heights(machine.geometry, poses + t * velocity + t**2 / 2 * acceleration + t**3 / 6 * jerk)[0]

    position, speed, rate = machine.motion(poses, velocity, acceleration)
    assert np.array_equal(position, machine.inverse(poses))
    assert np.abs(speed - derivative(path, 1, 1e-4)).max() < 1e-11
    assert np.abs(rate - derivative(path, 2, 1e-4)).max() < 1e-8
    assert np.abs(speed - np.einsum("kij,kj->ki", machine.jacobian(poses), velocity)).max() < 1e-13


@MACHINES
def test_array_rows_equal_single_poses_bit_for_bit(machine):
    poses = reachable(machine, 203, seed=12)
    velocity, acceleration = np.random.default_rng(13).normal(size=(2, *poses.shape))
    joints = machine.inverse(poses)
    guess = poses + np.array((0.02, 0.01, -0.03))
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
    poses = reachable(NOMINAL, 24, seed=14).reshape(2, 3, 4, 3)
    kept = poses.copy()
    joints = NOMINAL.inverse(poses)
    guess = np.array((0.0, 0.0, -4.0))
    assert joints.shape == poses.shape
    assert NOMINAL.forward_newton(joints, guess).shape == poses.shape
    assert NOMINAL.jacobian(poses).shape == (2, 3, 4, 3, 3)
    assert NOMINAL.reciprocal_condition(poses).shape == (2, 3, 4)
    assert NOMINAL.motion(poses, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))[2].shape == poses.shape
    assert NOMINAL.inverse(np.empty((0, 3))).shape == NOMINAL.forward_newton(np.empty((0, 3))).shape == (0, 3)
    assert NOMINAL.violations(np.empty((0, 3))) == []
    assert np.array_equal(poses, kept)
    assert guess.tolist() == [0.0, 0.0, -4.0]


@settings(derandomize=True, deadline=None)
@given(st.floats(0.0, 0.23), st.floats(-math.pi, math.pi), st.floats(-1.0, 1.0))
def test_a_turn_by_120_degrees_exchanges_the_struts(radius, angle, z):
    here, turned = (
        NOMINAL.inverse((radius * math.cos(phi), radius * math.sin(phi), z)) for phi in (angle, angle + math.tau / 3.0)
    )
    assert np.roll(here, 1) == pytest.approx(turned, abs=1e-13)


def exact_slider(geometry, strut, tcp):
    """u of one strut from |B + E - (P - W + A)| = L, solved for u by mpmath; the upper root."""
    phi, exact = geometry.azimuth[strut], mpmath.mpf
    radius = exact(geometry.base_radius) + geometry.base_radius_error[strut]
    turned = exact(phi) + geometry.azimuth_error[strut]
    length = exact(geometry.strut_length) + geometry.strut_length_error[strut]
    x, y, z = (p - exact(w) for p, w in zip(tcp, geometry.tool, strict=True))
    x = radius * mpmath.cos(turned) - x - exact(geometry.platform_radius) * mpmath.cos(phi)
    y = radius * mpmath.sin(turned) - y - exact(geometry.platform_radius) * mpmath.sin(phi)
    # u^2 + p u + q = 0 of the squared closure, with p = 2 (H - z)
    p = 2 * (exact(geometry.base_height[strut]) - z)
    q = x * x + y * y + (p / 2) ** 2 - length * length
    return -p / 2 + mpmath.sqrt(p * p / 4 - q)


@pytest.mark.parametrize("machine", [BUILT, WARPED], ids=["built", "warped"])
def test_derivatives_against_differences_of_the_closure_in_50_digits(machine):
    rng = np.random.default_rng(20)
    for pose in reachable(machine, 12, seed=21, margin=0.1):
        exact = [mpmath.mpf(float(p)) for p in pose]
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        jacobian, second = machine.jacobian(pose), machine.second_derivative(pose, direction)
        with mpmath.workdps(50):
            for strut in range(3):

                def along(s, way, strut=strut, exact=exact):
                    return exact_slider(machine.geometry, strut, [p + s * w for p, w in zip(exact, way, strict=True)])

                assert machine.inverse(pose)[strut] == pytest.approx(float(along(0, (0, 0, 0))), abs=1e-15)
                for column, unit in enumerate(np.eye(3).tolist()):
                    slope = mpmath.diff(partial(along, way=unit), 0)
                    assert jacobian[strut, column] == pytest.approx(float(slope), abs=1e-13)
                bend = mpmath.diff(partial(along, way=direction.tolist()), 0, 2)
                assert second[strut] == pytest.approx(float(bend), rel=1e-12, abs=1e-12)


def test_unequal_struts_enter_the_forward_kinematics_by_their_squares():
    """Sliders level, so the planes between the spheres are vertical: the TCP's place follows by hand."""
    lengths = np.array((0.61, 0.58, 0.60))
    machine = Tripod(Tripod.Geometry(strut_length_error=tuple((lengths - 0.6).tolist())))
    columns = 0.363 * np.stack([np.cos(NOMINAL.geometry.azimuth), np.sin(NOMINAL.geometry.azimuth)], axis=1)
    # columns at equal distance from the axis: 2 (c_1 - c_i) . P = L_i^2 - L_1^2
    place = np.linalg.solve(2.0 * (columns[0] - columns[1:]), lengths[1:] ** 2 - lengths[0] ** 2)
    depth = math.sqrt(lengths[0] ** 2 - ((place - columns[0]) ** 2).sum())
    assert np.linalg.norm(place) > 0.01
    for forward in (machine.forward, machine.forward_newton):
        assert forward((0.5, 0.5, 0.5)) == pytest.approx([*place, 0.5 - depth], abs=1e-15)


def test_a_base_point_that_is_higher_is_a_slider_that_is_lower():
    height = np.array((0.02, -0.03, 0.1))
    lifted = Tripod(Tripod.Geometry(base_height=tuple(height.tolist())))
    poses = reachable(NOMINAL, 100, seed=22, margin=0.1)
    assert np.abs(lifted.inverse(poses) + height - NOMINAL.inverse(poses)).max() < 1e-15
    assert np.abs(lifted.forward(NOMINAL.inverse(poses) - height) - poses).max() < 1e-14


def test_a_turned_column_leaves_its_platform_joint_where_it_is():
    """Strut 1 of a machine whose column 1 is turned by 90 deg, at the origin: it spans from column to joint."""
    machine = Tripod(Tripod.Geometry(azimuth=(0.0, 2.0, 4.0), azimuth_error=(math.pi / 2.0, 0.0, 0.0)))
    span = math.hypot(0.513, 0.150)
    assert machine.inverse((0.0, 0.0, 0.0))[0] == pytest.approx(math.sqrt(0.6**2 - span**2), abs=1e-15)


def test_struts_of_unequal_length_that_just_meet_are_told_so():
    machine = Tripod(Tripod.Geometry(strut_length_error=(0.05, -0.02, 0.03)))
    [violation] = machine.joint_violations((0.4, 0.4, 1.9))
    assert violation.axis == "u3"
    # with the strut at fault, and the others, longer by the same square they meet, with a little less they do not
    squares = np.array((0.65, 0.58, 0.63)) ** 2
    missing = (0.63 + violation.excess) ** 2 - 0.63**2
    for share, meets in ((1.000001, True), (0.999999, False)):
        longer = np.sqrt(squares + share * missing) - 0.6
        other = Tripod(Tripod.Geometry(strut_length_error=tuple(longer.tolist())))
        assert ("do not meet" not in " ".join(map(str, other.joint_violations((0.4, 0.4, 1.9))))) == meets


def test_neutral_errors_change_no_bit():
    """The columns of a machine as drawn stand where the formula without errors puts them, to the last bit."""
    phi = NOMINAL.geometry.azimuth[1]
    dx, dy = 0.1 - (0.513 - 0.15) * math.cos(phi), 0.2 - (0.513 - 0.15) * math.sin(phi)
    assert NOMINAL.inverse((0.1, 0.2, 0.3))[1] == 0.3 + math.sqrt(0.6 * 0.6 - (dx * dx + dy * dy))


def test_unreachable_pose_names_row_strut_and_excess():
    column = np.array((0.363 * math.cos(math.radians(165.0)), 0.363 * math.sin(math.radians(165.0))))
    outward = -column / np.linalg.norm(column)
    far = (*(column + 0.609 * outward), 0.1)
    with pytest.raises(
        UnreachableError,
        match=r"^row 1: strut u2: the TCP is 9 mm too far from its slider column \(horizontal span 609\.000 mm > "
        r"strut length 600\.000 mm\)$",
    ):
        NOMINAL.inverse([(0.0, 0.0, 0.0), far])
    with pytest.raises(UnreachableError, match=r"^strut u2: the TCP is 9 mm too far"):
        NOMINAL.inverse(far)
    [violation] = NOMINAL.violations([(0.0, 0.0, 0.0), far])
    assert (violation.row, violation.axis) == (1, "u2")
    assert violation.excess == pytest.approx(0.009, abs=1e-15)


@MACHINES
def test_violations_are_exactly_the_poses_out_of_reach(machine):
    rng = np.random.default_rng(15)
    poses = rng.uniform(-0.8, 0.8, (2000, 3))
    heights = slider_heights(machine.geometry, poses)[1]
    found = machine.violations(poses)
    assert [(v.row, v.axis) for v in found] == [(row, f"u{strut + 1}") for row, strut in np.argwhere(np.isnan(heights))]
    for row in {v.row for v in found}:
        with pytest.raises(UnreachableError, match=r"^strut u[123]: the TCP is"):
            machine.inverse(poses[row])
    # moved back towards its column by a little more than the excess, the strut reaches again
    for v in found[:200]:
        strut = int(v.axis[1]) - 1
        base, platform, _ = (part.astype(float) for part in chain(machine.geometry))
        column = (base - platform)[strut, :2] + machine.geometry.tool[:2]
        way = (column - poses[v.row, :2]) / np.linalg.norm(column - poses[v.row, :2])
        for share, free in ((0.999999, False), (1.000001, True)):
            moved = np.append(poses[v.row, :2] + share * v.excess * way, 0.0)
            assert (v.axis not in {w.axis for w in machine.violations(moved)}) == free


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
def test_what_is_not_a_position_is_refused(bad):
    for column, name in enumerate("xyz"):
        pose = [0.01, 0.02, 0.03]
        pose[column] = bad
        if math.isfinite(bad) and name == "z":
            continue  # far away, but the columns are endless
        message = f"^{name}: {bad} is not a finite" if not math.isfinite(bad) else "^strut u1: the TCP is 1e"
        with pytest.raises(UnreachableError, match=message):
            NOMINAL.inverse(pose)
        with pytest.raises(UnreachableError, match=f"^row 1: {message[1:]}"):
            NOMINAL.motion([[0.0] * 3, pose], [0.0] * 3, [0.0] * 3)
        joints = [0.5, 0.5, 0.5]
        joints[column] = bad
        for forward in (NOMINAL.forward, NOMINAL.forward_newton):
            with pytest.raises(UnreachableError, match=rf"u{column + 1}: "):
                forward(joints)
            with pytest.raises(UnreachableError, match=rf"^row 2: .*u{column + 1}: "):
                forward([[0.5] * 3, [0.5] * 3, joints])
        if not math.isfinite(bad):
            with pytest.raises(UnreachableError, match=f"^v{name}: {bad} is not a finite number$"):
                NOMINAL.motion([0.0] * 3, np.where(np.arange(3) == column, bad, 0.0), [0.0] * 3)
            with pytest.raises(UnreachableError, match=f"^row 0: a{name}: {bad} is not a finite number"):
                NOMINAL.motion([[0.0] * 3] * 2, [0.0] * 3, np.where(np.arange(3) == column, bad, 0.0))


def mirrored(machine, poses, struts):
    """Joints that hold the platform at `poses`, but with the sliders of `struts` mirrored to below the platform."""
    joints, heights = slider_heights(machine.geometry, poses)
    joints[:, struts] -= 2 * heights[:, struts]
    return joints.astype(float)


@MACHINES
@pytest.mark.parametrize("forward", ["forward", "forward_newton"])
def test_never_a_pose_with_the_platform_above_a_slider(machine, forward):
    poses = reachable(machine, 80, seed=16, margin=0.01)
    refused = 0
    for struts in ([0], [1], [2], [0, 1], [1, 2], [0, 2], [0, 1, 2]):
        for joints, violations in (
            (joints, machine.joint_violations(joints)) for joints in mirrored(machine, poses, struts)
        ):
            try:
                tcp = getattr(machine, forward)(joints)
            except UnreachableError:
                assert violations
                refused += 1
                continue
            assert not violations
            # these sliders hold the platform in a right pose too: it is that one and not the one it was made of
            assert (tcp[2] - machine.geometry.tool[2] < joints + machine.geometry.base_height).all()
            assert np.abs(machine.inverse(tcp) - joints).max() < 1e-9
    assert refused > 80


def test_wrong_branch_names_slider_and_excess():
    height = math.sqrt(0.6**2 - 0.363**2)
    joints = (height, -height, height)
    [violation] = NOMINAL.joint_violations([(0.5, 0.5, 0.5), joints])
    assert (violation.row, violation.axis) == (1, "u2")
    assert violation.excess == pytest.approx(height, abs=1e-14)
    for forward in (NOMINAL.forward, NOMINAL.forward_newton):
        with pytest.raises(
            UnreachableError, match=r"^slider u2: wrong assembly branch: it would be 477\.7 mm below the platform$"
        ):
            forward(joints)


def test_struts_that_do_not_meet_name_slider_and_excess():
    joints = np.array((0.4, 0.4, 1.9))
    points = [
        np.array((0.363 * math.cos(phi), 0.363 * math.sin(phi), u))
        for phi, u in zip(NOMINAL.geometry.azimuth, joints, strict=True)
    ]
    a, b, c = (float(np.linalg.norm(points[i] - points[j])) for i, j in ((0, 1), (1, 2), (2, 0)))
    s = (a + b + c) / 2.0
    radius = a * b * c / (4.0 * math.sqrt(s * (s - a) * (s - b) * (s - c)))  # circumscribed circle, after Heron
    [violation] = NOMINAL.joint_violations(joints)
    assert (violation.row, violation.axis) == (None, "u3")
    assert violation.excess == pytest.approx(radius - 0.6, abs=1e-12)
    for forward in (NOMINAL.forward, NOMINAL.forward_newton):
        with pytest.raises(UnreachableError, match=r"^slider u3: the struts do not meet.* 1500\.000 mm above the"):
            forward(joints)


def test_forward_returns_exactly_what_inverse_accepts():
    joints = np.random.default_rng(17).uniform(-0.5, 1.0, (3000, 3))
    refused = {violation.row for violation in NOMINAL.joint_violations(joints)}
    good = np.array([row for row in range(len(joints)) if row not in refused])
    assert 500 < len(good) < 2500
    assert NOMINAL.violations(NOMINAL.forward(joints[good])) == []
    for row in refused:
        with pytest.raises(UnreachableError):
            NOMINAL.forward(joints[row])


def test_condition_of_the_nominal_machine():
    assert NOMINAL.reciprocal_condition((0.0, 0.0, 0.4)) == pytest.approx(
        # rows (-d_i / h, 1), 120 deg apart: singular values sqrt(3/2) R/h twice and sqrt(3)
        math.sqrt(1.5) * 0.363 / math.sqrt(0.6**2 - 0.363**2) / math.sqrt(3.0),
        abs=1e-14,
    )
    poses = reachable(NOMINAL, 5000, seed=18)
    assert (NOMINAL.reciprocal_condition(poses) > tolerances.SINGULAR).all()
    determinants = np.linalg.det(NOMINAL.jacobian(poses))
    assert (np.abs(determinants) > 0.2).all()  # equal spacing: the three struts never come into one plane
    assert len(set(np.sign(determinants))) == 1


def test_singularity_inside_a_workspace_is_found_and_what_is_beyond_refused():
    """A machine made to be singular: its struts at one pose are three radii of one inclined circle."""
    turns = np.array((0.1, 0.7, 1.2))
    joints = 0.6 * np.column_stack((np.cos(turns), 0.5 * np.sin(turns), math.sqrt(0.75) * np.sin(turns)))
    (ax, ay), (bx, by) = joints[1, :2] - joints[0, :2], joints[2, :2] - joints[0, :2]
    ux, uy = by * (ax**2 + ay**2) - ay * (bx**2 + by**2), ax * (bx**2 + by**2) - bx * (ax**2 + ay**2)
    axis = joints[0, :2] + np.array((ux, uy)) / (2.0 * (ax * by - ay * bx))  # centre of the circle through the columns
    offset = float(np.linalg.norm(joints[0, :2] - axis))
    azimuth = np.arctan2(joints[:, 1] - axis[1], joints[:, 0] - axis[0])
    machine = Tripod(Tripod.Geometry(base_radius=offset + 0.1, platform_radius=0.1, azimuth=tuple(azimuth.tolist())))
    singular = np.append(-axis, 0.0)
    across = np.array((0.0, 1e-3, 0.0))
    assert np.abs(slider_heights(machine.geometry, singular)[1] - joints[:, 2]).max() < 1e-14

    usable = [machine.violations(singular + side * across) == [] for side in (-1.0, 1.0)]
    assert sorted(usable) == [False, True]
    good = across if usable[1] else -across
    assert machine.forward(machine.inverse(singular + good)) == pytest.approx(singular + good, abs=1e-12)
    beyond = singular - good
    with pytest.raises(UnreachableError, match=r"^strut u1: wrong assembly branch: the TCP is .* mm above the plane"):
        machine.inverse(beyond)
    hidden = slider_heights(machine.geometry, beyond)[0][0].astype(float)
    plane = np.linalg.solve(np.column_stack((joints[:, :2] - axis, np.ones(3))), hidden)
    [violation] = machine.violations([singular + good, beyond])
    assert violation.excess == pytest.approx(-(plane @ np.append(beyond[:2], 1.0)), abs=1e-12)
    assert (machine.forward(hidden) != beyond).any()

    [violation] = machine.violations(singular + 1e-8 * good)
    assert violation.axis == "u1"
    assert violation.reason.startswith("strut u1: singular pose: reciprocal condition ")
    assert 0.0 < violation.excess <= tolerances.SINGULAR


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strut_length": 0.363}, r"geometry\.strut_length: 0\.363 m is not above 0\.363 m"),
        ({"strut_length": -1.0}, r"geometry\.strut_length: -1\.0 m is not above 0\.0 m"),
        ({"strut_length": math.nan}, r"geometry\.strut_length: nan is not a finite number"),
        ({"platform_radius": 1.2}, r"geometry\.strut_length: 0\.6 m is not above 0\.687 m"),
        ({"platform_radius": 0.513}, r"geometry\.platform_radius: 0\.513 m equals geometry\.base_radius"),
        ({"azimuth": (0.0, 1.0, 1.0)}, r"geometry\.azimuth: 0\.0, 1\.0, 1\.0 rad: two columns stand at the same"),
        ({"azimuth": (0.0, 1.0, math.tau)}, r"geometry\.azimuth: .* two columns stand at the same"),
        ({"azimuth": (0.0, 1.0)}, r"geometry\.azimuth: 2 numbers given, 3 wanted"),
        ({"tool": (0.0, math.nan, 0.0)}, r"geometry\.tool\[1\]: nan is not a finite number"),
        ({"base_radius": 0.0}, r"geometry\.base_radius: 0\.0 m is not above 0\.0 m"),
        (
            {"strut_length_error": (0.0, -0.3, 0.0)},
            r"geometry\.strut_length: 0\.3 m is not above 0\.363 m, the distance that strut u2 .* errors included",
        ),
        ({"base_radius_error": (0.0, 0.0, 0.25)}, r"geometry\.strut_length: 0\.6 m is not above 0\.613 m.* strut u3"),
        (
            {"strut_length_error": (-0.6, 0.0, 0.0)},
            r"geometry\.strut_length_error\[0\]: -0\.6 m leaves 0 m of geometry\.strut_length: it must stay above 0",
        ),
        (
            {"base_radius_error": (0.0, 0.0, -0.513)},
            r"geometry\.base_radius_error\[2\]: -0\.513 m leaves 0 m of geometry\.base_radius: it must stay above 0",
        ),
        (
            {"azimuth": (0.0, 0.5, 3.0), "azimuth_error": (0.5, 0.0, 0.0)},
            r"geometry\.azimuth: .* two columns stand at the same place, those of u1 and u2, errors included",
        ),
        (  # columns and platform joints apart, but one less the other in one line
            {
                "azimuth": (0.0, math.pi / 2.0, math.pi),
                "platform_radius": 0.2,
                "base_radius_error": (0.0, 0.2 - 0.513, 0.0),
            },
            r"geometry\.azimuth: .* the columns less their platform joints stand in one line",
        ),
        ({"strut_length_error": (0.0, math.nan, 0.0)}, r"geometry\.strut_length_error\[1\]: nan is not a finite"),
        ({"base_radius_error": (math.inf, 0.0, 0.0)}, r"geometry\.base_radius_error\[0\]: inf is not a finite"),
        ({"azimuth_error": (0.0, 0.0, math.nan)}, r"geometry\.azimuth_error\[2\]: nan is not a finite number"),
        ({"base_height": (0.0, -math.inf, 0.0)}, r"geometry\.base_height\[1\]: -inf is not a finite number"),
        ({"base_height": (0.0, 0.0)}, r"geometry\.base_height: 2 numbers given, 3 wanted"),
    ],
)
def test_geometry_that_cannot_be_built_is_refused_with_its_key(changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Tripod(dataclasses.replace(Tripod.Geometry(), **changes))


@MACHINES
def test_sketch_is_the_machine(machine):
    pose = reachable(machine, 1, seed=19, margin=0.1)[0]
    joints = machine.inverse(pose)
    lines = dict(machine.sketch(joints, pose))
    assert list(lines) == [
        *(f"{part} {axis}" for axis in machine.axes for part in ("column", "strut")),
        "platform",
        "tool",
    ]
    geometry = machine.geometry
    base, platform, lengths = chain(geometry)
    for index, (axis, u) in enumerate(zip(machine.axes, joints, strict=True)):
        top, bottom = lines[f"strut {axis}"]
        assert np.linalg.norm(top - bottom) == pytest.approx(float(lengths[index]), abs=1e-14)
        assert np.abs(top - base[index] - (0.0, 0.0, u)).max() < 1e-15
        assert np.abs(bottom - (pose - geometry.tool) - platform[index]).max() < 1e-15
        column = lines[f"column {axis}"]
        assert (column[:, :2] == top[:2]).all()
        assert column[0, 2] <= geometry.base_height[index]
        assert column[0, 2] <= top[2] <= column[1, 2]
        assert (lines["platform"][index] == bottom).all()
    assert (lines["platform"][0] == lines["platform"][3]).all()
    assert lines["tool"][1] == pytest.approx(pose, abs=0.0)
    assert lines["tool"][0] == pytest.approx(pose - geometry.tool, abs=0.0)
    assert all(points.shape[1:] == (3,) for points in lines.values())
