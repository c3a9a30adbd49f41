"""Identification: what a machine is, from what it records.

Calibration estimates the geometry, identification the drives, by least squares or by networks.
"""

from pkm_cnc.identification.bench import Bench, PositioningTest
from pkm_cnc.identification.calibration import (
    Believed,
    Calibration,
    Estimate,
    Unknown,
    calibrate,
    unknowns_of,
    with_values,
)
from pkm_cnc.identification.drive_data import AxisData, ContourData, DriveData
from pkm_cnc.identification.drive_file import estimate_text, identified_setup, identified_yaml
from pkm_cnc.identification.drive_identification import DriveEstimate, DriveFit, fit_drives
from pkm_cnc.identification.drive_networks import fit_drives_by_networks
from pkm_cnc.identification.drive_run import DriveRun, drive_run
from pkm_cnc.identification.drive_unknowns import (
    DriveUnknown,
    drive_setup,
    drive_unknowns,
    drive_values,
    velocity_bandwidth,
)
from pkm_cnc.identification.frequency_response import FrequencyResponse, frequency_response
from pkm_cnc.identification.identified_set import IDENTIFIED, contradictions
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
    "IDENTIFIED",
    "AxisData",
    "Believed",
    "Bench",
    "Calibration",
    "Circle",
    "ContourData",
    "DriveData",
    "DriveEstimate",
    "DriveFit",
    "DriveRun",
    "DriveUnknown",
    "Estimate",
    "FrequencyResponse",
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
    "contradictions",
    "drive_run",
    "drive_setup",
    "drive_unknowns",
    "drive_values",
    "estimate_text",
    "fit_drives",
    "fit_drives_by_networks",
    "frequency_response",
    "identified_setup",
    "identified_yaml",
    "positioning",
    "positions_of_run",
    "read_measurements",
    "train",
    "unknowns_of",
    "velocity_bandwidth",
    "with_values",
]
