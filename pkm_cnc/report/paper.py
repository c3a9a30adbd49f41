"""Figures for paper: SVG and PNG by matplotlib. Equal figures give equal files."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import MultipleLocator

from pkm_cnc.report.figure import Curve, Figure, Map, Panel
from pkm_cnc.report.looks import Look, looks

__all__ = ["png", "svg"]

_STYLE = {
    "figure.dpi": 100.0,
    "savefig.dpi": 130.0,
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.0,
    "legend.framealpha": 1.0,
    "legend.edgecolor": "0.8",
    "svg.fonttype": "none",  # text stays text: it can be searched and edited
    "svg.hashsalt": "pkm_cnc",  # names within the file depend on its content alone
}
_SIZE = {True: (6.2, 6.0), False: (6.2, 3.0)}
"""Inches of a panel: of a plan view or a map, and of all others."""
_MARKED = 40
"""Most points of a line that get a marker each; of longer ones some do."""


def svg(figure: Figure) -> bytes:
    """The figure as an SVG file, without date and version."""
    return _drawn(figure, "svg", {"Date": None, "Creator": None})


def png(figure: Figure) -> bytes:
    """The figure as a PNG file, without version."""
    return _drawn(figure, "png", {"Software": None})


def _drawn(figure: Figure, kind: str, metadata: dict[str, Any]) -> bytes:
    with _style():
        file = io.BytesIO()
        _sheet(figure).savefig(file, format=kind, metadata=metadata)
        return file.getvalue()


@contextmanager
def _style() -> Iterator[None]:
    """The look of all pictures, whatever the reader's matplotlibrc says; ends with the block."""
    with matplotlib.style.context(["default", _STYLE]):
        yield


def _sheet(figure: Figure) -> Sheet:
    columns = min(figure.columns, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    tall = [
        any(panel.equal or panel.map for panel in figure.panels[row * columns : (row + 1) * columns])
        for row in range(rows)
    ]
    heights = [_SIZE[is_tall][1] for is_tall in tall]
    width = 9.0 if columns == 1 and not any(tall) else _SIZE[True][0] * columns
    sheet = Sheet(figsize=(width, sum(heights) + 0.8), layout="constrained")
    sheet.suptitle(figure.title, fontsize=11.0)
    grid = sheet.add_gridspec(rows, columns, height_ratios=heights)
    heads: dict[int, Axes] = {}
    for place, (panel, styles) in enumerate(zip(figure.panels, looks(figure), strict=True)):
        row, column = divmod(place, columns)
        above = heads.get(column) if figure.share_x else None
        axes = sheet.add_subplot(grid[row, column], sharex=above)
        heads.setdefault(column, axes)
        _draw_panel(sheet, axes, panel, styles)
    _add_legend(sheet, columns)
    return sheet


def _draw_panel(sheet: Sheet, axes: Axes, panel: Panel, styles: Sequence[Look]) -> None:
    axes.set_title(panel.title)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.map is not None:
        _draw_map(sheet, axes, panel.map)
    for curve, look in zip(panel.curves, styles, strict=True):
        axes.plot(curve.x, curve.y, label=curve.name or None, **_kind(curve, look))
    for text in panel.notes:
        box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
        axes.text(text.x, text.y, text.text, ha="center", va="center", fontsize=7.5, bbox=box, zorder=2.6)
        axes.update_datalim([(text.x, text.y)])
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if panel.x_step is not None:
        axes.xaxis.set_major_locator(MultipleLocator(panel.x_step))
    axes.margins(0.05)
    axes.autoscale_view()


def _kind(curve: Curve, look: Look) -> dict[str, Any]:
    kind: dict[str, Any] = {"color": look.color, "zorder": 2.2 if curve.role == "data" else 1.9}
    if curve.kind == "points":
        kind["linestyle"] = "none"
    else:
        kind |= {"linewidth": look.width, "linestyle": (0, look.dashes) if look.dashes else "-"}
    if curve.kind != "line":
        face = "white" if look.open else look.color
        kind |= {"marker": look.marker[0], "markersize": 5.0, "markerfacecolor": face}
        if curve.kind == "line and points":
            kind["markevery"] = max(1, len(curve.x) // _MARKED)
    return kind


def _draw_map(sheet: Sheet, axes: Axes, field: Map) -> None:
    axes.grid(False)
    axes.set_facecolor("0.9")  # nothing there
    values = np.asarray(field.values, dtype=float)
    there = values[np.isfinite(values)]
    drawn = axes.pcolormesh(field.x, field.y, values, cmap="viridis", shading="nearest", rasterized=True)
    if min(values.shape) > 1 and len(there) and float(np.ptp(there)) > 0.0:
        lines = axes.contour(field.x, field.y, values, colors="white", linewidths=0.8)
        axes.clabel(lines, fontsize=7.0)
    sheet.colorbar(drawn, ax=axes, label=field.label, shrink=0.85)


def _add_legend(sheet: Sheet, columns: int) -> None:
    """One legend of all panels, below them, where it covers nothing."""
    entries: dict[str, Any] = {}
    for axes in sheet.axes:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    if entries:
        sheet.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=2 + columns)
