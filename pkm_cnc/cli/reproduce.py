"""pkm_cnc reproduce: every experiment and every claim of the thesis, judged."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from pkm_cnc.cli.arguments import make_folder
from pkm_cnc.cli.progress import bar

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "reproduce",
        help="run every experiment and judge every claim of the thesis",
        description="Run every experiment with its defaults but calibration, compensation and the workspace map, judge "
        "every claim of the thesis that can be checked without its lost figures, and print claims, computed figures "
        "and verdicts. A claim that is contradicted is a result: exit status 0.",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--report", metavar="DIR", help="write pages, pictures and data.json to DIR")
    parser.set_defaults(action=_reproduce)


def _reproduce(arguments: argparse.Namespace) -> None:
    from pkm_cnc.reproduction import reproduce, text, write_report  # imports that no other command needs

    if arguments.report:
        make_folder(Path(arguments.report))
    with bar("reproduce") as tell:
        reproduction = reproduce(tell)
    print(json.dumps(reproduction.to_json(), allow_nan=False) if arguments.json else text(reproduction))
    if arguments.report:
        written = write_report(Path(arguments.report), reproduction, arguments.command)
        print(f"report {written}", file=sys.stderr if arguments.json else sys.stdout)
