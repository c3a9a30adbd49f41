"""Figures for the screen: zoomed and hovered, by plotly. The script itself is in the page once.

Every panel is a picture of its own in a grid of the page, so that panels side by side come below each other on a
narrow screen; panels that share their x range are zoomed together by the script.
"""

from __future__ import annotations

import html
import json
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.offline import get_plotlyjs

from pkm_cnc.report.figure import Curve, Figure, Map, Panel
from pkm_cnc.report.looks import DARKEST, SHADE, Look, looks
from pkm_cnc.report.text import plain

__all__ = ["picture", "script"]

WIDER = 1.3
"""Of lines on the screen against paper."""
_LABEL = 48
"""Most letters of a label's line: more do not fit on a narrow screen."""
_DRAW = """
function drawFigure(name, panels) {
  const config = {
    displaylogo: false, responsive: true, typesetMath: false,  // a $ in a name is a $
    modeBarButtonsToRemove: ["select2d", "lasso2d"],
    showSendToCloud: false, plotlyServerURL: ""  // what a machine does is not sent to anybody
  };
  const plots = panels.map((panel, place) => document.getElementById(name + "-" + (place + 1)));
  panels.forEach((panel, place) => Plotly.newPlot(plots[place], panel.data, panel.layout, config));
  plots.forEach((plot, place) => plot.on("plotly_relayout", () => plots.forEach((other, at) => {
    const range = plot.layout.xaxis.range;
    if (at !== place && panels[place].linked !== null && panels[at].linked === panels[place].linked
        && String(other.layout.xaxis.range) !== String(range)) {
      Plotly.relayout(other, {"xaxis.range": range.slice()});
    }
  })));
}
"""


def script() -> str:
    """The JavaScript that draws the pictures, for a page's head."""
    return f"{get_plotlyjs()}\n{_DRAW}"


def picture(figure: Figure, name: str) -> str:
    """The figure as HTML, a div with the id `name` and the call that fills it; `script` must have been loaded."""
    places = figure.places()
    cells, panels = [], []
    for place, (panel, styles) in enumerate(zip(figure.panels, looks(figure), strict=True)):
        column = places[place][1]
        below = [
            other
            for other, (_, at) in zip(figure.panels[place + 1 :], places[place + 1 :], strict=True)
            if at == column
        ]
        alone = not below or _names(below[0]) != _names(panel)
        drawn = go.Figure(_traces(panel, styles), _layout(panel, legend=alone and bool(_names(panel))))
        if figure.share_x and below:
            drawn.update_xaxes(title_text="")
        if figure.share_x:
            drawn.update_xaxes(
                range=_x_range([at for at, (_, c) in zip(figure.panels, places, strict=True) if c == column])
            )
        panels.append({**json.loads(drawn.to_json()), "linked": column if figure.share_x else None})
        size = " tall" if panel.rows == 1 and (panel.equal or panel.map is not None) else ""
        cells.append(
            f'<div class="panel{size}" style="--rows: {panel.rows}"><h3>{_text(panel.title)}</h3>'
            f'<div class="plot" id="{name}-{place + 1}"></div></div>'
        )
    call = json.dumps(panels, sort_keys=True).replace("<", "\\u003c")  # no text may end the script
    return (
        f'<div id="{name}" class="panels" style="--columns: {figure.columns}">{"".join(cells)}</div>'
        f'<script>drawFigure("{name}", {call});</script>'
    )


def _text(text: str) -> str:
    """Plotly takes a text for HTML, as the page does."""
    return html.escape(plain(text), quote=False)


def _label(text: str) -> str:
    return "<br>".join(_text(part) for line in text.split("\n") for part in textwrap.wrap(line, _LABEL) or [""])


def _names(panel: Panel) -> list[str]:
    return list(dict.fromkeys(curve.name for curve in panel.curves if curve.name))


def _x_range(panels: Sequence[Panel]) -> tuple[float, float] | None:
    """What panels that share their x axis show together."""
    given = next((panel.x_range for panel in panels if panel.x_range), None)
    parts = [np.asarray(curve.x, dtype=float) for panel in panels for curve in panel.curves]
    parts += [np.asarray(panel.map.x, dtype=float) for panel in panels if panel.map is not None]
    there = np.concatenate([part[np.isfinite(part)] for part in parts] or [np.zeros(0)])
    if given or not len(there):
        return given
    margin = 0.02 * float(np.ptp(there))
    return float(there.min()) - margin, float(there.max()) + margin


def _traces(panel: Panel, styles: Sequence[Look]) -> list[Any]:
    traces = [] if panel.map is None else _map_traces(panel, panel.map)
    shown: set[str] = set()
    for curve, look in zip(panel.curves, styles, strict=True):
        traces.append(
            _area(curve, look) if curve.kind == "area" else _trace(panel, curve, look, curve.name not in shown)
        )
        shown.add(curve.name)
    return traces


