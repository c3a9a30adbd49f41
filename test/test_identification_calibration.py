"""Geometric calibration against machines computed here, from their closures, not by the kinematics under test."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from pkm_cnc.config import load_setup, setup_from_text
from pkm_cnc.errors import InputError
from pkm_cnc.identification import (
    Believed,
    Bench,
    Circle,
    Positions,
    by_approach,
    calibrate,
    calibrate_by_networks,
    calibrated_setup,
    calibrated_yaml,
    positioning,
    unknowns_of,
    with_values,
)

MONOPOD, BIPOD, TRIPOD = (load_setup(name) for name in ("monopod", "bipod", "tripod"))
GAMMA, DX, DU = 0.002, 0.0005, -0.0003
TARGETS = np.linspace(0.300, 0.520, 12)


def monopod_tcp(u, gamma=GAMMA, dx=DX, du=DU):
    """x of the slider positions u: 4-10, the strut closing at x0 = 0.3, u0 = sqrt(0.36 - 0.09)."""
    big_u0, big_x0, sine = math.sqrt(0.27) + du, 0.3 + dx, math.sin(gamma)
    square = big_u0**2 + 2.0 * big_u0 * big_x0 * sine + big_x0**2
    big_u = u + du
    return -big_u * sine + np.sqrt((big_u * sine) ** 2 - big_u**2 + square) - dx


def monopod_measured() -> Positions:
    u = np.sqrt(0.36 - TARGETS**2)
    return Positions(u[:, None], monopod_tcp(u)[:, None])


def grid(half, places, center):
    steps = np.linspace(-half, half, places)
    return np.array([(x, y) for x in steps for y in steps]) + center


def bipod_joints(tcp, lengths, offsets, heights):
    """u_i = y - sqrt(L_i^2 - (x -+ b - offset)^2) - height_i."""
    return np.stack(
        [
            tcp[:, 1] - np.sqrt((0.6 + lengths[i]) ** 2 - (tcp[:, 0] - side * 0.2 - offsets[i]) ** 2) - heights[i]
            for i, side in enumerate((1.0, -1.0))
        ],
        axis=1,
    )


def tripod_joints(tcp, lengths, radii, angles, heights):
    """u_i = z + sqrt(L_i^2 - |B_i - A_i - (x, y)|^2) - H_i."""
    rows = []
    for i, azimuth in enumerate(np.radians((45.0, 165.0, 285.0))):
        there = azimuth + angles[i]
        x = (0.513 + radii[i]) * np.cos(there) - 0.150 * np.cos(azimuth)
        y = (0.513 + radii[i]) * np.sin(there) - 0.150 * np.sin(azimuth)
        rows.append(
            tcp[:, 2] + np.sqrt((0.6 + lengths[i]) ** 2 - (tcp[:, 0] - x) ** 2 - (tcp[:, 1] - y) ** 2) - heights[i]
        )
    return np.stack(rows, axis=1)


def drawn(*sizes, seed=3):
    """Errors of assembly up to 0.5 mm and 0.5 mrad."""
    generator = np.random.default_rng(seed)
    return [generator.uniform(1e-4, 5e-4, size) * generator.choice((-1.0, 1.0), size) for size in sizes]


def values(calibration):
    return np.array([estimate.value for estimate in calibration.estimates])


# --- least squares without noise: what is observable comes out to 1e-6


def test_least_squares_finds_the_monopod():
    found = calibrate(MONOPOD.kinematics, monopod_measured())
    np.testing.assert_allclose(values(found), (GAMMA, DX, DU), rtol=1e-6)
    assert [estimate.status for estimate in found.estimates] == ["estimated"] * 3
    assert found.rank == 3
    assert np.abs(found.before).max() > 1e-4
    assert np.abs(found.after).max() < 1e-12


def test_a_length_that_does_not_follow_from_the_start_point_is_found_too():
    machine = load_setup("monopod", ["geometry.closure=given"]).kinematics
    u = np.sqrt(0.36 - TARGETS**2)
    big_u, sine, length = u + DU, math.sin(GAMMA), 0.6004
    x = -big_u * sine + np.sqrt((big_u * sine) ** 2 - big_u**2 + length**2) - DX
    found = calibrate(machine, Positions(u[:, None], x[:, None]))
    np.testing.assert_allclose(values(found), (GAMMA, DX, DU, 0.0004), rtol=1e-6)


def test_least_squares_finds_the_bipod():
    errors, tcp = drawn(2, 2, 2), grid(0.1, 5, (0.0, 0.0))
    found = calibrate(BIPOD.kinematics, Positions(bipod_joints(tcp, *errors), tcp))
    np.testing.assert_allclose(values(found), np.concatenate(errors), rtol=1e-6)


def test_least_squares_finds_all_twelve_of_the_tripod_on_one_level():
    errors = drawn(3, 3, 3, 3)
    tcp = np.column_stack((grid(0.1, 5, (0.0, 0.0)), np.full(25, -0.02)))
    found = calibrate(TRIPOD.kinematics, Positions(tripod_joints(tcp, *errors), tcp))
    assert found.rank == 12
    np.testing.assert_allclose(values(found), np.concatenate(errors), rtol=1e-6)


# --- a platform that tilts moves the TCP by shares of x and y; only those show


SHARE_X, SHARE_Y = 9.6e-5, -3.6e-5
"""Tilt about y, and about x, by the height of the TCP over its centre."""


def tilted_tripod(errors, z=-0.02):
    """The struts carry the level platform; what is measured is beside it."""
    level = np.column_stack((grid(0.1, 5, (0.0, 0.0)), np.full(25, z)))
    measured = level * (1.0 + SHARE_X, 1.0 - SHARE_Y, 1.0)
    return Positions(tripod_joints(level, *errors), measured)


def test_a_tilt_is_found_beside_all_twelve_of_the_tripod():
    errors = drawn(3, 3, 3, 3)
    found = calibrate(TRIPOD.kinematics, tilted_tripod(errors), tilt=True)
    assert found.rank == 14
    np.testing.assert_allclose(values(found), [*np.concatenate(errors), SHARE_X, SHARE_Y], rtol=1e-6)
    assert [estimate.unknown.key for estimate in found.estimates[-2:]] == ["actual.tilt.about_y", "actual.tilt.about_x"]


def test_a_tilt_that_is_not_looked_for_is_taken_for_geometry_but_not_all_of_it():
    """6.3 um of shift (RMS of x and y) become 0.3 um of deviation, and lengths of struts that are wrong."""
    measured = tilted_tripod(drawn(3, 3, 3, 3))
    level, tilted = (calibrate(TRIPOD.kinematics, measured, tilt=tilt) for tilt in (False, True))
    assert 0.1e-6 < level.scatter < 1e-6
    assert tilted.scatter < 1e-11
    assert np.abs(values(level)[:3] - values(tilted)[:3]).max() > 10e-6


def test_a_tilt_is_written_for_the_model_and_not_for_the_controller():
    measured = tilted_tripod(drawn(3, 3, 3, 3))
    found = calibrate(TRIPOD.kinematics, measured, tilt=True)
    again = setup_from_text(calibrated_yaml(TRIPOD, found, ["b"]))
    np.testing.assert_allclose(again.true_tcp(measured.joints), measured.tcp, atol=1e-12)
    assert np.abs(again.machine.forward(measured.joints) - measured.tcp).max() > 5e-6


def test_the_tilt_of_a_machine_that_is_simulated_stays():
    setup = load_setup("tripod", ["actual.geometry.strut_length=0.6001", "actual.tilt.lever=0.1"])
    found = calibrate(setup.kinematics, tilted_tripod(drawn(3, 3, 3, 3)), tilt=True)
    assert calibrated_setup(setup, found).tilt == setup.tilt


def test_a_tilt_needs_a_machine_in_space():
    with pytest.raises(
        InputError, match=r"a bipod moves in x, y: a tilt is estimated on a machine that moves in x, y, z"
    ):
        calibrate(BIPOD.kinematics, bipod_rows(STEPS, STEPS), tilt=True)


# --- a ball bar tells distances: nothing about where and how turned the machine stands


def tripod_circle(errors):
    angle = np.radians(np.arange(0.0, 360.0, 5.0))
    tcp = np.column_stack((0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.0 * angle))
    center = np.zeros_like(tcp)
    return Circle(tripod_joints(tcp, *errors), tripod_joints(center, *errors), np.full(len(angle), 0.1))


def test_a_ball_bar_leaves_four_of_the_tripods_unknowns_alone():
    """Shift in x, y, z and turn about z change no distance."""
    errors = drawn(3, 3, 3, 3)
    found = calibrate(TRIPOD.kinematics, tripod_circle(errors))
    statuses = {estimate.unknown.key: estimate.status for estimate in found.estimates}
    assert found.rank == 8
    assert sum(status == "left alone" for status in statuses.values()) == 4
    lengths = [estimate for estimate in found.estimates if estimate.unknown.name == "strut_length_error"]
    assert all(estimate.status == "estimated" for estimate in lengths)
    np.testing.assert_allclose([estimate.value for estimate in lengths], errors[0], rtol=1e-6)
    for estimate in found.estimates:
        if estimate.status == "left alone":
            assert estimate.value == estimate.before == 0.0
            assert math.isnan(estimate.half_interval)
        elif estimate.unknown.name != "strut_length_error":
            assert estimate.status == "relative"


def test_what_a_ball_bar_found_is_right_for_distances_it_did_not_measure():
    errors = drawn(3, 3, 3, 3)
    machine = calibrate(TRIPOD.kinematics, tripod_circle(errors)).machine
    tcp = np.random.default_rng(4).uniform((-0.12, -0.12, -0.05), (0.12, 0.12, 0.05), (20, 3))
    believed = machine.forward(tripod_joints(tcp, *errors))
    distances = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (tcp, believed)]
    np.testing.assert_allclose(distances[1], distances[0], atol=1e-9)


def test_a_ball_bar_leaves_two_of_the_bipods_unknowns_alone():
    errors = drawn(2, 2, 2)
    angle = np.radians(np.arange(0.0, 360.0, 5.0))
    tcp = 0.1 * np.column_stack((np.cos(angle), np.sin(angle)))
    center = bipod_joints(np.zeros_like(tcp), *errors)
    found = calibrate(BIPOD.kinematics, Circle(bipod_joints(tcp, *errors), center, np.full(len(angle), 0.1)))
    assert found.rank == 4
    assert [estimate.status for estimate in found.estimates].count("left alone") == 2


# --- with noise the intervals keep what they promise


def coverage(calibrations, truth):
    inside = [
        [
            abs(estimate.value - true) <= estimate.half_interval
            for estimate, true in zip(one.estimates, truth, strict=True)
        ]
        for one in calibrations
    ]
    return np.mean(inside, axis=0)


def test_the_intervals_hold_the_truth_as_often_as_they_say():
    measured, generator = monopod_measured(), np.random.default_rng(11)
    found = []
    for _ in range(200):
        noisy = measured.tcp + generator.normal(0.0, 5e-6, measured.tcp.shape)
        found.append(calibrate(MONOPOD.kinematics, Positions(measured.joints, noisy)))
    held = coverage(found, (GAMMA, DX, DU))
    assert (held >= 0.90).all()
    assert (held <= 0.99).all()
    assert np.mean([one.scatter for one in found]) == pytest.approx(5e-6, rel=0.05)


def test_intervals_too_wide_to_fix_a_parameter_are_said_so():
    measured = monopod_measured()
    noisy = measured.tcp + np.random.default_rng(1).normal(0.0, 5e-6, measured.tcp.shape)
    found = calibrate(MONOPOD.kinematics, Positions(measured.joints, noisy))
    assert not any(estimate.fixed for estimate in found.estimates)
    text = calibrated_yaml(MONOPOD, found, ["m.csv"])
    assert text.count("these data do not fix it") == 3


# --- networks


def test_networks_find_the_monopod_to_a_percent_in_seven_iterations():
    found = calibrate_by_networks(MONOPOD.kinematics, monopod_measured(), seed=1)
    np.testing.assert_allclose(values(found.calibration), (GAMMA, DX, DU), rtol=0.01)
    assert found.history.shape == (8, 12)
    assert np.ptp(found.history[-1]) < 1e-3 * np.ptp(found.history[0])
    assert [network.name for network in found.networks] == [
        one.key for one in unknowns_of(Believed(MONOPOD.kinematics))
    ]


def test_networks_are_repeatable_and_their_spread_is_beside_the_intervals():
    measured = monopod_measured()
    noisy = Positions(measured.joints, measured.tcp + np.random.default_rng(2).normal(0.0, 2e-6, (12, 1)))
    first, again = (calibrate_by_networks(MONOPOD.kinematics, noisy, seed=1, iterations=2) for _ in range(2))
    np.testing.assert_array_equal(values(first.calibration), values(again.calibration))
    np.testing.assert_array_equal(first.spread, again.spread)
    halves = np.array([estimate.half_interval for estimate in first.calibration.estimates])
    assert (first.spread > 0.0).all()
    assert (1.96 * first.spread < halves).all()  # a network holds to its band what the data do not tell


def test_networks_refuse_a_machine_beyond_their_band():
    u = np.sqrt(0.36 - TARGETS**2)
    far = Positions(u[:, None], monopod_tcp(u, gamma=0.03)[:, None])
    with pytest.raises(InputError, match="outside the training band"):
        calibrate_by_networks(MONOPOD.kinematics, far)


def test_networks_leave_what_is_not_observable_to_least_squares():
    with pytest.raises(InputError, match=r"tell 8 of 12 unknowns.*least-squares names them"):
        calibrate_by_networks(TRIPOD.kinematics, tripod_circle(drawn(3, 3, 3, 3)))


# --- what cannot be used


def constant(index):
    measured = monopod_measured()
    joints = measured.joints.copy()
    joints[:, index] = joints[0, index]
    return Positions(joints, measured.tcp)


def bipod_rows(x, y):
    tcp = np.column_stack((x, y))
    return Positions(bipod_joints(tcp, (0, 0), (0, 0), (0, 0)), tcp)


STEPS = np.linspace(-0.1, 0.1, 20)


@pytest.mark.parametrize(
    ("setup", "measured", "words"),
    [
        (MONOPOD, constant(0), "u constant in all 12 rows"),
        (BIPOD, bipod_rows(0.01 * STEPS, STEPS), "x moves by 2 mm, at least 10 mm"),
        (BIPOD, dataclasses.replace(bipod_rows(STEPS, STEPS), joints=np.stack((STEPS, 0 * STEPS), 1)), "u2: constant"),
        (MONOPOD, Positions(monopod_measured().joints[1:4], monopod_measured().tcp[1:4]), "3 measured values for 3"),
        (MONOPOD, Positions(10.0 * monopod_measured().joints, monopod_measured().tcp), "do not fit the machine"),
        (
            load_setup("cartesian"),
            Positions(np.ones((3, 3)), np.ones((3, 3))),
            "cartesian has no geometry to calibrate",
        ),
    ],
)
def test_measurements_that_tell_nothing_are_refused(setup, measured, words):
    with pytest.raises(InputError, match=words):
        calibrate(setup.kinematics, measured)


def test_a_direction_without_effect_needs_no_motion():
    """The Bipod's struts turn with x alone: a line along x is enough but for what it measures."""
    found = calibrate(BIPOD.kinematics, bipod_rows(STEPS, 0.0 * STEPS))
    assert found.rank == 6


