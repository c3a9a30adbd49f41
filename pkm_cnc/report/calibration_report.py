"""The report of a calibration: estimates, deviations before and after, convergence, positioning test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.identification import Calibration, Estimate, NetworkCalibration, Positioning
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = [
    "calibration_data",
    "calibration_table",
    "convergence_table",
    "deviation_figure",
    "deviation_table",
    "positioning_table",
]

Array = NDArray[np.float64]
UM = 1e6
POSITIONING = {
    "VDI/DGQ 3441: uncertainty P": "uncertainty",
    "  reversal error U, mean": "reversal",
    "  standard deviation s, mean": "standard_deviation",
    "  position deviation P_a": "deviation",
    "  floor of P, U + 6 s": "floor",
    "ISO 230-2: accuracy A": "accuracy",
    "  systematic deviation E": "systematic",
    "  repeatability R": "repeatability",
    "  reversal error B, largest": "largest_reversal",
}


def calibration_table(calibration: Calibration) -> Table:
    """The estimates, in um and urad."""
    title = (
        f"Geometry by {calibration.method}: rank {calibration.rank} of {len(calibration.estimates)} unknowns, "
        f"condition {calibration.condition:.4g}"
    )
    columns = ("parameter", "unit", "before", "estimate", "+- (95 %)", "")
    return Table(title, columns, [_row(estimate) for estimate in calibration.estimates])


def _row(estimate: Estimate) -> list[str | float | None]:
    half = None if np.isnan(estimate.half_interval) else UM * estimate.half_interval
    words = {"estimated": "", "relative": "if those left alone are right", "left alone": "not observable, left alone"}
    remark = words[estimate.status]
    if half is not None and not estimate.fixed:
        remark = "; ".join(filter(None, (remark, "these data do not fix it")))
    return [
        estimate.unknown.key,
        "um" if estimate.unknown.unit == "m" else f"u{estimate.unknown.unit}",
        UM * estimate.before,
        UM * estimate.value,
        half,
        remark,
    ]


def deviation_table(calibration: Calibration) -> Table:
    """Measured less computed position before and after."""
    rows = [
        (name, _rms(values), UM * float(np.abs(values).max()), UM * float(np.ptp(values)))
        for name, values in (("before", calibration.before), ("after", calibration.after))
    ]
    return Table("Deviation, measured less computed", ("", "rms_um", "max_abs_um", "range_um"), rows)


def convergence_table(found: NetworkCalibration) -> Table:
    """The deviation over the iterations of the networks."""
    rows = [(float(i), _rms(values), UM * float(np.ptp(values))) for i, values in enumerate(found.history)]
    return Table("Deviation over the iterations", ("iteration", "rms_um", "range_um"), rows)


def _rms(values: Array) -> float:
    return UM * float(np.sqrt(np.mean(np.square(values))))


def positioning_table(title: str, tests: dict[str, Positioning]) -> Table:
    """Statistics of positioning tests by name, um, one column each."""
    rows = [[label, *(UM * getattr(test, key) for test in tests.values())] for label, key in POSITIONING.items()]
    return Table(title, ("", *(f"{name}_um" for name in tests)), rows)


def deviation_figure(
    calibration: Calibration, coordinates: Sequence[str], tcp: Array | None, history: Array | None
) -> Figure:
    """Deviation before and after (fig. 4-5): over the TCP's position if it has one coordinate, else over the row.

    `tcp` (n, coordinates), m, None of a circle; `history` (iterations + 1, m), m, of networks.
    """
    states = {"before": calibration.before, "after": calibration.after} if history is None else _iterations(history)
    names = ["radius"] if tcp is None else list(coordinates)
    rows = len(calibration.before) // len(names)
    if tcp is not None and len(names) == 1:
        order, label = np.argsort(tcp[:, 0], kind="stable"), f"TCP position {names[0]} (mm)"
        along = 1e3 * tcp[order, 0]
    else:
        order, label, along = np.arange(rows), "row of the measurement", np.arange(1.0, rows + 1.0)
    panels = [
        Panel(
            name,
            label,
            f"deviation of {name} (um)",
            [Curve(state, along, UM * values.reshape(rows, -1)[order, column]) for state, values in states.items()],
        )
        for column, name in enumerate(names)
    ]
    caption = "Measured less computed position" + (", as thesis figure 4-5." if history is not None else ".")
    return Figure("deviation", "Deviation before and after the calibration", panels, caption)


def _iterations(history: Array) -> dict[str, Array]:
    """The start, the first iteration and the last."""
    last = len(history) - 1
    return {"before": history[0], "after iteration 1": history[1], f"after iteration {last}": history[last]}


def calibration_data(calibration: Calibration) -> dict[str, Any]:
    """For scripts: SI values with units in the keys, None for what is not known."""
    return {
        "method": calibration.method,
        "rank": calibration.rank,
        "condition": calibration.condition,
        "scatter_um": UM * calibration.scatter,
        "deviation_rms_um": {"before": _rms(calibration.before), "after": _rms(calibration.after)},
        "parameters": [
            {
                "key": estimate.unknown.key,
                "unit": estimate.unknown.unit,
                "before": estimate.before,
                "estimate": estimate.value,
                "half_interval_95": None if np.isnan(estimate.half_interval) else estimate.half_interval,
                "status": estimate.status,
            }
            for estimate in calibration.estimates
        ],
    }
