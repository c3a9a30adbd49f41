"""The parameters of an axis' mechanics: ball screw, slider, friction, disturbance, linear scale, travel; and the load.

Every effect that makes an axis imperfect has a neutral default, 0: without any of them the axis is the rigid one of
thesis fig. 7-5, integrated exactly.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter

__all__ = [
    "DisturbanceParameters",
    "FrictionParameters",
    "LoadParameters",
    "PlantParameters",
    "ScaleParameters",
    "ScrewParameters",
    "SliderParameters",
    "TravelParameters",
]


@dataclass(frozen=True)
class ScrewParameters:
    """Section `screw.*`: the ball screw between motor and slider. Raises InputError for a table that is none."""

    pitch: float = parameter(0.010, "slider travel per revolution of the motor", unit="m/rev", above=0.0)
    backlash: float = parameter(
        0.0,
        "free travel of the slider against the screw, all of it, between one flank and the other; 0 = none",
        unit="m",
        minimum=0.0,
        maximum=0.01,
    )
    stiffness: float = parameter(
        0.0, "of screw, nut and bearings between motor and slider, along the travel; 0 = rigid", unit="N/m", minimum=0.0
    )
    damping: float = parameter(0.0, "beside the stiffness; without effect if that is 0", unit="N s/m", minimum=0.0)
    error_positions: tuple[float, ...] = parameter(
        (0.0,), "joint positions of the table of the pitch error, rising", unit="m", any_length=True
    )
    pitch_error: tuple[float, ...] = parameter(
        (0.0,),
        "what the slider is ahead of the screw's nominal travel there; straight lines between, level beyond",
        unit="m",
        minimum=-0.01,
        maximum=0.01,
        any_length=True,
    )

    def __post_init__(self) -> None:
        if len(self.error_positions) != len(self.pitch_error):
            raise InputError(
                f"pitch_error: {len(self.pitch_error)} values for {len(self.error_positions)} error_positions"
            )
        for before, after in pairwise(self.error_positions):
            if not before < after:
                raise InputError(f"error_positions: {after} m does not rise above {before} m before it")

    def error_at(self, position: float) -> float:
        """The pitch error, m, where the screw's nominal travel is `position`, m."""
        positions, errors = self.error_positions, self.pitch_error
        k = bisect_right(positions, position)
        if k == 0:
            return errors[0]
        if k == len(positions):
            return errors[-1]
        share = (position - positions[k - 1]) / (positions[k] - positions[k - 1])
        return errors[k - 1] + share * (errors[k] - errors[k - 1])


@dataclass(frozen=True)
class SliderParameters:
    """Section `slider.*`: what the screw moves. Its mass is part of drive.inertia, which has all of it."""

    mass: float = parameter(
        0.0, "of the slider with what it carries; needed for a stiffness and for its weight", unit="kg", minimum=0.0
    )
    incline: float = parameter(
        0.0,
        "of its travel above the horizontal, in the direction of rising joint position; pi/2 for the Tripod's columns",
        unit="rad",
        minimum=-1.6,
        maximum=1.6,
    )


@dataclass(frozen=True)
class FrictionParameters:
    """Section `friction.*`, at the slider.

    F = coulomb + (static - coulomb) exp(-(v / stribeck_velocity)^2) + viscous v against the motion: the model of
    Armstrong-Helouvry et al., Automatica 30 (1994). At rest up to `static` holds the slider still.
    Raises InputError for a static friction below the kinetic one.
    """

    coulomb: float = parameter(0.0, "kinetic friction, whatever the speed", unit="N", minimum=0.0)
    static: float = parameter(0.0, "what it takes to break the slider loose; 0 = as coulomb", unit="N", minimum=0.0)
    stribeck_velocity: float = parameter(
        0.005, "speed at which most of the difference of static and coulomb is gone", unit="m/s", above=0.0
    )
    viscous: float = parameter(0.0, "friction per speed", unit="N s/m", minimum=0.0)

    def __post_init__(self) -> None:
        if 0.0 < self.static < self.coulomb:
            raise InputError(f"static: {self.static} N is below coulomb, {self.coulomb} N; 0 takes that")

    @property
    def breakaway(self) -> float:
        """Static friction, N."""
        return self.static or self.coulomb


@dataclass(frozen=True)
class DisturbanceParameters:
    """Section `disturbance.*`: torques at the motor that nothing commands."""

    torque: float = parameter(0.0, "constant torque", unit="N m", minimum=-1e4, maximum=1e4)
    cogging: float = parameter(
        0.0, "amplitude of a torque that is periodic in the motor's angle", unit="N m", minimum=0.0
    )
    cogging_periods: int = parameter(36, "its periods in a revolution", unit="1/rev", minimum=1, maximum=10_000)


@dataclass(frozen=True)
class LoadParameters:
    """Section `load.*`: what hangs at the TCP and is felt by all drives, through the Jacobian."""

    mass: float = parameter(0.0, "of platform and tool, as a point at the TCP; 0 = none", unit="kg", minimum=0.0)


@dataclass(frozen=True)
class PlantParameters:
    """Section `plant.*`: how imperfect axes are integrated."""

    steps: int = parameter(
        10,
        "in a servo period",
        minimum=1,
        maximum=1000,
    )


@dataclass(frozen=True)
class ScaleParameters:
    """Section `scale.*`: the linear scale that measures the slider."""

    resolution: float = parameter(0.0, "of the linear scale; 0 = ideal", unit="m", minimum=0.0)
    noise: float = parameter(
        0.0,
        "standard deviation of what is added to a reading before it is rounded",
        unit="m",
        minimum=0.0,
        maximum=0.001,
    )
    seed: int = parameter(
        1, "of the noise: the same seed, axis and cycle have the same noise", unit="1", minimum=0, maximum=2**31 - 1
    )


@dataclass(frozen=True)
class TravelParameters:
    """Section `travel.*`: the ends of a slider's travel, as joint positions.

    The defaults suit the Tripod, whose sliders stand at z + 0.478 m with the TCP on the axis and, with the TCP at z = 0
    within 100 mm of it, between 0.38 and 0.54 m. Raises InputError when the ends are not in order.
    """

    minimum: float = parameter(0.0, "lower end of travel, as joint position", unit="m")
    maximum: float = parameter(1.0, "upper end of travel, as joint position", unit="m")

    def __post_init__(self) -> None:
        if not self.minimum < self.maximum:
            raise InputError(f"minimum: {self.minimum} m is not below the maximum of {self.maximum} m")

    def require(self, start_position: float) -> None:
        """Raise InputError if an axis cannot start at `start_position`, m: beyond an end."""
        if not self.minimum <= start_position <= self.maximum:
            raise InputError(
                f"start position {start_position * 1e3:.6g} mm is not within the travel of "
                f"{self.minimum * 1e3:.6g} to {self.maximum * 1e3:.6g} mm (travel.minimum, travel.maximum)"
            )
