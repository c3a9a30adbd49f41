"""The loop closed: run a machine, learn from the runs what it is, compensate by that, and run other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.bag import Run
from pkm_cnc.compensation import ErrorFigures, compensate, model_of, nominal
from pkm_cnc.config import Setup
from pkm_cnc.contour import star_program
from pkm_cnc.errors import PkmError
from pkm_cnc.evaluation import Evaluation, evaluate
from pkm_cnc.experiments._before_after import (
    MISMATCH,
    REPEATS,
    circle,
    faster,
    judged_run,
    noise_floor,
    path_panel,
    recorded_run,
    repeated,
    square,
)
from pkm_cnc.experiments._machine import require_plane
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.identification import (
    IDENTIFIED,
    Calibration,
    ContourData,
    DriveFit,
    Positions,
    calibrate,
    calibrate_by_networks,
    calibrated_setup,
    contradictions,
    drive_run,
    drive_unknowns,
    fit_drives,
    fit_drives_by_networks,
    identified_setup,
    positions_of_run,
)
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Program
from pkm_cnc.report.figure import Figure, Table

__all__ = ["EXPERIMENT", "METHODS", "Identified", "identified", "seen_programs", "unseen_programs"]

METHODS = ("networks", "least squares")
AS_IT_IS, BY_NOMINAL, BY_BAG = "as programmed", "nominal model", "its own bag"
SETTINGS = ("velocity_feed_forward", "acceleration_feed_forward")
"""Parameters of a drive that its controller sets: known, hence not looked for."""
SEEN_FEED = 6000.0
"""mm/min, of all that is learnt from."""
RANGE = 0.100
"""m. Half the square, and half the diameter of the circle, within which the seen programs run."""
LEARNT = 2
"""Runs that are learnt from; those that are judged have other noise."""
UM = 1e6


@dataclass(frozen=True)
class Options:
    """What is run."""

    program: str = parameter(
        "all", "unseen program that is judged", choices=("all", "star 3000", "star 9000", "circle", "square")
    )
    seed: int = parameter(0, "of the networks' training", minimum=0)


@dataclass(frozen=True)
class Identified:
    """What `method` made of the runs: the machine as it believes it to be, as calibrate and identify write it."""

    method: str
    setup: Setup
    calibration: Calibration
    drives: DriveFit


@dataclass(frozen=True)
class Outcome:
    """One unseen program, compensated by one model (or not), run on one machine. Without a run: the `reason`."""

    machine: str
    program: str
    model: str
    evaluation: Evaluation | None = None
    figures: ErrorFigures | None = None
    reason: str = ""


def seen_programs(setup: Setup) -> dict[str, str]:
    """What is learnt from: four lines of 200 mm and a circle R 100, both about the program's zero."""
    return {
        "star": star_program(SEEN_FEED, [0.0, 15.0, 45.0, 75.0], (0.0, 0.0), 2e3 * RANGE),
        "circle": circle(setup, SEEN_FEED, 1e3 * RANGE),
    }


def unseen_programs(setup: Setup) -> dict[str, str]:
    """What is judged: other feeds, pivots, headings, radii, way round, and sharp corners."""
    return {
        "star 3000": star_program(3000.0, [20.0, 60.0, 100.0], (20.0, -15.0), 100.0),
        "star 9000": star_program(9000.0, [-10.0, 35.0, 80.0], (-15.0, 10.0), 160.0),
        "circle": circle(setup, 4000.0, 60.0, (15.0, -10.0), "cw"),
        "square": square(4500.0),
    }


