"""The comparison of methods: what it says of a small program is what running it says."""

import pytest

from pkm_cnc.compensation import compensate, judged
from pkm_cnc.config import load_setup
from pkm_cnc.contour import circle_program
from pkm_cnc.evaluation import evaluate
from pkm_cnc.experiments import Lab, compensation, load_experiment, simulated
from pkm_cnc.experiments._before_after import recorded_run
from pkm_cnc.program import Program, Toolpath

CIRCLE = circle_program(
    feed_mm_min=4000.0,
    radius_mm=15.0,
    center_mm=(0.0, 0.0),
    direction="ccw",
    overshoot_deg=40.0,
    acceleration_mm_s2=2000.0,
)
KEPT = ("none", "mirror, model", "mirror, bags", "adapted gain")


@pytest.fixture(scope="module")
def findings():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compensation, "_programs", lambda setup, feed: {"circle": CIRCLE})
        methods = compensation._methods
        patch.setattr(
            compensation, "_methods", lambda setup: [method for method in methods(setup) if method.label in KEPT]
        )
        experiment = load_experiment("compensation")
        overrides = ["scale.noise=1e-6"]
        return experiment.run(Lab("tripod", overrides, simulated), experiment.options(passes=1))


def outcome(findings, machine, method):
    (found,) = (one for one in findings.data["outcomes"] if (one["machine"], one["method"]) == (machine, method))
    return found


def test_every_machine_has_every_method(findings):
    assert len(findings.data["outcomes"]) == 3 * len(KEPT)
    assert [table.title for table in findings.tables[:3]] == [
        f"Machine: {name}" for name in ("ideal", "Kv 18 % off", "as it is")
    ]
    assert [figure.name for figure in findings.figures] == ["compensation-circle"]


def test_figures_are_those_of_a_run(findings):
    setup = load_setup("tripod")
    program = compensate(setup, Program("circle.ngc", CIRCLE), "mirror").program
    evaluation = evaluate(recorded_run(setup, program))
    figures = judged(evaluation.errors, Toolpath(tuple(evaluation.elements)))
    found = outcome(findings, "ideal", "mirror, model")
    assert found["max_3d_um"] == pytest.approx(1e6 * figures.largest, rel=1e-9)
    assert found["max_3d_um"] < 0.02 * outcome(findings, "ideal", "none")["max_3d_um"]


def test_a_model_removes_what_it_knows_and_bags_what_happens(findings):
    before, model, bags = (
        outcome(findings, "Kv 18 % off", name)["rms_3d_um"] for name in ("none", "mirror, model", "mirror, bags")
    )
    assert model / before == pytest.approx(1.0 - 0.59, abs=0.03)
    assert bags / before < 0.05


def test_the_adapted_gain_needs_no_new_program(findings):
    found = outcome(findings, "ideal", "adapted gain")
    assert found["ordinary_cnc"] is False
    assert found["rms_3d_um"] < 0.1 * outcome(findings, "ideal", "none")["rms_3d_um"]


def test_the_floor_is_what_noise_leaves(findings):
    """Repeats differ by less than the noise of the scales, which the drives filter; a learnt program comes near it."""
    largest, rms = findings.data["floor_um"]["circle"]
    assert 0.0 < rms < largest < 5.0
    assert outcome(findings, "as it is", "mirror, bags")["rms_3d_um"] > 0.5 * rms
