"""Identification: what a machine is, from what it records.

Calibration estimates the geometry, by least squares or by networks.
"""

from pkm_cnc.identification.networks import Network, train

__all__ = ["Network", "train"]
