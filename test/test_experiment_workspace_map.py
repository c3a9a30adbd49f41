"""The map: its stars are those of part programs, whoever computes them, and it says what it left out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster

from pkm_cnc.config import load_setup
from pkm_cnc.contour import star_program
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated
from pkm_cnc.experiments._star_array import line_motion, star_errors
from pkm_cnc.program import Program

EXPERIMENT = load_experiment("workspace-map")


def run(machine: str = "tripod", **options: Any) -> Findings:
    small = {"points": 3, "headings": (250.0,), "half_width": 50.0, "feed": 9000.0, "jobs": 1}
    return EXPERIMENT.run(Lab(machine, (), simulated), EXPERIMENT.options(**{**small, **options}))


@pytest.mark.parametrize(("machine", "heading"), [("tripod", 37.0), ("bipod", 200.0)])
def test_a_line_of_the_map_is_that_of_the_step_loop(machine: str, heading: float) -> None:
    """Within 1e-12 m, for the part program of this line alone, with the tool at rest at its start."""
    cosine, sine = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    start = [round(0.03 - 0.1 * cosine, 9), round(0.02 - 0.1 * sine, 9), 0.0]
    program = Program("line", star_program(9000.0, [heading], (30.0, 20.0), 200.0))
    (summary,) = simulated(load_setup(machine, [f"start_pose={start}"]), program).evaluation.summaries.values()
    setup = load_setup(machine)
    found = star_errors(setup, np.array([0.03, 0.02, 0.0]), [heading], line_motion(setup, 0.2, 0.15))
    assert found.reason == ""
    assert found.left[0] == pytest.approx(summary.left_mean, abs=1e-12)
    assert found.up[0] == pytest.approx(summary.up_mean, abs=1e-12)


def test_the_map_agrees_with_its_part_program() -> None:
    assert run().to_json()["checked"]["difference_um"] < 1e-5


def test_who_computes_changes_nothing() -> None:
    alone = run().to_json()
    assert run(jobs=2).to_json() == alone
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        assert run(cluster=cluster.scheduler_address).to_json() == alone


def test_a_cluster_that_does_not_answer_is_refused() -> None:
    with pytest.raises(InputError, match="--cluster"):
        run(cluster="nowhere")


def test_no_process_is_refused() -> None:
    with pytest.raises(InputError, match="--jobs: 0"):
        run(jobs=0)


def test_pivots_that_cannot_be_run_are_left_out_and_counted() -> None:
    data = run(half_width=200.0).to_json()
    left = [value for row in data["left_um"] for value in row]
    assert left[4] is not None
    assert sum(value is None for value in left) == sum(data["not_run"].values()) > 0
    assert all("out of reach" in reason for reason in data["not_run"])


def test_travel_and_following_error_are_reasons() -> None:
    overrides = ("u2.travel.maximum=0.5",)
    small = EXPERIMENT.options(points=2, headings=(0.0,), half_width=60.0, jobs=1)
    assert "u2 beyond its travel" in EXPERIMENT.run(Lab("tripod", overrides, simulated), small).data["not_run"]
    setup = load_setup("tripod", ["drive.following_error_limit=0.002"])
    found = star_errors(setup, np.zeros(3), [0.0], line_motion(setup, 0.2, 0.1))
    assert (found.reason, np.isnan(found.left).all()) == ("following error", True)


def test_gain_and_condition_of_the_bipod() -> None:
    """|row i of J| = L / h_i with h_i = sqrt(L^2 - (b -+ x)^2), and J = ((b - x)/h1 ..., 1): by hand at x = 50 mm."""
    data = run("bipod").to_json()
    h1, h2 = math.sqrt(0.36 - 0.15**2), math.sqrt(0.36 - 0.25**2)
    assert data["velocity_gain"][1][2] == pytest.approx(0.6 / h2)
    values = np.linalg.svd([[-0.15 / h1, 1.0], [0.25 / h2, 1.0]], compute_uv=False)
    assert data["condition_number"][1][2] == pytest.approx(values[0] / values[1])


def test_the_monopod_has_a_curve() -> None:
    """du/dx of u = sqrt(L^2 - x^2) is x / u."""
    found = run("monopod", half_width=200.0, points=5)
    data = found.to_json()
    x = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    assert data["x_mm"] == pytest.approx(1e3 * x)
    assert data["velocity_gain"][0] == pytest.approx(x / np.sqrt(0.36 - x * x))
    assert [len(panel.curves) for panel in found.figures[0].panels] == [1, 1]


def test_a_scale_with_a_resolution_is_refused_by_its_parameter() -> None:
    with pytest.raises(InputError, match=r"u1\.scale\.resolution"):
        EXPERIMENT.run(Lab("tripod", ("scale.resolution=20e-6",), simulated), EXPERIMENT.options())
