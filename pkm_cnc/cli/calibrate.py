"""pkm_cnc calibrate: the geometry of a machine from drive scales and measured TCP, as a machine file."""

from __future__ import annotations

import argparse
from typing import Any

from pkm_cnc.cli.arguments import add_machine

__all__ = ["add_parser"]

METHODS = ("least-squares", "nn")


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("calibrate", help="the geometry of a machine from what was measured on it")
    add_machine(parser)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--bag", nargs="+", metavar="BAG", help="bags recorded on this machine")
    source.add_argument(
        "--measurements",
        metavar="CSV",
        help="drive scales and TCP (u1_mm,...,x_mm,...), or a ball-bar circle (u1_mm,...,center_u1_mm,...,radius_mm)",
    )
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help=f"({METHODS[0]})")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the networks' training (0)")
    parser.add_argument(
        "--tilt",
        action="store_true",
        help="look for a tilt of the platform, too: no controller corrects it, but compensate --model OUT.yaml does",
    )
    parser.add_argument("-o", dest="output", required=True, metavar="OUT.yaml", help="the calibrated machine file")
    parser.add_argument("--report", metavar="DIR", help="write a page, its pictures, data.json and the networks to DIR")
    parser.set_defaults(action=_calibrate)


def _calibrate(arguments: argparse.Namespace) -> None:
    from pkm_cnc.cli.calibration import run  # a second of imports (scikit-learn, statistics) that only this needs

    run(arguments)
