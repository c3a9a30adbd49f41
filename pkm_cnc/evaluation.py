"""What a bag tells of a run: the contour error of every evaluated segment, recomputed from setpoints and true TCP."""

from __future__ import annotations

import contextlib
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc import run_messages
from pkm_cnc.bag import Run
from pkm_cnc.config import Setup, setup_from_text
from pkm_cnc.contour import (
    CirclePath,
    ContourMonitor,
    SegmentSummary,
    arc_report,
    circle_pair_report,
    circle_pairs,
    circle_path,
    circle_report,
    is_full_circle,
    line_report,
)
from pkm_cnc.errors import InputError
from pkm_cnc.program import Arc, Element, Line, Program, ProgramSource, Toolpath
from pkm_cnc.records import NANOSECONDS, ContourError, TcpSetpoint

__all__ = ["Evaluation", "evaluate", "setup_of"]


@dataclass(frozen=True)
class Evaluation:
    """A judged run; everything in SI and `base_link`.

    `errors` has one ContourError a cycle, `true` (n, 3) is the true TCP, `elements` and `summaries` are by segment.
    """

    machine: str
    servo_period: float
    program_name: str
    end: run_messages.End | None
    elements: list[Element]
    starts: list[float]
    summaries: dict[int, SegmentSummary]
    errors: list[ContourError]
    true: NDArray[np.float64]

    def segments(self) -> list[dict[str, object]]:
        """JSON entries of the evaluated segments in order, then of the pairs of circles."""
        circles = self.circles()
        entries = []
        for index, summary in self.summaries.items():
            element = self.elements[index]
            if isinstance(element, Line):
                entries.append(line_report(element, summary))
            elif index in circles:
                entries.append(circle_report(circles[index]))
            else:
                entries.append(arc_report(element, summary))
        return [*entries, *(circle_pair_report(*pair) for pair in circle_pairs(list(circles.values())))]

    def circles(self) -> dict[int, CirclePath]:
        """The actual paths over the evaluated full circles, by segment; without those that were not run all around."""
        paths = {}
        for index in self.summaries:
            element = self.elements[index]
            if isinstance(element, Arc) and is_full_circle(element):
                rows = [row for row, error in enumerate(self.errors) if error.segment == index]
                with contextlib.suppress(InputError):
                    paths[index] = circle_path(element, self.true[rows])
        return paths

    def to_json(self) -> dict[str, object]:
        """The object that `pkm_cnc evaluate --json` prints."""
        return {
            "machine": self.machine,
            "servo_period_s": self.servo_period,
            "cycles": len(self.errors),
            "segments": self.segments(),
        }


def evaluate(run: Run, reference: Program | None = None) -> Evaluation:
    """Judge a recorded run by the code that judged it while it ran; by the contour of `reference` where it is given.

    The run then went along that contour in its order, by the share of the path length.
    Raises InputError for a bag that holds no run of ours, or not one whole cycle of it.
    """
    info = _run_info(run)
    elements, starts = _contour(run)
    recorded_length = starts[-1] + elements[-1].length if elements else 0.0
    if reference is not None:
        contour = _contour_of(reference, setup_of(run))
        elements, starts = list(contour.elements), list(contour.starts)
    cycles = run.cycles()
    if not cycles:
        raise InputError(f"bag {run.folder}: it holds no complete cycle")
    true = _columns(run.servo["tcp/state"][:cycles], "position.")
    believed = _columns(run.servo["tcp/state"][:cycles], "believed.")
    monitor = ContourMonitor()
    for index, (element, start) in enumerate(zip(elements, starts, strict=True)):
        monitor.add_segment(index, element, start)
    setpoints = _setpoints(run.servo["tcp/setpoint"][:cycles])
    if reference is not None:
        setpoints = _led(setpoints, starts, (starts[-1] + elements[-1].length) / recorded_length)
    errors = [
        monitor.step(setpoint, tuple(believed_point), tuple(true_point))[1]
        for setpoint, believed_point, true_point in zip(setpoints, believed.tolist(), true.tolist(), strict=True)
    ]
    ends = run.slow.get("run_end", [])
    return Evaluation(
        machine=info.machine,
        servo_period=info.servo_period / NANOSECONDS,
        program_name=info.program_name,
        end=run_messages.ended(ends[0]) if ends else None,
        elements=elements,
        starts=starts,
        summaries={summary.segment: summary for summary in monitor.finish()},
        errors=errors,
        true=true,
    )


def setup_of(run: Run) -> Setup:
    """The machine that made a run, from the bag alone. Raises InputError."""
    return setup_from_text(_run_info(run).parameters)


def _run_info(run: Run) -> Any:
    if not run.slow.get("run_info"):
        raise InputError(f"bag {run.folder}: it holds no run_info: not a run of pkm_cnc, or it ended before it began")
    return run.slow["run_info"][0]


def _contour(run: Run) -> tuple[list[Element], list[float]]:
    contents = sorted(run.slow.get("toolpath/segment", []), key=lambda content: content.index)
    if [content.index for content in contents] != list(range(len(contents))):
        raise InputError(f"bag {run.folder}: a toolpath segment is missing")
    return [run_messages.element_of(content) for content in contents], [content.path_start for content in contents]


def _contour_of(reference: Program, setup: Setup) -> Toolpath:
    source = ProgramSource(reference, setup.start_pose, setup.program_zero, setup.motion.rapid, setup.program)
    return source.toolpath().contour


def _led(setpoints: Iterator[TcpSetpoint], starts: list[float], rate: float) -> Iterator[TcpSetpoint]:
    """`setpoints` with segment and path length of a contour with these starts, `rate` times as long as the recorded."""
    for setpoint in setpoints:
        s = rate * setpoint.path_length
        yield setpoint._replace(path_length=s, segment=max(bisect_left(starts, s) - 1, 0))


def _columns(rows: NDArray[Any], prefix: str) -> NDArray[np.float64]:
    return np.stack([rows[f"{prefix}{axis}"] for axis in "xyz"], axis=1)


def _setpoints(rows: NDArray[Any]) -> Iterator[TcpSetpoint]:
    names = [name for name in rows.dtype.names or () if name != "cycle"]
    return (TcpSetpoint(*values) for values in zip(*(rows[name].tolist() for name in names), strict=True))