def identified(controller: Setup, runs: Sequence[Run], method: str, seed: int = 0) -> Identified:
    """Geometry and drives of the machine that recorded `runs` under `controller`, by one of `METHODS`.

    First the geometry, and the tilt on a machine in space, from scales and TCP; then, in that geometry, the drives from
    the contour errors, as thesis 7.6 does. Raises InputError as `calibrate` and `fit_drives` do.
    """
    parts = [positions_of_run(run, controller) for run in runs]
    positions = Positions(np.concatenate([part.joints for part in parts]), np.concatenate([part.tcp for part in parts]))
    contour = ContourData([drive_run(run, controller) for run in runs])
    tilt = tuple(controller.kinematics.coordinates) == ("x", "y", "z")
    if method == "networks":
        calibration = calibrate_by_networks(controller.kinematics, positions, seed=seed, tilt=tilt).calibration
    else:
        calibration = calibrate(controller.kinematics, positions, tilt=tilt)
    believed = model_of(controller, calibrated_setup(controller, calibration))
    unknowns = [one for one in drive_unknowns(believed, list(believed.axes)) if one.name not in SETTINGS]
    if method == "networks":
        fit, _ = fit_drives_by_networks(believed, unknowns, contour, seed=seed)
    else:
        fit = fit_drives(believed, unknowns, contour)
    return Identified(method, identified_setup(believed, [fit]), calibration, fit)


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup()
    require_plane(setup, "identification")
    controller = nominal(setup)
    machines = {"Kv 18 % off": faster(controller), "as it is": setup}
    programs = unseen_programs(setup)
    if options.program != "all":
        programs = {options.program: programs[options.program]}
    models: dict[str, list[Identified]] = {}
    outcomes: list[Outcome] = []
    floors: dict[tuple[str, str], tuple[float, float] | None] = {}
    steps = len(machines) * (1 + len(METHODS) + len(programs))
    done = iter(range(steps))
    for name, machine in machines.items():
        lab.tell(next(done) / steps, f"{name}: what is learnt from")
        seen = seen_programs(setup)
        runs = [
            recorded_run(repeated(machine, number), Program(f"{title}.ngc", text))
            for number, (title, text) in enumerate(seen.items())
        ]
        models[name] = []
        for method in METHODS:
            lab.tell(next(done) / steps, f"{name}: {method}")
            models[name].append(identified(controller, runs, method, options.seed))
        for title, text in programs.items():
            lab.tell(next(done) / steps, f"{name}: {title}")
            program = Program(f"{title.replace(' ', '-')}.ngc", text)
            outcomes += _outcomes(name, title, controller, machine, program, models[name])
            floors[name, title] = noise_floor(machine, program)
    return _findings(setup, machines, models, outcomes, floors)


def _outcomes(
    machine: str, title: str, controller: Setup, actual: Setup, program: Program, models: Sequence[Identified]
) -> list[Outcome]:
    """One program by all models. Its own bag is the best that a correction of the program can do in one pass."""
    before = recorded_run(repeated(actual, LEARNT), program)
    evaluation = evaluate(before)
    found = [Outcome(machine, title, AS_IT_IS, evaluation, judged_run(evaluation))]
    ways: list[tuple[str, Setup | None, list[Run]]] = [(BY_NOMINAL, None, [])]
    ways += [(model.method, model.setup, []) for model in models]
    ways += [(BY_BAG, None, [before])]
    for label, model, bags in ways:
        try:
            compensated = compensate(controller, program, "mirror", model=model, bags=bags).program
            evaluation = evaluate(recorded_run(repeated(actual, LEARNT + 1), compensated))
        except PkmError as error:
            found.append(Outcome(machine, title, label, reason=str(error)))
        else:
            found.append(Outcome(machine, title, label, evaluation, judged_run(evaluation)))
    return found


