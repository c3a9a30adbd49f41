"""Identification of drives: what is put into a machine comes out of its record, with intervals that hold."""

import dataclasses
import math

import mpmath
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from pkm_cnc.array_path import respond
from pkm_cnc.config import load_setup, setup_from_text
from pkm_cnc.errors import InputError
from pkm_cnc.identification import (
    IDENTIFIED,
    AxisData,
    ContourData,
    DriveRun,
    contradictions,
    drive_unknowns,
    fit_drives,
    fit_drives_by_networks,
    frequency_response,
    identified_setup,
    identified_yaml,
    velocity_bandwidth,
)
from pkm_cnc.identification.drive_data import contour_places, scatter
from pkm_cnc.identification.drive_identification import _correlation
from pkm_cnc.plant import AxisPlant, ImperfectAxis
from pkm_cnc.program import Arc, Line
from pkm_cnc.records import AxisSetpoint
from pkm_cnc.servo import DriveParameters, ServoDrive, TransferFunction, position_loop, step_response

PERIOD = 0.001
SINES = ((0.5, 0.020), (2.0, 0.004), (6.0, 0.0006))
"""Hz and m of what is commanded."""


def motion(cycles, period=PERIOD, sines=SINES):
    """Position, velocity and acceleration of sums of 1 - cos, which begin at rest."""
    times = np.arange(cycles) * period
    parts = []
    for frequency, amplitude in sines:
        w = 2.0 * math.pi * frequency
        wave = np.stack([1.0 - np.cos(w * times), w * np.sin(w * times), w * w * np.cos(w * times)])
        parts.append(amplitude * wave)
    return sum(parts)


def stepped(setup, axis, setpoint):
    """Readings of the axis by the objects that step the machine cycle by cycle."""
    parts = setup.axes[axis]
    drive = ServoDrive(parts.drive, setup.servo_period)
    start = setpoint[0, 0]
    if setup.imperfect(axis):
        plant = ImperfectAxis(axis, parts.parts, setup.servo_period, setup.plant.steps, start)
    else:
        plant = AxisPlant(parts.drive, parts.screw, parts.scale, parts.travel, setup.servo_period, start)
    readings = []
    for row in setpoint.T.tolist():
        readings.append(plant.state.position)
        plant.step(drive.step(AxisSetpoint(*row), plant.state))
    return np.array(readings)


def recorded(axis, setpoint, readings):
    path = np.zeros(len(readings))
    return DriveRun("bag", {axis: setpoint}, {axis: readings}, np.zeros((len(path), 3)), path, path.astype(int), (), ())


def cartesian(*overrides):
    return load_setup("cartesian", ["travel.minimum=-1.0", *overrides])


def by_name(fit):
    return {estimate.unknown.name: estimate for estimate in fit.estimates}


@pytest.mark.parametrize(
    "true",
    [
        {"kv": 23.64},
        {"kv": 17.0, "velocity_gain": 12.0, "velocity_feed_forward": 0.3},
        {"kv": 25.0, "velocity_gain": 16.0, "velocity_feed_forward": 0.6, "acceleration_feed_forward": 0.0002},
        {"kv": 22.0, "dead_time": 0.001},
        {"kv": 22.0, "velocity_gain": 13.0, "dead_time": 0.0007, "velocity_feed_forward": 0.5},
    ],
)
def test_without_noise_the_parameters_come_back_to_1e_6(true):
    setup = cartesian("drive.kind=cascade")
    machine = cartesian("drive.kind=cascade", *(f"drive.{name}={value}" for name, value in true.items()))
    setpoint = motion(2000)
    data = AxisData("x", [recorded("x", setpoint, stepped(machine, "x", setpoint))])
    fit = fit_drives(setup, drive_unknowns(setup, ["x"]), data)
    for name, estimate in by_name(fit).items():
        wanted = true.get(name, getattr(setup.axes["x"].drive, name))
        assert estimate.value == pytest.approx(wanted, rel=1e-6, abs=1e-8), name
    assert np.abs(fit.after).max() < 1e-10


