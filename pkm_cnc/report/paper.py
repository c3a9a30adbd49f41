"""Figures for paper: SVG and PNG by matplotlib. Equal figures give equal files."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import MultipleLocator

from pkm_cnc.report.figure import Curve, Figure, Map, Panel
from pkm_cnc.report.looks import DARKEST, SHADE, Look, looks
from pkm_cnc.report.text import plain

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
    "text.parse_math": False,  # a $ in a name is a $
    "svg.fonttype": "none",  # text stays text: it can be searched and edited
    "svg.hashsalt": "pkm_cnc",  # names within the file depend on its content alone
}
_WIDTH = 4.8
_PLAN, _MAP, _CURVES = 4.8, 3.9, 2.7
"""Inches: width of a panel beside another; height of a plan view, of a map with its scale beside it, of all others.
Two panels side by side on A4 are so shrunk to three quarters: text stays above 6 pt."""
_ALONE = 9.0
"""Inches: width of panels that stand below each other alone."""
_LETTERS = 12
"""Of a title on an inch."""
_MARKED = 40
"""Most points of a line that get a marker each; of longer ones some do."""


def svg(figure: Figure) -> bytes:
    """The figure as an SVG file, without date and version."""
    return _drawn(figure, "svg", {"Date": None, "Creator": None})


def png(figure: Figure) -> bytes:
    """The figure as a PNG file, without version."""
    return _drawn(figure, "png", {"Software": None})


def _drawn(figure: Figure, kind: str, metadata: dict[str, Any]) -> bytes:
    with _style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # the PNG then shows a box; the SVG is text
        file = io.BytesIO()
        _sheet(figure).savefig(file, format=kind, metadata=metadata)
        return file.getvalue()


@contextmanager
def _style() -> Iterator[None]:
    """The look of all pictures, whatever the reader's matplotlibrc says; ends with the block."""
    with matplotlib.style.context(["default", _STYLE]):
        yield


def _sheet(figure: Figure) -> Sheet:
    places = figure.places()
    heights = [_CURVES] * max(row + panel.rows for panel, (row, _) in zip(figure.panels, places, strict=True))
    for panel, (row, _) in zip(figure.panels, places, strict=True):
        if panel.rows == 1:
            heights[row] = max(heights[row], _height(panel))
    lone = figure.columns == 1 and all(_height(panel) == _CURVES for panel in figure.panels)
    width = _ALONE if lone else _WIDTH
    sheet = Sheet(figsize=(width * figure.columns, sum(heights) + 0.8), layout="constrained")
    sheet.suptitle(textwrap.fill(plain(figure.title), int(_LETTERS * width * figure.columns)), fontsize=11.0)
    grid = sheet.add_gridspec(len(heights), figure.columns, height_ratios=heights)
    heads: dict[int, Axes] = {}
    lowest = {column: row for row, column in sorted(places)}
    for panel, styles, (row, column) in zip(figure.panels, looks(figure), places, strict=True):
        above = heads.get(column) if figure.share_x else None
        axes = sheet.add_subplot(grid[row : row + panel.rows, column], sharex=above)
        heads.setdefault(column, axes)
        _draw_panel(axes, panel, styles)
        axes.set_title(textwrap.fill(plain(panel.title), int(_LETTERS * width)))
        if figure.share_x and row < lowest[column]:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    _add_legend(sheet)
    return sheet


def _height(panel: Panel) -> float:
    return _MAP if panel.map is not None else _PLAN if panel.equal else _CURVES


def _draw_panel(axes: Axes, panel: Panel, styles: Sequence[Look]) -> None:
    axes.set_xlabel(plain(panel.x_label))
    axes.set_ylabel(plain(panel.y_label))
    axes.margins(0.05)
    if panel.map is not None:
        _draw_map(axes, panel.map)
    for curve, look in zip(panel.curves, styles, strict=True):
        _draw_curve(axes, curve, look)
    for text in panel.notes:
        box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
        axes.text(text.x, text.y, plain(text.text), ha="center", va="center", fontsize=7.5, bbox=box, zorder=2.6)
        axes.update_datalim([(text.x, text.y)])
    axes.autoscale_view()
    if panel.equal:
        axes.set_aspect("equal", adjustable="box" if panel.map is not None else "datalim")
    if panel.x_step is not None:
        axes.xaxis.set_major_locator(MultipleLocator(panel.x_step))
    if panel.x_range is not None:
        axes.set_xlim(panel.x_range)
    if panel.y_range is not None:
        axes.set_ylim(panel.y_range)


def _draw_curve(axes: Axes, curve: Curve, look: Look) -> None:
    label = plain(curve.name) or None
    order = 2.2 if curve.role == "data" else 1.9
    if curve.kind == "area":
        axes.fill(curve.x, curve.y, color=look.color, alpha=SHADE, linewidth=0.0, label=label, zorder=1.8)
        return
    kind = {"color": look.color, "zorder": order, **_kind(curve, look)}
    if curve.bars is None:
        axes.plot(curve.x, curve.y, label=label, **kind)
    else:
        axes.errorbar(curve.x, curve.y, curve.bars, label=label, capsize=3.0, elinewidth=1.2, **kind)
    if curve.arrow:
        arrow = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 9.0, "color": look.color}
        tip, behind = (np.array([curve.x[at], curve.y[at]]) for at in (-1, -2))
        axes.annotate("", tuple(tip), tuple(tip + 0.01 * (behind - tip)), arrowprops=arrow, zorder=order)


def _kind(curve: Curve, look: Look) -> dict[str, Any]:
    """Line and marker."""
    kind: dict[str, Any] = {"linestyle": "none"}
    if curve.kind != "points":
        kind = {"linewidth": look.width, "linestyle": (0, look.dashes) if look.dashes else "-"}
    if curve.kind != "line":
        face = "white" if look.open else look.color
        kind |= {"marker": look.marker[0], "markersize": 5.0, "markerfacecolor": face}
        if curve.kind == "line and points":
            kind["markevery"] = max(1, len(curve.x) // _MARKED)
    return kind


def _draw_map(axes: Axes, field: Map) -> None:
    axes.grid(False)
    axes.set_facecolor("0.9")  # nothing there
    axes.margins(0.0)
    values = np.asarray(field.values, dtype=float)
    colors = ListedColormap(matplotlib.colormaps["viridis"](np.linspace(DARKEST, 1.0, 256)))
    drawn = axes.pcolormesh(field.x, field.y, values, cmap=colors, shading="nearest", rasterized=True)
    if field.has_contours():
        lines = axes.contour(field.x, field.y, values, colors="black", linewidths=0.7)
        axes.clabel(lines, fontsize=7.5)
    beside = axes.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map, whatever its shape
    axes.figure.colorbar(drawn, cax=beside, label=plain(field.label))


def _add_legend(sheet: Sheet) -> None:
    """One legend of all panels, below them, where it covers nothing."""
    entries: dict[str, Any] = {}
    for axes in sheet.axes:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    if entries:
        longest = 0.07 * max(map(len, entries)) + 0.6
        fitting = max(1, min(len(entries), int(sheet.get_figwidth() / longest)))
        sheet.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=fitting)
