"""The loop closed on small programs: what is learnt from some runs is right for runs that nobody has seen."""

import pytest

from pkm_cnc.experiments import Lab, identification, load_experiment, simulated
from pkm_cnc.experiments._before_after import circle

SEEN = "G21 G90\nG0 X-35 Y-45\nG1 X45 Y35 F6000\nG0 X0 Y45\nG1 Y-45\nM2\n"
UNSEEN = "G21 G90\nG0 X-25 Y40\nG1 X-10 Y-30 F5000\nM2\n"


@pytest.fixture(scope="module")
def findings():
    """Least squares alone: networks take half a minute, and are tested where they are made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "METHODS", ("least squares",))
        patch.setattr(
            identification, "seen_programs", lambda setup: {"lines": SEEN, "circle": circle(setup, 6000.0, 35.0)}
        )
        patch.setattr(identification, "unseen_programs", lambda setup: {"line": UNSEEN})
        experiment = load_experiment("identification")
        return experiment.run(Lab("tripod_real", [], simulated), experiment.options())


def outcome(findings, machine, model):
    (found,) = (one for one in findings.data["outcomes"] if (one["machine"], one["model"]) == (machine, model))
    return found


@pytest.mark.parametrize(("machine", "removed"), [("Kv 18 % off", 95.0), ("as it is", 80.0)])
def test_what_was_learnt_is_right_for_a_line_that_was_not_seen(findings, machine, removed):
    found = outcome(findings, machine, "least squares")
    assert found["less_rms_percent"] > removed
    assert found["less_max_percent"] > removed


def test_a_model_that_is_wrong_removes_less(findings):
    for machine in ("Kv 18 % off", "as it is"):
        right, wrong = (outcome(findings, machine, name)["rms_3d_um"] for name in ("least squares", "nominal model"))
        assert right < 0.5 * wrong


def test_what_is_removed_is_what_the_runs_say(findings):
    """kappa goes with 1/Kv^2: a model with another Kv removes (23.64/20)^-2 of it too much or too little."""
    nominal = outcome(findings, "Kv 18 % off", "nominal model")
    assert nominal["less_rms_percent"] == pytest.approx(100.0 * (1.0 - ((23.64 / 20.0) ** 2 - 1.0)), abs=2.0)
    before = outcome(findings, "as it is", "as programmed")
    after = outcome(findings, "as it is", "its own bag")
    assert after["less_rms_percent"] == pytest.approx(100.0 * (1.0 - after["rms_3d_um"] / before["rms_3d_um"]))
    (limit,) = findings.data["floor_um"]
    assert limit["machine"] == "as it is"
    assert limit["rms_3d_um"] < after["rms_3d_um"]


def test_the_drives_and_the_geometry_are_found(findings):
    gains = [
        row
        for row in findings.data["drives"]
        if row["machine"] == "Kv 18 % off" and row["parameter"].endswith(".kv") and row["half_interval"] is not None
    ]
    assert len(gains) == 3
    assert [row["estimate"] for row in gains] == pytest.approx([23.64] * 3, rel=1e-6)
    left = {row["machine"]: row["left_rms_um"] for row in findings.data["geometry"]}
    assert left["Kv 18 % off"] < 1e-3
    assert left["as it is"] < 1.0


def test_the_page_shows_the_paths_and_why_the_printed_set_is_impossible(findings):
    assert [figure.name for figure in findings.figures] == ["identification-line"]
    assert [panel.title.split(",")[0] for panel in findings.figures[0].panels] == ["Kv 18 % off", "as it is"]
    impossible = findings.data["impossible"]
    assert impossible["N1/D4, gain over the seconds of a motion"]["is"] == pytest.approx(4100.0 / 4020.0)
