"""The parameters of an axis' mechanics: ball screw, linear scale, travel."""

from dataclasses import dataclass

from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter

__all__ = ["ScaleParameters", "ScrewParameters", "TravelParameters"]


@dataclass(frozen=True)
class ScrewParameters:
    """Section `screw.*`: a rigid ball screw without friction or backlash."""

    pitch: float = parameter(0.010, "slider travel per revolution of the motor", unit="m/rev", above=0.0)


@dataclass(frozen=True)
class ScaleParameters:
    """Section `scale.*`: the linear scale that measures the slider."""

    resolution: float = parameter(0.0, "of the linear scale; 0 = ideal", unit="m", minimum=0.0)


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
