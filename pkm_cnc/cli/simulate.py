"""pkm_cnc simulate: the same steps and the same bag as run, without ROS."""

from __future__ import annotations

import argparse
import gc
import time
from typing import Any

from pkm_cnc.bag import BagWriter
from pkm_cnc.check import prepare
from pkm_cnc.cli.arguments import add_bag, add_from_line, add_program, add_reference, print_bag, program_of, setup_of
from pkm_cnc.cli.progress import live_line
from pkm_cnc.run_messages import RunOptions
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import recorded_topics

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("simulate", help="the same steps without ROS, the same bag")
    add_program(parser)
    add_reference(parser)
    add_bag(parser)
    add_from_line(parser)
    parser.set_defaults(action=_simulate)


def _simulate(arguments: argparse.Namespace) -> None:
    setup = setup_of(arguments)
    program = program_of(arguments)
    options = RunOptions(from_line=arguments.from_line)
    checked = prepare(setup, program, options.from_line)
    gc.freeze()  # what is there by now stays: without looking at it the garbage collector costs a fifth less
    started = time.monotonic()
    with (
        live_line("simulate", setup.servo_period) as show,
        BagWriter(arguments.bag, recorded_topics(tuple(setup.axes), setup.tcp_control.active)) as bag,
    ):
        count = simulate(setup, program, checked, bag, lambda cycle: show(cycle.cycle), options=options)
    print_bag(arguments.bag, count * setup.servo_period, time.monotonic() - started)
