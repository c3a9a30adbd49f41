"""pkm_cnc evaluate: contour errors from a bag alone, as tables, JSON and a page."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from pkm_cnc.bag import read_run
from pkm_cnc.cli.arguments import add_reference
from pkm_cnc.evaluation import Evaluation, evaluate, setup_of
from pkm_cnc.program import read_program
from pkm_cnc.report import run_headline, run_page, run_remarks, run_tables, text_table, write_page

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("evaluate", help="contour errors from a bag alone: table, JSON, pictures")
    parser.add_argument("bag", metavar="BAG", help="folder of the bag")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    add_reference(parser)
    parser.add_argument("--report", metavar="DIR", help="write a page (index.html), its pictures and data.json to DIR")
    parser.set_defaults(action=_evaluate)


def _evaluate(arguments: argparse.Namespace) -> None:
    run = read_run(arguments.bag)
    evaluation = evaluate(run, read_program(arguments.reference) if arguments.reference else None)
    if not run.complete:
        held = len(evaluation.errors)
        print(
            f"pkm_cnc: bag {arguments.bag} was never closed: evaluated up to its last whole chunk, {held} cycles "
            f"({held * evaluation.servo_period:.3f} s)",
            file=sys.stderr,
        )
    _tell_end(arguments.bag, evaluation)
    print(json.dumps(evaluation.to_json()) if arguments.json else _text(evaluation))
    if arguments.report:
        page = run_page(evaluation, setup_of(run), arguments.command)
        written = write_page(Path(arguments.report), page)
        print(f"report {written[-1]}", file=sys.stderr if arguments.json else sys.stdout)


def _text(evaluation: Evaluation) -> str:
    tables = [text_table(table) for table in run_tables(evaluation)]
    return "\n\n".join([run_headline(evaluation), *tables, *run_remarks(evaluation)])


def _tell_end(bag: str, evaluation: Evaluation) -> None:
    end = evaluation.end
    if end is not None and not end.completed:
        print(f"pkm_cnc: bag {bag}: the run did not complete: {end.node}: {end.reason}", file=sys.stderr)
