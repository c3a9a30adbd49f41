"""Bringing up the graph: its one description, for the command and for launch files, and the ways to run it."""

from pkm_cnc.bringup.description import GraphNodeSpec, describe_graph
from pkm_cnc.bringup.environment import prepare_environment
from pkm_cnc.bringup.one_process import run_in_one_process
from pkm_cnc.bringup.processes import run_in_processes
from pkm_cnc.bringup.trial import run_trial

__all__ = [
    "GraphNodeSpec",
    "describe_graph",
    "prepare_environment",
    "run_in_one_process",
    "run_in_processes",
    "run_trial",
]
