"""pkm_cnc replay: a recorded run done again from its bag alone, and compared with it bit for bit."""

from __future__ import annotations

import argparse
import contextlib
from typing import Any

from pkm_cnc.bag import BagWriter
from pkm_cnc.cli.progress import live_line
from pkm_cnc.errors import MachineFault
from pkm_cnc.replay import read_recording, replay
from pkm_cnc.topics import recorded_topics

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "replay", help="do a recorded run again, the operator's commands in their cycles, and compare it bit for bit"
    )
    parser.add_argument("recorded", metavar="BAG", help="folder of the bag")
    parser.add_argument("--bag", metavar="DIR", help="write the replayed run too; must not exist")
    parser.set_defaults(action=_replay)


def _replay(arguments: argparse.Namespace) -> None:
    recording = read_recording(arguments.recorded)
    period = recording.setup.servo_period
    with contextlib.ExitStack() as stack:
        axes = tuple(recording.setup.axes)
        bag = (
            stack.enter_context(BagWriter(arguments.bag, recorded_topics(axes, recording.setup.tcp_control.active)))
            if arguments.bag
            else None
        )
        show = stack.enter_context(live_line("replay", period))
        comparison = replay(recording, bag, lambda cycle: show(cycle.cycle))
    if comparison.difference:
        raise MachineFault(f"replay of {arguments.recorded}: {comparison.difference}")
    end = recording.end.reason if recording.end else "it was never closed"
    ended = "" if recording.whole else f", up to where the run ended ({end})"
    print(f"equal bit for bit: {recording.cycles} cycles, {comparison.messages} messages{ended}")
