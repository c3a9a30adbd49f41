"""Models of a machine: as its controller knows it, and as a measurement has it.

The controller of a machine decides the setpoints; where the tool then goes, the machine decides. A model that is
calibrated or identified says something about the second and leaves the first as it is.
"""

from __future__ import annotations

from pkm_cnc.compensation.observation import check_machine, decides_setpoints
from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.kinematics import NOT_AS_DRAWN, is_drawn

__all__ = ["model_of", "nominal"]

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


def model_of(setup: Setup, believed: Setup) -> Setup:
    """The machine that `believed` describes, under the controller of `setup`: for predicting what a program will do.

    From `believed` come its actual geometry (`actual.geometry.*`, else `geometry.*`: as `calibrate` and `identify`
    write it), tilt, drives, and what else is imperfect about it; from `setup` what decides setpoints, and controllers
    at the TCP. Raises InputError for other kinematics, another drawing or servo period: that is another machine.
    """
    check_machine("--model", believed, setup, _drawn)
    ours, theirs = ({key: value for key, (value, _) in one.parameters.items()} for one in (setup, believed))
    values = {key: value for key, value in theirs.items() if not _controls(key)}
    values |= {key: value for key, value in ours.items() if _controls(key)}
    for key in [f"geometry.{name}" for name in NOT_AS_DRAWN if f"geometry.{name}" in ours]:
        values.setdefault(f"actual.{key}", theirs[key])
    same = [
        key for key in values if key.startswith("actual.geometry.") and values[key] == ours[key.removeprefix("actual.")]
    ]
    return setup_from_parameters({key: value for key, value in values.items() if key not in same})


def _drawn(key: str) -> bool:
    """What is the same for all machines of one kind."""
    return key in ("machine", "servo_period") or is_drawn(key)


def _controls(key: str) -> bool:
    return decides_setpoints(key) or key.startswith("tcp_control.")
