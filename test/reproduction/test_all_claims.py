"""`pkm_cnc reproduce`, all of it: every claim has the verdict that the project states, and the document says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import done
from reproduction_verdicts import VERDICTS

from pkm_cnc.experiments import experiment_names
from pkm_cnc.reproduction import LEFT_OUT

DOCUMENT = Path(__file__).parents[2] / "docs" / "reproduction.md"


@pytest.mark.timeout(1800)
def test_reproduce() -> None:
    found = json.loads(done("reproduce", "--json"))
    assert {claim["name"]: claim["verdict"] for claim in found["claims"]} == VERDICTS
    assert sorted(found["experiments"]) == [name for name in experiment_names() if name not in LEFT_OUT]
    document = DOCUMENT.read_text(encoding="utf-8")
    for claim in found["claims"]:
        assert claim["reason"].replace("|", "\\|") in document, claim["name"]
