"""pkm_cnc experiment: options from the experiment's own dataclass, output, errors, and the same result on the graph."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import done, refused
from running import command

from pkm_cnc import experiments
from pkm_cnc.bringup import run_trial
from pkm_cnc.config import load_setup
from pkm_cnc.experiments import Experiment, Findings, Lab, experiment_names, simulated
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Program
from pkm_cnc.report.figure import Table

SHORT = "G21 G90\nG1 X6 Y2 F6000\nG3 X6 Y2 I-3 J0\nM30\n"


@dataclass(frozen=True)
class Options:
    """One parameter of every kind."""

    feeds: tuple[float, ...] = parameter((3000.0,), "feeds", unit="mm/min", above=0.0, any_length=True)
    center: tuple[float, ...] = parameter((0.0, 0.0), "a point", unit="mm", any_length=True, each=2)
    lowest_share: float = parameter(0.5, "50 % of it", minimum=-1.0, maximum=1.0)
    rows: int = parameter(3, "rows", minimum=1)
    forward: bool = parameter(True, "with it")
    kind: str = parameter("a", "which", choices=("a", "b"))


def _echo(lab: Lab, options: Options) -> Findings:
    lab.tell(0.5, "half of it")
    setup = lab.setup(["u1.drive.kv=30"])
    table = Table("What was given", ["name", "value"], [["feed", options.feeds[0]], ["nothing", None]])
    nothing = np.array([1.0, np.nan])
    kv = [parts.drive.kv for parts in setup.axes.values()]
    return Findings([table], [], {"kv": kv, "nothing": nothing}, ["A remark."])


@pytest.fixture
def echo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An experiment called echo, which is put among the package's."""
    (tmp_path / "echo.py").write_text("from test_cli_experiment import EXPERIMENT\n", encoding="utf-8")
    monkeypatch.setattr(experiments, "__path__", [*experiments.__path__, str(tmp_path)])


EXPERIMENT = Experiment("echo", "What comes back?", "tripod", Options, _echo)


@pytest.mark.usefixtures("echo")
def test_options_are_flags_of_the_kind_of_their_parameter() -> None:
    words = "--feeds 3000,6000 --center -50 0 --center 5 -1e-3 --lowest-share -0.5 --rows 4 --no-forward --kind b"
    given = json.loads(done("experiment", "echo", *words.split(), "--json"))["options"]
    assert given == {
        "feeds": [3000.0, 6000.0],
        "center": [-50.0, 0.0, 5.0, -1e-3],
        "lowest_share": -0.5,
        "rows": 4,
        "forward": False,
        "kind": "b",
    }


@pytest.mark.usefixtures("echo")
def test_lists_are_ranges_too() -> None:
    given = json.loads(done("experiment", "echo", "--feeds", "1000:3000:500", "--json"))["options"]
    assert given["feeds"] == [1000.0, 1500.0, 2000.0, 2500.0, 3000.0]


@pytest.mark.usefixtures("echo")
def test_defaults_machine_and_overrides() -> None:
    result = json.loads(done("experiment", "echo", "--set", "drive.kv=25", "--json"))
    assert result["experiment"] == "echo"
    assert result["machine"] == "tripod"
    assert result["set"] == ["drive.kv=25"]
    assert result["options"]["feeds"] == [3000.0]
    assert result["data"] == {"kv": [30.0, 25.0, 25.0], "nothing": [1.0, None]}


@pytest.mark.usefixtures("echo")
def test_the_help_shows_meaning_unit_and_default() -> None:
    text = " ".join(done("experiment", "echo", "--help").split())
    for words in (
        "What comes back?",
        "--feeds LIST feeds (3000 mm/min)",
        "50 % of it (0.5)",
        "--center X Y",
        "--graph",
    ):
        assert words in text


