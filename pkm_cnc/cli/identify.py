"""pkm_cnc identify: the drives of a machine from recorded runs, as a machine file."""

from __future__ import annotations

import argparse
from typing import Any

from pkm_cnc.cli.arguments import add_machine

__all__ = ["add_parser"]

METHODS = ("least-squares", "nn")
DATA = ("axis", "contour")


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("identify", help="the drives of a machine from recorded runs")
    add_machine(parser)
    parser.add_argument("--bag", nargs="+", required=True, metavar="BAG", help="bags recorded on this machine")
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help=f"({METHODS[0]})")
    parser.add_argument(
        "--data",
        choices=DATA,
        default=DATA[0],
        help="axis: setpoint and scale of each drive; contour: contour errors of star and circle runs (axis)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the networks' training (0)")
    parser.add_argument("-o", dest="output", required=True, metavar="OUT.yaml", help="the identified machine file")
    parser.add_argument("--report", metavar="DIR", help="write a page, its pictures, data.json and the networks to DIR")
    parser.set_defaults(action=_identify)


def _identify(arguments: argparse.Namespace) -> None:
    from pkm_cnc.cli.identification import run  # a second of imports (scikit-learn, statistics) that only this needs

    run(arguments)
