"""Responses against the closed forms of first- and second-order systems, and of a sampled first-order loop."""

from __future__ import annotations

import functools
import math
import re

import pytest
from command_line import refused

from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated

EXPERIMENT = load_experiment("step")


@functools.cache
def find(overrides: tuple[str, ...] = (), **options) -> Findings:
    return EXPERIMENT.run(Lab("tripod", overrides, simulated), EXPERIMENT.options(**options))


@pytest.mark.parametrize("constant", [0.02, 0.05])
def test_first_order(constant):
    first = find(time_constant=constant).data["systems"][0]
    assert first["t_d_ms"] == pytest.approx(1e3 * constant * math.log(2.0), rel=1e-4)
    assert first["t_r_ms"] == pytest.approx(1e3 * constant * math.log(9.0), rel=1e-4)
    assert first["t_s_ms"] == pytest.approx(1e3 * constant * math.log(50.0), rel=1e-4)
    assert first["ramp_lag_ms"] == pytest.approx(1e3 * constant, rel=1e-6)
    assert first["M_p_percent"] == 0.0
    assert first["t_p_ms"] is None
    assert first["impulse_area_to_t_p"] is None


@pytest.mark.parametrize(("omega", "zeta"), [(40.0, 0.4), (60.0, 0.2), (30.0, 0.7)])
def test_second_order(omega, zeta):
    second = find(natural_frequency=omega, damping=zeta).data["systems"][1]
    overshoot = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta * zeta))
    assert second["t_p_ms"] == pytest.approx(1e3 * math.pi / (omega * math.sqrt(1.0 - zeta * zeta)), rel=1e-4)
    assert second["M_p_percent"] == pytest.approx(100.0 * overshoot, rel=1e-4)
    assert second["impulse_area_to_t_p"] == pytest.approx(1.0 + overshoot, rel=1e-4)
    assert second["ramp_lag_ms"] == pytest.approx(1e3 * 2.0 * zeta / omega, rel=1e-4)


def test_drive_of_the_thesis():
    data = find().data
    drive, runs = data["systems"][2:]
    assert round(drive["t_d_ms"]) == 35
    assert drive["M_p_percent"] == 0.0
    assert drive["ramp_lag_ms"] == pytest.approx(50.0, abs=1e-3)
    assert runs["t_d_ms"] == pytest.approx(drive["t_d_ms"], abs=0.5)
    assert 0.0 < data["largest_difference_simulated_to_transfer_function_percent"] < 1.0


def test_sampled_first_order_loop_is_its_geometric_series():
    data = find(("drive.kind=first_order", "servo_period=0.004")).data
    runs, left = data["systems"][3], 1.0 - 20.0 * 0.004
    k = int(math.log(0.5) / math.log(left))
    share = (left**k - 0.5) / (left**k - left ** (k + 1))
    assert runs["t_d_ms"] == pytest.approx(4.0 * (k + share), rel=1e-6)
    assert runs["M_p_percent"] == 0.0


def test_the_tables_are_full_and_a_figure_marks_the_peak():
    findings = find()
    (table,) = findings.tables
    assert all(len(row) == len(table.columns) for row in table.rows)
    notes = {note.text.split()[0]: note for note in findings.figures[0].panels[0].notes}
    second = findings.data["systems"][1]
    assert notes["t_p"].x == pytest.approx(second["t_p_ms"])
    assert notes["t_p"].y == pytest.approx(1.0 + second["M_p_percent"] / 100.0, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"seconds": 0.05}, "not settled"),
        ({"seconds": 0.001, "time_constant": 1e-5}, "not settled|three servo periods"),
    ],
)
def test_too_short_a_response_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        find(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"time_constant": 1e-12}, "time_constant: 1e-12 is too fast"),
        ({"natural_frequency": 1e9}, "natural_frequency: 1e+09 is too fast"),
        ({"seconds": 60.0}, "take fewer seconds"),
    ],
)
def test_what_falls_between_the_samples_is_refused(options, words):
    with pytest.raises(InputError, match=re.escape(words)):
        find(**options)


def test_a_length_that_no_memory_holds_is_refused_by_its_bound():
    assert "--seconds: 1000000000.0 s is over its maximum" in refused("experiment", "step", "--seconds", "1e9")
