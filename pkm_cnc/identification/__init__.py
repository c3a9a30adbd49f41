"""Identification: what a machine is, from what it records.

Calibration estimates the geometry, by least squares or by networks.
"""

from pkm_cnc.identification.bench import Bench, PositioningTest
from pkm_cnc.identification.calibration import Calibration, Estimate, Unknown, calibrate, unknowns_of, with_values
from pkm_cnc.identification.machine_file import calibrated_setup, calibrated_yaml
from pkm_cnc.identification.measurements import (
    Circle,
    Measurements,
    Positions,
    positions_of_run,
    read_measurements,
)
from pkm_cnc.identification.network_calibration import NetworkCalibration, calibrate_by_networks
from pkm_cnc.identification.networks import Network, train
from pkm_cnc.identification.positioning import Positioning, by_approach, positioning

__all__ = [
    "Bench",
    "Calibration",
    "Circle",
    "Estimate",
    "Measurements",
    "Network",
    "NetworkCalibration",
    "Positioning",
    "PositioningTest",
    "Positions",
    "Unknown",
    "by_approach",
    "calibrate",
    "calibrate_by_networks",
    "calibrated_setup",
    "calibrated_yaml",
    "positioning",
    "positions_of_run",
    "read_measurements",
    "train",
    "unknowns_of",
    "with_values",
]