def test_a_dead_time_of_an_ideal_velocity_loop_comes_back():
    """Where no velocity loop rounds off the answer, it is told as well as the velocity gain."""
    setup = cartesian("drive.kind=first_order", "drive.velocity_feed_forward=0.5")
    true = dataclasses.replace(setup.axes["x"].drive, kv=23.0, dead_time=0.0017)
    machine = dataclasses.replace(setup, axes={"x": dataclasses.replace(setup.axes["x"], drive=true)})
    setpoint = motion(2000)
    data = AxisData("x", [recorded("x", setpoint, respond(machine, "x", *setpoint).position)])
    found = by_name(fit_drives(setup, drive_unknowns(setup, ["x"]), data))
    assert found["kv"].value == pytest.approx(23.0, rel=1e-6)
    assert found["dead_time"].value == pytest.approx(0.0017, rel=1e-6)
    assert not found["dead_time"].left_alone
    networks, _ = fit_drives_by_networks(setup, drive_unknowns(setup, ["x"]), data, vectors=100)
    assert by_name(networks)["dead_time"].value == pytest.approx(0.0017, rel=0.01)


def test_a_drive_without_feed_forward_does_not_tell_all():
    """Its feed-forwards, whose setting is known, are left alone: they act as another velocity loop does."""
    setup = cartesian("drive.kind=cascade")
    setpoint = motion(2000)
    data = AxisData("x", [recorded("x", setpoint, stepped(setup, "x", setpoint))])
    fit = fit_drives(setup, drive_unknowns(setup, ["x"]), data)
    alone = [name for name, estimate in by_name(fit).items() if estimate.left_alone]
    assert alone == ["velocity_feed_forward", "acceleration_feed_forward"]
    assert fit.singular[-2] < 1e-3 * fit.singular[-3]


def test_with_noise_the_intervals_hold_as_often_as_they_say():
    setup = cartesian("drive.kind=first_order", "servo_period=0.004", "drive.kv=21.5")
    true = {"kv": 22.0, "velocity_feed_forward": 0.2}
    machine = cartesian(
        "drive.kind=first_order", "servo_period=0.004", *(f"drive.{name}={value}" for name, value in true.items())
    )
    setpoint = motion(300, 0.004)
    readings = stepped(machine, "x", setpoint)
    unknowns = [one for one in drive_unknowns(setup, ["x"]) if one.name in true]
    within = dict.fromkeys(true, 0)
    repetitions = 200
    for seed in range(repetitions):
        noisy = readings + np.random.default_rng(seed).normal(0.0, 2e-6, len(readings))
        fit = fit_drives(setup, unknowns, AxisData("x", [recorded("x", setpoint, noisy)]))
        for name, estimate in by_name(fit).items():
            within[name] += abs(estimate.value - true[name]) <= estimate.half_interval
    for name, count in within.items():
        assert 0.90 <= count / repetitions <= 0.99, (name, count)


def test_correlated_deviations_count_for_as_many_as_theory_says():
    """First-order autoregression with r: (1 + r) / (1 - r) of them say as much as one."""
    generator = np.random.default_rng(0)
    r, series = 0.8, np.zeros(100_000)
    noise = generator.normal(size=len(series))
    for k in range(1, len(series)):
        series[k] = r * series[k - 1] + noise[k]
    assert _correlation(series) == pytest.approx((1.0 + r) / (1.0 - r), rel=0.1)
    assert _correlation(noise) == pytest.approx(1.0, abs=0.05)
    assert _correlation(np.zeros(10)) == 1.0


def test_scatter_sees_the_noise_and_not_the_motion():
    x = motion(5000)[0]
    assert scatter(x) < 1e-8
    assert scatter(x + np.random.default_rng(1).normal(0.0, 3e-6, len(x))) == pytest.approx(3e-6, rel=0.05)


