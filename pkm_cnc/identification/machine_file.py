"""A calibrated machine as a file: the estimate becomes what the controller believes, its uncertainty a comment.

The estimate is written as `geometry.*`, the nominal geometry, because that is what a controller corrects its kinematics
with. A tilt that was estimated is written as `actual.tilt.*`: controllers do not correct it, but a compensation by this
model of the machine does. What the machine truly is, `actual.geometry.*`, is nobody's to know but a simulation's: a
file that has it keeps it, written out where it was inherited from the nominal geometry, and keeps its tilt, so that the
machine stays the one that was measured.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.identification.calibration import Calibration, Estimate
from pkm_cnc.parameters import Value, parameters_of

__all__ = ["calibrated_setup", "calibrated_yaml"]


def calibrated_setup(setup: Setup, calibration: Calibration) -> Setup:
    """The machine whose controller knows the estimated geometry, and which tilts as estimated."""
    values: dict[str, Value] = {key: value for key, (value, _) in setup.parameters.items()}
    names = {one.unknown.name for one in calibration.estimates if one.unknown.section == "geometry"}
    if setup.actual is not setup.machine:
        values = {**{f"actual.geometry.{name}": values[f"geometry.{name}"] for name in names}, **values}
    elif calibration.tilt is not None:
        values |= {f"actual.tilt.{name}": value for name, value in vars(calibration.tilt).items()}
    geometry = calibration.machine.geometry  # type: ignore[attr-defined]
    for spec in parameters_of(type(geometry)):
        if spec.name in names:
            values[f"geometry.{spec.name}"] = getattr(geometry, spec.name)
    return setup_from_parameters(values)


def calibrated_yaml(setup: Setup, calibration: Calibration, sources: Sequence[str]) -> str:
    """The machine file of `calibrated_setup`, headed by what was estimated from which `sources` and how well."""
    lines = [
        f"Calibrated by {calibration.method} from {', '.join(sources)}.",
        f"{len(calibration.before)} measured values; rank {calibration.rank} of {len(calibration.estimates)} unknowns, "
        f"condition {calibration.condition:.4g}.",
        f"Deviation, rms: {_um(calibration.before)} um before, {_um(calibration.after)} um after.",
        "Each estimate with its 95 % interval:",
        *(f"  {_line(estimate)}" for estimate in calibration.estimates),
    ]
    return "".join(f"# {line}\n" for line in lines) + calibrated_setup(setup, calibration).to_yaml()


def _um(deviations: NDArray[np.float64]) -> str:
    return f"{1e6 * float(np.sqrt(np.mean(np.square(deviations)))):.4g}"


def _line(estimate: Estimate) -> str:
    unknown = estimate.unknown
    value = f"{unknown.key} {estimate.value:.9g}"
    if estimate.status == "left alone":
        return f"{value} {unknown.unit}: not observable, left alone"
    held = "" if estimate.status == "estimated" else ", if those left alone are right"
    weak = "" if estimate.fixed else f"; wider than {unknown.tolerance:g} {unknown.unit}: these data do not fix it"
    return f"{value} +- {estimate.half_interval:.3g} {unknown.unit}{held}{weak}"