# --- the machine file


def test_the_estimate_is_what_the_controller_believes():
    found = calibrate(MONOPOD.kinematics, monopod_measured())
    text = calibrated_yaml(MONOPOD, found, ["m.csv"])
    again = setup_from_text(text)
    u = np.sqrt(0.36 - TARGETS**2)
    np.testing.assert_allclose(again.kinematics.forward(u[:, None])[:, 0], monopod_tcp(u), atol=1e-12)
    assert again.actual is again.machine
    for key in ("geometry.inclination 0.002 +- ", "geometry.tcp_offset 0.0005 +- ", "m.csv", "95 % interval"):
        assert key in text


def test_a_machine_that_is_simulated_stays_what_it_was():
    """It inherited dx from the nominal geometry: calibrating the controller must not move it."""
    setup = load_setup("monopod", ["actual.geometry.inclination=0.002"])
    found = calibrate(setup.kinematics, monopod_measured())
    before, after = setup.actual, calibrated_setup(setup, found).actual
    joints = np.sqrt(0.36 - TARGETS**2)[:, None]
    np.testing.assert_array_equal(before.forward(joints), after.forward(joints))


def test_lists_by_strut_are_written_as_lists():
    errors, tcp = drawn(2, 2, 2), grid(0.1, 5, (0.0, 0.0))
    found = calibrate(BIPOD.kinematics, Positions(bipod_joints(tcp, *errors), tcp))
    geometry = setup_from_text(calibrated_yaml(BIPOD, found, ["b"])).kinematics.geometry
    np.testing.assert_allclose(geometry.base_height, errors[2], rtol=1e-6)


