"""The largest velocity gain that the Monopod's TCP bears, over its position."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.experiments._axis import follow
from pkm_cnc.experiments._monopod import STATIONS, joint, monopod, require_reachable, strut_angle
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.kinematics.monopod import Monopod
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT", "Options", "stability_limit", "tcp_overshoot", "tcp_vibration"]

Array = NDArray[np.float64]

_STEP_SECONDS = 0.2
_VIBRATION_SECONDS = 0.4  # of which the second half is judged
_PROBE = 1e-9  # m, step that tells whether the loop is stable: it may grow much before the following error trips
_FIRST_GAIN, _GROWTH = 1.0, 1.25  # 1/s, and ratio from one to the next, of the gains that bracket the bound
_LAST_GAIN = 1e5  # 1/s: at no servo period is a loop stable there
PER_MIN = 0.06
"""[1000/min] in 1/s."""


@dataclass(frozen=True)
class Options:
    """Options of kv-max."""

    positions: tuple[float, ...] = parameter(
        tuple(np.linspace(*STATIONS, 9).tolist()), "TCP positions x, from x_s to x_e", unit="mm", any_length=True
    )
    step_feed: float = parameter(6000.0, "velocity step of the TCP in +x, from rest", unit="mm/min", above=0.0)
    overshoot: float = parameter(5.0, "bound of the TCP's velocity overshoot over the feed", unit="%", above=0.0)
    amplitude: float = parameter(
        5.0, "of the ripple on the slider's measured position, as of a scale's interpolation", unit="um", above=0.0
    )
    frequency: float = parameter(50.0, "of that ripple", unit="Hz", above=0.0)
    vibration: float = parameter(1.0, "bound of the amplitude with which the TCP then vibrates", unit="um", above=0.0)


def with_gain(setup: Setup, kv: float) -> Setup:
    """The same machine with the velocity gain `kv`, 1/s, in all drives."""
    axes = {
        name: dataclasses.replace(parts, drive=dataclasses.replace(parts.drive, kv=kv))
        for name, parts in setup.axes.items()
    }
    return dataclasses.replace(setup, axes=axes)


def tcp_overshoot(setup: Setup, machine: Monopod, x: float, speed: float) -> float:
    """Overshoot, 1, of the TCP's speed over `speed`, m/s, with which it is sent off in +x from rest at x, m.

    Below 0 if it never gets there within 0.2 s. Raises MachineFault, UnreachableError.
    """
    times = np.arange(0.0, _STEP_SECONDS, setup.servo_period)
    u = joint(machine, x + speed * times)
    velocity = speed * machine.jacobian((x + speed * times)[:, None])[:, 0, 0]
    position = machine.forward((follow(setup, "u", u - u[0], velocity).position + u[0])[:, None])[:, 0]
    return float(np.diff(position).max() / (speed * setup.servo_period)) - 1.0


def tcp_vibration(setup: Setup, machine: Monopod, x: float, amplitude: float, frequency: float) -> float:
    """Amplitude, m, with which the TCP at x, m, vibrates when the slider's measured position ripples by `amplitude`, m.

    The part of `frequency`, Hz, by least squares after 0.2 s. Raises MachineFault, UnreachableError.
    """
    times = np.arange(0.0, _VIBRATION_SECONDS, setup.servo_period)
    ripple = amplitude * np.sin(math.tau * frequency * times)
    slider = joint(machine, np.array([x])) + follow(setup, "u", 0.0, ripple=ripple).position
    settled = times >= 0.5 * _VIBRATION_SECONDS
    phase = math.tau * frequency * times[settled]
    parts = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
    position = machine.forward(slider[settled, None])[:, 0] - x
    return float(np.hypot(*np.linalg.lstsq(parts, position, rcond=None)[0][:2]))


def stability_limit(setup: Setup, axis: str) -> float:
    """Gain, 1/s, from which on the sampled position loop of an axis is unstable. No kinematics are in that loop."""

    def growth(kv: float) -> float:
        """Logarithm of how much the error of a tiny step grows in 0.2 s, -1 to 1."""
        times = np.arange(0.0, 0.4, setup.servo_period)
        try:
            error = np.abs(follow(with_gain(setup, kv), axis, np.full(len(times), _PROBE)).tracking_error)
        except MachineFault:
            return 1.0
        early, late = (error[(start <= times) & (times < start + 0.1)].max() for start in (0.1, 0.3))
        return float(np.clip(np.log(late / early), -1.0, 1.0)) if early > 0.0 < late else -1.0

    limit = _first_crossing(growth, _LAST_GAIN)
    return _LAST_GAIN if limit is None else limit


def _first_crossing(function: Callable[[float], float], last: float) -> float | None:
    """The smallest gain, 1/s, at which `function` rises through 0; None if it is below 0 up to `last`.

    Not the smallest there is if it rises and falls again within a quarter of the gain.
    """
    from scipy import optimize

    low = _FIRST_GAIN
    while low < last:
        high = min(low * _GROWTH, last)
        if function(high) > 0.0:
            return float(optimize.brentq(function, low, high, xtol=1e-6))
        low = high
    return None


def _run(lab: Lab, options: Options) -> Findings:
    setup, machine = monopod(lab, "kv-max")
    speed = options.step_feed / 60e3
    ends = [x + 1e3 * speed * _STEP_SECONDS for x in options.positions]
    highest = 0.5 / setup.servo_period
    if options.frequency >= highest:
        raise InputError(
            f"frequency: {options.frequency:g} Hz is not below half the servo rate, {highest:g} Hz: the drive reads it "
            "as a lower one"
        )
    require_reachable(machine, "positions, with the way of the step", [*options.positions, *ends])
    lab.tell(0.0, "stability of the drive")
    limit = stability_limit(setup, "u")
    drive = _first_crossing(lambda kv: _drive_overshoot(with_gain(setup, kv), speed) - 1e-2 * options.overshoot, limit)
    entries = []
    for done, position in enumerate(options.positions):
        lab.tell((1 + done) / (1 + len(options.positions)), f"x = {position:g} mm")
        entries.append(_entry(setup, machine, options, position, limit))
    first, last = entries[0], entries[-1]
    data = {
        "positions": entries,
        "drive_stability_limit_per_s": limit,
        "drive_overshoot_kv_per_s": limit if drive is None else drive,
        "ratio_end_to_start_overshoot": last["kv_max_overshoot_per_s"] / first["kv_max_overshoot_per_s"],
        "ratio_end_to_start_vibration": last["kv_max_vibration_per_s"] / first["kv_max_vibration_per_s"],
        "ratio_end_to_start_gear_ratio": last["gear_ratio"] / first["gear_ratio"],
    }
    return Findings([_table(entries)], [_figure(entries, data)], data, _remarks(options, data))


def _drive_overshoot(setup: Setup, speed: float) -> float:
    """As `tcp_overshoot`, of the slider alone."""
    times = np.arange(0.0, _STEP_SECONDS, setup.servo_period)
    position = follow(setup, "u", speed * times, speed).position
    return float(np.diff(position).max() / (speed * setup.servo_period)) - 1.0


def _entry(setup: Setup, machine: Monopod, options: Options, position: float, limit: float) -> dict[str, Any]:
    x, speed = 1e-3 * position, options.step_feed / 60e3

    def overshoot(kv: float) -> float:
        return tcp_overshoot(with_gain(setup, kv), machine, x, speed) - 1e-2 * options.overshoot

    def vibration(kv: float) -> float:
        vibrates = tcp_vibration(with_gain(setup, kv), machine, x, 1e-6 * options.amplitude, options.frequency)
        return 1e6 * vibrates - options.vibration

    if vibration(_FIRST_GAIN) > 0.0:
        raise InputError(
            f"vibration: {options.vibration:g} um is exceeded at {position:g} mm even with the gain {_FIRST_GAIN:g} 1/s"
        )
    found = {"overshoot": _first_crossing(overshoot, limit), "vibration": _first_crossing(vibration, limit)}
    entry: dict[str, Any] = {
        "x_mm": position,
        "beta_deg": math.degrees(float(strut_angle(machine, x))),
        "gear_ratio": float(machine.jacobian((x,))[0, 0]),
    }
    for name, kv in found.items():
        entry[f"kv_max_{name}_per_s"] = limit if kv is None else kv
        entry[f"{name}_limited_by_stability"] = kv is None
    return entry


def _table(entries: list[dict[str, Any]]) -> Table:
    columns = ["x_mm", "beta_deg", "gear_ratio", "kv_max_overshoot_per_s", "kv_max_vibration_per_s"]
    rows: list[list[str | float | None]] = [
        [*(entry[name] for name in columns), PER_MIN * entry["kv_max_vibration_per_s"]] for entry in entries
    ]
    return Table("Largest velocity gain", [*columns, "kv_max_vibration_1000_per_min"], rows)


def _figure(entries: list[dict[str, Any]], data: dict[str, Any]) -> Figure:
    x = np.array([entry["x_mm"] for entry in entries])

    def level(name: str) -> Array:
        return np.full(len(x), data[name])

    panels = [
        Panel(
            "By the TCP's vibration",
            "TCP position x (mm)",
            "largest Kv (1/s)",
            [
                Curve(
                    "vibration", x, np.array([entry["kv_max_vibration_per_s"] for entry in entries]), "line and points"
                )
            ],
        ),
        Panel(
            "By the TCP's velocity overshoot, and of the drive alone",
            "TCP position x (mm)",
            "largest Kv (1/s)",
            [
                Curve("overshoot, TCP", x, np.array([entry["kv_max_overshoot_per_s"] for entry in entries]), "points"),
                Curve("overshoot, drive", x, level("drive_overshoot_kv_per_s")),
                Curve("stability, drive", x, level("drive_stability_limit_per_s")),
            ],
        ),
    ]
    return Figure("kv_max", "Largest velocity gain over the TCP's position", panels, "Figure 4-10.", share_x=True)


def _remarks(options: Options, data: dict[str, Any]) -> list[str]:
    return [
        f"Vibration: the slider's measured position ripples by {options.amplitude:g} um at {options.frequency:g} Hz; "
        f"the TCP may vibrate by {options.vibration:g} um. The drive follows the ripple the more the higher its gain, "
        "and the TCP moves by the slider's way over the gear ratio: its largest gain at the last position is "
        f"{data['ratio_end_to_start_vibration']:.3f} times that at the first, the gear ratio "
        f"{data['ratio_end_to_start_gear_ratio']:.3f} times.",
        f"Overshoot: the TCP is sent off from rest with {options.step_feed:g} mm/min in +x; its largest speed may be "
        f"{options.overshoot:g} % above. Over so short a way the gear ratio hardly changes, so this gain hardly "
        f"depends on the position: {data['ratio_end_to_start_overshoot']:.4f} times from last to first; that of the "
        f"drive alone is {data['drive_overshoot_kv_per_s']:.2f} 1/s.",
        f"The drive's own loop holds no kinematics: it is stable below {data['drive_stability_limit_per_s']:.1f} 1/s "
        "at every position. What depends on the position is how much of the drive's vibration reaches the TCP.",
        "The positions, the ripple and the bounds are ours: the thesis gives none. 50 1/s is 3 [1000/min].",
    ]


EXPERIMENT = Experiment(
    name="kv-max",
    question="How large may the velocity gain be over the position of the Monopod's TCP, and why does it depend on it? "
    "(thesis 4.2.4: figure 4-10)",
    machine="monopod",
    options=Options,
    run=_run,
)
