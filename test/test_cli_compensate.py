"""pkm_cnc compensate: what it says, what it writes, what it leaves behind when it refuses."""

import json

import pytest
from command_line import pkm

STAR = "G21 G90\nG0 X-30 Y-5\nG1 X30 Y5 F6000\nM2\n"


@pytest.fixture
def star(tmp_path):
    path = tmp_path / "star.ngc"
    path.write_text(STAR)
    return path


def test_compensate_simulate_evaluate(star, tmp_path):
    out, bag, again = tmp_path / "out.ngc", tmp_path / "bag", tmp_path / "again.ngc"
    status, said, errors = pkm("compensate", star, "--machine", "tripod", "-o", out, "--iterations", "1")
    assert (status, errors) == (0, "")
    assert said.splitlines()[1].split()[0] == "before"
    assert said.splitlines()[-1] == f"compensated program {out}"
    assert pkm("simulate", out, "--machine", "tripod", "--bag", bag)[0] == 0
    (segment,) = json.loads(pkm("evaluate", bag, "--json")[1])["segments"]
    assert segment["line"] == 3
    assert segment["below_feed"] == 0
    predicted = float(said.splitlines()[2].split()[2])
    assert segment["contour_error_3d_um"]["max"] == pytest.approx(predicted, rel=0.05)

    status, said, errors = pkm("compensate", out, "--machine", "tripod", "-o", again, "--from", "bag", bag)
    assert (status, errors) == (0, "")
    assert float(said.splitlines()[1].split()[1]) == pytest.approx(predicted, rel=0.05)


def test_a_reference_for_simulation_and_evaluation(star, tmp_path):
    shifted = tmp_path / "shifted.ngc"
    shifted.write_text(STAR.replace("Y-5", "Y-4").replace("Y5", "Y6"))
    plain, led = tmp_path / "plain", tmp_path / "led"
    assert pkm("simulate", shifted, "--machine", "tripod", "--bag", plain)[0] == 0
    assert pkm("simulate", shifted, "--machine", "tripod", "--bag", led, "--reference", star)[0] == 0
    by_run = json.loads(pkm("evaluate", led, "--json")[1])["segments"]
    by_evaluation = json.loads(pkm("evaluate", plain, "--json", "--reference", star)[1])["segments"]
    assert by_run == by_evaluation
    assert by_run[0]["contour_error_um"]["mean"] == pytest.approx(986.0, abs=20.0)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--from", "bag"), "--from bag: give model, or bag and at least one bag"),
        (("--from", "bag", "nowhere"), "bag nowhere: no .mcap file there"),
        (("--gain", "2"), "--gain: 2.0 is over its maximum 1.0"),
        (("--set", "u1.travel.maximum=0.3"), "star.ngc:2: u1 leaves its travel"),
        (("--model", "bipod"), "--model: it is of another machine: machine is bipod there and tripod here"),
    ],
)
def test_refused_and_nothing_left(star, tmp_path, arguments, reason):
    out = tmp_path / "out.ngc"
    status, said, errors = pkm("compensate", star, "--machine", "tripod", "-o", out, *arguments)
    assert (status, said) == (2, "")
    assert reason in errors
    assert errors.count("\n") == 1
    assert not out.exists()


def test_the_original_is_not_overwritten(star):
    status, _, errors = pkm("compensate", star, "--machine", "tripod", "-o", star)
    assert status == 2
    assert "this is PROGRAM itself" in errors
    assert star.read_text() == STAR
