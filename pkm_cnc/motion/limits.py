"""What the TCP and the drives may do: the sections `motion` and `limits` of a machine file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter

__all__ = ["ANY_DRIVES", "DriveLimits", "LimitParameters", "MotionParameters", "refuse_long_ramp"]

LONGEST_RAMP = 10.0
"""s. A motion is smoothed over acceleration / jerk, which nobody wants longer and no memory holds without a bound."""


@dataclasses.dataclass(frozen=True)
class MotionParameters:
    """How the TCP moves along the contour: the section `motion` of a machine file."""

    acceleration: float = parameter(
        2.0,
        "Largest change of the path speed, speeding up and braking. The default reaches 6000 mm/min within 2.5 mm, so "
        "that test contours are run at their feed but for their ends, and is common for the axes of machine tools.",
        unit="m/s^2",
        above=0.0,
    )
    centripetal_acceleration: float = parameter(
        2.0,
        "Largest acceleration across the path, v^2/r on an arc; where two elements meet at a small angle also the "
        "largest jump of the velocity, divided by the servo period. The default is that of motion.acceleration.",
        unit="m/s^2",
        above=0.0,
    )
    jerk: float = parameter(
        0.0,
        "Largest change of the TCP's acceleration vector per time; 0 = any, else it reaches the acceleration within "
        "10 s. The default is 0, as the experiments of the thesis have it; machine tools have 20 to 500 m/s^3.",
        unit="m/s^3",
        minimum=0.0,
    )
    rapid: float = parameter(
        1.0 / 6.0,
        "Path speed of rapids, which G0 gives its elements as their feed. The default, 10 m/min, is above the feeds of "
        "the usual tests and moderate for a machine.",
        unit="m/s",
        above=0.0,
    )
    tangent_angle: float = parameter(
        0.05,
        "Two feed elements that meet at a larger angle are joined by a stop (G61), others are passed no faster than "
        "motion.centripetal_acceleration and the limits of the drives allow a jump of the velocity within one servo "
        "period. The default, 3 deg, takes a row of lines of 1 mm along a curve of 20 mm radius for a curve, also with "
        "what rounding to 0.001 mm turns the direction of a line of 0.05 mm; what is more is meant as a corner.",
        unit="rad",
        minimum=0.0,
        maximum=0.5,
    )
    blend_tolerance: float = parameter(
        50e-6,
        "Largest deviation from the programmed path under G64 without P. The default is that of rough milling.",
        unit="m",
        above=0.0,
    )
    wait_in_position: bool = parameter(
        False,
        "Wait at every stop, not only at the end of the program, until the TCP is in position. Off by default, as in "
        "the exact path mode (G61) of RS-274: a corner is a stop of the setpoint, the axes need not have caught up.",
    )
    in_position_tolerance: float = parameter(
        40e-6,
        "The TCP is in position when the controller believes it this close to the setpoint. The default is twice the "
        "resolution of the linear scale of the thesis (20 um): with a coarse scale a finer one may never be met.",
        unit="m",
        above=0.0,
    )
    in_position_timeout: float = parameter(
        10.0,
        "Longest time to wait for the TCP to be in position; longer is a fault. The default is far above what drives "
        "need to settle (at Kv = 16.7 1/s the lag falls to a millionth within 0.9 s) and short for somebody who waits.",
        unit="s",
        above=0.0,
    )


@dataclasses.dataclass(frozen=True)
class LimitParameters:
    """What one drive's setpoint may do: the section `limits` of a machine file, of an axis or of all."""

    velocity: float = parameter(
        2.0,
        "Largest speed of the drive's setpoint. The default, 12000 rpm of a screw of 10 mm/rev, is what fast ball "
        "screws reach, and wide enough for the experiments of the thesis.",
        unit="m/s",
        above=0.0,
    )
    acceleration: float = parameter(
        40.0,
        "Largest acceleration of the drive's setpoint. The default is twenty times motion.acceleration, so that the "
        "path slows down only where the machine turns little motion of the TCP into much of a drive.",
        unit="m/s^2",
        above=0.0,
    )
    jerk: float = parameter(
        0.0,
        "Largest jerk of the drive's setpoint; 0 = any, else it reaches the acceleration within 10 s. The default is "
        "0, as the experiments of the thesis have it.",
        unit="m/s^3",
        minimum=0.0,
    )


def refuse_long_ramp(section: str, limits: MotionParameters | LimitParameters) -> None:
    """Raises InputError if the jerk of a section would take longer than LONGEST_RAMP to reach its acceleration."""
    if limits.jerk * LONGEST_RAMP < limits.acceleration and limits.jerk > 0.0:
        least = limits.acceleration / LONGEST_RAMP
        raise InputError(
            f"{section}.jerk: {limits.jerk:g} m/s^3 takes more than {LONGEST_RAMP:g} s to reach "
            f"{section}.acceleration, {limits.acceleration:g} m/s^2; at least {least:g} m/s^3, or 0 = any"
        )


@dataclasses.dataclass(frozen=True)
class DriveLimits:
    """The drives as the planner needs them.

    `motion` gives u, du/dt, d2u/dt2 (k, n) of positions, velocities, accelerations (k, 3) of the TCP, as
    `kinematics.Machine.motion`; with tangent and curvature in place of velocity and acceleration u, du/ds, d2u/ds2.
    `velocity` m/s, `acceleration` m/s^2 and `jerk` m/s^3 (inf = any) have the shape (n,).
    """

    motion: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64]

    @staticmethod
    def of(motion: Callable[..., Any], drives: list[LimitParameters]) -> DriveLimits:
        """From the kinematics' `motion` and the section `limits` of each drive, in the machine's order."""
        return DriveLimits(
            motion,
            np.array([drive.velocity for drive in drives]),
            np.array([drive.acceleration for drive in drives]),
            np.array([drive.jerk or np.inf for drive in drives]),
        )


ANY_DRIVES = DriveLimits(
    lambda tcp, velocity, acceleration: (tcp, velocity, acceleration), *(np.full(3, np.inf) for _ in range(3))
)
"""Drives without limits."""
