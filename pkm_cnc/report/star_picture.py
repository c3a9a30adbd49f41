"""The picture of a star test: the lines in plan view with the contour error magnified, and the error over heading."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from pkm_cnc.contour import SegmentSummary, heading_deg
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.program import Line
from pkm_cnc.records import Vector
from pkm_cnc.report.drawing import (
    FIRST,
    PROGRAMMED,
    SECOND,
    degrees,
    judged_cycles,
    legend_below,
    new_figure,
    note,
    plan_view,
    round_scale,
)
from pkm_cnc.tolerances import ARC_RADII

__all__ = ["Star", "star_figure", "stars"]

Array = NDArray[np.float64]

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


def star_figure(evaluation: Evaluation, star: Star) -> Figure:
    """Draw one star test."""
    x, y, z = (1e3 * value for value in star.pivot)
    feed = 60e3 * star.lines[0][1].feed
    figure = new_figure(
        12.0, 6.2, f"Star test, {evaluation.machine}: {feed:g} mm/min, pivot x {x:.3f}, y {y:.3f}, z {z:.3f} mm"
    )
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    _draw_plan(figure.add_subplot(grid[:, 0]), evaluation, star)
    upper, lower = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    _draw_over_heading(upper, star, "left", "In-plane contour error (+ = tool left of travel)", "left (um)")
    _draw_over_heading(lower, star, "up", "z contour error (+ = tool above)", "z (um)")
    upper.axhline(0.0, **PROGRAMMED, zorder=1.8)
    lower.set_xlabel("heading (deg, counter-clockwise from +x)")
    lower.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    return figure


def _draw_plan(axes: Axes, evaluation: Evaluation, star: Star) -> None:
    length = max(line.length for _, line, _ in star.lines)
    largest = max(summary.left_max_abs for _, _, summary in star.lines)
    scale = round_scale(largest, ROOM * length)
    plan_view(axes, f"Programmed lines and actual path, its distance to them magnified {scale:.10g}:1")
    judged = judged_cycles(evaluation)
    segment = np.array([error.segment for error in evaluation.errors])
    for index, line, _ in star.lines:
        _draw_line(axes, line, 1e3 * length)
        rows = [evaluation.errors[row] for row in np.flatnonzero(judged & (segment == index))]
        rows = rows[:: max(1, len(rows) // POINTS)]
        along = np.array([error.path_length for error in rows]) - evaluation.starts[index]
        left = np.array([error.left for error in rows])
        _draw_side(axes, line, along, np.where(left > ON_THE_LINE * largest, left, np.nan), scale, FIRST)
        _draw_side(axes, line, along, np.where(left < -ON_THE_LINE * largest, left, np.nan), scale, SECOND)
    for label, kind in (
        ("programmed, arrow = heading", PROGRAMMED),
        ("actual, left of travel", FIRST),
        ("actual, right of travel", SECOND),
    ):
        axes.plot([], [], label=label, **kind)
    legend_below(axes, 3)
    axes.margins(0.04)


def _draw_line(axes: Axes, line: Line, length: float) -> None:
    (x0, y0, _), (x1, y1, _) = ([1e3 * value for value in point] for point in (line.start, line.end))
    arrow = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 9.0}
    axes.annotate("", (x1, y1), (x0, y0), arrowprops={**arrow, "color": "0.35", "linewidth": 0.8})
    tx, ty, _ = line.tangent(0.0)
    axes.update_datalim([(x0, y0), (x1 + 0.07 * length * tx, y1 + 0.07 * length * ty)])
    note(axes, x1 + 0.05 * length * tx, y1 + 0.05 * length * ty, degrees(heading_deg(line)))


def _draw_side(axes: Axes, line: Line, along: Array, left: Array, scale: float, kind: dict[str, Any]) -> None:
    """The judged path on one side of the line: `left` magnified, m, NaN where it is not on this side."""
    tx, ty, _ = line.tangent(0.0)
    offset = scale * left / math.hypot(tx, ty)
    x, y = 1e3 * (line.start[0] + along * tx), 1e3 * (line.start[1] + along * ty)
    actual_x, actual_y = x - 1e3 * offset * ty, y + 1e3 * offset * tx
    axes.plot(actual_x, actual_y, zorder=2.5 if kind is SECOND else 2.0, **kind)
    there = np.flatnonzero(np.isfinite(left))
    if len(there):
        outline = np.concatenate([np.stack([x, y], axis=1)[there], np.stack([actual_x, actual_y], axis=1)[there[::-1]]])
        axes.fill(*outline.T, color=kind["color"], alpha=0.12, linewidth=0.0)


def _draw_over_heading(axes: Axes, star: Star, part: str, title: str, label: str) -> None:
    rows = sorted(
        (heading_deg(line), *(1e6 * getattr(summary, f"{part}_{name}") for name in ("mean", "std", "max_abs")))
        for _, line, summary in star.lines
    )
    heading, mean, std, largest = np.array(rows, dtype=float).T
    axes.set_title(title)
    axes.set_ylabel(label)
    axes.errorbar(heading, mean, std, capsize=3.0, marker="o", markersize=4.0, label="mean, bar = std", **FIRST)
    axes.plot(
        heading,
        np.copysign(largest, mean),
        linestyle="none",
        marker="x",
        color=SECOND["color"],
        label="largest size, on the side of the mean",
    )
    span = max(float(np.ptp(heading)), 1.0)
    axes.xaxis.set_major_locator(MultipleLocator(next(step for step in (5, 15, 30, 45, 90) if 12.5 * step >= span)))
