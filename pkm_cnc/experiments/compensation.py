"""Methods against the contour error, side by side: what each takes away, what it costs, what it must know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.compensation import ErrorFigures, compensate, nominal
from pkm_cnc.config import Setup, setup_from_parameters
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
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Program
from pkm_cnc.report.figure import Figure, Panel, Table
from pkm_cnc.servo import equivalent_delay

__all__ = ["EXPERIMENT"]

PLATE = """(a plate: outline with rounded corners, a slot, a step down)
G21 G90 G17
G0 X-30 Y-20
G1 X30 F{feed:.0f}
G3 X40 Y-10 I0 J10
G1 Y15
G3 X35 Y20 I-5 J0
G1 X-35
G3 X-40 Y15 I0 J-5
G1 Y-10
G3 X-30 Y-20 I10 J0
G0 X-15 Y0
G1 Z-3
G1 X15
G3 X15 Y8 I0 J4
G1 X-15
G3 X-15 Y0 I0 J-4
M2
"""


@dataclass(frozen=True)
class Options:
    """What is run."""

    program: str = parameter("all", "what is run", choices=("all", "star", "circle", "square", "plate"))
    feed: float = parameter(
        6000.0, "of star and square; half of it of the circle, 0.4 of it of the plate", unit="mm/min", above=0.0
    )
    passes: int = parameter(
        5, "runs that are learnt from, of the methods that use bags", unit="1", minimum=1, maximum=50
    )


@dataclass(frozen=True)
class Method:
    """`name` of the preprocessor or "" for the drives as they are; overrides of the controller; where errors come from.

    `ordinary`: whether an ordinary CNC can use it. `knows`: what it must.
    """

    label: str
    knows: str
    ordinary: bool = True
    name: str = ""
    from_bags: bool = False
    overrides: Sequence[str] = ()


@dataclass(frozen=True)
class Outcome:
    """One method on one program and machine; SI. `figures` is None, with the `reason`, where there is no run."""

    machine: str
    program: str
    method: Method
    figures: ErrorFigures | None = None
    whole: float = float("nan")
    """Largest distance from the contour, corners and starts included, m."""
    duration: float = float("nan")
    acceleration: float = float("nan")
    """Largest of a drive's setpoint, m/s^2."""
    evaluation: Evaluation | None = None
    reason: str = ""
    by_pass: tuple[float, ...] = ()
    """RMS errors in three dimensions, m: before and after every run that was learnt from."""


def _methods(setup: Setup) -> list[Method]:
    delay = max(equivalent_delay(parts.drive) for parts in setup.axes.values())
    delays = [
        "drive.velocity_feed_forward=1.0",
        f"drive.setpoint_delay={0.5 * setup.servo_period!r}",
        f"drive.equivalent_delay={delay!r}",
    ]
    return [
        Method("none", "nothing"),
        Method("mirror, model", "model of machine and drives", name="mirror"),
        Method("inverse, model", "model of machine and drives", name="inverse"),
        Method("zpetc, model", "model of machine and drives", name="zpetc"),
        Method("ilc, model", "model of machine and drives", name="ilc"),
        Method("mirror, bags", "contour error of runs", name="mirror", from_bags=True),
        Method("ilc, bags", "scales of runs; model", name="ilc", from_bags=True),
        Method("velocity feed-forward", "delay of the velocity loop", False, overrides=delays),
        Method(
            "velocity and acceleration feed-forward",
            "delay of the velocity loop",
            False,
            overrides=[*delays[:1], f"drive.acceleration_feed_forward={delay!r}"],
        ),
        Method("cross coupling", "kinematics", False, overrides=["tcp_control.cross_coupling=200.0"]),
        Method(
            "direct feedback", "the TCP, measured while it runs", False, overrides=["tcp_control.direct_feedback=true"]
        ),
        Method("adapted gain", "Kv", False, overrides=["tcp_control.adapted_gain=true"]),
    ]


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup()
    require_plane(setup, "compensation")
    model = nominal(setup)
    machines = {"ideal": model, "Kv 18 % off": faster(model), "as it is": setup}
    programs = _programs(setup, options.feed)
    if options.program != "all":
        programs = {options.program: programs[options.program]}
    methods = _methods(model)
    known: dict[tuple[str, str], Program] = {}
    outcomes: list[Outcome] = []
    count = len(machines) * len(programs) * len(methods)
    for machine, actual in machines.items():
        for name, text in programs.items():
            for method in methods:
                lab.tell(len(outcomes) / count, f"{machine}, {name}, {method.label}")
                program = Program(f"{name}.ngc", text)
                outcomes.append(_outcome(machine, actual, model, program, method, options.passes, known))
    lab.tell(0.99, "what noise leaves")
    floors = {name: noise_floor(setup, Program(f"{name}.ngc", text)) for name, text in programs.items()}
    return Findings(
        [*(_table(machine, outcomes) for machine in machines), _pass_table(outcomes, floors)],
        [_figure(setup, name, outcomes) for name in programs],
        {"outcomes": [_entry(outcome) for outcome in outcomes], "floor_um": floors},
        [
            "max and rms: over the middle half of lines and all of arcs, in the plane and in three dimensions; whole: "
            "the largest distance anywhere, with the corners, which a setpoint that stops exactly there leaves to the "
            "drives.",
            "Every figure is of a run. The preprocessor's methods are run from the program that it wrote; one that "
            "refuses, or a run that faults, has its reason.",
            f"The model is the machine as its controller believes it. Kv 18 % off: drives of {MISMATCH:g} times that "
            "Kv. As it is: the machine file, with what its controller does not know.",
            f"Floor: largest and RMS distance of {REPEATS} runs with different noise from their mean; every run that "
            "is learnt from has another noise, too.",
        ],
    )


