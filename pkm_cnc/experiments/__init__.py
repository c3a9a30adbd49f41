"""Experiments: a question about a machine, the programs that answer it, tables and pictures of the answer.

An experiment is one module `<name>.py` here with one constant `EXPERIMENT`; `load_experiment` finds it by its name.
"""

import importlib
import pkgutil
from typing import cast

from pkm_cnc.errors import InputError
from pkm_cnc.experiments._page import experiment_page
from pkm_cnc.experiments._workers import starting_workers
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab, Tell
from pkm_cnc.experiments.trial import Runner, Trial, simulated, trial_of_bag

__all__ = [
    "Experiment",
    "Findings",
    "Lab",
    "Runner",
    "Tell",
    "Trial",
    "experiment_names",
    "experiment_page",
    "load_experiment",
    "simulated",
    "starting_workers",
    "trial_of_bag",
]

_PARTS = ("experiment", "trial")


def experiment_names() -> list[str]:
    """The names of all experiments, sorted."""
    names = [module.name for module in pkgutil.iter_modules(__path__)]
    return sorted(name.replace("_", "-") for name in names if name not in _PARTS and name[0] != "_")


def load_experiment(name: str) -> Experiment:
    """The experiment called `name`. Raises InputError, listing those there are, if there is none of that name."""
    if name not in experiment_names():
        raise InputError(f"experiment: {name!r} is unknown; there are {', '.join(experiment_names())}")
    module = importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
    return cast(Experiment, module.EXPERIMENT)
