"""What the experiments with circles share: directions, harmonics of the radial deviation, the magnified path."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pkm_cnc.contour import CirclePath
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.report import round_scale
from pkm_cnc.report.figure import Array, Curve, Note, Panel

__all__ = ["DIRECTIONS", "ORDERS", "by_direction", "harmonics", "polar_panel"]

DIRECTIONS = {"ccw": "counter-clockwise", "cw": "clockwise"}
ORDERS = 12
"""Highest order of the harmonics."""
ROOM = 0.5
"""Of the radius: how far the largest radial deviation is drawn from the programmed circle at most."""


def by_direction(trial: Trial) -> dict[str, tuple[int, CirclePath]]:
    """Segment and actual path of the full circles of a run, by direction (of several the last)."""
    return {
        "ccw" if path.arc.sweep > 0.0 else "cw": (segment, path) for segment, path in trial.evaluation.circles().items()
    }


def harmonics(path: CirclePath) -> dict[str, Array]:
    """dR = sum of amplitude_um[n] cos(n angle - phase_deg[n]) over the orders n = 0..12."""
    weights = np.fft.rfft(path.by_angle)[: ORDERS + 1] / len(path.by_angle) * 2e6
    weights[0] /= 2.0
    return {"amplitude_um": np.abs(weights), "phase_deg": np.degrees(-np.angle(weights)) + 0.0}


def polar_panel(paths: Mapping[str, CirclePath], title: str) -> Panel:
    """The paths by direction in plan view, their distance to the programmed circle magnified as the title then says."""
    arc = next(iter(paths.values())).arc
    largest = max((float(path.deviation[np.abs(path.deviation).argmax()]) for path in paths.values()), key=abs)
    scale = round_scale(abs(largest), ROOM * arc.radius)
    angle = np.linspace(0.0, math.tau, 721)

    def curve(name: str, deviation: Array, role: Any = "data") -> Curve:
        r = 1e3 * (arc.radius - scale * deviation)
        return Curve(name, 1e3 * arc.center[0] + r * np.cos(angle), 1e3 * arc.center[1] + r * np.sin(angle), role=role)

    curves = [curve("programmed", 0.0 * angle, "programmed")]
    for direction, path in paths.items():
        at = np.arange(len(path.by_angle)) * (math.tau / len(path.by_angle))
        curves.append(curve(DIRECTIONS[direction], np.interp(angle, at, path.by_angle, period=math.tau)))
    note = Note(1e3 * arc.center[0], 1e3 * arc.center[1], f"largest dR {1e6 * largest:.1f} um")
    return Panel(f"{title}, dR magnified {scale:.10g}:1", "x (mm)", "y (mm)", curves, notes=[note], equal=True)
