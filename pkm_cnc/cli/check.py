"""pkm_cnc check: interpret a part program, check it against the machine, list its motion; nothing moves."""

from __future__ import annotations

import argparse
import json
from typing import Any

from pkm_cnc.check import prepare
from pkm_cnc.cli.arguments import add_program, setup_of
from pkm_cnc.program import canonical_motion, read_motions, read_program

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("check", help="interpret and check a part program, list its motion; moves nothing")
    add_program(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(action=_check)


def _check(arguments: argparse.Namespace) -> None:
    setup = setup_of(arguments)
    program = read_program(arguments.program)
    toolpath = prepare(setup, program)
    motions = read_motions(program, start=setup.start_pose, zero=setup.program_zero, rapid=setup.motion.rapid)
    motion = canonical_motion(motions, setup.program_zero)
    if arguments.json:
        print(json.dumps({"motion": motion}))
        return
    print(f"{'line':>6}  {'motion':8}  {'x_mm':>12} {'y_mm':>12} {'z_mm':>12}  {'feed_mm_min':>11}")
    for entry in motion:
        x, y, z = entry["end_mm"]
        print(f"{entry['line']:>6}  {entry['kind']:8}  {x:12.4f} {y:12.4f} {z:12.4f}  {entry['feed_mm_min']:11.1f}")
    print(f"{len(motion)} motions, {toolpath.length * 1e3:.3f} mm: within workspace and travel")
