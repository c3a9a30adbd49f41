"""What the experiments on the Monopod share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.experiments.experiment import Lab
from pkm_cnc.kinematics.monopod import Monopod

__all__ = ["STATIONS", "joint", "monopod", "require_reachable", "strut_angle"]

Array = NDArray[np.float64]

STATIONS = (344.0, 520.0)
"""mm. x_s and x_e, where the strut stands at 35 and 60 deg to the slider's guide: the thesis gives no positions, but
says in 4.2.1 that angles from 35 to 60 deg were tested. x = L sin(beta) with the machine file's L of 600 mm."""


def monopod(lab: Lab, experiment: str, overrides: Iterable[str] = ()) -> tuple[Setup, Monopod]:
    """The machine under test, and its kinematics. Raises InputError if it is not the Monopod."""
    name = lab.setup().machine_name  # before the overrides, which another machine would not know
    if name != "monopod":
        raise InputError(f"experiment {experiment}: it is about the monopod, not about the machine {name}")
    setup = lab.setup(overrides)
    return setup, cast(Monopod, setup.kinematics)


def require_reachable(machine: Monopod, option: str, positions_mm: Iterable[float]) -> None:
    """Raises InputError naming the option and the first position that the strut does not reach."""
    for position in positions_mm:
        try:
            machine.inverse((1e-3 * position,))
        except UnreachableError as error:
            raise InputError(f"{option}: {position:g} mm: {error}") from None


def joint(machine: Monopod, x: ArrayLike) -> Array:
    """u (n,), m, of the TCP positions x (n,), m. Raises UnreachableError."""
    return machine.inverse(np.asarray(x, dtype=float)[..., None])[..., 0]


def strut_angle(machine: Monopod, x: ArrayLike) -> Array:
    """beta (n,), rad, between strut and slider's guide at the TCP positions x (n,), m."""
    span = (np.asarray(x, dtype=float) + machine.geometry.tcp_offset) * np.cos(machine.geometry.inclination)
    return np.asarray(np.arcsin(span / machine.strut_length))