def test_networks_come_within_one_percent_whatever_the_threads():
    setup = cartesian("drive.kind=first_order")
    machine = cartesian("drive.kind=first_order", "drive.kv=23.64")
    setpoint = motion(1000)
    data = AxisData("x", [recorded("x", setpoint, stepped(machine, "x", setpoint))])
    answers = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            fit, networks = fit_drives_by_networks(setup, drive_unknowns(setup, ["x"]), data, seed=3)
            answers.append(fit.values)
    assert np.array_equal(*answers)
    estimate = by_name(fit)["kv"]
    assert estimate.value == pytest.approx(23.64, rel=0.01)
    assert estimate.value != 23.64
    assert "x.drive.kv" in networks[0].trained_on
    assert np.nanmax(fit.spread) > 0.0


def test_a_machine_outside_of_the_band_is_refused_by_networks():
    setup = cartesian("drive.kind=first_order")
    machine = cartesian("drive.kind=first_order", "drive.kv=45")
    setpoint = motion(1000)
    data = AxisData("x", [recorded("x", setpoint, stepped(machine, "x", setpoint))])
    with pytest.raises(InputError, match=r"outside the training band.*x\.drive\.kv"):
        fit_drives_by_networks(setup, drive_unknowns(setup, ["x"]), data)


def test_a_drive_far_from_the_file_is_refused_by_least_squares():
    setup = cartesian("drive.kind=first_order", "drive.kv=2")
    machine = cartesian("drive.kind=first_order", "drive.kv=45")
    setpoint = motion(1000)
    data = AxisData("x", [recorded("x", setpoint, stepped(machine, "x", setpoint))])
    with pytest.raises(InputError, match=r"x\.drive\.kv would be"):
        fit_drives(setup, drive_unknowns(setup, ["x"]), data)


def test_too_little_motion_names_what_is_missing():
    setup = cartesian()
    still = np.zeros((3, 500))
    with pytest.raises(InputError, match=r"too little motion to tell x\.drive\.kv: x does not move"):
        fit_drives(setup, drive_unknowns(setup, ["x"]), AxisData("x", [recorded("x", still, still[0])]))
    tiny = 1e-4 * motion(500)
    noisy = tiny[0] + np.random.default_rng(0).normal(0.0, 1e-6, 500)
    with pytest.raises(InputError, match="longer or faster motions"):
        fit_drives(setup, drive_unknowns(setup, ["x"]), AxisData("x", [recorded("x", tiny, noisy)]))


def test_contour_data_need_a_contour():
    with pytest.raises(InputError, match="run a star test and a circular test"):
        ContourData([recorded("x", motion(100), motion(100)[0])])


def test_places_and_errors_on_a_line_and_an_arc():
    line = Line(1, (0.0, 0.0, 0.0), (0.3, 0.4, 0.0), 0.1, False, True)
    place, left, up = contour_places(line, np.array([[0.3 - 0.08, 0.4 + 0.06, 0.002]]), (0, 0.0))
    assert [float(part[0]) for part in (place, left, up)] == pytest.approx([0.5, 0.1, 0.002])
    for sweep, way in ((2.0 * math.pi, 1.0), (-2.0 * math.pi, -1.0)):
        arc = Arc(1, (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.1, False, True, (0.0, 0.0, 0.0), sweep)
        angle = way * np.radians([170.0, 190.0, 350.0])
        tcp = np.stack([0.099 * np.cos(angle), 0.099 * np.sin(angle), 0.003 + 0.0 * angle], axis=1)
        place, left, up = contour_places(arc, tcp, (1, 0.33))
        assert place == pytest.approx(0.1 * np.radians([170.0, 190.0, 350.0]))
        assert left == pytest.approx(way * np.full(3, 0.001))  # inside of a counter-clockwise circle is left
        assert up == pytest.approx(np.full(3, 0.003))


def test_frequency_response_of_a_first_order_lag():
    """dy/dt = kv (x - y), solved exactly between samples of a held setpoint; analytic response of that."""
    kv, cycles = 20.0, 60_000
    generator = np.random.default_rng(2)
    x = np.cumsum(generator.normal(0.0, 1e-4, cycles))
    decay, y = math.exp(-kv * PERIOD), np.zeros(cycles)
    for k in range(1, cycles):
        y[k] = x[k - 1] + decay * (y[k - 1] - x[k - 1])
    found = frequency_response(x, y, PERIOD)
    z = np.exp(2j * np.pi * found.frequency * PERIOD)
    expected = (1.0 - decay) / (z - decay)
    low = found.frequency < 20.0
    assert np.abs(found.response / expected - 1.0)[low].max() < 0.1
    assert found.coherence[low].min() > 0.95
    noisy = frequency_response(x, y + generator.normal(0.0, 1e-4, cycles), PERIOD)
    assert noisy.coherence[-5:].max() < 0.3
    assert np.all(np.diff(found.phase_deg[low]) < 5.0)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (np.zeros(3000), np.arange(3000.0), "constant"),
        (np.arange(500.0), np.arange(500.0), "more than 1024 cycles"),
        (np.arange(3000.0), np.full(3000, np.nan), "no finite number"),
    ],
)
def test_frequency_response_refuses(x, y, words):
    with pytest.raises(InputError, match=words):
        frequency_response(x, y, PERIOD)


