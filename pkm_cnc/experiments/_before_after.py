"""Runs of compensated programs, and how they are judged and drawn beside those of the programs as they were."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pkm_cnc.bag import BagWriter, Run, read_run
from pkm_cnc.check import prepare
from pkm_cnc.compensation import ErrorFigures, judged
from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.contour import circle_program
from pkm_cnc.evaluation import Evaluation, evaluate
from pkm_cnc.program import Arc, Program, Toolpath
from pkm_cnc.report import round_scale
from pkm_cnc.report.figure import Curve, Panel
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import recorded_topics

__all__ = [
    "MISMATCH",
    "REPEATS",
    "circle",
    "faster",
    "floor",
    "judged_run",
    "noise_floor",
    "path_panel",
    "recorded_run",
    "repeated",
    "square",
]

MISMATCH = 23.64 / 20.0
"""1. Kv of the machine by that of the model: what thesis 7.6 identified, by what it had assumed."""
REPEATS = 3
"""Runs with different noise, from which the floor is computed."""
ROOM = 0.1
"""Of a contour's size: how far the largest error is drawn from it."""


def faster(setup: Setup) -> Setup:
    """The machine whose drives have `MISMATCH` times the Kv."""
    values: dict[str, object] = {key: value for key, (value, _) in setup.parameters.items()}
    return setup_from_parameters(
        {**values, **{f"{axis}.drive.kv": parts.drive.kv * MISMATCH for axis, parts in setup.axes.items()}}
    )


def circle(setup: Setup, feed: float, radius: float, center: tuple[float, float] = (0.0, 0.0), way: str = "ccw") -> str:
    """A circle with its run-up and run-out; feed in mm/min, radius and centre in mm."""
    return circle_program(
        feed_mm_min=feed,
        radius_mm=radius,
        center_mm=center,
        direction=way,
        overshoot_deg=60.0,
        acceleration_mm_s2=setup.motion.acceleration * 1e3,
    )


def square(feed: float) -> str:
    """40 mm, corners sharp, feed in mm/min."""
    return f"(a square with sharp corners)\nG21 G90\nG1 X40 F{feed:.0f}\nY40\nX0\nY0\nM2\n"


def recorded_run(setup: Setup, program: Program) -> Run:
    """Run a program on `setup` by the simulation, as its bag has it. Raises InputError, MachineFault."""
    with tempfile.TemporaryDirectory(prefix="pkm_cnc-") as folder:
        bag = str(Path(folder) / "bag")
        with BagWriter(bag, recorded_topics(tuple(setup.axes), setup.tcp_control.active)) as sink:
            simulate(setup, program, prepare(setup, program), sink)
        return read_run(bag)


def judged_run(evaluation: Evaluation) -> ErrorFigures:
    """Its figures over what is judged."""
    return judged(evaluation.errors, Toolpath(tuple(evaluation.elements)))


def floor(runs: Sequence[Evaluation]) -> tuple[float, float]:
    """Largest and RMS distance, m, of repeated runs from their mean, over what is judged: no program takes it away."""
    count = min(len(run.errors) for run in runs)
    vectors = np.array([[error[:3] for error in run.errors[:count]] for run in runs])
    away = np.sqrt(((vectors - vectors.mean(axis=0)) ** 2).sum(axis=2))
    contour = Toolpath(tuple(runs[0].elements))
    figures = [
        judged([error._replace(magnitude=size) for error, size in zip(run.errors, sizes, strict=False)], contour)
        for run, sizes in zip(runs, away.tolist(), strict=True)
    ]
    squares = sum(one.rms**2 for one in figures)
    return max(one.largest for one in figures), float(np.sqrt(squares / (len(runs) - 1)))


def repeated(setup: Setup, repeat: int) -> Setup:
    """`setup` with other noise at its scales: no run of a machine has the noise of the one before."""
    seeds = {f"{axis}.scale.seed": parts.scale.seed + repeat for axis, parts in setup.axes.items()}
    return setup_from_parameters({**{key: value for key, (value, _) in setup.parameters.items()}, **seeds})


def noise_floor(setup: Setup, program: Program) -> tuple[float, float] | None:
    """The `floor`, um, of `REPEATS` runs that differ by their noise; None for a machine without."""
    if not any(parts.scale.noise for parts in setup.axes.values()):
        return None
    runs = [evaluate(recorded_run(repeated(setup, repeat), program)) for repeat in range(REPEATS)]
    largest, rms = floor(runs)
    return 1e6 * largest, 1e6 * rms


def path_panel(setup: Setup, title: str, largest: float, paths: Sequence[tuple[str, Evaluation]]) -> Panel:
    """Top view of the contour and of the paths by label; their distance from it magnified so that `largest`, m, shows.

    As figures 7-7, 7-8, 7-10 to 7-12 of the thesis.
    """
    first = paths[0][1]
    zero = np.array(setup.program_zero[:2])
    gap = [(np.nan, np.nan)]  # between elements, which need not follow each other
    contour = np.array(
        [
            point
            for element in first.elements
            if element.evaluated
            for point in [*(element.position(element.length * step / 60)[:2] for step in range(61)), *gap]
        ]
    )
    size = float((np.nanmax(contour, axis=0) - np.nanmin(contour, axis=0)).max())
    scale = round_scale(max(largest, 1e-9), ROOM * size)
    drawn = 1e3 * (contour - zero)
    curves = [Curve("programmed", drawn[:, 0], drawn[:, 1], role="programmed")]
    for label, evaluation in paths:
        points = []
        for error in evaluation.errors[::4]:
            element, start = evaluation.elements[error.segment], evaluation.starts[error.segment]
            place = error.path_length - start
            away_from_ends = isinstance(element, Arc) or 0.1 * element.length < place < 0.9 * element.length
            x, y, _ = element.position(place)
            inside = element.evaluated and away_from_ends
            points.append((x + scale * error.x, y + scale * error.y) if inside else (np.nan, np.nan))
        path = 1e3 * (np.array(points) - zero)
        curves.append(Curve(label, path[:, 0], path[:, 1]))
    return Panel(f"{title}, error magnified {scale:.10g}:1", "x (mm)", "y (mm)", curves, equal=True)
