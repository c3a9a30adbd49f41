"""What an experiment found, as the object for scripts and as the page for readers."""

from __future__ import annotations

import dataclasses
from typing import Any

from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameters_of
from pkm_cnc.report import Page, Table, parameter_tables

__all__ = ["experiment_json", "experiment_page"]


def experiment_json(experiment: Experiment, lab: Lab, options: Any, findings: Findings) -> dict[str, Any]:
    """What was asked of which machine and what came of it, in the types of JSON."""
    return {
        "experiment": experiment.name,
        "machine": lab.machine,
        "set": list(lab.overrides),
        "options": dataclasses.asdict(options),
        "data": findings.to_json(),
    }


def experiment_page(experiment: Experiment, lab: Lab, options: Any, findings: Findings, command: str) -> Page:
    """The page of an experiment that `command` ran; with its object for scripts. Raises InputError as `lab.setup`."""
    return Page(
        title=f"Experiment {experiment.name}: {lab.setup().machine_name}",
        question=experiment.question,
        command=command,
        tables=findings.tables,
        figures=findings.figures,
        remarks=findings.remarks,
        parameters=[_options_table(options), *parameter_tables(lab.setup())],
        data=experiment_json(experiment, lab, options, findings),
    )


def _options_table(options: Any) -> Table:
    rows = []
    for spec in parameters_of(type(options)):
        value = getattr(options, spec.name)
        text = ", ".join(f"{part:g}" for part in value) if isinstance(value, tuple) else str(value)
        rows.append((spec.name, text, spec.unit, spec.doc))
    return Table("Options of the experiment", ("option", "value", "unit", "meaning"), rows)
