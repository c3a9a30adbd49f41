"""What the documents say must hold: their code runs, their links lead somewhere, their tables are those of the code."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import done

from pkm_cnc import kinematics
from pkm_cnc.check import prepare
from pkm_cnc.cli.command import main
from pkm_cnc.config import setup_from_text
from pkm_cnc.contour import star_program
from pkm_cnc.kinematics import Machine
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulated_cycles

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8"))
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (document.parent / link).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_code_runs(document: Path) -> None:
    code = "\n".join(re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL))
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_the_parameter_table_is_that_of_the_code() -> None:
    spec = importlib.util.spec_from_file_location("parameter_docs", ROOT / "tools" / "parameter_docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.DOCUMENT.read_text(encoding="utf-8") == module.document()


def test_the_commands_of_the_readme_exist(capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [shlex.split(line)[1:] for line in re.findall(r"^    (?:.*\| )?(pkm_cnc .*)$", text, re.MULTILINE)]
    assert len(commands) >= 6
    for words in commands:
        options = [word for word in words if word.startswith("--")]
        names = [word for word in words[:2] if word.isalpha()]
        with pytest.raises(SystemExit):
            main([*names, "--help"])
        text = capsys.readouterr().out
        assert [option for option in options if option not in text] == [], words


def test_the_table_of_the_readme_is_what_is_printed(tmp_path: Path) -> None:
    program, bag = tmp_path / "star-1.ngc", tmp_path / "star-1"
    star = "program star --machine tripod --feed 6000 --headings=-15:105:15 --pivot 0 0 --length 200 -o"
    assert star in (ROOT / "tools" / "star_test.sh").read_text(encoding="utf-8")
    done(*star.split(), program)
    done("simulate", program, "--machine", "tripod", "--bag", bag)
    assert done("evaluate", bag) in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_minimal_machine_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "add_a_machine.md").read_text(encoding="utf-8")
    code, machine_file = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("python", "yaml"))
    (tmp_path / "corexy.py").write_text("\n".join(code), encoding="utf-8")
    monkeypatch.setattr(kinematics, "__path__", [*kinematics.__path__, str(tmp_path)])
    setup = setup_from_text("\n".join(machine_file))
    program = Program("star.ngc", star_program(6000.0, [0.0, 30.0], (0.0, 0.0), 200.0))
    cycles = list(simulated_cycles(setup, prepare(setup, program)))
    sys.modules.pop("pkm_cnc.kinematics.corexy")
    assert all(cycle.error.up == 0.0 for cycle in cycles)
    summaries = [summary for cycle in cycles for summary in cycle.summaries]
    assert len(summaries) == 2
    for summary in summaries:
        assert summary.left_max_abs < 1e-8
        assert summary.tracking_error_mean == pytest.approx(0.1 / 20.0, rel=1e-4)
    assert all(name in dir(setup.machine) for name in dir(Machine) if not name.startswith("_"))
