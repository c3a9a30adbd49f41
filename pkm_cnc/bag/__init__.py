"""Runs on disk: rosbag2 folders with one MCAP file, written while the machine runs, readable even if it was killed."""

from pkm_cnc.bag.reader import Channel, Run, read_channels, read_run
from pkm_cnc.bag.writer import BagWriter, refuse_existing

__all__ = ["BagWriter", "Channel", "Run", "read_channels", "read_run", "refuse_existing"]