# --- statistics of a positioning test


def test_statistics_by_hand():
    """Two positions, two runs, um: s of (a, b) is |a - b| / sqrt 2."""
    up, down = np.array([(0.0, 2.0), (10.0, 10.0)]), np.array([(5.0, 7.0), (14.0, 18.0)])
    test = positioning(np.stack((up, down), axis=1))
    s_up, s_down = np.array((math.sqrt(2.0), 0.0)), np.array((math.sqrt(2.0), math.sqrt(8.0)))
    # x_up 1, 10; x_down 6, 16; x 3.5, 13; U 5, 6; s sqrt 2 both
    assert test.reversal == pytest.approx(5.5)
    assert test.standard_deviation == pytest.approx(math.sqrt(2.0))
    assert test.deviation == pytest.approx(9.5)
    assert test.uncertainty == pytest.approx(13.0 + 3.0 - 3.5 + 2.5 + 6.0 * math.sqrt(2.0))
    assert test.floor == pytest.approx(5.5 + 6.0 * math.sqrt(2.0))
    assert test.systematic == pytest.approx(15.0)
    assert test.accuracy == pytest.approx(16.0 + 2.0 * s_down[1] - (1.0 - 2.0 * s_up[0]))
    assert test.largest_reversal == pytest.approx(6.0)
    assert test.repeatability == pytest.approx(max(4.0 * math.sqrt(2.0) + 5.0, 2.0 * s_down[1] + 6.0, 4.0 * s_down[1]))


