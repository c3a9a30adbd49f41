"""Claims of the thesis: expected verdicts, claims that need no run, the command. All: `make test-reproduction`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NoReturn
from unittest import mock

import numpy as np
import pytest
from command_line import done, pkm, refused
from reproduction_verdicts import VERDICTS

from pkm_cnc.errors import MachineFault
from pkm_cnc.experiments import Findings
from pkm_cnc.reproduction import CHAPTERS, Claim, Evidence, Judged, Outcome, Reproduction, printed_tripod, run
from pkm_cnc.reproduction.claim import judged, not_checkable
from pkm_cnc.reproduction.reading import around, exponent, maxima_of, nearest, turning_points

CLAIMS = [claim for claims in CHAPTERS.values() for claim in claims]
DOCUMENT = Path(__file__).parents[1] / "docs" / "reproduction.md"


class _NeedsRun(Exception):
    """A check asked for a run."""


class _NoRuns(Evidence):
    def data(self, experiment: str) -> NoReturn:
        raise _NeedsRun

    def _run(self, *arguments: Any) -> NoReturn:
        raise _NeedsRun


def test_every_claim_has_an_expected_verdict_and_a_name_of_its_own() -> None:
    assert [claim.name for claim in CLAIMS if claim.name not in VERDICTS] == []
    assert sorted(claim.name for claim in CLAIMS) == sorted(VERDICTS)


def test_claims_that_need_no_run() -> None:
    evidence = _NoRuns()
    outcomes = {}
    for claim in CLAIMS:
        try:
            outcomes[claim.name] = claim.check(evidence)
        except _NeedsRun:
            continue
    assert len(outcomes) > 50
    assert {name: outcome.verdict for name, outcome in outcomes.items()} == {name: VERDICTS[name] for name in outcomes}
    for outcome in outcomes.values():
        assert "nan" not in outcome.computed
        assert outcome.reason or outcome.verdict == "reproduced"


def test_the_document_holds_every_claim_with_its_verdict() -> None:
    rows = [line.split(" | ") for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    found = [(row[0].removeprefix("| "), row[1], row[3]) for row in rows if row[0] != "| section"]
    assert found == [(claim.section, claim.claim.replace("|", "\\|"), VERDICTS[claim.name]) for claim in CLAIMS]


def test_a_check_that_fails_is_an_error_and_no_verdict() -> None:
    def broken(evidence: Evidence) -> Outcome:
        raise ZeroDivisionError

    with (
        mock.patch("pkm_cnc.reproduction.run.CHAPTERS", {"x": (Claim("x", "1", "x", "x", broken),)}),
        pytest.raises(ZeroDivisionError),
    ):
        run._judge_chapter("x", {})


def test_verdicts_follow_what_is_computed() -> None:
    assert judged(True, "1 um", otherwise="no").verdict == "reproduced"
    assert judged(False, "2 um", otherwise="no") == Outcome("contradicted", "2 um", "no")
    assert judged(False, "2 um").reason
    assert not_checkable("lost").verdict == "not checkable"


def test_evidence_is_made_once_and_taken_where_given() -> None:
    evidence = Evidence({"kv-max": {"a": 1}})
    assert evidence.data("kv-max") == {"a": 1}
    assert evidence.setup("tripod") is evidence.setup("tripod")
    first = evidence.star("cartesian", 6000.0, (0.0,), length=20.0)
    assert evidence.star("cartesian", 6000.0, (0.0,), length=20.0) is first
    assert first[0.0]["tracking_error_mm"]["mean"] > 0.0


@pytest.mark.parametrize("seed", range(5))
def test_the_corrected_formulas_are_a_round_trip_and_the_printed_ones_are_not(seed: int) -> None:
    point = np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
    angle = np.radians([45.0, 165.0, 285.0])
    span = point[:2] - 0.363 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sliders = point[2] + np.sqrt(0.36 - (span * span).sum(axis=1))
    assert printed_tripod.forward(sliders) == pytest.approx(point, abs=1e-12)
    for misprint in ("6-7", "6-9", "6-11"):
        off = np.abs(printed_tripod.forward(sliders, [misprint]) - point).max()
        assert not off < 1e-4, misprint
    assert printed_tripod.newton_steps(sliders, corrected=True) in range(1, 6)
    assert printed_tripod.newton_steps(sliders, corrected=False) is None


def test_readings() -> None:
    assert [around(angle) for angle in (10.0, 190.0, -200.0, 180.0)] == [10.0, -170.0, 160.0, -180.0]
    assert nearest(np.array([10.0, 350.0]), 359.0) == 350.0
    assert math.isnan(nearest(np.array([]), 1.0))
    assert exponent((1.0, 2.0, 4.0), (3.0, 12.0, 48.0)) == pytest.approx(2.0)
    assert math.isnan(exponent((1.0, 2.0), (1.0, -1.0)))
    angles = np.arange(360.0)
    assert maxima_of(angles, np.cos(np.radians(3.0 * (angles - 15.0)))).tolist() == [15.0, 135.0, 255.0]
    assert turning_points(angles, np.sin(np.radians(angles - 0.5))).tolist() == [0.0, 180.0]


def _small(tell: Any) -> Reproduction:
    tell(1.0, "all")
    claim = CLAIMS[0]
    found = [Judged(claim, Outcome("contradicted", "3 um", "because"))]
    return Reproduction(found, {"step": Findings((), (), {"x_um": 1.0})})


def test_command(tmp_path: Path) -> None:
    with (
        mock.patch("pkm_cnc.reproduction.reproduce", _small),
        mock.patch("pkm_cnc.reproduction.run.CHAPTERS", {"2 Title": CLAIMS[:1]}),
    ):
        text = done("reproduce")
        printed = json.loads(done("reproduce", "--json"))
        told = done("reproduce", "--report", tmp_path / "pages")
    assert "CONTRADICTED" in text
    assert "3 um (because)" in text
    assert text.rstrip().endswith("1 claims: 0 reproduced, 1 contradicted, 0 not checkable")
    assert printed["counts"] == {"reproduced": 0, "contradicted": 1, "not checkable": 0}
    assert printed["claims"][0]["reason"] == "because"
    assert printed["experiments"] == {"step": {"x_um": 1.0}}
    assert told.splitlines()[-1] == f"report {tmp_path / 'pages' / 'index.html'}"
    assert json.loads((tmp_path / "pages" / "data.json").read_text()) == printed
    page = (tmp_path / "pages" / "index.html").read_text()
    assert "2 Title" in page
    assert 'href="step/index.html"' in page
    assert (tmp_path / "pages" / "step" / "index.html").exists()


def test_a_report_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "report" in refused("reproduce", "--report", tmp_path / "file")


def test_a_fault_ends_the_command_with_one_line() -> None:
    def fault(tell: Any) -> Reproduction:
        raise MachineFault("u2: following error")

    with mock.patch("pkm_cnc.reproduction.reproduce", fault):
        result = pkm("reproduce")
    assert (result.code, result.out) == (1, "")
    assert result.err == "pkm_cnc: u2: following error\n"
