"""Identified drives as a machine file: every drive with its own parameters, how well they are known in comments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.identification.drive_identification import DriveEstimate, DriveFit
from pkm_cnc.parameters import Value, parameters_of
from pkm_cnc.servo import DriveParameters

__all__ = ["estimate_text", "identified_setup", "identified_yaml"]


def identified_setup(setup: Setup, fits: Sequence[DriveFit]) -> Setup:
    """The machine with the estimated drives. What an estimate is below a parameter's least value is that value.

    A feed-forward of none is estimated as often just below none as above.
    """
    values: dict[str, Value] = {key: value for key, (value, _) in setup.parameters.items()}
    least = {spec.name: spec.minimum for spec in parameters_of(DriveParameters)}
    for estimate in _estimates(fits):
        low = least[estimate.unknown.name]
        values[estimate.unknown.key] = estimate.value if low is None else max(low, estimate.value)
    return setup_from_parameters(values)


def identified_yaml(setup: Setup, fits: Sequence[DriveFit], sources: Sequence[str]) -> str:
    """The machine file of `identified_setup`, headed by what was estimated from which `sources` and how well."""
    lines = [f"Drives identified by {fits[0].method} from {', '.join(sources)}."]
    for fit in fits:
        lines.append(
            f"{fit.name}: {len(fit.after)} observations; {fit.rank} of {len(fit.estimates)} unknowns told; deviation, "
            f"rms: {_um(fit.before)} um before, {_um(fit.after)} um after."
        )
    lines.append("Each estimate with its 95 % interval, true if what was left alone is:")
    lines += [f"  {estimate_text(estimate)}" for estimate in _estimates(fits)]
    return "".join(f"# {line}\n" for line in lines) + identified_setup(setup, fits).to_yaml()


def estimate_text(estimate: DriveEstimate) -> str:
    """One line: key, value, interval, unit."""
    unknown = estimate.unknown
    if estimate.left_alone:
        return f"{unknown.key} {estimate.value:.9g} {unknown.unit}: these data do not tell it, left alone"
    return f"{unknown.key} {estimate.value:.9g} +- {estimate.half_interval:.3g} {unknown.unit}"


def _estimates(fits: Sequence[DriveFit]) -> list[DriveEstimate]:
    return [estimate for fit in fits for estimate in fit.estimates]


def _um(deviations: NDArray[np.float64]) -> str:
    return f"{1e6 * float(np.sqrt(np.mean(np.square(deviations)))):.4g}"
