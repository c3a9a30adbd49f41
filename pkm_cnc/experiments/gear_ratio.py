"""Gear ratio of the Monopod, and what a constant deviation of the TCP is at the slider."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.errors import InputError
from pkm_cnc.experiments._monopod import STATIONS, joint, monopod, require_reachable, strut_angle
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT", "Options"]

_POINTS = 201


@dataclass(frozen=True)
class Options:
    """Options of gear-ratio."""

    gammas: tuple[float, ...] = parameter(
        (0.0,),
        "inclinations gamma, instead of the machine file's",
        unit="deg",
        minimum=-30.0,
        maximum=30.0,
        any_length=True,
    )
    begin: float = parameter(60.0, "TCP position x where the curves begin", unit="mm", above=0.0)
    end: float = parameter(560.0, "TCP position x where they end", unit="mm", above=0.0)
    feed: float = parameter(10000.0, "v of the TCP, of which dx = v / Kv", unit="mm/min", above=0.0)
    kv: float = parameter(50.0, "velocity gain Kv, of which dx = v / Kv; 50 1/s is 3 [1000/min]", unit="1/s", above=0.0)
    stations: tuple[float, ...] = parameter(STATIONS, "TCP positions x of the table", unit="mm", any_length=True)


def _run(lab: Lab, options: Options) -> Findings:
    if not options.begin < options.end:
        raise InputError(f"begin: {options.begin:g} mm is not below end {options.end:g} mm")
    deviation = options.feed / 60e3 / options.kv
    x = np.linspace(1e-3 * options.begin, 1e-3 * options.end, _POINTS)
    entries = [_curves(lab, options, gamma, deviation, x) for gamma in options.gammas]
    rows: list[list[str | float | None]] = [
        [entry["gamma_deg"], *(station[key] for key in _COLUMNS)] for entry in entries for station in entry["stations"]
    ]
    return Findings(
        tables=[Table(f"A deviation of {1e3 * deviation:.6g} mm at the TCP", ["gamma_deg", *_COLUMNS], rows)],
        figures=_figures(entries, deviation),
        data={"deviation_mm": 1e3 * deviation, "curves": entries},
        remarks=[
            "Gear ratio: du/dx (4-13). du_left, du_right: size of the slider's way for the TCP's from x to x - dx and "
            f"to x + dx, dx = v / Kv = {1e3 * deviation:.6g} mm; on a machine with straight axes their quotient is 1.",
            "The positions of the stations are ours, the thesis gives none.",
        ],
    )


_COLUMNS = ["x_mm", "beta_deg", "u_mm", "gear_ratio", "du_left_mm", "du_right_mm", "du_left_by_du_right"]


def _curves(lab: Lab, options: Options, gamma: float, deviation: float, x: Any) -> dict[str, Any]:
    _, machine = monopod(lab, "gear-ratio", [f"geometry.inclination={math.radians(gamma)!r}"])
    ends = (options.begin - 1e3 * deviation, options.end + 1e3 * deviation)
    require_reachable(machine, "begin and end, with dx", ends)
    require_reachable(
        machine, "stations, with dx", [s + k * 1e3 * deviation for s in options.stations for k in (-1, 1)]
    )

    def at(positions: Any) -> dict[str, Any]:
        here = joint(machine, positions)
        left = np.abs(joint(machine, positions - deviation) - here)
        right = np.abs(joint(machine, positions + deviation) - here)
        ratio = machine.jacobian(positions[:, None])[:, 0, 0]
        return {
            "x_mm": 1e3 * positions,
            "beta_deg": np.degrees(strut_angle(machine, positions)),
            "u_mm": 1e3 * here,
            "gear_ratio": ratio,
            "du_left_mm": 1e3 * left,
            "du_right_mm": 1e3 * right,
            "du_left_by_du_right": left / right,
        }

    curves = {key: value.tolist() for key, value in at(x).items()}
    stations = at(1e-3 * np.array(options.stations))
    rows = [dict(zip(stations, row, strict=True)) for row in zip(*(v.tolist() for v in stations.values()), strict=True)]
    return {"gamma_deg": gamma, **curves, "stations": rows}


def _figures(entries: list[dict[str, Any]], deviation: float) -> list[Figure]:
    def panel(title: str, label: str, keys: dict[str, str]) -> Panel:
        curves = [
            Curve(f"{name}gamma {entry['gamma_deg']:g} deg", np.array(entry["x_mm"]), np.array(entry[key]))
            for entry in entries
            for key, name in keys.items()
        ]
        return Panel(title, "TCP position x (mm)", label, curves)

    position = panel("Position of the slider", "u (mm)", {"u_mm": ""})
    ratio = panel("Gear ratio", "du/dx (1)", {"gear_ratio": ""})
    sides = panel("Way of the slider", "du (mm)", {"du_left_mm": "to x - dx, ", "du_right_mm": "to x + dx, "})
    quotient = panel("Quotient", "du_left / du_right (1)", {"du_left_by_du_right": ""})
    return [
        Figure("gear_ratio", "Slider and TCP of the Monopod", [position, ratio], "Figures 4-6 and 4-7.", share_x=True),
        Figure(
            "deviation",
            f"A constant deviation dx = {1e3 * deviation:.4g} mm of the TCP, seen at the slider",
            [sides, quotient],
            "Figure 4-8.",
            share_x=True,
        ),
    ]


EXPERIMENT = Experiment(
    name="gear-ratio",
    question="How do slider and TCP of the Monopod move against each other, and what is a constant deviation of the "
    "TCP at the slider? (thesis 4.2.3: 4-6..4-8, 4-13)",
    machine="monopod",
    options=Options,
    run=_run,
)
