"""The report of the reproduction: one page with all claims, and one per experiment that it links to."""

from __future__ import annotations

from pathlib import Path

from pkm_cnc.experiments import Lab, experiment_page, load_experiment, simulated
from pkm_cnc.report import Page, write_page
from pkm_cnc.reproduction.document import READING, claims_table, counts_table
from pkm_cnc.reproduction.run import Reproduction

__all__ = ["write_report"]


def write_report(folder: Path, reproduction: Reproduction, command: str) -> Path:
    """Write folder/index.html and folder/NAME/index.html of every experiment; return the first.

    Raises InputError where `folder` cannot be written.
    """
    for name, findings in reproduction.findings.items():
        experiment = load_experiment(name)
        lab, options = Lab(experiment.machine, (), simulated), experiment.options()
        write_page(folder / name, experiment_page(experiment, lab, options, findings, f"pkm_cnc experiment {name}"))
    page = Page(
        title="The thesis, claim by claim",
        question="Which statements of the thesis does its own model bear out? Every claim that can be checked without "
        "the lost figures is computed anew; what the model contradicts is reported as contradicted, with the reason.",
        command=command,
        tables=[
            counts_table(reproduction),
            *(claims_table(title, judged) for title, judged in reproduction.by_chapter().items()),
        ],
        figures=(),
        remarks=[*READING, "The experiments, each with its pictures:"],
        links=[(f"{name}: {load_experiment(name).question}", f"{name}/index.html") for name in reproduction.findings],
        data=reproduction.to_json(),
    )
    return write_page(folder, page)[-1]
