"""Axis plants: what is faster than any topic (velocity and current loop, motor) and the mechanics behind it."""

from pkm_cnc.plant.axis_plant import AxisPlant
from pkm_cnc.plant.plant_parameters import ScaleParameters, ScrewParameters, TravelParameters

__all__ = ["AxisPlant", "ScaleParameters", "ScrewParameters", "TravelParameters"]
