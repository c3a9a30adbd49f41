"""The page of an experiment."""

from __future__ import annotations

from typing import Any

from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameters_of
from pkm_cnc.report import Page, Table, parameter_tables

__all__ = ["experiment_page"]


def experiment_page(experiment: Experiment, lab: Lab, options: Any, findings: Findings, command: str) -> Page:
    """The page of `findings`, with the options and the machine's parameters; `command` made it."""
    rows = [
        (spec.name, _text(getattr(options, spec.name)), spec.unit, spec.doc) for spec in parameters_of(type(options))
    ]
    return Page(
        title=f"{experiment.name} on {lab.machine}",
        question=experiment.question,
        command=command,
        tables=findings.tables,
        figures=findings.figures,
        remarks=findings.remarks,
        parameters=[
            Table("Options of the experiment", ("option", "value", "unit", "meaning"), rows),
            *parameter_tables(lab.setup()),
        ],
        data={
            "experiment": experiment.name,
            "machine": lab.machine,
            "set": list(lab.overrides),
            "options": {spec.name: getattr(options, spec.name) for spec in parameters_of(type(options))},
            "data": findings.to_json(),
        },
    )


def _text(value: Any) -> str:
    return ", ".join(f"{part:.10g}" for part in value) if isinstance(value, tuple) else str(value)
