"""The picture of a whole run: contour error over the length of the programmed contour."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.drawing import FIRST, judged_cycles, new_figure

__all__ = ["path_figure"]

Array = NDArray[np.float64]

PARTS = (("left", "left (um)\n+ = left of travel"), ("up", "up (um)\n+ = above"), ("magnitude", "3-D (um)\nsize"))
MOST_NAMES = 40
"""More segments than this are not named: the names would cover each other."""
FRAME = 1.0
"""Of the range of the judged cycles: what is shown above and below it of the others."""


def path_figure(evaluation: Evaluation) -> Figure:
    """Draw the contour error of every cycle; the frame is chosen for the judged cycles, the others may leave it."""
    figure = new_figure(12.0, 6.6, f"Contour error along the path, {evaluation.machine}: {evaluation.program_name}")
    path_length = 1e3 * np.array([error.path_length for error in evaluation.errors])
    last = max(error.segment for error in evaluation.errors)
    judged = judged_cycles(evaluation)
    rows = figure.subplots(len(PARTS), 1, sharex=True)
    for axes, (part, label) in zip(rows, PARTS, strict=True):
        values = 1e6 * np.array([getattr(error, part) for error in evaluation.errors])
        axes.plot(path_length, values, color="0.7", linewidth=0.9, linestyle="-", label="other cycles")
        axes.plot(path_length, np.where(judged, values, np.nan), **FIRST, label="judged cycles")
        axes.set_ylabel(label)
        borders = [1e3 * start for start in evaluation.starts[: last + 1]]
        axes.vlines(borders, 0.0, 1.0, transform=axes.get_xaxis_transform(), color="0.6", linewidth=0.6, linestyle=":")
        _set_frame(axes, values, judged)
    rows[-1].set_xlabel("path length along the programmed contour (mm); dotted lines: borders of segments")
    rows[-1].set_xlim(path_length.min(), max(path_length.max(), path_length.min() + 1e-3))
    rows[-1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.26), ncols=2)
    _name_segments(rows[0], evaluation, last)
    return figure


def _set_frame(axes: Axes, values: Array, judged: NDArray[np.bool_]) -> None:
    finite = np.isfinite(values)
    largest = f"largest size\n{np.abs(values[finite]).max():.1f} um" if finite.any() else ""
    axes.text(1.008, 0.5, largest, transform=axes.transAxes, rotation=90.0, va="center", fontsize=8.0)
    if not finite.any():
        axes.text(0.5, 0.5, "not defined: the path is vertical", transform=axes.transAxes, ha="center")
        return
    counted = values[judged & finite]
    if not len(counted):
        return
    low, high = min(float(counted.min()), 0.0), max(float(counted.max()), 0.0)
    margin = FRAME * max(high - low, 1e-3)
    low, high = (
        max(low - margin, float(values[finite].min()) - 0.1 * margin),
        min(high + margin, float(values[finite].max()) + 0.1 * margin),
    )
    axes.set_ylim(low, high)


def _name_segments(axes: Axes, evaluation: Evaluation, last: int) -> None:
    names = [index for index in evaluation.summaries if index <= last]
    if not 0 < len(names) <= MOST_NAMES:
        return
    middles = [1e3 * (evaluation.starts[index] + 0.5 * evaluation.elements[index].length) for index in names]
    upper = axes.secondary_xaxis("top")
    upper.set_xticks(middles, [str(evaluation.elements[index].line) for index in names], fontsize=7.5)
    upper.tick_params(length=0.0)
    upper.set_xlabel("line of the part program", fontsize=8.0)
