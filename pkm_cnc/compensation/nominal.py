"""The machine as its controller knows it: what is imperfect about the actual one left out."""

from __future__ import annotations

from pkm_cnc.config import Setup, setup_from_parameters

__all__ = ["nominal"]

ACTUAL = frozenset(("actual", "friction", "slider", "disturbance", "load", "plant", "scale"))
"""Sections of what no controller knows."""
UNKNOWN = frozenset(
    (
        *("drive.back_emf", "drive.current_limit", "drive.voltage_limit", "drive.dead_time"),
        *("screw.backlash", "screw.stiffness", "screw.damping", "screw.error_positions", "screw.pitch_error"),
    )
)
"""Parameters of the other sections that no controller knows."""


def nominal(setup: Setup) -> Setup:
    """`setup` without them, of all axes and of one: what is then simulated is what the controller believes."""

    def known(key: str) -> bool:
        axis, _, rest = key.partition(".")
        own = rest if axis in setup.axes else key
        return own.split(".")[0] not in ACTUAL and own not in UNKNOWN

    return setup_from_parameters({key: value for key, (value, _) in setup.parameters.items() if known(key)})
