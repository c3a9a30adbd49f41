"""The command's frame: subcommands, error lines, exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence

from pkm_cnc import __version__
from pkm_cnc.cli import (
    calibrate,
    check,
    compensate,
    evaluate,
    experiment,
    identify,
    kinematics,
    program,
    replay,
    reproduce,
    run,
    simulate,
)
from pkm_cnc.cli.parser import Parser, joined
from pkm_cnc.errors import PkmError

__all__ = ["main"]

SUBCOMMANDS = (
    program,
    check,
    run,
    simulate,
    replay,
    evaluate,
    compensate,
    calibrate,
    identify,
    kinematics,
    experiment,
    reproduce,
)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="pkm_cnc",
        description="CNC controller of a parallel kinematic machine: runs a part program through the machine's drives "
        "and tells how far the tool leaves the contour.",
        epilog="Exit status: 0 done, 1 a fault while running, 2 bad input. Errors are one line on stderr.",
    )
    parser.add_argument("--version", action="version", version=f"pkm_cnc {__version__}")
    subparsers = parser.add_subparsers(title="subcommands", metavar="SUBCOMMAND", required=True, parser_class=Parser)
    for module in SUBCOMMANDS:
        module.add_parser(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status. KeyboardInterrupt is left to the caller."""
    given = sys.argv[1:] if arguments is None else arguments
    parsed = _parser().parse_args(joined(given))
    parsed.command = shlex.join(["pkm_cnc", *given])  # for what tells how it was made
    try:
        parsed.action(parsed)
        sys.stdout.flush()
    except PkmError as error:
        print(f"pkm_cnc: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        _discard_output()
    except OSError as error:  # a file that cannot be used has its own error: what is left is standard output
        _discard_output()
        print(f"pkm_cnc: {error.filename or 'standard output'}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


def _discard_output() -> None:
    """What standard output still holds goes nowhere: at the end Python would fail on it a second time."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
