"""A calibration of the Monopod on a synthetic bench, judged by positioning tests; what grid and ball bar can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._monopod import monopod, require_reachable
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.identification import (
    Believed,
    Bench,
    Calibration,
    Circle,
    NetworkCalibration,
    Positioning,
    PositioningTest,
    Positions,
    calibrate,
    calibrate_by_networks,
    positioning,
    unknowns_of,
    with_values,
)
from pkm_cnc.kinematics import Machine
from pkm_cnc.parameters import parameter
from pkm_cnc.report.calibration_report import POSITIONING, convergence_table, positioning_table
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT", "Options"]

Array = NDArray[np.float64]
UM = 1e6
THESIS = {"uncertainty": (265.0, 44.0), "reversal": (12.0, 11.6), "standard_deviation": (5.3, 5.0)}
"""um, before and after: table 4-1."""


@dataclass(frozen=True)
class Options:
    """Options of calibration."""

    gamma: float = parameter(1.0, "true inclination of the slider's guide", unit="mrad", minimum=-3.0, maximum=3.0)
    dx: float = parameter(0.4, "true offset of the TCP", unit="mm", minimum=-3.0, maximum=3.0)
    du: float = parameter(-0.1, "true offset of the slider", unit="mm", minimum=-3.0, maximum=3.0)
    reversal: float = parameter(12.0, "reversal error of the bench; table 4-1", unit="um", minimum=0.0)
    repeatability: float = parameter(
        5.3, "standard deviation of one approach of the bench; table 4-1", unit="um", minimum=0.0
    )
    begin: float = parameter(300.0, "first target position x; strut at 30 deg", unit="mm", above=0.0)
    end: float = parameter(520.0, "last target position x; strut at 60 deg", unit="mm", above=0.0)
    targets: int = parameter(12, "target positions", unit="1", minimum=5, maximum=1000)
    runs: int = parameter(5, "approaches of each target from each side", unit="1", minimum=2, maximum=1000)
    iterations: int = parameter(7, "of the networks; figure 4-5", unit="1", minimum=1, maximum=100)
    vectors: int = parameter(300, "training vectors of each network; 4.2.2", unit="1", minimum=50, maximum=10000)
    repetitions: int = parameter(
        200, "of the noise, to learn how often an interval holds the truth", unit="1", minimum=2, maximum=10000
    )
    seed: int = parameter(1, "of all noise and training", unit="1", minimum=0)


def _run(lab: Lab, options: Options) -> Findings:
    _, nominal = monopod(lab, "calibration", ["geometry.closure=start"])
    if not options.begin < options.end:
        raise InputError(f"begin: {options.begin:g} mm is not below end {options.end:g} mm")
    require_reachable(nominal, "begin and end", (options.begin, options.end))
    values = np.array((options.gamma, options.dx, options.du)) * 1e-3
    believed = Believed(nominal)
    truth = with_values(believed, unknowns_of(believed), values).machine
    bench = Bench(truth, options.reversal / UM, options.repeatability / UM)
    generator = np.random.default_rng(options.seed)
    targets = np.asarray(np.linspace(1e-3 * options.begin, 1e-3 * options.end, options.targets), dtype=float)

    def test(controller: Machine) -> PositioningTest:
        return bench.test(controller, targets, options.runs, generator)

    lab.tell(0.1, "networks")
    before = test(nominal)
    networks = calibrate_by_networks(
        nominal, before.positions, seed=options.seed, iterations=options.iterations, vectors=options.vectors
    )
    squares = calibrate(nominal, before.positions)
    machines = {"nn": networks.calibration.machine, "least_squares": squares.machine, "perfect": truth}
    tests = {"before": before, **{name: test(controller) for name, controller in machines.items()}}
    lab.tell(0.4, "repetitions")
    covered = _coverage(nominal, Bench(truth, 0.0, bench.noise), targets, options, generator, values)
    lab.tell(0.9, "grid and ball bar")
    return _findings(tests, squares, networks, _estimates(squares, networks, values, covered), _observable())


def _findings(
    tests: dict[str, PositioningTest],
    squares: Calibration,
    networks: NetworkCalibration,
    estimates: list[dict[str, Any]],
    observable: list[dict[str, Any]],
) -> Findings:
    judged = {name: positioning(one.deviations) for name, one in tests.items()}
    return Findings(
        tables=_tables(judged, networks, estimates, observable),
        figures=[_positioning_figure(tests), _convergence_figure(networks, tests["before"])],
        data={
            "positioning_um": {
                name: {key: UM * value for key, value in vars(one).items()} for name, one in judged.items()
            },
            "estimates": estimates,
            "convergence_range_um": UM * np.ptp(networks.history, axis=1),
            "condition": squares.condition,
            "scatter_um": UM * squares.scatter,
            "observable": observable,
        },
        remarks=_remarks(judged),
    )


def _coverage(
    nominal: Machine, bench: Bench, targets: Array, options: Options, generator: np.random.Generator, values: Array
) -> Array:
    """How often the interval of each unknown holds its true value, (3,), 1; noise alone, without reversal error."""
    held = np.zeros(len(values))
    for _ in range(options.repetitions):
        found = calibrate(nominal, bench.test(nominal, targets, options.runs, generator).positions)
        estimates = np.array([(one.value, one.half_interval) for one in found.estimates])
        held += np.abs(estimates[:, 0] - values) <= estimates[:, 1]
    return held / options.repetitions


def _estimates(
    squares: Calibration, networks: NetworkCalibration, values: Array, covered: Array
) -> list[dict[str, Any]]:
    """By unknown, in um and urad."""
    return [
        {
            "key": one.unknown.key,
            "unit": "um" if one.unknown.unit == "m" else "urad",
            "true": UM * true,
            "least_squares": UM * one.value,
            "half_interval_95": UM * one.half_interval,
            "held": share,
            "nn": UM * other.value,
            "nn_spread": UM * spread,
        }
        for one, other, true, share, spread in zip(
            squares.estimates,
            networks.calibration.estimates,
            values.tolist(),
            covered.tolist(),
            networks.spread.tolist(),
            strict=True,
        )
    ]


def _observable() -> list[dict[str, Any]]:
    """Rank and condition of what a grid and a ball-bar circle on the axis tell of Bipod and Tripod as drawn."""
    found = []
    for name in ("bipod", "tripod"):
        machine = load_setup(name).kinematics
        for kind, measurements in (("grid 200 x 200 mm", _grid(machine)), ("ball bar R 100 mm", _circle(machine))):
            calibration = calibrate(machine, measurements)
            alone = [one.unknown for one in calibration.estimates if one.status == "left alone"]
            found.append(
                {
                    "machine": name,
                    "measurement": kind,
                    "unknowns": len(calibration.estimates),
                    "rank": calibration.rank,
                    "condition": calibration.condition,
                    "left_alone": [unknown.key.removeprefix("geometry.") for unknown in alone],
                }
            )
    return found


def _grid(machine: Machine) -> Positions:
    steps = np.linspace(-0.1, 0.1, 7)
    tcp = np.array([(x, y, 0.0)[: len(machine.coordinates)] for x in steps for y in steps])
    return Positions(machine.inverse(tcp), tcp)


def _circle(machine: Machine) -> Circle:
    angle = np.radians(np.arange(0.0, 360.0, 5.0))
    around = np.stack((np.cos(angle), np.sin(angle), 0.0 * angle)[: len(machine.coordinates)], axis=1)
    radius = np.full(len(angle), 0.1)
    return Circle(machine.inverse(0.1 * around), machine.inverse(0.0 * around), radius)


def _tables(
    judged: dict[str, Positioning],
    networks: NetworkCalibration,
    estimates: Sequence[dict[str, Any]],
    observable: Sequence[dict[str, Any]],
) -> list[Table]:
    columns = ("parameter", "unit", "true", "least_squares", "+- (95 %)", "held", "nn", "nn_spread")
    telling = [
        [row["machine"], row["measurement"], f"{row['rank']} of {row['unknowns']}", row["condition"], _names(row)]
        for row in observable
    ]
    return [
        _with_thesis(positioning_table("Positioning before and after the calibration, table 4-1", judged)),
        Table(
            "What was estimated, and how often the interval holds the truth",
            columns,
            [list(row.values()) for row in estimates],
        ),
        convergence_table(networks),
        Table("What can be known", ("machine", "measurement", "rank", "condition", "left alone"), telling),
    ]


def _names(row: dict[str, Any]) -> str:
    return ", ".join(row["left_alone"]) or "none"


def _with_thesis(table: Table) -> Table:
    """Two more columns: what the thesis has."""
    thesis = [THESIS.get(key, (None, None)) for key in POSITIONING.values()]
    rows = [[*row, *extra] for row, extra in zip(table.rows, thesis, strict=True)]
    return Table(table.title, (*table.columns, "thesis_before_um", "thesis_after_um"), rows)


def _remarks(judged: dict[str, Positioning]) -> list[str]:
    return [
        "Definitions: docs/calibration.md. Before, after: two independent tests of the same bench, whose controller "
        "takes its nominal and then its estimated geometry; perfect: a controller that knows the truth.",
        f"The floor, U + 6 s, is {UM * judged['perfect'].floor:.1f} um for the perfect controller; its P is "
        f"{UM * judged['perfect'].uncertainty:.1f} um, because s of so few approaches differs from target to target "
        "and P takes the widest.",
        "+-: 95 % interval of least squares. held: share of repetitions whose interval holds the truth. nn_spread: "
        "standard deviation of what the first iteration's networks make of measurements that differ by noise alone; it "
        "is no uncertainty, a network answers near the middle of its band what the data do not tell.",
    ]


def _positioning_figure(tests: dict[str, PositioningTest]) -> Figure:
    def curve(name: str) -> Curve:
        test = tests[name]
        deviations = UM * test.deviations.reshape(len(test.targets), -1)
        return Curve(
            name.replace("_", " "),
            1e3 * test.targets,
            deviations.mean(axis=1),
            "line and points",
            bars=2.0 * deviations.std(axis=1, ddof=1),
        )

    label = "deviation, mean of both directions (um)"
    panels = [
        Panel("Before", "target position x (mm)", label, [curve("before")]),
        Panel("After", "target position x (mm)", label, [curve("nn"), curve("least_squares"), curve("perfect")]),
    ]
    return Figure(
        "positioning", "Positioning tests", panels, "Bars: two standard deviations, reversal error included.", 2
    )


def _convergence_figure(networks: NetworkCalibration, before: PositioningTest) -> Figure:
    """Figure 4-5: the deviation at the start and after the iterations, mean of each target."""
    states = np.mean(networks.history.reshape(len(networks.history), len(before.targets), -1), axis=2)
    curves = [
        Curve("start" if place == 0 else f"iteration {place}", 1e3 * before.targets, UM * states[place])
        for place in sorted({0, 1, 2, len(states) - 1})
        if place < len(states)
    ]
    ranges = Curve("range", np.arange(float(len(states))), UM * np.ptp(states, axis=1), "line and points")
    panels = [
        Panel("Deviation", "target position x (mm)", "mean deviation (um)", curves),
        Panel("Convergence", "iteration", "range of the mean deviation (um)", [ranges], x_step=1.0),
    ]
    return Figure("convergence", "Calibration by networks", panels, "As thesis figure 4-5.", 2)


EXPERIMENT = Experiment(
    name="calibration",
    question="How much of the Monopod's positioning error does a calibration remove, by networks and by least squares, "
    "and what can measurements tell of Bipod and Tripod? (thesis 4.2.2: figure 4-5, table 4-1)",
    machine="monopod",
    options=Options,
    run=_run,
)
