"""A live line on a terminal's stderr; silent elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from pkm_cnc.experiments import Tell

__all__ = ["Show", "bar", "live_line"]


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
        if terminal and now - shown > 0.1:
            shown = now
            machine, wall = cycle * servo_period, now - started
            ratio = f", {machine / wall:.2f} x real time" if cycle else ""
            print(f"\r\033[K{name}: {machine:.1f} s of machine time in {wall:.1f} s{ratio}", end="", file=sys.stderr)

    try:
        yield show
    finally:
        if terminal:
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