def _findings(
    setup: Setup,
    machines: dict[str, Setup],
    models: dict[str, list[Identified]],
    outcomes: Sequence[Outcome],
    floors: dict[tuple[str, str], tuple[float, float] | None],
) -> Findings:
    geometry = {
        (name, one.method): _left(machines[name], nominal(setup), one.setup)
        for name in machines
        for one in models[name]
    }
    titles = list(dict.fromkeys(outcome.program for outcome in outcomes))
    return Findings(
        [
            *(_table(name, outcomes, floors) for name in machines),
            _drive_table(machines, models),
            _geometry_table(models, geometry),
            _impossible(),
        ],
        [_figure(setup, title, outcomes) for title in titles],
        {
            "outcomes": [_entry(outcome, outcomes) for outcome in outcomes],
            "floor_um": [
                {"machine": name, "program": title, "max_3d_um": limit[0], "rms_3d_um": limit[1]}
                for (name, title), limit in floors.items()
                if limit is not None
            ],
            "drives": _drive_rows(machines, models),
            "geometry": [
                {"machine": name, "method": method, "left_rms_um": rms, "left_max_um": largest}
                for (name, method), (rms, largest) in geometry.items()
            ],
            "impossible": {
                name: {"is": value, "must_be": due} for name, (value, due) in contradictions(IDENTIFIED).items()
            },
        },
        _remarks(),
    )


def _remarks() -> list[str]:
    return [
        f"Learnt from: a star of four lines of {2e3 * RANGE:g} mm and a circle R {1e3 * RANGE:g} mm at {SEEN_FEED:g} "
        "mm/min. Judged: other programs, at other feeds and places. Every figure is of a run of the program that was "
        "written, on the machine itself, after one use of mirror.",
        "max and rms: contour error in three dimensions over the middle half of lines and all of arcs; less: part of "
        "it that is gone.",
        f"Kv 18 % off: the machine as its controller believes it, but with drives of {MISMATCH:g} times that Kv. As it "
        "is: the machine file, with what its controller does not know.",
        "The controller stays what it is. A model has geometry and tilt as calibrated from drive scales and TCP of "
        "the runs, and in that geometry the drives as identified from the contour errors, as in thesis 7.6. "
        "Feed-forwards are settings of the controller and known; where there is no interval the data did not tell.",
        f"Its own bag: mirror from a run of the judged program itself. Noise alone: largest and RMS distance of "
        f"{REPEATS} runs with different noise from their mean.",
        "The intervals count what is left as noise. Friction, backlash and load act alike in every run: where a "
        "machine has them the intervals are too narrow, and the estimated drive is the linear one that comes nearest.",
    ]


def _left(machine: Setup, controller: Setup, believed: Setup) -> tuple[float, float]:
    """RMS and largest distance, um, between where the TCP is and where a model has it, over the square of `RANGE`."""
    steps = np.linspace(-RANGE, RANGE, 11)
    x, y = (values.ravel() for values in np.meshgrid(steps, steps))
    tcp = np.stack([x, y, 0.0 * x], axis=1) + np.array(controller.program_zero)
    joints = controller.machine.inverse(tcp)
    away = np.linalg.norm(model_of(controller, believed).true_tcp(joints) - machine.true_tcp(joints), axis=1)
    return UM * float(np.sqrt(np.mean(away**2))), UM * float(away.max())


def _before(outcome: Outcome, outcomes: Sequence[Outcome]) -> ErrorFigures:
    return next(
        one.figures
        for one in outcomes
        if (one.machine, one.program, one.model) == (outcome.machine, outcome.program, AS_IT_IS) and one.figures
    )