@pytest.mark.usefixtures("echo")
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--feeds 0", "--feeds[0]: 0.0 mm/min is not above 0.0 mm/min"),
        ("--feeds north", "--feeds: 'north'"),
        ("--feeds -5,3", "--feeds[0]: -5.0 mm/min is not above 0.0 mm/min"),
        ("--center 1 x", "--center: 'x' is not a number"),
        ("--center 1 nan", "--center[1]: nan is not a finite number"),
        ("--center 1", "--center: expected 2 arguments"),
        ("--lowest-share 2", "--lowest-share: 2.0 is over its maximum 1.0"),
        ("--rows 2.5", "--rows: '2.5' is not a whole number"),
        ("--rows 0", "--rows: 0 is below its minimum 1"),
        ("--kind c", "--kind: 'c' is not one of a, b"),
        ("--machine nowhere", "machine nowhere"),
        ("--set drive.kv=-1", "drive.kv: -1.0 1/s is not above 0.0 1/s"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(words: str, reason: str) -> None:
    assert reason in refused("experiment", "echo", *words.split())


def test_a_name_is_wanted_and_must_be_known() -> None:
    assert "--list" in refused("experiment")
    assert "'stars'" in refused("experiment", "stars")


def test_the_list_has_every_experiment_with_machine_and_question() -> None:
    lines = done("experiment", "--list").splitlines()
    assert [line.split()[0] for line in lines] == experiment_names()
    assert all(len(line.split()) > 5 for line in lines)


@pytest.mark.usefixtures("echo")
def test_tables_and_remarks_are_printed_and_the_report_holds_the_same_as_json(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    text = done("experiment", "echo", "--feeds", "1e3,2e3", "--report", folder)
    assert "What was given\nname     value" in text
    assert "nothing      -" in text
    assert text.endswith(f"\nA remark.\nreport {folder}/index.html\n")
    written = json.loads((folder / "data.json").read_text(encoding="utf-8"))
    assert written == json.loads(done("experiment", "echo", "--feeds", "1e3,2e3", "--json"))
    page = (folder / "index.html").read_text(encoding="utf-8")
    for words in ("What comes back?", f"pkm_cnc experiment echo --feeds 1e3,2e3 --report {folder}", "1000, 2000"):
        assert words in page


@pytest.mark.usefixtures("echo")
@pytest.mark.parametrize("folder", ["file", "/proc"])
def test_a_report_that_cannot_be_written_is_refused_before_anything_is_run(
    tmp_path: Path, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(Lab, "setup", lambda *_: pytest.fail("it was run"))
    assert f"report {tmp_path / folder}" in refused("experiment", "echo", "--report", tmp_path / folder)


@pytest.mark.usefixtures("ros_domain")
def test_a_trial_through_the_graph_is_the_simulated_one() -> None:
    setup, program = load_setup("tripod", ["u2.drive.kv=19"]), Program("a name / with a slash", SHORT)
    one, other = simulated(setup, program), run_trial(setup, program)
    assert other.evaluation.program_name == one.evaluation.program_name
    assert other.evaluation.errors == one.evaluation.errors
    assert other.evaluation.segments() == one.evaluation.segments()
    arrays = ("tcp_setpoint", "axis_setpoint", "axis_position", "axis_velocity", "tracking_error", "believed")
    for name in arrays:
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert np.array_equal(one.evaluation.true, other.evaluation.true)


@pytest.mark.usefixtures("ros_domain")
def test_an_experiment_through_the_graph_prints_the_same() -> None:
    words = "experiment star --headings 30 --feeds 6000 --pivot 0 0 --length 40".split()
    ended = command(*words, "--graph")
    assert (ended.returncode, ended.stderr, ended.stdout) == (0, "", done(*words))


def test_ctrl_c_while_an_experiment_is_imported_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("raise KeyboardInterrupt\n", encoding="utf-8")
    monkeypatch.setattr(experiments, "__path__", [*experiments.__path__, str(tmp_path)])
    assert refused("experiment", "slow", code=1) == "pkm_cnc: stopped by SIGINT"
