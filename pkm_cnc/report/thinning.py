"""Long curves: fewer points that look the same."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.report.figure import Array, Curve, Figure

__all__ = ["MOST_POINTS", "thinned"]

MOST_POINTS = 10_000
"""Of a curve in a picture. Of a longer one every stretch keeps its ends, its gaps and its extremes in x and y."""
_KEPT = 6
"""Points that a stretch without gaps keeps: two ends, two extremes in x, two in y."""


def thinned(figure: Figure) -> Figure:
    """The figure with at most MOST_POINTS points a curve, those at gaps besides; its caption says so where it matters.

    Areas stay whole. What is short enough is returned as it came.
    """
    if not any(_is_long(curve) for panel in figure.panels for curve in panel.curves):
        return figure
    panels = [
        dataclasses.replace(panel, curves=[_thin(curve) if _is_long(curve) else curve for curve in panel.curves])
        for panel in figure.panels
    ]
    note = f"Curves of more than {MOST_POINTS} points are drawn by the ends and extremes of short stretches."
    return dataclasses.replace(figure, panels=panels, caption=f"{figure.caption} {note}".lstrip())


def _is_long(curve: Curve) -> bool:
    return len(curve.x) > MOST_POINTS and curve.kind != "area"


def _thin(curve: Curve) -> Curve:
    kept = _kept(np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float))
    return dataclasses.replace(
        curve,
        x=curve.x[kept],
        y=curve.y[kept],
        bars=None if curve.bars is None else curve.bars[kept],
        value=None if curve.value is None else curve.value[kept],
    )


def _kept(x: Array, y: Array) -> NDArray[np.intp]:
    """Which points stay, in order."""
    gap = ~(np.isfinite(x) & np.isfinite(y))
    kept = [np.flatnonzero(gap & ~np.concatenate([[False], gap[:-1]]))]  # one point a gap
    for stretch in np.array_split(np.arange(len(x)), MOST_POINTS // _KEPT):
        there = stretch[~gap[stretch]]
        if len(there):
            extremes = (pick(values[there]) for values in (x, y) for pick in (np.argmin, np.argmax))
            kept.append(there[[0, -1, *extremes]])
    return np.unique(np.concatenate(kept))
