"""Axis plants: what is faster than any topic (velocity and current loop, motor) and the mechanics behind it.

`AxisPlant` is the ideal axis, exact; `ImperfectAxis` one with friction, backlash, compliance, limits and loads. Which
of them an axis is follows from its parameters (`imperfect`). `PlatformLoad` is what all axes carry together.
"""

from pkm_cnc.plant.axis_plant import AxisPlant
from pkm_cnc.plant.imperfect_axis import DEAD_TIME, AxisParts, ImperfectAxis, imperfect
from pkm_cnc.plant.linear_scale import LinearScale
from pkm_cnc.plant.plant_parameters import (
    DisturbanceParameters,
    FrictionParameters,
    LoadParameters,
    PlantParameters,
    ScaleParameters,
    ScrewParameters,
    SliderParameters,
    TravelParameters,
)
from pkm_cnc.plant.platform_load import PlatformLoad

__all__ = [
    "DEAD_TIME",
    "AxisParts",
    "AxisPlant",
    "DisturbanceParameters",
    "FrictionParameters",
    "ImperfectAxis",
    "LinearScale",
    "LoadParameters",
    "PlantParameters",
    "PlatformLoad",
    "ScaleParameters",
    "ScrewParameters",
    "SliderParameters",
    "TravelParameters",
    "imperfect",
]