def _entry(outcome: Outcome, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    entry: dict[str, Any] = {"machine": outcome.machine, "program": outcome.program, "model": outcome.model}
    if outcome.figures is None:
        return {**entry, "reason": outcome.reason}
    before = _before(outcome, outcomes)
    return {
        **entry,
        "max_3d_um": UM * outcome.figures.largest,
        "rms_3d_um": UM * outcome.figures.rms,
        "less_max_percent": 100.0 * (1.0 - outcome.figures.largest / before.largest),
        "less_rms_percent": 100.0 * (1.0 - outcome.figures.rms / before.rms),
    }


def _table(
    machine: str, outcomes: Sequence[Outcome], floors: dict[tuple[str, str], tuple[float, float] | None]
) -> Table:
    keys = ("max_3d_um", "rms_3d_um", "less_max_percent", "less_rms_percent")
    rows: list[list[str | float | None]] = []
    for outcome in outcomes:
        if outcome.machine != machine:
            continue
        entry = _entry(outcome, outcomes)
        rows.append([outcome.program, outcome.model, *(entry.get(key) for key in keys), outcome.reason])
        if outcome.model == BY_BAG and (limit := floors[machine, outcome.program]) is not None:
            rows.append([outcome.program, "noise alone", *limit, None, None, ""])
    columns = ("program", "compensated by", "max_3d_um", "rms_3d_um", "less_max_%", "less_rms_%", "remark")
    return Table(f"Unseen programs, machine: {machine}", columns, rows)


def _drive_rows(machines: dict[str, Setup], models: dict[str, list[Identified]]) -> list[dict[str, Any]]:
    return [
        {
            "machine": name,
            "method": model.method,
            "parameter": estimate.unknown.key,
            "unit": estimate.unknown.unit,
            "believed": estimate.before,
            "estimate": estimate.value,
            "half_interval": None if estimate.left_alone else estimate.half_interval,
            "machine_has": getattr(machines[name].axes[estimate.unknown.axis].drive, estimate.unknown.name),
        }
        for name, found in models.items()
        for model in found
        for estimate in model.drives.estimates
    ]


def _drive_table(machines: dict[str, Setup], models: dict[str, list[Identified]]) -> Table:
    rows = _drive_rows(machines, models)
    columns = ("machine", "method", "parameter", "unit", "believed", "estimate", "+- (95 %)", "machine has")
    return Table("Drives, from the contour errors of the seen runs", columns, [list(row.values()) for row in rows])


def _geometry_table(models: dict[str, list[Identified]], left: dict[tuple[str, str], tuple[float, float]]) -> Table:
    rows: list[list[str | float | None]] = [
        [name, model.method, _rms(model.calibration.before), _rms(model.calibration.after), *left[name, model.method]]
        for name, found in models.items()
        for model in found
    ]
    columns = ("machine", "method", "before_rms_um", "after_rms_um", "left_rms_um", "left_max_um")
    title = f"Geometry, from scales and TCP of the seen runs; left: over the square of {2e3 * RANGE:g} mm"
    return Table(title, columns, rows)


def _rms(deviations: NDArray[np.float64]) -> float:
    return UM * float(np.sqrt(np.mean(np.square(deviations))))


def _impossible() -> Table:
    rows: list[list[str | float | None]] = [
        [name, value, due] for name, (value, due) in contradictions(IDENTIFIED).items()
    ]
    title = "Why the set of thesis 7.6 is impossible: no position loop closed on a scale has these coefficients"
    return Table(title, ("in eq. 7-1", "is", "must be"), rows)


def _figure(setup: Setup, title: str, outcomes: Sequence[Outcome]) -> Figure:
    """Before and after, magnified, one panel for a machine; as figures 7-10 to 7-12 of the thesis."""
    panels = []
    for machine in dict.fromkeys(outcome.machine for outcome in outcomes):
        chosen = [one for one in outcomes if (one.machine, one.program) == (machine, title)]
        paths = [(one.model, one.evaluation) for one in chosen if one.model != BY_BAG and one.evaluation is not None]
        panels.append(path_panel(setup, machine, _before(chosen[0], outcomes).largest, paths))
    return Figure(
        f"identification-{title.replace(' ', '-')}",
        f"Identification, {setup.machine_name}, {title}: paths before and after",
        panels,
        "Top view; the distance from the programmed contour is magnified as each title says.",
        columns=2,
    )


EXPERIMENT = Experiment(
    name="identification",
    question="A machine is run, its geometry and drives are learnt from the runs, and other programs are compensated "
    "by what was learnt: how much of their contour error is gone? (thesis 7.6, figs 7-10 to 7-12)",
    machine="tripod_real",
    options=Options,
    run=_run,
)
