"""The calibration bench: the shape of thesis table 4-1 and what it means."""

from __future__ import annotations

import numpy as np
import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Lab, load_experiment, simulated

EXPERIMENT = load_experiment("calibration")


def run(machine: str = "monopod", **options):
    return EXPERIMENT.run(Lab(machine, [], simulated), EXPERIMENT.options(**options))


@pytest.fixture(scope="module")
def findings():
    return run(repetitions=20)


def test_a_calibration_leaves_what_the_bench_scatters(findings):
    """Table 4-1: uncertainty 265 um before, near its floor after; reversal error and scatter stay."""
    before, after, perfect = (findings.data["positioning_um"][name] for name in ("before", "least_squares", "perfect"))
    networks = findings.data["positioning_um"]["nn"]
    assert before["uncertainty"] == pytest.approx(265.0, rel=0.1)
    for calibrated in (after, networks):
        assert calibrated["uncertainty"] == pytest.approx(perfect["uncertainty"], rel=0.25)
        assert calibrated["deviation"] < 0.03 * before["deviation"]
        assert calibrated["reversal"] == pytest.approx(12.0, rel=0.2)
        assert calibrated["standard_deviation"] == pytest.approx(5.3, rel=0.25)
    assert perfect["floor"] == pytest.approx(12.0 + 6.0 * 0.94 * 5.3, rel=0.1)  # s of five is 0.94 sigma on average


def test_the_intervals_hold_the_truth_as_often_as_they_say(findings):
    for row in findings.data["estimates"]:
        assert row["held"] >= 0.75  # 20 repetitions: 200 are in the test of the calibration itself
        assert abs(row["least_squares"] - row["true"]) <= row["half_interval_95"]
        assert 0.0 < row["nn_spread"] < row["half_interval_95"]


def test_without_noise_the_networks_converge_to_the_truth():
    data = run(reversal=0.0, repeatability=0.0, repetitions=2, targets=6, runs=2).data
    for row in data["estimates"]:
        assert row["nn"] == pytest.approx(row["true"], rel=0.01)
        assert row["least_squares"] == pytest.approx(row["true"], rel=1e-6)
    assert len(data["convergence_range_um"]) == 8
    assert data["convergence_range_um"][-1] < 0.1
    assert data["positioning_um"]["least_squares"]["uncertainty"] < 1e-6


def test_what_grid_and_ball_bar_can_tell(findings):
    """A ball bar sees no shift (2 in a plane, 3 in space) and no turn about z, which a Bipod's guides do not have."""
    ranks = {(row["machine"], row["measurement"].split()[0]): row["rank"] for row in findings.data["observable"]}
    assert ranks == {("bipod", "grid"): 6, ("bipod", "ball"): 4, ("tripod", "grid"): 12, ("tripod", "ball"): 8}
    for row in findings.data["observable"]:
        assert len(row["left_alone"]) == row["unknowns"] - row["rank"]


def test_equal_seeds_give_equal_findings():
    first, again, other = (
        run(repetitions=2, targets=5, runs=2, iterations=1, seed=seed).to_json() for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other
    assert np.isfinite(first["condition"])


@pytest.mark.parametrize(
    ("machine", "options", "words"),
    [
        ("tripod", {}, "calibration: it is about the monopod"),
        ("monopod", {"begin": 500.0, "end": 400.0}, "begin: 500 mm is not below end 400 mm"),
        ("monopod", {"end": 700.0}, "begin and end: 700 mm"),
    ],
)
def test_bad_options_are_refused(machine, options, words):
    with pytest.raises(InputError, match=words):
        run(machine, **options)
