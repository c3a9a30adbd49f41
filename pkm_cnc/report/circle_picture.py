"""The picture of a circular test: the path with its radial deviation magnified, and the deviation over the angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from pkm_cnc.contour import CirclePath, extrema
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.drawing import FIRST, PROGRAMMED, SECOND, legend_below, new_figure, note, plan_view, round_scale
from pkm_cnc.tolerances import ARC_RADII

__all__ = ["circle_figure", "circle_tests"]

Array = NDArray[np.floating[Any]]

ROOM = 0.6
"""Of the radius: how far the largest radial deviation is drawn from the programmed circle at most."""
FULL_TURN = np.linspace(0.0, math.tau, 721)


def circle_tests(evaluation: Evaluation) -> list[list[CirclePath]]:
    """The actual paths of a run's circular tests: those over the same circle at the same feed together, in order."""
    found: list[list[CirclePath]] = []
    for path in evaluation.circles().values():
        for paths in found:
            first = paths[0].arc
            if (
                math.dist(first.center, path.arc.center) < ARC_RADII
                and abs(first.radius - path.arc.radius) < ARC_RADII
                and first.feed == path.arc.feed
            ):
                paths.append(path)
                break
        else:
            found.append([path])
    return found


def circle_figure(evaluation: Evaluation, paths: Sequence[CirclePath]) -> Figure:
    """Draw one circular test."""
    arc = paths[0].arc
    x, y, z = (1e3 * value for value in arc.center)
    figure = new_figure(
        12.0,
        6.2,
        f"Circular test, {evaluation.machine}: R {1e3 * arc.radius:.3f} mm, {60e3 * arc.feed:g} mm/min, "
        f"centre x {x:.3f}, y {y:.3f}, z {z:.3f} mm",
    )
    grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.05))
    _draw_plan(figure.add_subplot(grid[0, 0]), paths)
    _draw_over_angle(figure.add_subplot(grid[0, 1]), paths)
    return figure


def _kind(path: CirclePath) -> dict[str, Any]:
    """Line style, and the direction for the legend."""
    return {**FIRST, "label": "counter-clockwise"} if path.arc.sweep > 0.0 else {**SECOND, "label": "clockwise"}


def _mark(path: CirclePath) -> dict[str, Any]:
    counter_clockwise = path.arc.sweep > 0.0
    style = FIRST if counter_clockwise else SECOND
    face = style["color"] if counter_clockwise else "white"
    marker = "^" if counter_clockwise else "v"
    return {"linestyle": "none", "color": style["color"], "marker": marker, "markerfacecolor": face, "zorder": 4}


def _draw_plan(axes: Axes, paths: Sequence[CirclePath]) -> None:
    arc = paths[0].arc
    largest = max(float(np.abs(path.deviation).max()) for path in paths)
    scale = round_scale(largest, ROOM * arc.radius)
    plan_view(axes, f"Actual path, its distance to the programmed circle magnified {scale:.10g}:1")
    axes.grid(False)

    def draw(angle: Array, deviation: Array, **kind: Any) -> None:
        radius = 1e3 * (arc.radius - scale * deviation)
        axes.plot(1e3 * arc.center[0] + radius * np.cos(angle), 1e3 * arc.center[1] + radius * np.sin(angle), **kind)

    draw(FULL_TURN, 0.0 * FULL_TURN, **PROGRAMMED, label="programmed")
    lowest, highest = (1e6 * bound for bound in _bounds(paths))
    for deviation in MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(min(lowest, 0.0), max(highest, 0.0)):
        if deviation and scale * 1e-6 * deviation < 0.9 * arc.radius:
            draw(FULL_TURN, 0.0 * FULL_TURN + 1e-6 * deviation, color="0.75", linewidth=0.6, linestyle=":")
            radius = 1e3 * (arc.radius - scale * 1e-6 * deviation) / math.sqrt(2.0)
            note(axes, 1e3 * arc.center[0] + radius, 1e3 * arc.center[1] - radius, f"{deviation:g} um")
    for path in paths:
        draw(path.angle, path.deviation, **_kind(path))
        tops = np.array(extrema(path))
        draw(tops, _deviation(path, tops), **_mark(path))
    legend_below(axes, 3)


def _bounds(paths: Sequence[CirclePath]) -> tuple[float, float]:
    return min(float(path.deviation.min()) for path in paths), max(float(path.deviation.max()) for path in paths)


def _deviation(path: CirclePath, angle: Array) -> Array:
    steps = len(path.by_angle)
    grid = np.arange(steps) * (math.tau / steps)
    return np.asarray(np.interp(angle, grid, path.by_angle, period=math.tau), dtype=np.float64)


def _draw_over_angle(axes: Axes, paths: Sequence[CirclePath]) -> None:
    axes.set_title("Radial deviation (+ = the circle came out too small)")
    axes.set_xlabel("actual angle about the programmed centre (deg)")
    axes.set_ylabel("dR (um)")
    for path in paths:
        order = np.argsort(path.angle)
        axes.plot(np.degrees(path.angle[order]), 1e6 * path.deviation[order], **_kind(path))
        tops = np.array(extrema(path))
        numbers = ", ".join(f"{angle:.2f}" for angle in sorted(np.degrees(tops)))
        axes.plot(
            np.degrees(tops),
            1e6 * _deviation(path, tops),
            **_mark(path),
            label=f"maxima at {numbers or 'no angle'} deg",
        )
    axes.set_xlim(0.0, 360.0)
    axes.xaxis.set_major_locator(MultipleLocator(45.0))
    legend_below(axes, 2)
