"""Figures for the screen: zoomed and hovered, by plotly. The script itself is in the page once."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from pkm_cnc.report.figure import Array, Curve, Figure, Panel
from pkm_cnc.report.looks import Look, looks

__all__ = ["picture", "script"]

MOST_POINTS = 4000
"""Of a curve on the screen. Of a longer one every stretch keeps its ends and its extremes in x and y."""


def script() -> str:
    """The JavaScript that draws the pictures, for a page's head."""
    return str(get_plotlyjs())


def picture(figure: Figure, name: str) -> str:
    """The figure as HTML, a div with the id `name` and the call that fills it; `script` must have been loaded."""
    return str(
        plotly.io.to_html(
            _drawn(figure),
            include_plotlyjs=False,
            full_html=False,
            div_id=name,
            config={"displaylogo": False, "responsive": True},
        )
    )


def _drawn(figure: Figure) -> Any:
    columns = min(figure.columns, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    rows_of_panels = [figure.panels[row * columns : (row + 1) * columns] for row in range(rows)]
    heights = [560 if any(panel.equal or panel.map for panel in row) else 300 for row in rows_of_panels]
    height = sum(heights) + 130
    drawn = make_subplots(
        rows=rows,
        cols=columns,
        shared_xaxes="columns" if figure.share_x else False,
        subplot_titles=[html.escape(panel.title, quote=False) for panel in figure.panels],
        row_heights=heights,
        vertical_spacing=min(95 / height, 0.9 / rows),
        horizontal_spacing=0.12 if columns > 1 else None,
    )
    shown: set[str] = set()
    for place, (panel, styles) in enumerate(zip(figure.panels, looks(figure), strict=True)):
        row, column = place // columns + 1, place % columns + 1
        at = {"row": row, "col": column}
        if panel.map is not None:
            drawn.add_trace(_heatmap(panel, column, columns, row, rows), **at)
        for curve, look in zip(panel.curves, styles, strict=True):
            drawn.add_trace(_trace(curve, look, curve.name not in shown), **at)
            shown.add(curve.name)
        for note in panel.notes:
            text = html.escape(note.text, quote=False)
            drawn.add_annotation(
                x=note.x, y=note.y, text=text, showarrow=False, font_size=11, bgcolor="rgba(255,255,255,0.85)", **at
            )
        drawn.update_xaxes(title_text=html.escape(panel.x_label, quote=False), **at)
        drawn.update_yaxes(title_text=html.escape(panel.y_label, quote=False), **at)
        if panel.x_step is not None:
            drawn.update_xaxes(dtick=panel.x_step, **at)
        if panel.equal:
            anchor = next(drawn.select_traces(**at)).xaxis or "x"
            drawn.update_yaxes(scaleanchor=anchor, scaleratio=1, constrain="domain", **at)
            drawn.update_xaxes(constrain="domain", **at)
    drawn.update_xaxes(showline=True, linecolor="#444", gridcolor="#e2e2e2", zerolinecolor="#cccccc")
    drawn.update_yaxes(showline=True, linecolor="#444", gridcolor="#e2e2e2", zerolinecolor="#cccccc")
    drawn.update_layout(
        height=height,
        template="none",
        margin={"l": 75, "r": 25, "t": 45, "b": 60},
        font={"family": "system-ui, sans-serif", "size": 13},
        legend={"orientation": "h", "yanchor": "top", "y": -75 / height, "x": 0.0},
        hovermode="closest",
    )
    return drawn


def _trace(curve: Curve, look: Look, first: bool) -> Any:
    x, y = _thinned(np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float))
    dashes = ",".join(f"{1.3 * length:g}px" for length in look.dashes) or "solid"
    symbol = f"{look.marker[1]}-open" if look.open else look.marker[1]
    return go.Scatter(
        x=x,
        y=y,
        name=html.escape(curve.name, quote=False),
        legendgroup=curve.name or None,
        showlegend=bool(curve.name) and first,
        mode={"line": "lines", "points": "markers", "line and points": "lines+markers"}[curve.kind],
        line={"color": look.color, "width": 1.3 * look.width, "dash": dashes},
        marker={"symbol": symbol, "size": 7, "color": look.color},
        hovertemplate="%{x:.6g}, %{y:.6g}",
        connectgaps=False,
    )


def _heatmap(panel: Panel, column: int, columns: int, row: int, rows: int) -> Any:
    field = panel.map
    assert field is not None
    return go.Heatmap(
        x=field.x,
        y=field.y,
        z=np.asarray(field.values, dtype=float),
        colorscale="Viridis",
        hovertemplate="%{x:.6g}, %{y:.6g}: %{z:.6g}<extra></extra>",
        colorbar={
            "title": {"text": html.escape(field.label, quote=False), "side": "right"},
            "x": (column - 0.12) / columns + 0.04 if columns > 1 else 1.0,
            "y": 1.0 - (row - 0.5) / rows,
            "len": 0.8 / rows,
            "thickness": 14,
        },
    )


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """The points that are drawn: all, or of each stretch the first, the last and the extremes, in order."""
    if len(x) <= MOST_POINTS:
        return x, y
    kept = set()
    for stretch in np.array_split(np.arange(len(x)), MOST_POINTS // 6):
        kept |= {int(stretch[0]), int(stretch[-1])}
        for values in (x[stretch], y[stretch]):
            gaps = np.flatnonzero(~np.isfinite(values))
            kept |= set(stretch[gaps[:1]].tolist())
            if len(gaps) < len(values):
                kept |= {int(stretch[np.nanargmin(values)]), int(stretch[np.nanargmax(values)])}
    order = sorted(kept)
    return x[order], y[order]
