"""What all pictures share: sizes, line styles that stay apart in grey, magnification, labels and files."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pkm_cnc.contour import judged_range
from pkm_cnc.errors import InputError
from pkm_cnc.evaluation import Evaluation

__all__ = [
    "FIRST",
    "PROGRAMMED",
    "SECOND",
    "degrees",
    "judged_cycles",
    "legend_below",
    "new_figure",
    "note",
    "plan_view",
    "round_scale",
    "save",
    "style",
]

PROGRAMMED: dict[str, Any] = {"color": "0.35", "linewidth": 0.8, "linestyle": "-"}
FIRST: dict[str, Any] = {"color": "#0b4f8a", "linewidth": 1.4, "linestyle": "-"}
SECOND: dict[str, Any] = {"color": "#d9730d", "linewidth": 1.4, "linestyle": (0, (4, 1.5))}
"""The programmed contour; the first and the second of two kinds: told apart by tone and dashes, not by colour alone."""

LARGEST_SCALE = 1e6
"""1. Largest magnification: 1 nm drawn as 1 mm. What is smaller than that is rounding."""
_STYLE = {
    "figure.dpi": 100.0,
    "savefig.dpi": 130.0,
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.0,
    "legend.framealpha": 1.0,
    "legend.edgecolor": "0.8",
    "svg.fonttype": "none",  # text stays text: it can be searched and edited
    "svg.hashsalt": "pkm_cnc",  # names within the file depend on its content alone
}


@contextmanager
def style() -> Iterator[None]:
    """The look of all pictures, whatever the reader's matplotlibrc says; ends with the block."""
    with matplotlib.style.context(["default", _STYLE]):
        yield


def new_figure(width: float, height: float, title: str) -> Figure:
    """An empty figure of `width` by `height` inches that arranges itself."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize=11.0)
    return figure


def plan_view(axes: Axes, title: str) -> None:
    """Make `axes` a plan view: x and y in mm, to the same scale."""
    axes.set_title(title)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axisbelow(True)


def note(axes: Axes, x: float, y: float, text: str) -> None:
    """Write a small text at the point (x, y), in data units, over the grid and under the curves."""
    box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
    axes.text(x, y, text, ha="center", va="center", fontsize=7.5, bbox=box, zorder=1.5)


def legend_below(axes: Axes, columns: int) -> None:
    """A legend that covers nothing: below the axis label."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=columns)


def degrees(heading: float | None) -> str:
    """A heading as a text, with the sign that axis labels have."""
    return f"{heading:g}°".replace("-", "\N{MINUS SIGN}")


def round_scale(largest: float, room: float) -> float:
    """The largest of 1, 2, 5, 10, ... by which `largest` may be magnified to fit into `room` (same unit)."""
    if not largest * LARGEST_SCALE > room:
        return LARGEST_SCALE
    decade = 10.0 ** math.floor(math.log10(room / largest))
    return max(factor * decade for factor in (1.0, 2.0, 5.0) if factor * decade <= room / largest * (1.0 + 1e-9))


def judged_cycles(evaluation: Evaluation) -> NDArray[np.bool_]:
    """Which cycles count in the summaries, shape (n,): those on the middle half of a judged line, on a judged arc."""
    low, high = np.array(list(map(judged_range, evaluation.elements, evaluation.starts))).T
    segment = np.array([error.segment for error in evaluation.errors])
    path_length = np.array([error.path_length for error in evaluation.errors])
    inside = (low[segment] <= path_length) & (path_length <= high[segment])
    return np.asarray(inside & np.isin(segment, list(evaluation.summaries)), dtype=np.bool_)


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write `figure` to `folder` as SVG and PNG, without dates and versions. Raises InputError where it cannot."""
    metadata: dict[str, dict[str, Any]] = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}
    paths = [folder / f"{name}.{kind}" for kind in metadata]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in zip(paths, metadata.values(), strict=True):
            figure.savefig(path, metadata=content)
    except OSError as error:
        raise InputError(f"report {folder}: a picture cannot be written: {error.strerror}") from None
    return paths
