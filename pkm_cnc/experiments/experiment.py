"""What an experiment is, what it works with and what it finds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.experiments.trial import Runner, Trial
from pkm_cnc.program import Program
from pkm_cnc.report.figure import Figure, Table

__all__ = ["Experiment", "Findings", "Lab", "Tell"]

Tell = Callable[[float, str], None]
"""Takes how much is done, 0 to 1, and what is at work now."""


@dataclass(frozen=True)
class Findings:
    """The outcome: tables and pictures in the reader's units, `data` for scripts (JSON, keys with units)."""

    tables: Sequence[Table]
    figures: Sequence[Figure]
    data: dict[str, Any]
    remarks: Sequence[str] = ()
    """Sentences that a reader needs beside them: definitions used, what the outcome means, what was left out."""

    def to_json(self) -> dict[str, Any]:
        """`data` in the types of JSON: arrays as lists, what is no finite number as None."""
        plain: dict[str, Any] = _plain(self.data)
        return plain


@dataclass(frozen=True)
class Lab:
    """The machine under test and the means to run programs on it.

    `machine` and `overrides` are what --machine and --set say; an experiment adds overrides of its own, after those of
    the user, or takes another machine to compare with.
    """

    machine: str
    overrides: Sequence[str]
    runner: Runner
    tell: Tell = field(default=lambda done, what: None)

    def setup(self, overrides: Iterable[str] = (), machine: str | None = None) -> Setup:
        """The machine under test, or the one of the package called `machine` with the same overrides.

        Raises InputError.
        """
        return load_setup(machine or self.machine, [*self.overrides, *overrides])

    def run(self, setup: Setup, program: str, name: str) -> Trial:
        """Run a part program given as text; `name` is what messages call it. Raises InputError, MachineFault."""
        return self.runner(setup, Program(name, program))


@dataclass(frozen=True)
class Experiment:
    """An experiment: `run` takes the lab and an instance of `options`, a dataclass of `parameter` fields.

    Options are in the reader's units (mm, mm/min, deg), which their units and docs say.
    """

    name: str
    question: str
    """What it answers, in one sentence, with the place in the thesis."""
    machine: str
    """The machine it runs on unless another is given."""
    options: type[Any]
    run: Callable[[Lab, Any], Findings]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
