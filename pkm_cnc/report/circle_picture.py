"""The picture of a circular test: the path with its radial deviation magnified, and the deviation over the angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pkm_cnc.contour import CirclePath, extrema
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.figure import Array, Curve, Figure, Note, Panel, round_scale
from pkm_cnc.tolerances import ARC_RADII

__all__ = ["circle_figure", "circle_plan", "circle_tests"]

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


def circle_figure(evaluation: Evaluation, paths: Sequence[CirclePath], name: str) -> Figure:
    """One circular test: plan view with the radial deviation magnified, the deviation over the actual angle."""
    arc = paths[0].arc
    x, y, z = (1e3 * value for value in arc.center)
    plan = circle_plan(paths)
    return Figure(
        name,
        f"Circular test, {evaluation.machine}: R {1e3 * arc.radius:.3f} mm, {60e3 * arc.feed:g} mm/min, "
        f"centre x {x:.3f}, y {y:.3f}, z {z:.3f} mm",
        [plan, _over_angle(paths)],
        f"{plan.title}. dR = programmed - actual radius, by the actual angle about the programmed centre; points mark "
        "its local maxima.",
        columns=2,
    )


def circle_plan(paths: Sequence[CirclePath]) -> Panel:
    """The actual paths in plan view, their distance to the programmed circle magnified to a round scale."""
    arc = paths[0].arc
    largest = max(float(np.abs(path.deviation).max()) for path in paths)
    scale = round_scale(largest, ROOM * arc.radius)

    def curve(angle: Array, deviation: Array, name: str, **kind: Any) -> Curve:
        radius = 1e3 * (arc.radius - scale * deviation)
        x, y = 1e3 * arc.center[0] + radius * np.cos(angle), 1e3 * arc.center[1] + radius * np.sin(angle)
        return Curve(name, x, y, value=1e6 * deviation, value_label="dR (um)", **kind)

    curves = [curve(FULL_TURN, 0.0 * FULL_TURN, "programmed", role="programmed")]
    notes = []
    for ring in _rings(paths):
        if scale * 1e-6 * ring < 0.9 * arc.radius:
            curves.append(curve(FULL_TURN, 0.0 * FULL_TURN + 1e-6 * ring, "", role="scale"))
            radius = 1e3 * (arc.radius - scale * 1e-6 * ring) / math.sqrt(2.0)
            notes.append(Note(1e3 * arc.center[0] + radius, 1e3 * arc.center[1] - radius, f"{ring:g} um"))
    for path in paths:
        curves.append(curve(path.angle, path.deviation, _direction(path)))
        tops = np.array(extrema(path))
        curves.append(curve(tops, _deviation(path, tops), "", kind="points"))
    title = f"Actual path, its distance to the programmed circle magnified {scale:.10g}:1"
    return Panel(title, "x (mm)", "y (mm)", curves, notes=notes, equal=True)


def _direction(path: CirclePath) -> str:
    return "counter-clockwise" if path.arc.sweep > 0.0 else "clockwise"


def _rings(paths: Sequence[CirclePath]) -> list[float]:
    """Round radial deviations, um, for circles that tell the scale."""
    lowest = 1e6 * min(float(path.deviation.min()) for path in paths)
    highest = 1e6 * max(float(path.deviation.max()) for path in paths)
    low, high = min(lowest, 0.0), max(highest, 0.0)
    step = round_scale(1.0, 0.5 * max(high - low, 1e-9))
    return [step * n for n in range(math.floor(low / step), math.ceil(high / step) + 1) if n]


def _deviation(path: CirclePath, angle: Array) -> Array:
    steps = len(path.by_angle)
    grid = np.arange(steps) * (math.tau / steps)
    return np.asarray(np.interp(angle, grid, path.by_angle, period=math.tau), dtype=np.float64)


def _over_angle(paths: Sequence[CirclePath]) -> Panel:
    curves = []
    for path in paths:
        order = np.argsort(path.angle)
        curves.append(Curve(_direction(path), np.degrees(path.angle[order]), 1e6 * path.deviation[order]))
        tops = np.array(extrema(path))
        numbers = ", ".join(f"{angle:.2f}" for angle in sorted(np.degrees(tops)))
        curves.append(
            Curve(
                f"{_direction(path)}: maxima at {numbers or 'no angle'} deg",
                np.degrees(tops),
                1e6 * _deviation(path, tops),
                kind="points",
                like=_direction(path),
            )
        )
    title = "Radial deviation (+ = the circle came out too small)"
    return Panel(title, "actual angle about the programmed centre (deg)", "dR (um)", curves, x_step=45.0)
