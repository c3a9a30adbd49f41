"""A live line on a terminal's stderr; silent elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from pkm_cnc.experiments import Tell
from pkm_cnc.messages import deserialize
from pkm_cnc.motion import STATE_NAMES
from pkm_cnc.records import STATE_FINISHED, STATE_RUNNING, ContourError
from pkm_cnc.status import GOES_ON_WITH
from pkm_cnc.topics import STATUS, topics

__all__ = ["RunLine", "Show", "bar", "live_line", "run_line"]

REDRAWN = 0.1
"""s of wall time between two drawings of a line."""


class Show(Protocol):
    """Shows how far a run has come."""

    def __call__(self, cycle: int) -> None:
        """Show a number of finished cycles."""


@contextmanager
def live_line(name: str, servo_period: float) -> Iterator[Show]:
    """A line with machine time, wall time and their ratio, redrawn at most ten times a second and wiped at the end."""
    terminal = sys.stderr.isatty()
    started = time.monotonic()
    shown = 0.0

    def show(cycle: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if terminal and now - shown > REDRAWN:
            shown = now
            machine, wall = cycle * servo_period, now - started
            ratio = f", {machine / wall:.2f} x real time" if cycle else ""
            print(f"\r\033[K{name}: {machine:.1f} s of machine time in {wall:.1f} s{ratio}", end="", file=sys.stderr)

    try:
        yield show
    finally:
        if terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


class RunLine:
    """The line of a run through the graph: where it is, how fast, how well; or what it waits for.

    The real-time factor is taken over the wall time in which it did not wait for the operator.
    """

    def __init__(self, servo_period: float) -> None:
        self._period = servo_period
        self._codec = topics(())["contour_error"].codec
        self._status: Any = None
        self._worst = 0.0
        self._moved = 0.0
        self._seen = self._shown = time.monotonic()

    def take(self, topic: str, data: bytes) -> None:
        """Take a message of one of the topics `bringup.HEARD`."""
        if topic == STATUS:
            if self._status is None:  # it begins now: until here the nodes were starting
                self._seen = time.monotonic()
            self._status = deserialize(data, "pkm_cnc_msgs/msg/ControllerStatus")
        else:
            self._worst = max(self._worst, ContourError(*self._codec.unpack(data)[1]).magnitude)

    def show(self, cycle: int) -> None:
        """Draw the line, at most ten times a second."""
        now = time.monotonic()
        if self._status is not None and now - self._shown > REDRAWN:
            if not _waits_for(self._status) and self._status.state != STATE_FINISHED:
                self._moved += now - self._seen
            self._seen = self._shown = now
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\033[K{self.text()[:width]}", end="", file=sys.stderr, flush=True)

    def text(self) -> str:
        """What the line says."""
        status = self._status
        waits_for = _waits_for(status)
        words = [STATE_NAMES[status.state] + (f", go on with: ros2 {waits_for}" if waits_for else "")]
        if status.path_length > 0.0:
            words.append(f"{100.0 * status.path_position / status.path_length:.0f} %")
        words += [f"{status.feed * 60e3:.0f} mm/min", f"worst contour error {self._worst * 1e6:.1f} um"]
        if self._moved > 0.0:
            words.append(f"{status.cycle * self._period / self._moved:.2f} x real time")
        return "; ".join([*words, f"line {status.line}: {' '.join(status.block.split())}"])


def _waits_for(status: Any) -> str:
    """What the operator must call, as the words behind `ros2`; empty where he is not waited for."""
    if status.state in GOES_ON_WITH:
        return f"service call /interpolator/{GOES_ON_WITH[status.state]} std_srvs/srv/Trigger"
    for name in ("feed_override", "rapid_override"):
        if status.state == STATE_RUNNING and status.feed == 0.0 and getattr(status, name) == 0.0:
            return f"param set /interpolator {name} 1.0"
    return ""


@contextmanager
def run_line(servo_period: float) -> Iterator[RunLine | None]:
    """The line of a run on a terminal, wiped at the end; None elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    try:
        yield RunLine(servo_period)
    finally:
        print("\r\033[K", end="", file=sys.stderr, flush=True)


@contextmanager
def bar(name: str) -> Iterator[Tell]:
    """A bar on a terminal's stderr, gone at the end; silent elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, what: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = TextColumn(name), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=1.0)
        yield lambda done, what: progress.update(task, completed=done, description=what)