def _with(setup: Setup, overrides: Sequence[str]) -> Setup:
    values: dict[str, object] = {key: value for key, (value, _) in setup.parameters.items()}
    for override in overrides:
        key, _, value = override.partition("=")
        values[key] = value == "true" if value in ("true", "false") else float(value)
    return setup_from_parameters(values)


def _programs(setup: Setup, feed: float) -> dict[str, str]:
    star = star_program(feed, [0.0, 15.0, 45.0, 75.0], (0.0, 0.0), 100.0)
    return {
        "star": star,
        "circle": circle(setup, 0.5 * feed, 50.0),
        "square": square(feed),
        "plate": PLATE.format(feed=0.4 * feed),
    }


def _outcome(
    machine: str,
    actual: Setup,
    model: Setup,
    program: Program,
    method: Method,
    passes: int,
    known: dict[tuple[str, str], Program],
) -> Outcome:
    """`known` are the programs that were compensated by the model, which is the same for all machines."""
    name = program.name.removesuffix(".ngc")
    by_pass: list[float] = []
    try:
        if method.name and not method.from_bags:
            if (name, method.name) not in known:
                known[name, method.name] = compensate(model, program, method.name).program
            program = known[name, method.name]
        passes = passes if method.from_bags else 0
        for number in range(passes):
            run = recorded_run(repeated(actual, number), program)
            by_pass.append(judged_run(evaluate(run)).rms)
            program = compensate(model, program, method.name, bags=[run]).program
        run = recorded_run(repeated(_with(actual, method.overrides), passes), program)
    except PkmError as error:
        return Outcome(machine, name, method, reason=str(error))
    evaluation = evaluate(run)
    figures = judged_run(evaluation)
    axes = [run.servo[f"{axis}/setpoint"]["acceleration"] for axis in actual.axes]
    return Outcome(
        machine,
        name,
        method,
        figures,
        max(error.magnitude for error in evaluation.errors if evaluation.elements[error.segment].evaluated),
        run.cycles() * actual.servo_period,
        float(np.abs(np.array(axes)).max()),
        evaluation,
        by_pass=(*by_pass, figures.rms) if method.from_bags else (),
    )


def _before(outcome: Outcome, outcomes: Sequence[Outcome]) -> ErrorFigures | None:
    return next(
        one.figures
        for one in outcomes
        if (one.machine, one.program) == (outcome.machine, outcome.program)
        and not one.method.name
        and not one.method.overrides
    )