def test_the_set_that_the_thesis_identified_is_no_position_loop():
    """Held by the loop itself in high precision: G(0) and the value that a step stays at for seconds."""
    found = contradictions(IDENTIFIED)
    gain, at_rest = found["N1/D4, gain over the seconds of a motion"]
    assert at_rest == pytest.approx(1.0, abs=1e-4)
    assert gain == pytest.approx(1.0199, abs=1e-4)
    assert found["N3/D6, gain at rest, G(0)"][0] == pytest.approx(0.9982, abs=1e-4)
    held = step_response(IDENTIFIED, np.linspace(0.0, 2.0, 2001))[-1]
    assert held == pytest.approx(gain, rel=1e-3)
    s = mpmath.mpf("0.05")  # rad/s: slower than any motion
    numerator, denominator = (sum(c * (1j * s) ** n for n, c in enumerate(reversed(part))) for part in IDENTIFIED)
    assert float(abs(numerator / denominator)) == pytest.approx(gain, rel=2e-3)


def test_every_drive_of_ours_is_a_possible_loop():
    for drive in (DriveParameters(), DriveParameters(kv=60.0, velocity_gain=5.0, inertia=0.02)):
        loop = position_loop(drive)
        assert contradictions(loop) == {}
        as_printed = TransferFunction(*([float(f"{c:.3e}") for c in part] for part in loop))
        assert contradictions(as_printed) == {}


def test_the_file_of_identified_drives_is_a_machine_file():
    setup = cartesian("drive.kind=cascade")
    machine = cartesian("drive.kind=cascade", "drive.kv=23.64")
    setpoint = motion(1500)
    readings = stepped(machine, "x", setpoint) + np.random.default_rng(0).normal(0.0, 1e-6, 1500)
    fit = fit_drives(setup, drive_unknowns(setup, ["x"]), AxisData("x", [recorded("x", setpoint, readings)]))
    text = identified_yaml(setup, [fit], ["bag"])
    found = setup_from_text(text)
    kv = by_name(fit)["kv"]
    assert found.axes["x"].drive.kv == kv.value == pytest.approx(23.64, rel=1e-3)
    assert found.axes["y"].drive.kv == 20.0
    assert f"x.drive.kv {kv.value:.9g} +- {kv.half_interval:.3g} 1/s" in text
    assert "left alone" in text
    below = dataclasses.replace(by_name(fit)["velocity_feed_forward"], value=-1e-6)
    changed = dataclasses.replace(fit, estimates=(below,))
    assert identified_setup(setup, [changed]).axes["x"].drive.velocity_feed_forward == 0.0


def test_bandwidth_of_the_velocity_loop():
    """(R + K_pi) J / (K_m K_p K_pi) of thesis 7-3 by hand; none of an ideal loop."""
    by_hand = 0.77 * 2.0 * math.pi * 2.4 * 15.0 / ((1.45 + 15.0) * 0.0087)
    assert velocity_bandwidth(DriveParameters()) == pytest.approx(by_hand)
    assert velocity_bandwidth(DriveParameters(kind="first_order")) == math.inf
