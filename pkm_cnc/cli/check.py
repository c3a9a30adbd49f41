"""pkm_cnc check: interpret a part program, check it against the machine, list its motion; nothing moves."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import Any

from pkm_cnc.check import prepare
from pkm_cnc.cli.arguments import add_program, setup_of
from pkm_cnc.config import Setup
from pkm_cnc.program import Event, Motion, Program, canonical_events, canonical_motion, read_motions, read_program

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
    motions, commands, time = 0, False, 0.0
    for item in _items(setup, program):
        if isinstance(item, Event):
            commands = commands or item.kind != "program_end"
            time += item.value or 0.0 if item.kind == "dwell" else 0.0
        else:
            motions += 1
    length = 0.0
    if motions or not commands:  # a program that only speaks to spindle, tool or operator is one, with nothing to check
        checked = prepare(setup, program)
        length, time = checked.length, checked.time()
    if arguments.json:
        items = list(_items(setup, program))
        listed = {"motion": canonical_motion(items, setup.program_zero), "events": canonical_events(items)}
        print(json.dumps({**listed, "time_s": time}))
        return
    print(f"{'line':>6}  {'motion':8}  {'x_mm':>12} {'y_mm':>12} {'z_mm':>12}  {'feed_mm_min':>11}")
    for item in _items(setup, program):
        if isinstance(item, Event):
            value = "" if item.value is None else f" {item.value:g}"
            print(f"{item.line:>6}  {item.kind}{value}{_quoted(item.text)}")
            continue
        (entry,) = canonical_motion([item], setup.program_zero)
        x, y, z = entry["end_mm"]
        print(f"{entry['line']:>6}  {entry['kind']:8}  {x:12.4f} {y:12.4f} {z:12.4f}  {entry['feed_mm_min']:11.1f}")
    print(f"{motions} motions, {length * 1e3:.3f} mm, {time:.3f} s: within workspace and travel")


def _items(setup: Setup, program: Program) -> Iterator[Motion | Event]:
    """Read anew whenever they are wanted: a list of them would grow with the file."""
    return read_motions(
        program, start=setup.start_pose, zero=setup.program_zero, rapid=setup.motion.rapid, parameters=setup.program
    )


def _quoted(text: str) -> str:
    return f": {text}" if text else ""