def _table(machine: str, outcomes: Sequence[Outcome]) -> Table:
    columns = ["program", "method", "max_plane_um", "rms_plane_um", "max_3d_um", "rms_3d_um", "less_%", "whole_um"]
    columns += ["time_s", "acc_m_s2", "must know", "any CNC"]
    rows: list[list[str | float | None]] = []
    for outcome in outcomes:
        if outcome.machine != machine:
            continue
        method, figures, before = outcome.method, outcome.figures, _before(outcome, outcomes)
        row: list[str | float | None] = [outcome.program, method.label]
        if figures is None:
            rows.append([*row, *[None] * 8, outcome.reason, "yes" if method.ordinary else "no"])
            continue
        less = None if before is None else 100.0 * (1.0 - figures.largest / before.largest)
        row += [1e6 * figures.largest_in_plane, 1e6 * figures.rms_in_plane, 1e6 * figures.largest, 1e6 * figures.rms]
        row += [less, 1e6 * outcome.whole, outcome.duration, outcome.acceleration]
        rows.append([*row, method.knows, "yes" if method.ordinary else "no"])
    return Table(f"Machine: {machine}", columns, rows)


def _pass_table(outcomes: Sequence[Outcome], floors: dict[str, tuple[float, float] | None]) -> Table:
    learnt = [outcome for outcome in outcomes if outcome.by_pass]
    most = max((len(outcome.by_pass) for outcome in learnt), default=1)
    columns = ["machine", "program", "method", *(f"rms_{number}_um" for number in range(most)), "floor_rms_um"]
    rows: list[list[str | float | None]] = []
    for outcome in learnt:
        values = [1e6 * value for value in outcome.by_pass]
        limit = floors[outcome.program] if outcome.machine == "as it is" else None
        rows.append(
            [outcome.machine, outcome.program, outcome.method.label, *values, None if limit is None else limit[1]]
        )
    return Table("RMS error in three dimensions after each run that was learnt from", columns, rows)


def _figure(setup: Setup, program: str, outcomes: Sequence[Outcome]) -> Figure:
    """Before and after, magnified, one panel for a machine; as figures 7-7, 7-8, 7-10 to 7-12 of the thesis."""
    panels = []
    for machine in dict.fromkeys(outcome.machine for outcome in outcomes):
        chosen = [
            outcome
            for outcome in outcomes
            if (outcome.machine, outcome.program) == (machine, program)
            and outcome.method.label in ("none", "mirror, model", "mirror, bags")
            and outcome.evaluation is not None
        ]
        if chosen:
            panels.append(_panel(setup, machine, chosen))
    return Figure(
        f"compensation-{program}",
        f"Compensation, {setup.machine_name}, {program}: paths before and after",
        panels,
        "Top view; the distance from the programmed contour is magnified as each title says.",
        columns=min(len(panels), 2),
    )


def _panel(setup: Setup, machine: str, outcomes: Sequence[Outcome]) -> Panel:
    largest = outcomes[0].figures.largest if outcomes[0].figures else 0.0
    paths = [(outcome.method.label, outcome.evaluation) for outcome in outcomes if outcome.evaluation is not None]
    return path_panel(setup, machine, largest, paths)


def _entry(outcome: Outcome) -> dict[str, Any]:
    figures = outcome.figures
    entry: dict[str, Any] = {
        "machine": outcome.machine,
        "program": outcome.program,
        "method": outcome.method.label,
        "must_know": outcome.method.knows,
        "ordinary_cnc": outcome.method.ordinary,
    }
    if figures is None:
        return {**entry, "reason": outcome.reason}
    return {
        **entry,
        "max_plane_um": 1e6 * figures.largest_in_plane,
        "rms_plane_um": 1e6 * figures.rms_in_plane,
        "max_3d_um": 1e6 * figures.largest,
        "rms_3d_um": 1e6 * figures.rms,
        "whole_um": 1e6 * outcome.whole,
        "time_s": outcome.duration,
        "acceleration_m_s2": outcome.acceleration,
        "rms_3d_by_pass_um": [1e6 * value for value in outcome.by_pass],
    }


EXPERIMENT = Experiment(
    name="compensation",
    question="Which method takes how much of the contour error away, on a machine that is its model and on ones that "
    "are not, and what does it cost? (thesis chapters 2.2.6 and 7, figs 7-7, 7-8, 7-10 to 7-12)",
    machine="tripod_real",
    options=Options,
    run=_run,
)