def _trace(panel: Panel, curve: Curve, look: Look, first: bool) -> Any:
    mode = {"points": "markers", "line and points": "lines+markers"}.get(curve.kind, "lines")
    dashes = ",".join(f"{WIDER * length:g}px" for length in look.dashes) or "solid"
    marker = {"symbol": f"{look.marker[1]}-open" if look.open else look.marker[1], "size": 7, "color": look.color}
    if curve.arrow:
        mode = "lines+markers"
        size = [0.0] * (len(curve.x) - 1) + [10.0]
        marker = {"symbol": "arrow", "angleref": "previous", "size": size, "color": look.color}
    value = "" if curve.value is None else f"<br>{_hover(curve.value_label)}: %{{customdata:.6g}}"
    return go.Scatter(
        x=np.asarray(curve.x, dtype=float),
        y=np.asarray(curve.y, dtype=float),
        customdata=curve.value,
        name=_text(curve.name),
        legendgroup=_text(curve.name) or None,
        showlegend=bool(curve.name) and first,
        mode=mode,
        line={"color": look.color, "width": WIDER * look.width, "dash": dashes},
        marker=marker,
        error_y=None
        if curve.bars is None
        else {"array": curve.bars, "color": look.color, "thickness": 1.5, "width": 4},
        hovertemplate=f"{_hover(panel.x_label)}: %{{x:.6g}}<br>{_hover(panel.y_label)}: %{{y:.6g}}{value}",
        connectgaps=False,
    )


def _hover(label: str) -> str:
    """A label within a hover template, where %{...} would be replaced."""
    return _text(" ".join(label.split())).replace("%{", "% {")


def _area(curve: Curve, look: Look) -> Any:
    red, green, blue = (int(look.color[at : at + 2], 16) for at in (1, 3, 5))
    return go.Scatter(
        x=np.asarray(curve.x, dtype=float),
        y=np.asarray(curve.y, dtype=float),
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=f"rgba({red},{green},{blue},{SHADE})",
        name=_text(curve.name),
        legendgroup=_text(curve.name) or None,
        showlegend=bool(curve.name),
        hoverinfo="skip",
    )


def _map_traces(panel: Panel, field: Map) -> list[Any]:
    values = np.asarray(field.values, dtype=float)
    colors = sample_colorscale("Viridis", np.linspace(DARKEST, 1.0, 16).tolist())
    cells = go.Heatmap(
        x=field.x,
        y=field.y,
        z=values,
        colorscale=colors,
        hovertemplate=f"{_hover(panel.x_label)}: %{{x:.6g}}<br>{_hover(panel.y_label)}: %{{y:.6g}}<br>"
        f"{_hover(field.label)}: %{{z:.6g}}<extra></extra>",
        colorbar={"title": {"text": _label(field.label), "side": "right"}, "thickness": 14},
    )
    lines = go.Contour(
        x=field.x,
        y=field.y,
        z=values,
        contours={"coloring": "none", "showlabels": True, "labelfont": {"size": 11, "color": "#000000"}},
        line={"color": "#000000", "width": 0.8, "smoothing": 0.0},
        showlegend=False,
        hoverinfo="skip",
    )
    return [cells, lines] if field.has_contours() else [cells]


def _layout(panel: Panel, legend: bool) -> dict[str, Any]:
    line = {
        "showline": True,
        "linecolor": "#444",
        "gridcolor": "#e2e2e2",
        "zerolinecolor": "#cccccc",
        "automargin": True,
    }
    x_axis = {**line, "title": {"text": _label(panel.x_label)}, "range": panel.x_range, "dtick": panel.x_step}
    y_axis = {**line, "title": {"text": _label(panel.y_label)}, "range": panel.y_range}
    if panel.equal:
        x_axis["constrain"] = "domain"
        y_axis |= {"constrain": "domain", "scaleanchor": "x", "scaleratio": 1}
    return {
        "template": "none",
        "margin": {"l": 60, "r": 15, "t": 25, "b": 50},
        "font": {"family": "system-ui, sans-serif", "size": 12},
        "xaxis": x_axis,
        "yaxis": y_axis,
        "showlegend": legend,
        "legend": {"orientation": "h", "yref": "container", "y": 0.0, "yanchor": "bottom", "x": 0.0},
        "hovermode": "closest",
        "annotations": [
            {
                "x": note.x,
                "y": note.y,
                "text": _text(note.text),
                "showarrow": False,
                "font": {"size": 11},
                "bgcolor": "rgba(255,255,255,0.85)",
            }
            for note in panel.notes
        ],
    }
