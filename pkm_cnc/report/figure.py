"""A picture as data: what is drawn, not by what. One description makes the SVG, the PNG and the picture of the page.

Everything is in the reader's units, which every label names: "contour error (um)".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Curve", "Figure", "Map", "Note", "Panel", "Table", "round_scale"]

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Curve:
    """Points (x, y), shape (n,) each, NaN = a gap.

    `role`: "programmed" is what the others are compared with, drawn thin and grey, "aside" what only surrounds them,
    pale, "scale" a line that tells a value, dotted; all others take the next look, told apart by tone, dashes and
    markers as well as by colour. Curves of one figure with the same `name` share look and legend entry; an empty name
    is not in the legend and takes the look of the curve before it.
    """

    name: str
    x: Array
    y: Array
    kind: Literal["line", "points", "line and points", "area"] = "line"
    """An area is the polygon through the points, shaded."""
    role: Literal["data", "programmed", "aside", "scale"] = "data"
    like: str = ""
    """The curve of the figure whose look this one takes, where it has a name and a legend entry of its own."""
    bars: Array | None = None
    """Half the height of the error bar at each point, (n,)."""
    arrow: bool = False
    """An arrow head at the last point, along the last piece of the line."""
    value: Array | None = None
    """What the points stand for besides x and y, (n,), e.g. a deviation that is drawn magnified: shown on hovering."""
    value_label: str = ""
    """Label of `value`, with its unit."""


@dataclass(frozen=True)
class Map:
    """Values over a grid: x (nx,), y (ny,), values (ny, nx), NaN = nothing; `label` of the scale with its unit."""

    x: Array
    y: Array
    values: Array
    label: str

    def has_contours(self) -> bool:
        """Whether lines of equal value can be drawn: over a grid, of values that differ."""
        values = np.asarray(self.values, dtype=float)
        there = values[np.isfinite(values)]
        return min(values.shape) > 1 and len(there) > 0 and bool(np.ptp(there) > 0.0)


@dataclass(frozen=True)
class Note:
    """A small text at a point of the panel."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes with curves over an optional map; `equal` gives both axes the same scale (plan views)."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve] = ()
    map: Map | None = None
    notes: Sequence[Note] = ()
    equal: bool = False
    x_step: float | None = None
    """Distance of the numbers on the x axis; None = round ones that fit."""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    """What is shown; None = everything that is there."""
    rows: int = 1
    """How many rows of the figure it takes: a plan view beside two others takes both."""


@dataclass(frozen=True)
class Figure:
    """Panels in reading order, `columns` side by side; those of one column share their x range if `share_x`.

    Each panel takes the first place that is free. `name` is the stem of its files, `caption` says in a sentence what to
    see and to which scale.
    """

    name: str
    title: str
    panels: Sequence[Panel]
    caption: str = ""
    columns: int = 1
    share_x: bool = False

    def places(self) -> list[tuple[int, int]]:
        """Row and column of each panel, of the uppermost row where it takes several."""
        taken: set[tuple[int, int]] = set()
        found = []
        for panel in self.panels:
            row, column = next(
                divmod(place, self.columns) for place in itertools.count() if divmod(place, self.columns) not in taken
            )
            taken |= {(row + below, column) for below in range(panel.rows)}
            found.append((row, column))
        return found


@dataclass(frozen=True)
class Table:
    """Rows under column names that carry their units; a number is written with enough digits, None as "-"."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | None]]


LARGEST_SCALE = 1e6
"""1. Largest magnification: 1 nm drawn as 1 mm. What is smaller than that is rounding."""


def round_scale(largest: float, room: float) -> float:
    """The largest of 1, 2, 5, 10, ... by which `largest` may be magnified to fit into `room` (same unit)."""
    if not largest * LARGEST_SCALE > room:
        return LARGEST_SCALE
    decade = 10.0 ** math.floor(math.log10(room / largest))
    return max(factor * decade for factor in (1.0, 2.0, 5.0) if factor * decade <= room / largest * (1.0 + 1e-9))
