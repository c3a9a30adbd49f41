"""pkm_cnc compensate: a part program that takes the tool to where the given one says."""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path
from typing import Any

from pkm_cnc.bag import read_run
from pkm_cnc.cli.arguments import add_program, setup_of, write_text
from pkm_cnc.cli.options import add_options, options_of
from pkm_cnc.compensation import METHODS, Compensated, CompensationOptions, compensate, nominal
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import read_program

__all__ = ["add_parser"]

NAMED = 10
"""Lines of the program that are named at most."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("compensate", help="write a part program that makes the contour right")
    add_program(parser)
    parser.add_argument("-o", "--output", required=True, metavar="OUT.ngc", help="the compensated part program")
    parser.add_argument("--method", choices=tuple(METHODS), default="mirror", help="how (%(default)s)")
    parser.add_argument(
        "--from",
        dest="source",
        nargs="+",
        default=["model"],
        metavar=("model|bag", "BAG"),
        help="where the errors come from: model, or bag BAG... (runs of PROGRAM, averaged) (model)",
    )
    parser.add_argument(
        "--model",
        metavar="FILE",
        help="machine file of the model, e.g. an identified one (what the controller knows of --machine)",
    )
    add_options(parser, CompensationOptions, "options")
    parser.set_defaults(action=_compensate)


def _compensate(arguments: argparse.Namespace) -> None:
    bags = _bags(arguments.source)
    options = options_of(arguments, CompensationOptions)
    setup = setup_of(arguments)
    model = load_setup(arguments.model) if arguments.model else None
    program = read_program(arguments.program)
    _refuse_same(arguments.program, arguments.output)
    started = time.monotonic()
    runs = [read_run(bag) for bag in bags]
    gc.freeze()  # as in simulate
    done = compensate(setup, program, arguments.method, model=model, bags=runs, options=options)
    write_text(arguments.output, done.program.text)
    print(_told(done, time.monotonic() - started))
    if model is None and not bags and nominal(setup).parameters != setup.parameters:
        print(
            "the model is what the controller knows: what the machine file says besides (actual.*, friction.*, ...) is "
            "not in it"
        )
    print(f"compensated program {arguments.output}")


def _bags(source: list[str]) -> list[str]:
    kind, *bags = source
    if kind not in ("model", "bag") or (kind == "model") == bool(bags):
        raise InputError(f"--from {' '.join(source)}: give model, or bag and at least one bag")
    return bags


def _refuse_same(program: str, output: str) -> None:
    """The original is not overwritten: it would be gone if the result is not what was wanted."""
    if Path(output).exists() and Path(output).samefile(program):
        raise InputError(f"-o {output}: this is PROGRAM itself: name another file")


def _told(done: Compensated, wall: float) -> str:
    rows = [("before", done.before, done.settled_before, "")]
    rows += [
        (f"pass {number}", one.figures, one.settled, f"{one.correction * 1e6:13.4g}")
        for number, one in enumerate(done.passes, 1)
    ]
    lines = [
        f"{'':8}  {'max_3d_um':>11} {'rms_3d_um':>11} {'max_plane_um':>12} {'settled_um':>11} {'correction_um':>13}"
    ]
    for name, figures, settled, correction in rows:
        lines.append(
            f"{name:8}  {figures.largest * 1e6:11.5f} {figures.rms * 1e6:11.5f} "
            f"{figures.largest_in_plane * 1e6:12.5f} {settled * 1e6:11.5f} {correction:>13}".rstrip()
        )
    settled = 100.0 * (1.0 - done.passes[done.chosen].settled / done.settled_before)
    lines.append(
        f"predicted, by pass {done.chosen + 1}: {settled:.4g} % of the largest contour error removed away from stops "
        f"(settled){_overall(done)}; judged are the middle half of lines and all of arcs ({wall:.1f} s)"
    )
    if done.untouched:
        named = ", ".join(map(str, done.untouched[:NAMED])) + (", ..." if len(done.untouched) > NAMED else "")
        count = f"{len(done.untouched)} line{'s' if len(done.untouched) > 1 else ''}"
        lines.append(f"left as they are, too near to stops or too tight for the drives: {count} ({named})")
    return "\n".join(lines)


def _overall(done: Compensated) -> str:
    """The part of the RMS error that is gone, where something is judged."""
    if not done.before.rms > 0.0:
        return ""
    return f", {100.0 * (1.0 - done.after.rms / done.before.rms):.4g} % of the RMS error over all"
