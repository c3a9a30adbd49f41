"""Instruments at the TCP and tests as they are measured."""

import math

import numpy as np
import pytest

from pkm_cnc.contour import ball_bar, straightedge
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Lab, load_experiment, simulated
from pkm_cnc.program import Arc, Line

T = 0.001


def lab(machine="tripod", *overrides):
    return Lab(machine, overrides, simulated)


def found(name, laboratory, **options):
    experiment = load_experiment(name)
    return experiment.run(laboratory, experiment.options(as_measured=True, **options)).data["as_measured"]


def test_a_probe_reads_what_is_left_of_the_line_a_hundred_times_a_second():
    line = Line(1, (0.0, 0.0, 0.0), (0.0, 0.2, 0.0), 0.1, False, True)
    y = 1e-4 * np.arange(2000.0)
    tcp = np.stack([-12.34e-6 + 0.0 * y, y, 5e-6 + 0.0 * y], axis=1)
    readings = straightedge(line, tcp, T)
    assert readings.place == pytest.approx(y[::10])
    assert readings.value == pytest.approx([12.3e-6] * 200, abs=1e-12)
    readings = straightedge(line, tcp - [1.1e-3, 0.0, 0.0], T)
    assert np.isnan(readings.value).all()


def test_a_ball_bar_reads_the_distance_from_the_centre():
    arc = Arc(1, (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.05, False, True, (0.0, 0.0, 0.0), math.tau)
    angle = np.linspace(0.0, math.tau, 5000)
    tcp = np.stack([0.10002 * np.cos(angle), 0.10002 * np.sin(angle), 0.0 * angle], axis=1)
    readings = ball_bar(arc, tcp, T)
    assert len(readings.value) == 500
    assert readings.value == pytest.approx([20e-6] * 500, abs=1e-12)


def test_the_star_as_measured_is_the_star_without_what_is_not_dynamic():
    """The error less that of the slow run, and errors go with the square of the feed."""
    options = {"headings": (0.0, 15.0), "feeds": (6000.0,), "pivot": (0.0, 0.0), "repeats": 1}
    (measured,) = found("star", lab(), **options)
    (half,) = found("star", lab(), slow_feed=3000.0, **options)
    ratios = np.divide(half["left_mean_um"], measured["left_mean_um"])
    assert ratios == pytest.approx([(1 - 0.25) / (1 - 0.01)] * 2, rel=0.03)
    plain = load_experiment("star")
    (star,) = plain.run(lab(), plain.options(headings=(0.0, 15.0), feeds=(6000.0,), pivot=(0.0, 0.0))).data["stars"]
    middle_half = [line["contour_error_um"]["mean"] for line in star["lines"]]
    assert measured["left_mean_um"] == pytest.approx(middle_half, rel=0.2)


def test_a_geometry_error_is_taken_off_by_the_slow_run():
    wrong = "actual.geometry.strut_length_error=[0.0001, 0, 0]"
    figures = [
        found("star", machine, headings=(0.0,), feeds=(6000.0,), pivot=(0.0, 0.0), length=120.0, repeats=1)
        for machine in (lab(), lab("tripod", wrong))
    ]
    (right,), (off,) = figures
    assert off["left_mean_um"] == pytest.approx(right["left_mean_um"], abs=0.3)


def test_repeats_differ_by_noise_and_again_by_the_same():
    noisy = lab("tripod", "scale.noise=1e-6")
    options = {"headings": (0.0,), "feeds": (6000.0,), "pivot": (0.0, 0.0), "length": 100.0, "repeats": 3}
    first, second = (found("star", noisy, slow_feed=3000.0, **options) for _ in range(2))
    assert first == second
    assert 0.001 < first[0]["left_std_um"][0] < 1.0


def test_a_platform_that_tilts_makes_the_radius_in_x_larger():
    """Thesis 6.5.2: then dR_x < dR_y."""
    options = {"center": (0.0, 0.0), "radii": (50.0,), "feeds": (3000.0,), "repeats": 1}
    level, tilted = (
        found("circle", lab("tripod", *overrides), **options)[0]
        for overrides in (
            [],
            ["actual.tilt.about_y=0.001", "actual.tilt.about_x=-0.0004", "actual.tilt.lever=0.1"],
        )
    )
    change = {axis: tilted[f"dR_{axis}_um"] - level[f"dR_{axis}_um"] for axis in "xy"}
    assert change["x"] < change["y"] < 0.0
    mean_square_cosine = 0.5 + math.sin(2 * math.radians(15)) / 2 / (2 * math.radians(15))
    expected = 0.1e6 * 0.05 * (0.001 * mean_square_cosine + 0.0004 * (1 - mean_square_cosine))
    assert change["x"] == pytest.approx(-expected, rel=0.02)
    assert tilted["dR_x_um"] < tilted["dR_y_um"]


def test_a_line_too_short_for_its_feed_is_refused():
    with pytest.raises(InputError, match="line of 0 deg is too short for its feed of 9000 mm/min"):
        found("star", lab(), headings=(0.0,), feeds=(9000.0,), pivot=(0.0, 0.0), length=20.0, repeats=1)
