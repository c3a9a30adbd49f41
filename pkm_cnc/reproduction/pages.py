"""The pages of a reproduction: one with all claims, and one for each experiment that it links to."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from pkm_cnc.config import load_setup
from pkm_cnc.experiments import Findings, Tell, load_experiment
from pkm_cnc.parameters import parameters_of
from pkm_cnc.report import Page, Table, parameter_tables, write_page
from pkm_cnc.reproduction.document import READING, claims_table, counts_table
from pkm_cnc.reproduction.run import Reproduction

__all__ = ["write_pages"]


def write_pages(folder: Path, reproduction: Reproduction, tell: Tell = lambda done, what: None) -> Path:
    """Write index.html and data.json to `folder` and each experiment's page to a folder in it; return the index.

    Raises InputError where `folder` cannot be written.
    """
    for number, (name, findings) in enumerate(reproduction.findings.items()):
        tell(number / len(reproduction.findings), f"page of {name}")
        write_page(folder / name, _experiment_page(name, findings))
    return write_page(folder, _index(folder, reproduction))[-1]


def _index(folder: Path, reproduction: Reproduction) -> Page:
    return Page(
        title="The thesis, claim by claim",
        question="Which statements of sections 2.2 to 7.6 of the thesis hold, as far as they can be checked without "
        "its lost figures?",
        command=f"pkm_cnc reproduce --report {folder}",
        tables=[
            counts_table(reproduction),
            *(claims_table(title, chapter) for title, chapter in reproduction.by_chapter().items()),
        ],
        figures=[],
        remarks=READING,
        links=[
            (f"Experiment {name}: {load_experiment(name).question}", f"{name}/index.html")
            for name in reproduction.findings
        ],
        data=reproduction.to_json(),
    )


def _experiment_page(name: str, findings: Findings) -> Page:
    """Of an experiment run with its defaults."""
    experiment = load_experiment(name)
    options = dataclasses.asdict(experiment.options())
    rows = [(spec.name, str(options[spec.name]), spec.unit, spec.doc) for spec in parameters_of(experiment.options)]
    return Page(
        title=f"Experiment {name}",
        question=experiment.question,
        command=f"pkm_cnc experiment {name}",
        tables=findings.tables,
        figures=findings.figures,
        remarks=findings.remarks,
        parameters=[
            Table("Options", ("option", "value", "unit", "meaning"), rows),
            *parameter_tables(load_setup(experiment.machine)),
        ],
        links=[("All claims of the thesis", "../index.html")],
        data=findings.to_json(),
    )
