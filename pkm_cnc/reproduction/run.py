"""All experiments and all claims, on as many processes as there are processors, whose number changes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pkm_cnc.experiments import Findings, Lab, Tell, experiment_names, load_experiment, simulated, starting_workers
from pkm_cnc.reproduction.claim import Claim, Outcome, Verdict
from pkm_cnc.reproduction.claims import CHAPTERS
from pkm_cnc.reproduction.evidence import Evidence

__all__ = ["LEFT_OUT", "VERDICTS", "Judged", "Reproduction", "judge", "reproduce"]

LEFT_OUT = ("calibration", "compensation", "identification", "workspace-map")
"""Experiments that no claim needs and that take too long beside the others."""
VERDICTS: tuple[Verdict, ...] = ("reproduced", "contradicted", "not checkable")


@dataclass(frozen=True)
class Judged:
    """A claim with the outcome of its check."""

    claim: Claim
    outcome: Outcome

    def to_json(self) -> dict[str, str]:
        """Name, section, claim, source, computed, verdict, reason."""
        return {
            "name": self.claim.name,
            "section": self.claim.section,
            "claim": self.claim.claim,
            "source": self.claim.source,
            "computed": self.outcome.computed,
            "verdict": self.outcome.verdict,
            "reason": self.outcome.reason,
        }


@dataclass(frozen=True)
class Reproduction:
    """All claims, judged, in the order of the thesis, and what each experiment found."""

    judged: Sequence[Judged]
    findings: Mapping[str, Findings]

    def by_chapter(self) -> dict[str, list[Judged]]:
        """The judged claims under the titles of their chapters."""
        judged = {each.claim.name: each for each in self.judged}
        return {title: [judged[claim.name] for claim in claims] for title, claims in CHAPTERS.items()}

    def counts(self) -> dict[Verdict, int]:
        """How many claims have each verdict."""
        return {verdict: sum(each.outcome.verdict == verdict for each in self.judged) for verdict in VERDICTS}

    def to_json(self) -> dict[str, Any]:
        """Counts, claims, and the data of each experiment by its name."""
        return {
            "counts": self.counts(),
            "claims": [each.to_json() for each in self.judged],
            "experiments": {name: found.to_json() for name, found in self.findings.items()},
        }


def reproduce(tell: Tell = lambda done, what: None) -> Reproduction:
    """Run every experiment with its defaults but LEFT_OUT, then judge every claim. Raises PkmError for a fault."""
    names = [name for name in experiment_names() if name not in LEFT_OUT]
    steps = len(names) + len(CHAPTERS)

    def told(done: int, what: str) -> None:
        tell(done / steps, what)

    findings = dict(_in_parallel([(_run_experiment, name) for name in names], told, 0))
    data = {name: found.data for name, found in findings.items()}
    return Reproduction(judge(data, lambda done, what: told(len(names) + done, what)), findings)


def judge(data: Mapping[str, dict[str, Any]], told: Any = lambda done, what: None) -> list[Judged]:
    """Judge all claims; `data` of experiments already run. What a check raises is not caught."""
    outcomes = dict(_in_parallel([(_judge_chapter, title, data) for title in CHAPTERS], told, 0))
    return [
        Judged(claim, outcome)
        for title, claims in CHAPTERS.items()
        for claim, outcome in zip(claims, outcomes[title], strict=True)
    ]


def _in_parallel(tasks: Sequence[tuple[Any, ...]], told: Any, done: int) -> list[tuple[str, Any]]:
    """(name, result) of tasks (function, name, ...), in their order; `told` how many are done and which was last."""
    from joblib import Parallel, delayed

    order = {task[1]: place for place, task in enumerate(tasks)}
    results = []
    with starting_workers():
        computed = Parallel(n_jobs=-1, return_as="generator_unordered")(delayed(_named)(*task) for task in tasks)
    for name, result in computed:
        results.append((name, result))
        told(done + len(results), name)
    return sorted(results, key=lambda pair: order[pair[0]])


def _named(work: Any, name: str, *arguments: Any) -> tuple[str, Any]:
    return name, work(name, *arguments)


def _run_experiment(name: str) -> Findings:
    experiment = load_experiment(name)
    return experiment.run(Lab(experiment.machine, (), simulated), experiment.options())


def _judge_chapter(title: str, data: Mapping[str, dict[str, Any]]) -> list[Outcome]:
    evidence = Evidence(data)
    return [claim.check(evidence) for claim in CHAPTERS[title]]
