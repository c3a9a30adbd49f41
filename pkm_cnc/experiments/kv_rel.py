"""The velocity gain that the TCP of the Monopod shows, over position, direction, feed and feed-forward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.errors import InputError
from pkm_cnc.experiments._monopod import STATIONS, monopod, require_reachable
from pkm_cnc.experiments._velocity_gain import SETTLED, Array, Pass, passes, passes_program, require_root
from pkm_cnc.experiments._velocity_step import VelocityStep, velocity_step
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT", "Options"]

MM = 1e3
_GRID = 101  # positions at which the directions are compared


@dataclass(frozen=True)
class Options:
    """Options of kv-rel."""

    feeds: tuple[float, ...] = parameter(
        (6000.0, 18000.0, 36000.0),
        "of the TCP; the first, second and last are the thesis' 100, 300 and 600 mm/s",
        unit="mm/min",
        above=0.0,
        any_length=True,
    )
    kv: float = parameter(50.0, "velocity gain of the drive; 50 1/s is 3 [1000/min]", unit="1/s", above=0.0)
    begin: float = parameter(200.0, "TCP position x where the way begins", unit="mm", above=0.0)
    end: float = parameter(560.0, "TCP position x where the way ends", unit="mm", above=0.0)
    acceleration: float = parameter(20.0, "of the TCP at the ends of the way", unit="m/s^2", above=0.0)
    positions: tuple[float, ...] = parameter(
        (350.0, 400.0, 450.0), "TCP positions x of the tables", unit="mm", any_length=True
    )
    velocity_feed: float = parameter(18000.0, "at which velocities are looked at", unit="mm/min", above=0.0)
    feed_forward_feed: float = parameter(36000.0, "at which feed-forward is looked at", unit="mm/min", above=0.0)
    feed_forwards: tuple[float, ...] = parameter(
        (0.5, 1.0), "factors K_nV of the velocity feed-forward", unit="1", above=0.0, any_length=True
    )
    setpoint_delay: float = parameter(
        0.0005, "T_Gn of the balancing filter: half a servo period of 1 ms", unit="s", minimum=0.0
    )
    equivalent_delay: float = parameter(
        0.00082, "T_En of the balancing filter: that of the default drive", unit="s", minimum=0.0
    )
    stations: tuple[float, ...] = parameter(
        STATIONS, "TCP positions x of the velocity steps", unit="mm", any_length=True
    )
    step_gains: tuple[float, ...] = parameter(
        (50.0, 250.0 / 3.0), "Kv of the velocity steps; 3 and 5 [1000/min]", unit="1/s", above=0.0, any_length=True
    )
    step_feed: float = parameter(6000.0, "of the velocity steps, in +x", unit="mm/min", above=0.0)


def _run(lab: Lab, options: Options) -> Findings:
    base = [f"drive.kv={options.kv!r}", f"motion.acceleration={options.acceleration!r}"]
    _, machine = monopod(lab, "kv-rel", base)
    require_root(machine)
    if not options.begin < options.end:
        raise InputError(f"begin: {options.begin:g} mm is not below end {options.end:g} mm")
    require_reachable(machine, "begin and end", (options.begin, options.end))
    forward = {factor: _feed_forward(options, factor) for factor in options.feed_forwards}
    runs: dict[str, tuple[list[str], tuple[float, ...]]] = {"feeds": ([], options.feeds)}
    runs |= {"velocity": ([], (options.velocity_feed,))}
    runs |= {"without": ([], (options.feed_forward_feed,))}
    runs |= {f"{factor:g}": (overrides, (options.feed_forward_feed,)) for factor, overrides in forward.items()}
    found: dict[str, list[Pass]] = {}
    for done, (name, (overrides, feeds)) in enumerate(runs.items()):
        lab.tell(done / (len(runs) + 1), name)
        program = passes_program(options.begin, options.end, feeds)
        found[name] = passes(lab.run(lab.setup([*base, *overrides]), program, "kv-rel"), machine)
    lab.tell(len(runs) / (len(runs) + 1), "velocity steps")
    steps = [
        velocity_step(lab, station, options.step_feed, gain)
        for station in options.stations
        for gain in options.step_gains
    ]
    with_forward = {factor: found[f"{factor:g}"] for factor in forward}
    reversals = [_reversal(*pair) for pair in _pairs(found["feeds"])]
    data = {
        "kv_per_s": options.kv,
        "passes": [_entry(one, options.positions) for one in found["feeds"]],
        "reversal": reversals,
        "velocity": [_velocities(one, options.positions) for one in found["velocity"]],
        "feed_forward": _feed_forward_entries(found["without"], with_forward),
        "velocity_steps": [step.to_json() for step in steps],
    }
    figures = [
        _gain_figure(found["feeds"]),
        _velocity_figure(found["velocity"]),
        _feed_forward_figure(found["without"], with_forward),
        _step_figure(steps),
    ]
    return Findings(_tables(data), figures, data, _remarks(options, reversals))


def _feed_forward(options: Options, factor: float) -> list[str]:
    return [
        f"drive.velocity_feed_forward={factor!r}",
        f"drive.setpoint_delay={options.setpoint_delay!r}",
        f"drive.equivalent_delay={options.equivalent_delay!r}",
    ]


def _pairs(found: Sequence[Pass]) -> list[tuple[Pass, Pass]]:
    """Ways in +x and -x at the same feed, as `passes_program` has them."""
    return list(zip(found[::2], found[1::2], strict=True))


def _common(one: Pass, other: Pass) -> Array:
    """Positions, m, that both ways pass when settled. Raises InputError if there are none."""
    low, high = max(one.x.min(), other.x.min()), min(one.x.max(), other.x.max())
    if not low < high:
        raise InputError(
            f"at {60e3 * one.feed:g} mm/min the ways in +x and in -x have no settled position in common; take a "
            "longer way, a lower feed, a higher kv or a higher acceleration"
        )
    return np.asarray(np.linspace(low, high, _GRID))


def _entry(one: Pass, positions_mm: Sequence[float]) -> dict[str, Any]:
    x = np.array(positions_mm) / MM
    estimate = np.argsort(one.estimated_x)
    return {
        "direction": "+x" if one.direction > 0 else "-x",
        "feed_mm_min": 60e3 * one.feed,
        "x_mm": list(positions_mm),
        "kv_rel_simulated": _plain(one.at(one.simulated, x)),
        "kv_rel_closed_form": _plain(one.at(one.closed, x)),
        "kv_rel_estimated": _plain(
            np.interp(x, one.estimated_x[estimate], one.estimated[estimate], left=np.nan, right=np.nan)
        ),
        "tracking_error_mm": _plain(MM * one.direction * one.at(one.lag, x)),
        "tracking_error_estimated_mm": _plain(MM * one.direction * one.at(one.estimated_lag, x)),
        "kv_tcp_per_s": _plain(one.at(one.kv_tcp, x)),
        "simulated_less_closed_form_max_abs": float(np.abs(one.simulated - one.closed).max()),
        "simulated_less_estimated_max_abs": float(np.abs(one.simulated - one.estimated).max()),
    }


def _plain(values: Array) -> list[float | None]:
    return [value if value == value else None for value in values.tolist()]


def _reversal(forth: Pass, back: Pass) -> dict[str, Any]:
    """How far K_V-rel - 1 in -x is from that in +x with its sign changed, at the same actual positions."""
    x = _common(forth, back)
    plus, minus = forth.at(forth.simulated, x) - 1.0, back.at(back.simulated, x) - 1.0
    lag_plus, lag_minus = forth.at(forth.lag, x), -back.at(back.lag, x)
    estimated_plus, estimated_minus = forth.at(forth.estimated_lag, x), -back.at(back.estimated_lag, x)
    return {
        "feed_mm_min": 60e3 * forth.feed,
        "x_from_mm": MM * float(x[0]),
        "x_to_mm": MM * float(x[-1]),
        "kv_rel_minus_1_in_plus_x_min_max": [float(plus.min()), float(plus.max())],
        "kv_rel_minus_1_in_minus_x_min_max": [float(minus.min()), float(minus.max())],
        "mirror_error_percent": 100.0 * float(np.abs(plus + minus).max() / np.abs(plus).max()),
        "tracking_error_mean_in_plus_x_mm": MM * float(lag_plus.mean()),
        "tracking_error_mean_in_minus_x_mm": MM * float(lag_minus.mean()),
        "tracking_error_estimated_mean_in_plus_x_mm": MM * float(estimated_plus.mean()),
        "tracking_error_estimated_mean_in_minus_x_mm": MM * float(estimated_minus.mean()),
        "tracking_error_higher_in_minus_x_everywhere": bool((lag_minus > lag_plus).all()),
    }


def _velocities(one: Pass, positions_mm: Sequence[float]) -> dict[str, Any]:
    x = np.array(positions_mm) / MM
    drive, at_once = np.abs(one.drive_velocity), np.abs(one.demanded_drive_velocity)
    speed = one.direction * one.tcp_velocity
    return {
        "direction": "+x" if one.direction > 0 else "-x",
        "feed_mm_min": 60e3 * one.feed,
        "x_mm": list(positions_mm),
        "tcp_speed_mm_s": _plain(MM * one.at(speed, x)),
        "tcp_speed_less_feed_min_max_mm_s": [
            MM * float((speed - one.feed).min()),
            MM * float((speed - one.feed).max()),
        ],
        "drive_speed_mm_s": _plain(MM * one.at(drive, x)),
        "drive_speed_demanded_at_once_mm_s": _plain(MM * one.at(at_once, x)),
        "drive_speed_demanded_here_mm_s": _plain(MM * one.at(np.abs(one.demanded_drive_velocity_here), x)),
        "drive_slower_than_demanded_at_once_everywhere": bool((drive < at_once).all()),
        "drive_faster_than_demanded_at_once_everywhere": bool((drive > at_once).all()),
    }


def _feed_forward_entries(without: Sequence[Pass], with_forward: dict[float, list[Pass]]) -> list[dict[str, Any]]:
    entries = []
    for factor, found in {0.0: list(without), **with_forward}.items():
        for one, base in zip(found, without, strict=True):
            x = _common(one, base)
            gain, base_gain = (p.at(p.simulated, x) - 1.0 for p in (one, base))
            lag, base_lag = (np.abs(p.at(p.lag, x)) for p in (one, base))
            entries.append(
                {
                    "velocity_feed_forward": factor,
                    "direction": "+x" if one.direction > 0 else "-x",
                    "feed_mm_min": 60e3 * one.feed,
                    "x_from_mm": MM * float(x[0]),
                    "x_to_mm": MM * float(x[-1]),
                    "kv_rel_min_max": [1.0 + float(gain.min()), 1.0 + float(gain.max())],
                    "kv_rel_deviation_from_1_mean": float(np.abs(gain).mean()),
                    "kv_rel_deviation_reduced_percent": 100.0
                    * (1.0 - float(np.abs(gain).mean() / np.abs(base_gain).mean())),
                    "tracking_error_mean_mm": MM * float(lag.mean()),
                    "tracking_error_reduced_percent": 100.0 * (1.0 - float(lag.mean() / base_lag.mean())),
                }
            )
    return entries


def _tables(data: dict[str, Any]) -> list[Table]:
    columns = ["feed_mm_min", "direction", "x_mm", "kv_rel_simulated", "kv_rel_closed_form", "kv_rel_estimated"]
    columns += ["tracking_error_mm", "tracking_error_estimated_mm"]
    gains: list[list[str | float | None]] = [
        [entry["feed_mm_min"], entry["direction"], *(entry[name][place] for name in columns[2:])]
        for entry in data["passes"]
        for place in range(len(entry["x_mm"]))
    ]
    reversal_columns = ["feed_mm_min", "x_from_mm", "x_to_mm", "mirror_error_percent"]
    reversal_columns += [f"tracking_error_mean_in_{side}_x_mm" for side in ("plus", "minus")]
    speeds = ["x_mm", "tcp_speed_mm_s", "drive_speed_mm_s", "drive_speed_demanded_at_once_mm_s"]
    speeds += ["drive_speed_demanded_here_mm_s"]
    speed_rows: list[list[str | float | None]] = [
        [entry["direction"], *(entry[name][place] for name in speeds)]
        for entry in data["velocity"]
        for place in range(len(entry["x_mm"]))
    ]
    forward = ["velocity_feed_forward", "direction", "x_from_mm", "x_to_mm", "kv_rel_deviation_from_1_mean"]
    forward += ["kv_rel_deviation_reduced_percent", "tracking_error_mean_mm", "tracking_error_reduced_percent"]
    steps = ["station_mm", "kv_per_s", "overshoot_percent", "rise_time_ms", "settling_time_ms", "speed_at_end_mm_s"]
    return [
        Table("Relative velocity gain K_V-rel", columns, gains),
        Table("Reversal", reversal_columns, [[entry[name] for name in reversal_columns] for entry in data["reversal"]]),
        Table("Velocities", ["direction", *speeds], speed_rows),
        Table("Velocity feed-forward", forward, [[entry[name] for name in forward] for entry in data["feed_forward"]]),
        Table("Velocity steps", steps, [[entry[name] for name in steps] for entry in data["velocity_steps"]]),
    ]


def _gain_figure(found: Sequence[Pass]) -> Figure:
    panels = []
    for pair in _pairs(found):
        curves = []
        for one in pair:
            way = "+x" if one.direction > 0 else "-x"
            curves += [
                Curve(f"simulated {way}", MM * one.x, one.simulated),
                Curve(f"4-17 {way}", MM * one.x[::20], one.closed[::20], "points"),
                Curve(f"estimated {way}", MM * one.estimated_x, one.estimated),
            ]
        title = f"{MM * pair[0].feed:g} mm/s"
        panels.append(Panel(title, "actual TCP position x (mm)", "K_V-rel (1)", curves))
    caption = "Figure 4-12: + and - x are nearly, not exactly, mirror images about 1."
    return Figure("kv_rel", "Relative velocity gain of the Monopod", panels, caption, share_x=True)


def _velocity_figure(found: Sequence[Pass]) -> Figure:
    tcp, drive = [], []
    for one in found:
        way = "+x" if one.direction > 0 else "-x"
        tcp.append(Curve(f"actual {way}", MM * one.x, MM * np.abs(one.tcp_velocity)))
        drive.append(Curve(f"actual {way}", MM * one.x, MM * np.abs(one.drive_velocity)))
        drive.append(Curve(f"demanded at the same instant {way}", MM * one.x, MM * np.abs(one.demanded_drive_velocity)))
    both = np.concatenate([one.x for one in found])
    ends = np.array([both.min(), both.max()])
    tcp.insert(0, Curve("demanded", MM * ends, MM * np.full(2, found[0].feed), role="programmed"))
    panels = [
        Panel("TCP", "actual TCP position x (mm)", "speed (mm/s)", tcp),
        Panel("Slider", "actual TCP position x (mm)", "speed (mm/s)", drive),
    ]
    title = f"Demanded and actual speeds, {MM * found[0].feed:g} mm/s"
    return Figure("velocities", title, panels, "Figure 4-13.", share_x=True)


def _feed_forward_figure(without: Sequence[Pass], with_forward: dict[float, list[Pass]]) -> Figure:
    gains, lags = [], []
    for factor, found in {0.0: list(without), **with_forward}.items():
        for one in found:
            name = f"K_nV {factor:g} {'+x' if one.direction > 0 else '-x'}"
            gains.append(Curve(name, MM * one.x, one.simulated))
            lags.append(Curve(name, MM * one.x, MM * np.abs(one.lag)))
    panels = [
        Panel("Relative velocity gain", "actual TCP position x (mm)", "K_V-rel (1)", gains),
        Panel("Tracking error of the TCP", "actual TCP position x (mm)", "size of the tracking error (mm)", lags),
    ]
    title = f"Velocity feed-forward, {MM * without[0].feed:g} mm/s"
    return Figure("feed_forward", title, panels, "Figure 4-14.", share_x=True)


def _step_figure(steps: Sequence[VelocityStep]) -> Figure:
    panels = []
    for station in dict.fromkeys(step.station_mm for step in steps):
        here = [step for step in steps if step.station_mm == station]
        curves = [Curve("setpoint", MM * here[0].times, MM * here[0].demanded, role="programmed")]
        curves += [Curve(f"Kv {step.kv:.4g} 1/s", MM * step.times, MM * step.actual) for step in here]
        panels.append(Panel(f"x = {station:g} mm", "time (ms)", "speed of the TCP (mm/s)", curves))
    return Figure("velocity_steps", "Velocity steps of the TCP at two stations", panels, "Figure 4-9.", share_x=True)


def _remarks(options: Options, reversals: Sequence[dict[str, Any]]) -> list[str]:
    lags = "; ".join(
        f"at {entry['feed_mm_min']:g} mm/min {entry['tracking_error_mean_in_plus_x_mm']:.4f} mm in +x and "
        f"{entry['tracking_error_mean_in_minus_x_mm']:.4f} mm in -x (by 4-15 "
        f"{entry['tracking_error_estimated_mean_in_plus_x_mm']:.4f} and "
        f"{entry['tracking_error_estimated_mean_in_minus_x_mm']:.4f} mm)"
        for entry in reversals
    )
    return [
        "K_V-rel = K_V of the TCP / K_V of the drive (4-16), each the actual velocity by the tracking error, so that "
        "K_V-rel = (Delta-u/Delta-x) / (du/dx at the actual position), as 4-17 has it. Simulated: velocities by "
        "differences of recorded positions. Closed form: 4-17 with the recorded Delta-u. Estimated: 4-17 with "
        "Delta-u = (du_s/dt)/Kv (4-15), drawn where the TCP then is.",
        "With the setpoint's velocities instead (2-6) the gear ratio would be that at the setpoint, and + and -x "
        "change sides of 1.",
        f"Judged: from {SETTLED:g}/Kv after the feed is reached till it is left. Mirror error: largest size of the sum "
        "of K_V-rel - 1 in +x and in -x at the same actual position, by the largest size in +x.",
        f"Mean tracking error of the TCP at the same positions: {lags}. The estimate has the higher one on the other "
        "side, because it misses the part -(1/(2 Kv^2) + kappa) d2u/dt2 of the lag, which outweighs what it has.",
        f"Feed-forward: K_nV as given, balancing filter T_Gn {options.setpoint_delay:g} s, T_En "
        f"{options.equivalent_delay:g} s; reduction of the mean over the positions that both runs pass.",
        "The stations are ours, the thesis gives no positions. Velocity steps start from rest with 1000 m/s^2.",
    ]


EXPERIMENT = Experiment(
    name="kv-rel",
    question="Which velocity gain does the TCP of the Monopod show, over position, direction, feed and feed-forward? "
    "(thesis 4.4: figures 4-9, 4-12 to 4-14, 4-16, 4-17)",
    machine="monopod",
    options=Options,
    run=_run,
)
