"""pkm_cnc experiment: a question about a machine, answered by running part programs; tables, pictures, JSON."""

from __future__ import annotations

import argparse
import gc
import json
import sys
from pathlib import Path
from typing import Any

from pkm_cnc.cli.arguments import add_machine, make_folder
from pkm_cnc.cli.options import add_options, options_of
from pkm_cnc.cli.parser import Parser
from pkm_cnc.cli.progress import bar
from pkm_cnc.experiments import (
    Experiment,
    Findings,
    Lab,
    Runner,
    experiment_names,
    experiment_page,
    load_experiment,
    simulated,
)
from pkm_cnc.report import text_table, write_page

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("experiment", help="answer a question about a machine: tables, pictures, JSON")
    parser.add_argument("--list", action="store_true", help="list the experiments: name, machine, question")
    parser.set_defaults(action=lambda arguments: _list(parser, arguments))
    names = parser.add_subparsers(title="experiments", metavar="NAME", parser_class=_ExperimentParser)
    for name in experiment_names():
        names.add_parser(name, experiment=name)


class _ExperimentParser(Parser):
    """Learns its arguments when its experiment is named: no other command has to import the experiments."""

    def __init__(self, *, experiment: str, **options: Any) -> None:
        super().__init__(**options)
        self._experiment = experiment

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        experiment = load_experiment(self._experiment)
        self.description = experiment.question
        add_machine(self, experiment.machine)
        self.add_argument("--json", action="store_true", help="print one JSON object instead of the tables")
        self.add_argument("--report", metavar="DIR", help="write a page, its pictures and data.json to DIR")
        self.add_argument(
            "--graph", action="store_true", help="run the programs through the ROS graph; the result is the same"
        )
        add_options(self, experiment.options)
        self.set_defaults(action=lambda arguments: _run(experiment, arguments))
        return super().parse_known_args(args, namespace)


def _list(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    if not arguments.list:
        parser.error("the NAME of an experiment or --list is wanted")
    experiments = [load_experiment(name) for name in experiment_names()]
    width = max(len(experiment.name) for experiment in experiments)
    machine_width = max(len(experiment.machine) for experiment in experiments)
    for experiment in experiments:
        print(f"{experiment.name:{width}}  {experiment.machine:{machine_width}}  {experiment.question}")


def _run(experiment: Experiment, arguments: argparse.Namespace) -> None:
    options = options_of(arguments, experiment.options)
    if arguments.report:
        make_folder(Path(arguments.report))
    gc.freeze()  # as in simulate: without looking at what is there by now the garbage collector costs a fifth less
    with bar(experiment.name) as tell:
        lab = Lab(arguments.machine, arguments.set, _graph_runner() if arguments.graph else simulated, tell)
        findings = experiment.run(lab, options)
    page = experiment_page(experiment, lab, options, findings, arguments.command)
    written = write_page(Path(arguments.report), page) if arguments.report else []
    print(json.dumps(page.data, allow_nan=False) if arguments.json else _text(findings))
    if written:
        print(f"report {written[-1]}", file=sys.stderr if arguments.json else sys.stdout)


def _graph_runner() -> Runner:
    from pkm_cnc.bringup import run_trial  # only here are the graph's rooms needed

    return run_trial


def _text(findings: Findings) -> str:
    return "\n\n".join([*map(text_table, findings.tables), *findings.remarks])
