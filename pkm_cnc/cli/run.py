"""pkm_cnc run: a part program through the ROS graph, recorded to a bag."""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pkm_cnc.bag import refuse_existing
from pkm_cnc.bringup import prepare_environment, run_in_one_process, run_in_processes
from pkm_cnc.check import prepare
from pkm_cnc.cli.arguments import add_bag, add_from_line, add_program, add_reference, print_bag, program_of, setup_of
from pkm_cnc.cli.progress import run_line
from pkm_cnc.program import Program
from pkm_cnc.run_messages import RunOptions

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("run", help="run a part program through the ROS graph, recorded to an MCAP bag")
    add_program(parser)
    add_reference(parser)
    add_bag(parser)
    parser.add_argument(
        "--pacing",
        choices=("fast", "realtime"),
        default="fast",
        help="as fast as possible, or one cycle per servo period; the result is the same (%(default)s)",
    )
    parser.add_argument(
        "--processes",
        choices=("one", "each"),
        default="one",
        help="all nodes in one process, or one process per node; the result is the same (%(default)s)",
    )
    add_from_line(parser)
    parser.add_argument(
        "--attended",
        action="store_true",
        help="wait for an operator, who commands by ROS services: start, hold, resume, abort, reset (docs/operator.md)",
    )
    parser.set_defaults(action=_run)


def _run(arguments: argparse.Namespace) -> None:
    setup = setup_of(arguments)
    program = program_of(arguments)
    prepare(setup, program, arguments.from_line)
    refuse_existing(arguments.bag)
    prepare_environment()
    run_graph = run_in_one_process if arguments.processes == "one" else run_in_processes
    started = time.monotonic()
    options = RunOptions(arguments.attended, arguments.from_line)
    with run_line(setup.servo_period) as line, _file_of(arguments, program) as file:
        show, hear = (line.show, line.take) if line else (lambda cycle: None, None)
        end = run_graph(setup, file, arguments.bag, arguments.pacing, show, options, hear)
    wall = time.monotonic() - started
    end.require_completed()
    print_bag(arguments.bag, (end.cycle + 1) * setup.servo_period, wall)


@contextlib.contextmanager
def _file_of(arguments: argparse.Namespace, program: Program) -> Iterator[str]:
    """The file that the interpolator reads: PROGRAM itself, or a copy that carries --reference."""
    if not arguments.reference:
        yield arguments.program
        return
    with tempfile.TemporaryDirectory(prefix="pkm_cnc_") as folder:
        copy = Path(folder, Path(arguments.program).name)
        copy.write_text(program.text, encoding="utf-8")
        yield str(copy)
