"""One run of a part program through the graph, everything of it as arrays: an experiment's runner on ROS."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from pkm_cnc.bag import read_run
from pkm_cnc.bringup.environment import prepare_environment
from pkm_cnc.bringup.one_process import run_in_one_process
from pkm_cnc.check import prepare
from pkm_cnc.config import Setup
from pkm_cnc.experiments import Trial, trial_of_bag
from pkm_cnc.program import Program

__all__ = ["run_trial"]


def run_trial(setup: Setup, program: Program) -> Trial:
    """Run a program through the graph in this process, with a bag that is gone afterwards; as `simulated`.

    Raises InputError for what the machine cannot do, MachineFault.
    """
    prepare(setup, program)
    prepare_environment()
    with tempfile.TemporaryDirectory(prefix="pkm_cnc-") as folder:
        path = Path(folder) / "program.ngc"
        path.write_text(program.text, encoding="utf-8")
        bag = str(Path(folder) / "bag")
        run_in_one_process(setup, str(path), bag, "fast").require_completed()
        trial = trial_of_bag(setup, read_run(bag))
    return replace(trial, evaluation=replace(trial.evaluation, program_name=program.name))
