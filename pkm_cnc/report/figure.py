"""A picture as data: what is drawn, not by what. One description makes the SVG, the PNG and the picture of the page.

Everything is in the reader's units, which every label names: "contour error (um)".
"""

from __future__ import annotations

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

    `role`: "programmed" is what the others are compared with, drawn thin and grey, "scale" a line that tells a value,
    drawn dotted; all others take the next look, told apart by tone, dashes and markers as well as by colour. Curves of
    one figure with the same `name` share look and legend entry; an empty name is not in the legend and takes the look
    of the curve before it.
    """

    name: str
    x: Array
    y: Array
    kind: Literal["line", "points", "line and points"] = "line"
    role: Literal["data", "programmed", "scale"] = "data"


@dataclass(frozen=True)
class Map:
    """Values over a grid: x (nx,), y (ny,), values (ny, nx), NaN = nothing; `label` of the scale with its unit."""

    x: Array
    y: Array
    values: Array
    label: str


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


@dataclass(frozen=True)
class Figure:
    """Panels in reading order, `columns` side by side; those of one column share their x range if `share_x`.

    `name` is the stem of its files, `caption` says in a sentence what to see and to which scale.
    """

    name: str
    title: str
    panels: Sequence[Panel]
    caption: str = ""
    columns: int = 1
    share_x: bool = False


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
