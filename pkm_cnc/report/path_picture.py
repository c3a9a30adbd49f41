"""The picture of a whole run: contour error over the length of the programmed contour."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.drawing import FIRST, new_figure

__all__ = ["path_figure"]

PARTS = (
    ("left", "left (um)\n+ = left of travel"),
    ("up", "up (um)\n+ = above"),
    ("magnitude", "3-D (um)\nsize"),
)
MOST_NAMES = 40
"""Segments beyond this many are not named: the names would cover each other."""


def path_figure(evaluation: Evaluation) -> Figure:
    """Draw the contour error of every cycle; what is judged dark, rapids and the rest pale."""
    figure = new_figure(12.0, 6.6, f"Contour error along the path, {evaluation.machine}: {evaluation.program_name}")
    path_length = 1e3 * np.array([error.path_length for error in evaluation.errors])
    segment = np.array([error.segment for error in evaluation.errors])
    judged = np.isin(segment, list(evaluation.summaries))
    rows = figure.subplots(len(PARTS), 1, sharex=True)
    for axes, (part, label) in zip(rows, PARTS, strict=True):
        values = 1e6 * np.array([getattr(error, part) for error in evaluation.errors])
        axes.plot(path_length, np.where(judged, np.nan, values), color="0.72", linewidth=0.9, label="not judged")
        axes.plot(path_length, np.where(judged, values, np.nan), **{**FIRST, "linewidth": 1.1}, label="judged segments")
        axes.set_ylabel(label)
        _show_borders(axes, evaluation, segment)
        if not np.isfinite(values).any():
            axes.text(0.5, 0.5, "not defined: the path is vertical", transform=axes.transAxes, ha="center")
    rows[-1].set_xlabel("path length along the programmed contour (mm); upright lines: borders of segments")
    rows[-1].set_xlim(path_length.min(), max(path_length.max(), path_length.min() + 1e-3))
    _name_segments(rows[0], evaluation, segment)
    rows[-1].legend(loc="best")
    return figure


def _show_borders(axes: Axes, evaluation: Evaluation, segment: NDArray[np.int64]) -> None:
    borders = [1e3 * start for start in evaluation.starts[: segment.max() + 1]]
    axes.vlines(borders, 0.0, 1.0, transform=axes.get_xaxis_transform(), color="0.6", linewidth=0.5, linestyle=(0, (1, 2)))


def _name_segments(axes: Axes, evaluation: Evaluation, segment: NDArray[np.int64]) -> None:
    names = [index for index in evaluation.summaries if index <= segment.max()]
    if not 0 < len(names) <= MOST_NAMES:
        return
    middles = [1e3 * (evaluation.starts[index] + 0.5 * evaluation.elements[index].length) for index in names]
    upper = axes.secondary_xaxis("top")
    upper.set_xticks(middles, [str(evaluation.elements[index].line) for index in names], fontsize=7.5)
    upper.tick_params(length=0.0)
    upper.set_xlabel("line of the part program", fontsize=8.0)
