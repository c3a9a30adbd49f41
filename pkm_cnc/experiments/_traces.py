"""Actual paths over the lines of a star, and their picture in plan view with the contour error magnified."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pkm_cnc.contour import heading_deg, judged_range
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.program import Line
from pkm_cnc.report import round_scale
from pkm_cnc.report.figure import Array, Curve, Note, Panel

__all__ = ["Trace", "plan_panel", "traces_of"]

ROOM = 0.1
"""Of the longest line: how far the largest contour error is drawn from it at most."""
POINTS = 100
"""Of a drawn path: more cannot be told apart."""


@dataclass(frozen=True)
class Trace:
    """The judged part of one line: path length from its start and signed error in the plane, m, shape (n,) each."""

    line: Line
    along: Array
    left: Array


def traces_of(trial: Trial) -> list[Trace]:
    """The lines of a run in order, decimated for drawing."""
    evaluation = trial.evaluation
    found = []
    for index in evaluation.summaries:
        line, start = evaluation.elements[index], evaluation.starts[index]
        if isinstance(line, Line):
            low, high = judged_range(line, start)
            errors = [evaluation.errors[cycle] for cycle in trial.cycles_of(index)]
            errors = [error for error in errors if low <= error.path_length <= high]
            errors = errors[:: max(1, len(errors) // POINTS)]
            along = np.array([error.path_length - start for error in errors])
            found.append(Trace(line, along, np.array([error.left for error in errors])))
    return found


def plan_panel(traces: Sequence[Trace], zero: tuple[float, float], title: str) -> Panel:
    """Plan view in part-program coordinates, whose zero in base_link is `zero` (m); the title gets the scale."""
    largest = max((float(np.abs(trace.left).max()) for trace in traces if len(trace.left)), default=0.0)
    length = max(trace.line.length for trace in traces)
    scale = round_scale(largest, ROOM * length)
    programmed, sides, notes = [], [], []
    for trace in traces:
        line = trace.line
        tx, ty, _ = line.tangent(0.0)
        x0, y0 = 1e3 * (line.start[0] - zero[0]), 1e3 * (line.start[1] - zero[1])
        x1, y1 = 1e3 * (line.end[0] - zero[0]), 1e3 * (line.end[1] - zero[1])
        programmed.append(Curve("programmed", np.array([x0, x1]), np.array([y0, y1]), role="programmed"))
        margin = 60.0 * length
        notes.append(Note(x1 + margin * tx, y1 + margin * ty, f"{heading_deg(line):g} deg"))
        for name, here in (("actual, left of travel", trace.left > 0.0), ("actual, right of travel", trace.left < 0.0)):
            offset = 1e3 * scale * np.where(here, trace.left, math.nan)
            x, y = x0 + 1e3 * trace.along * tx - offset * ty, y0 + 1e3 * trace.along * ty + offset * tx
            sides.append(Curve(name, x, y))
    return Panel(
        f"{title}, error magnified {scale:.10g}:1", "x (mm)", "y (mm)", [*programmed, *sides], notes=notes, equal=True
    )
