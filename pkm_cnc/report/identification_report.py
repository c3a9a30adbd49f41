"""The report of an identification of drives: estimates, what the data tell, frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.identification import DriveEstimate, DriveFit, FrequencyResponse, velocity_bandwidth
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = [
    "bandwidth_table",
    "deviation_table",
    "estimate_table",
    "identification_data",
    "response_figure",
    "singular_table",
]

UM = 1e6
COHERENT = 0.8
"""1. Below this coherence a recorded response is not drawn: a fifth of the answer comes from elsewhere."""


def estimate_table(fits: Sequence[DriveFit]) -> Table:
    """The estimates in the units of the machine file."""
    title = f"Drives by {fits[0].method}; true if what was left alone is"
    columns = ["parameter", "unit", "before", "estimate", "+- (95 %)", "spread (95 %)", ""]
    rows: list[list[str | float | None]] = []
    for fit in fits:
        spread = np.full(len(fit.estimates), np.nan) if fit.spread is None else 1.96 * fit.spread
        rows += [_row(estimate, width) for estimate, width in zip(fit.estimates, spread.tolist(), strict=True)]
    if all(fit.spread is None for fit in fits):
        columns.remove("spread (95 %)")
        rows = [[*row[:5], row[6]] for row in rows]
    return Table(title, columns, rows)


def _row(estimate: DriveEstimate, spread: float) -> list[str | float | None]:
    return [
        estimate.unknown.key,
        estimate.unknown.unit,
        f"{estimate.before:.6g}",
        f"{estimate.value:.6g}",
        _digits(estimate.half_interval),
        _digits(spread),
        "these data do not tell it, left alone" if estimate.left_alone else "",
    ]


def _digits(value: float) -> str | None:
    return None if np.isnan(value) else f"{value:.2g}"


def bandwidth_table(setup: Setup) -> Table:
    """Bandwidth of each velocity loop, Hz."""
    rows = [(axis, velocity_bandwidth(parts.drive) / (2.0 * np.pi)) for axis, parts in setup.axes.items()]
    return Table("Velocity loops as first-order lags", ("drive", "bandwidth_Hz"), rows)


def deviation_table(fits: Sequence[DriveFit]) -> Table:
    """What the drives of the machine file and the estimated ones do not explain, and the noise of an observation."""
    rows: list[list[str | float | None]] = [
        [fit.name, len(fit.after), f"{UM * fit.noise:.3g}", f"{_rms(fit.before):.4g}", f"{_rms(fit.after):.4g}"]
        for fit in fits
    ]
    title = "Deviations, rms; what is left above the noise the model lacks (friction, backlash)"
    return Table(title, ("data", "observations", "noise_um", "before_um", "after_um"), rows)


def singular_table(fits: Sequence[DriveFit]) -> Table:
    """What the data tell by direction, the best first: a step is a time constant doubled, a full feed-forward, 1 ms."""
    rows: list[list[str | float | None]] = []
    for fit in fits:
        for value, direction in zip(fit.singular.tolist(), fit.directions, strict=True):
            rows.append([fit.name, f"{UM * value:.3g}", f"{UM * fit.noise:.3g}", _direction(fit, direction)])
    return Table("What the data tell", ("data", "change_um_per_step", "noise_um", "direction"), rows)


def _direction(fit: DriveFit, direction: NDArray[np.float64]) -> str:
    """The parts above a tenth, the largest first."""
    order = [place for place in np.argsort(-np.abs(direction), kind="stable") if abs(direction[place]) > 0.1]
    sign = 1.0 if direction[order[0]] > 0.0 else -1.0
    return " ".join(f"{sign * direction[place]:+.2f} {_short(fit.estimates[place])}" for place in order)


def _short(estimate: DriveEstimate) -> str:
    return f"{estimate.unknown.axis}.{estimate.unknown.name}"


def response_figure(measured: dict[str, FrequencyResponse], model: dict[str, FrequencyResponse]) -> Figure:
    """Gain, phase and coherence by drive, as recorded and as the identified model gives them for the same setpoints."""
    panels = []
    for title, label, part in (
        ("Gain", "gain (dB)", "gain_db"),
        ("Phase", "phase (deg)", "phase_deg"),
        ("Coherence", "coherence (1)", "coherence"),
    ):
        curves = []
        for axis, response in measured.items():
            if part == "coherence":
                curves.append(Curve(axis, response.frequency, response.coherence))
                continue
            end = _end_of_coherence(response)
            for name, drawn in ((axis, response), (f"{axis}, model", model[axis])):
                curves.append(Curve(name, drawn.frequency[:end], getattr(drawn, part)[:end]))
        panels.append(Panel(title, "frequency (Hz)", label, curves))
    caption = (
        "From setpoint to scale reading, by Welch's method, as far as the program excites the drive: up to where the "
        f"coherence falls below {COHERENT:g}."
    )
    return Figure("frequency_response", "Frequency response of the drives", panels, caption, share_x=True)


def _end_of_coherence(response: FrequencyResponse) -> int:
    """How many frequencies from the lowest on are coherent; two at least, for a line."""
    below = np.append(response.coherence < COHERENT, True)
    return max(2, int(np.argmax(below)))


def identification_data(fits: Sequence[DriveFit]) -> dict[str, Any]:
    """For scripts: SI values with units in the keys, None for what is not known."""
    return {
        "method": fits[0].method,
        "fits": [
            {
                "data": fit.name,
                "observations": len(fit.after),
                "noise_um": UM * fit.noise,
                "deviation_rms_um": {"before": _rms(fit.before), "after": _rms(fit.after)},
                "singular_values_um_per_step": (UM * fit.singular).tolist(),
                "parameters": [
                    {
                        "key": estimate.unknown.key,
                        "unit": estimate.unknown.unit,
                        "before": estimate.before,
                        "estimate": estimate.value,
                        "half_interval_95": _known(estimate.half_interval),
                        "spread": None if fit.spread is None else _known(float(fit.spread[place])),
                    }
                    for place, estimate in enumerate(fit.estimates)
                ],
            }
            for fit in fits
        ],
    }


def _rms(values: NDArray[np.float64]) -> float:
    return UM * float(np.sqrt(np.mean(np.square(values))))


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value
