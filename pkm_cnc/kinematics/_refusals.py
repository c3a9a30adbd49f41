"""Reasons that every machine has to refuse something: what is not a finite number, by row and name."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pkm_cnc.kinematics._pointwise import Component, everywhere
from pkm_cnc.kinematics.machine import Array, Violation, unreachable

__all__ = ["by_row", "finite", "not_finite", "refuse_rates"]


def not_finite(rows: Array, names: Sequence[str]) -> list[Violation]:
    """One violation for each element of `rows` (N, n) that is NaN or infinite; `names` are those of the n columns."""
    return [
        Violation(row, names[column], math.nan, f"{names[column]}: {rows[row, column]} is not a finite number")
        for row, column in np.argwhere(~np.isfinite(rows)).tolist()
    ]


def by_row(violations: list[Violation], *, single: bool) -> list[Violation]:
    """The violations in the order of their rows; without a row if they are those of a single pose."""
    if single:
        return [violation._replace(row=None) for violation in violations]
    return sorted(violations, key=lambda violation: violation.row or 0)


def finite(components: Sequence[Component]) -> bool:
    """Whether every one of the components, of the one pose or of all poses, is a finite number."""
    nothing: Component = 0.0
    for component in components:
        nothing = nothing + (component - component)  # 0, but NaN for NaN and infinity
    return everywhere(nothing == 0.0)


def refuse_rates(coordinates: Sequence[str], velocity: Sequence[Component], acceleration: Sequence[Component]) -> None:
    """Raise UnreachableError, naming row and component, if a velocity or an acceleration is not finite."""
    rates = [*velocity, *acceleration]
    if not finite(rates):
        table = np.stack(rates, axis=-1)
        names = [f"{kind}{name}" for kind in "va" for name in coordinates]
        raise unreachable(by_row(not_finite(table.reshape(-1, len(names)), names), single=table.ndim == 1))
