"""The picture of a star test: the lines in plan view with the contour error magnified, and the error over heading."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pkm_cnc.contour import SegmentSummary, heading_deg
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.program import Line
from pkm_cnc.records import Vector
from pkm_cnc.report.figure import Array, Curve, Figure, Note, Panel, round_scale
from pkm_cnc.report.judged import judged_cycles
from pkm_cnc.tolerances import ARC_RADII

__all__ = ["Star", "star_figure", "stars"]

ROOM = 0.1
"""Of the longest line's length: how far the largest judged contour error is drawn from it at most."""
POINTS = 200
"""Of a magnified path: more cannot be told apart."""
ON_THE_LINE = 0.005
"""Of the largest contour error: what is smaller lies within the width of the programmed line and is on no side."""


class Star(NamedTuple):
    """Judged lines through one point at one feed: the point (m), their segments, elements and summaries."""

    pivot: Vector
    lines: list[tuple[int, Line, SegmentSummary]]


def stars(evaluation: Evaluation) -> list[Star]:
    """The star tests of a run: groups of two or more judged lines with one middle and one feed, in order."""
    found: list[Star] = []
    for index, summary in evaluation.summaries.items():
        line = evaluation.elements[index]
        if not isinstance(line, Line) or heading_deg(line) is None or summary.cycles == 0:
            continue
        middle = line.position(0.5 * line.length)
        for star in found:
            if math.dist(star.pivot, middle) < ARC_RADII and star.lines[0][1].feed == line.feed:
                star.lines.append((index, line, summary))
                break
        else:
            found.append(Star(middle, [(index, line, summary)]))
    return [star for star in found if len(star.lines) > 1]


def star_figure(evaluation: Evaluation, star: Star, name: str) -> Figure:
    """One star test: plan view with the error magnified, in-plane and z error over heading."""
    x, y, z = (1e3 * value for value in star.pivot)
    feed = 60e3 * star.lines[0][1].feed
    largest = max(summary.left_max_abs for _, _, summary in star.lines)
    scale = round_scale(largest, ROOM * max(line.length for _, line, _ in star.lines))
    return Figure(
        name,
        f"Star test, {evaluation.machine}: {feed:g} mm/min, pivot x {x:.3f}, y {y:.3f}, z {z:.3f} mm",
        [
            _plan(evaluation, star, scale),
            _over_heading(star, "left", "In-plane contour error (+ = tool left of travel)", "left (um)"),
            _over_heading(star, "up", "z contour error (+ = tool above)", "z (um)"),
        ],
        f"Plan view: the distance of the actual path to the lines is drawn {scale:.10g}:1, headings stand at the ends. "
        "Mean, standard deviation and largest size are each over the line's middle half.",
        columns=2,
    )


def _plan(evaluation: Evaluation, star: Star, scale: float) -> Panel:
    length = max(line.length for _, line, _ in star.lines)
    largest = max(summary.left_max_abs for _, _, summary in star.lines)
    judged = judged_cycles(evaluation)
    segment = np.array([error.segment for error in evaluation.errors])
    curves, notes = [], []
    for index, line, _ in star.lines:
        rows = [evaluation.errors[row] for row in np.flatnonzero(judged & (segment == index))]
        rows = rows[:: max(1, len(rows) // POINTS)]
        along = np.array([error.path_length for error in rows]) - evaluation.starts[index]
        left = np.array([error.left for error in rows])
        ends = 1e3 * np.array([line.start, line.end])
        curves.append(Curve("programmed, arrow = heading", ends[:, 0], ends[:, 1], role="programmed", arrow=True))
        curves += _side(
            "actual, left of travel", line, along, np.where(left > ON_THE_LINE * largest, left, np.nan), scale
        )
        curves += _side(
            "actual, right of travel", line, along, np.where(left < -ON_THE_LINE * largest, left, np.nan), scale
        )
        tx, ty, _ = line.tangent(0.0)
        x, y = ends[1, 0] + 50.0 * length * tx, ends[1, 1] + 50.0 * length * ty
        notes.append(Note(x, y, f"{heading_deg(line):g}\N{DEGREE SIGN}".replace("-", "\N{MINUS SIGN}")))
    title = f"Programmed lines and actual path, its distance to them magnified {scale:.10g}:1"
    return Panel(title, "x (mm)", "y (mm)", curves, notes=notes, equal=True, rows=2)


def _side(name: str, line: Line, along: Array, left: Array, scale: float) -> list[Curve]:
    """The judged path on one side of the line, its error `left` (m, NaN on the other side) magnified, and its shade."""
    tx, ty, _ = line.tangent(0.0)
    x, y = 1e3 * (line.start[0] + along * tx), 1e3 * (line.start[1] + along * ty)
    across = 1e3 * scale * left / math.hypot(tx, ty)
    path_x, path_y = x - across * ty, y + across * tx
    curve = Curve(name, path_x, path_y, value=1e6 * left, value_label="left (um)")
    there = np.isfinite(left)
    if not there.any():
        return [curve]
    outline_x, outline_y = (
        np.concatenate([base[there], path[there][::-1]]) for base, path in ((x, path_x), (y, path_y))
    )
    return [curve, Curve("", outline_x, outline_y, kind="area")]


def _over_heading(star: Star, part: str, title: str, label: str) -> Panel:
    rows = sorted(
        (heading_deg(line), *(1e6 * getattr(summary, f"{part}_{name}") for name in ("mean", "std", "max_abs")))
        for _, line, summary in star.lines
    )
    heading, mean, std, largest = np.array(rows, dtype=float).T
    ends = np.array([heading[0], heading[-1]])
    zero = [Curve("", ends, np.zeros(2), role="programmed")] if part == "left" else []
    span = max(float(np.ptp(heading)), 1.0)
    return Panel(
        title,
        "heading (deg, counter-clockwise from +x)",
        label,
        [
            *zero,
            Curve("mean, bar = std", heading, mean, kind="line and points", like="actual, left of travel", bars=std),
            Curve(
                "largest size, on the side of the mean",
                heading,
                np.copysign(largest, mean),
                kind="points",
                like="actual, right of travel",
            ),
        ],
        x_step=next(step for step in (5.0, 15.0, 30.0, 45.0, 90.0) if 12.5 * step >= span),
    )
