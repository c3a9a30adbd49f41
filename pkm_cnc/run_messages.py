"""The messages below the servo rate that describe a run, for graph, simulation and bag alike, and what they tell."""

from __future__ import annotations

import importlib.metadata
import math
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pkm_cnc import __version__
from pkm_cnc.config import Setup
from pkm_cnc.contour import SegmentSummary
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.messages import deserialize, message, serialize
from pkm_cnc.program import Arc, Event, EventKind, Line, Plane, Program
from pkm_cnc.records import Command, Vector
from pkm_cnc.status import Status
from pkm_cnc.topics import BASE_FRAME

__all__ = [
    "COMPLETED",
    "EVENT_KINDS",
    "NEUTRAL",
    "End",
    "RunOptions",
    "command_of",
    "controller_status",
    "element_of",
    "end_of",
    "ended",
    "operator_command",
    "program_event",
    "run_end",
    "run_info",
    "segment",
    "segment_summary",
]

LINE, ARC = 0, 1
"""Kinds of elements: an arc's is ARC plus the number of its plane."""

EVENT_KINDS = {kind: number for number, kind in enumerate(get_args(EventKind))}
"""Numbers of the kinds of events in ProgramEvent."""

COMPLETED = "run completed in cycle "
"""What a node's process prints after a run that completed, before the number of the last cycle."""


class RunOptions(NamedTuple):
    """What a run depends on beside machine, program and commands.

    `attended`: an operator starts the program, and it waits for him; `from_line`: the line it begins at, 0 = its first.
    """

    attended: bool = False
    from_line: int = 0


NEUTRAL = RunOptions()


class End(NamedTuple):
    """How a run ended: in which cycle, by whose word, why (empty: it completed), and what a command exits with."""

    cycle: int
    node: str
    reason: str
    exit_code: int = 1

    @property
    def completed(self) -> bool:
        """Whether the part program ran to its end and everything is recorded."""
        return not self.reason

    def require_completed(self) -> None:
        """Raise what ended the run, InputError or MachineFault by its exit code, if it did not complete."""
        if not self.completed:
            raise (InputError if self.exit_code == InputError.exit_code else MachineFault)(
                f"{self.node}: {self.reason}"
            )


def run_info(setup: Setup, program: Program, options: RunOptions) -> bytes:
    """pkm_cnc_msgs/RunInfo: what made the run."""
    versions = {"pkm_cnc": __version__, "python": platform.python_version()}
    versions |= {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "rosbags", "mcap")}
    return serialize(
        message(
            "pkm_cnc_msgs/msg/RunInfo",
            header=(0, ""),
            machine=setup.machine_name,
            parameters=setup.to_yaml(),
            program_name=Path(program.name).name,
            program=program.text,
            versions="\n".join(f"{name} {version}" for name, version in versions.items()),
            servo_period=setup.servo_period_ns,
            **options._asdict(),
        )
    )


def segment(index: int, element: Line | Arc, path_start: float, time: int) -> bytes:
    """pkm_cnc_msgs/ToolpathSegment of one toolpath element; `time` = stamp of the cycle that needs it, ns."""
    arc = element if isinstance(element, Arc) else None
    nowhere = (math.nan, math.nan, math.nan)
    return serialize(
        message(
            "pkm_cnc_msgs/msg/ToolpathSegment",
            header=(time, BASE_FRAME),
            index=index,
            line=element.line,
            kind=ARC + arc.plane if arc else LINE,
            traverse=element.traverse,
            evaluated=element.evaluated,
            start=_point(element.start),
            end=_point(element.end),
            center=_point(arc.center if arc else nowhere),
            radius=arc.radius if arc else math.nan,
            sweep=arc.sweep if arc else math.nan,
            length=element.length,
            path_start=path_start,
            feed=element.feed,
        )
    )


def element_of(content: Any) -> Line | Arc:
    """The toolpath element that a ToolpathSegment message object describes."""
    common = {
        "line": content.line,
        "start": (content.start.x, content.start.y, content.start.z),
        "end": (content.end.x, content.end.y, content.end.z),
        "feed": content.feed,
        "traverse": bool(content.traverse),
        "evaluated": bool(content.evaluated),
    }
    if content.kind == LINE:
        return Line(**common)
    center = (content.center.x, content.center.y, content.center.z)
    return Arc(**common, center=center, sweep=content.sweep, plane=Plane(content.kind - ARC))


def segment_summary(summary: SegmentSummary, time: int) -> bytes:
    """pkm_cnc_msgs/SegmentSummary of one evaluated segment."""
    return serialize(message("pkm_cnc_msgs/msg/SegmentSummary", header=(time, ""), **summary._asdict()))


def operator_command(command: Command, cycle: int, time: int) -> bytes:
    """pkm_cnc_msgs/OperatorCommand of a command that takes effect in `cycle`; `time` = stamp of that cycle, ns."""
    return serialize(message("pkm_cnc_msgs/msg/OperatorCommand", header=(time, ""), cycle=cycle, **command._asdict()))


def command_of(content: Any) -> tuple[int, Command]:
    """The cycle and the command that an OperatorCommand message object tells."""
    return content.cycle, Command(content.kind, content.value)


def program_event(event: Event, cycle: int, time: int) -> bytes:
    """pkm_cnc_msgs/ProgramEvent of an event that happens in `cycle`; `time` = stamp of that cycle, ns."""
    return serialize(
        message(
            "pkm_cnc_msgs/msg/ProgramEvent",
            header=(time, ""),
            cycle=cycle,
            line=event.line,
            kind=EVENT_KINDS[event.kind],
            value=math.nan if event.value is None else float(event.value),
            text=event.text,
        )
    )


def controller_status(status: Status, blocks: Sequence[str], cycle: int, time: int) -> bytes:
    """pkm_cnc_msgs/ControllerStatus of `cycle`; `blocks` are the program's lines, `time` = stamp of the cycle, ns."""
    block = blocks[status.line - 1].strip() if 0 < status.line <= len(blocks) else ""
    fields = {**status._asdict(), "block": block}
    return serialize(message("pkm_cnc_msgs/msg/ControllerStatus", header=(time, ""), cycle=cycle, **fields))


def run_end(end: End, time: int) -> bytes:
    """pkm_cnc_msgs/RunEnd; `time` = stamp of its cycle, ns."""
    return serialize(
        message(
            "pkm_cnc_msgs/msg/RunEnd",
            header=(time, ""),
            cycle=end.cycle,
            completed=end.completed,
            node=end.node,
            reason=end.reason,
        )
    )


def end_of(data: bytes) -> End:
    """The end that a RunEnd message tells."""
    content = deserialize(data, "pkm_cnc_msgs/msg/RunEnd")
    return ended(content)


def ended(content: Any) -> End:
    """The end that a RunEnd message object tells."""
    reason = content.reason or ("" if content.completed else "stopped without a reason")
    return End(content.cycle, content.node, reason)


def _point(point: Vector) -> Any:
    return message("geometry_msgs/msg/Point", x=point[0], y=point[1], z=point[2])