def test_the_floor_is_what_a_perfect_calibration_leaves():
    """Thesis table 4-1: 12 and 5.3 um leave 44 um."""
    run = 5.3e-6 * np.array((-1.0, 0.0, 1.0))  # standard deviation 5.3 um
    side = np.array((-6e-6, 6e-6))[:, None]
    test = positioning(np.broadcast_to(side + run, (4, 2, 3)))
    assert test.uncertainty == pytest.approx(test.floor)
    assert test.uncertainty == pytest.approx(43.8e-6)


def test_rows_of_a_test_cycle_are_sorted_by_target_and_side():
    """Up over three targets, overrun, down again; twice."""
    targets = np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0, 1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
    sorted_rows = by_approach(targets, np.arange(12.0))
    np.testing.assert_array_equal(sorted_rows, [[[0, 6], [5, 11]], [[1, 7], [4, 10]], [[2, 8], [3, 9]]])
    with pytest.raises(InputError, match="as often from below as from above"):
        by_approach(targets[:5], np.arange(5.0))


@pytest.mark.parametrize(
    "deviations", [np.zeros((3, 2, 1)), np.zeros((1, 2, 5)), np.zeros(5), np.full((3, 2, 3), np.nan)]
)
def test_what_is_no_positioning_test_is_refused(deviations):
    with pytest.raises(InputError, match="positioning test"):
        positioning(deviations)


def test_the_bench_has_the_reversal_error_and_the_noise_that_it_was_given():
    nominal = Believed(MONOPOD.kinematics)
    truth = with_values(nominal, unknowns_of(nominal), np.array((GAMMA, DX, DU))).machine
    test = Bench(truth, 12e-6, 5e-6).test(MONOPOD.kinematics, TARGETS, 200, np.random.default_rng(1))
    found = positioning(test.deviations)
    assert found.reversal == pytest.approx(12e-6, rel=0.05)
    assert found.standard_deviation == pytest.approx(5e-6, rel=0.05)
    u = np.sqrt(0.36 - TARGETS**2)
    np.testing.assert_allclose(test.measured.mean(axis=(1, 2)), monopod_tcp(u), atol=1e-6)
