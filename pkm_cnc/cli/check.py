"""pkm_cnc check: interpret a part program, check it against the machine, list its motion; nothing moves."""

from __future__ import annotations

import argparse
import json
from typing import Any

from pkm_cnc.check import prepare
from pkm_cnc.cli.arguments import add_program, setup_of
from pkm_cnc.program import Event, canonical_events, canonical_motion, read_motions, read_program

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
    items = list(
        read_motions(
            program,
            start=setup.start_pose,
            zero=setup.program_zero,
            rapid=setup.motion.rapid,
            parameters=setup.program,
        )
    )
    motion, events = canonical_motion(items, setup.program_zero), canonical_events(items)
    # a program that only speaks to spindle, tool or operator is one; there is then nothing to check
    commands_something = any(event["kind"] != "program_end" for event in events)
    length, time = 0.0, sum(event["value"] for event in events if event["kind"] == "dwell")
    if motion or not commands_something:
        checked = prepare(setup, program)
        length, time = checked.length, checked.time()
    if arguments.json:
        print(json.dumps({"motion": motion, "events": events, "time_s": time}))
        return
    print(f"{'line':>6}  {'motion':8}  {'x_mm':>12} {'y_mm':>12} {'z_mm':>12}  {'feed_mm_min':>11}")
    rows = iter(motion)
    for item in items:
        if isinstance(item, Event):
            print(
                f"{item.line:>6}  {item.kind}" + ("" if item.value is None else f" {item.value:g}") + _quoted(item.text)
            )
            continue
        entry = next(rows)
        x, y, z = entry["end_mm"]
        print(f"{entry['line']:>6}  {entry['kind']:8}  {x:12.4f} {y:12.4f} {z:12.4f}  {entry['feed_mm_min']:11.1f}")
    print(f"{len(motion)} motions, {length * 1e3:.3f} mm, {time:.3f} s: within workspace and travel")


def _quoted(text: str) -> str:
    return f": {text}" if text else ""
