"""The picture of a whole run: contour error over the length of the programmed contour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.figure import Array, Curve, Figure, Note, Panel
from pkm_cnc.report.judged import judged_cycles

__all__ = ["path_figure"]

PARTS = (
    ("left", "In-plane (+ = tool left of travel)", "left (um)"),
    ("up", "Upward (+ = tool above)", "up (um)"),
    ("magnitude", "In three dimensions, its size", "3-D (um)"),
)
MOST_NAMES = 40
"""More segments than this are not named: the names would cover each other."""
FRAME = 1.0
"""Of the range of the judged cycles: what is shown above and below it of the others."""


def path_figure(evaluation: Evaluation, name: str) -> Figure:
    """The contour error of every cycle; what leaves the judged cycles' range by far is cut off and named."""
    path_length = 1e3 * np.array([error.path_length for error in evaluation.errors])
    judged = judged_cycles(evaluation)
    panels = []
    for part, title, label in PARTS:
        values = 1e6 * np.array([getattr(error, part) for error in evaluation.errors])
        panels.append(_panel(evaluation, path_length, values, judged, title, label))
    return Figure(
        name,
        f"Contour error along the path, {evaluation.machine}: {evaluation.program_name}",
        panels,
        "Every cycle of the run. Judged are those on the middle half of lines and on arcs; the frame is chosen for "
        "them, and the others may leave it: the title says how large they are. Numbers are lines of the part program.",
        share_x=True,
    )


def _panel(
    evaluation: Evaluation, path_length: Array, values: Array, judged: NDArray[np.bool_], title: str, label: str
) -> Panel:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return Panel(f"{title}: not defined, the path is vertical", "path length (mm)", label)
    low, high = _frame(values, judged)
    curves = [
        Curve("other cycles", path_length, values, role="aside"),
        Curve("judged cycles", path_length, np.where(judged, values, np.nan)),
        _borders(evaluation, low, high),
    ]
    return Panel(
        f"{title}; largest size {np.abs(finite).max():.1f} um",
        "path length along the programmed contour (mm)",
        label,
        curves,
        notes=_names(evaluation, high - 0.05 * (high - low)),
        y_range=(low, high),
    )


def _borders(evaluation: Evaluation, low: float, high: float) -> Curve:
    last = max(error.segment for error in evaluation.errors)
    starts = 1e3 * np.array(evaluation.starts[: last + 1])
    x, y = np.repeat(starts, 3), np.tile([low, high, np.nan], len(starts))
    return Curve("borders of segments", x, y, role="scale")


def _frame(values: Array, judged: NDArray[np.bool_]) -> tuple[float, float]:
    finite = np.isfinite(values)
    counted = values[judged & finite]
    if not len(counted):
        counted = values[finite]
    low, high = min(float(counted.min()), 0.0), max(float(counted.max()), 0.0)
    margin = FRAME * max(high - low, 1e-3)
    lowest, highest = float(values[finite].min()), float(values[finite].max())
    return max(low - margin, lowest - 0.15 * margin), min(high + margin, highest + 0.15 * margin)


def _names(evaluation: Evaluation, height: float) -> list[Note]:
    last = max(error.segment for error in evaluation.errors)
    names = [index for index in evaluation.summaries if index <= last]
    if len(names) > MOST_NAMES:
        return []
    middles = [1e3 * (evaluation.starts[index] + 0.5 * evaluation.elements[index].length) for index in names]
    return [
        Note(middle, height, str(evaluation.elements[index].line)) for index, middle in zip(names, middles, strict=True)
    ]
