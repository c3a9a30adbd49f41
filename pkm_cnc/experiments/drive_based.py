"""Contour errors from joint signals alone, by the recorded and by the estimated tracking error, against the exact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.contour import (
    circle_program,
    circle_radial_deviation,
    circle_radial_deviation_by_velocity,
    estimated_tracking_error,
    heading_deg,
    is_full_circle,
    judged_range,
    left_and_up,
    line_contour_error,
    star_program,
    tcp_tracking_error,
    tcp_velocity,
)
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._axis import Lag, steady_lag
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Arc, Line
from pkm_cnc.report.figure import Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT", "Options", "Recomputed", "recomputed"]

Array = NDArray[np.float64]
UM, PM = 1e6, 1e12


@dataclass(frozen=True)
class Options:
    """Options of drive-based."""

    headings: tuple[float, ...] = parameter(
        tuple(15.0 * step for step in range(13)),
        "directions of travel of the star's lines",
        unit="deg",
        any_length=True,
    )
    feed: float = parameter(6000.0, "along the star's lines", unit="mm/min", above=0.0)
    pivot: tuple[float, ...] = parameter((0.0, 0.0), "x, y of the star's middle", unit="mm")
    length: float = parameter(200.0, "of the star's lines", unit="mm", above=0.0)
    circle_feed: float = parameter(3000.0, "along the circles", unit="mm/min", above=0.0)
    radius: float = parameter(100.0, "of the circles", unit="mm", above=0.0)
    center: tuple[float, ...] = parameter((0.0, 0.0), "x, y of the circles' centre", unit="mm")


@dataclass(frozen=True)
class Recomputed:
    """Deviations of one segment over the cycles in which it is judged, m, (n,) each; by what they were computed.

    "nearest": nearest point of the contour; "recorded": from joint signals with the recorded tracking error;
    "estimated": with 4-15's; a circle has also "velocity": 5-27, and "actual velocity": 5-27 with Kv Delta-U in the
    place of the setpoint's velocity, as printed. `first` is a line's left part, a circle's radial deviation; `up` the
    part in z of both.
    """

    element: Line | Arc
    path: Array
    """Where along it the tool is: path length m on a line, actual angle rad on a circle."""
    first: dict[str, Array]
    up: dict[str, Array]


def recomputed(trial: Trial) -> list[Recomputed]:
    """The judged lines and full circles of a run, in order; cycles with setpoint and tool on one line or circle."""
    return [
        _line(trial, index, element) if isinstance(element, Line) else _circle(trial, index, element)
        for index in trial.evaluation.summaries
        if isinstance(element := trial.evaluation.elements[index], Line) or is_full_circle(element)
    ]


def _gains(trial: Trial) -> Array:
    return np.array([parts.drive.kv for parts in trial.setup.axes.values()])


def _cycles(trial: Trial, index: int, element: Line | Arc) -> NDArray[np.intp]:
    """Cycles with the foot on the judged part of the element, and the setpoint moving on its line or circle."""
    cycles = trial.cycles_of(index)
    start, end = judged_range(element, trial.evaluation.starts[index])
    feet = np.array([trial.evaluation.errors[cycle].path_length for cycle in cycles])
    velocity = trial.tcp_setpoint[cycles, 1]
    setpoint = trial.tcp_setpoint[cycles, 0]
    moving = (velocity * velocity).sum(axis=1) > 0.0
    on_element = np.array([_is_on(element, *point) for point in setpoint.tolist()])
    return np.asarray(cycles[(start <= feet) & (feet <= end) & moving & on_element])


def _is_on(element: Line | Arc, x: float, y: float, z: float) -> bool:
    s = element.nearest((x, y, z), 0.5 * element.length)
    return 0.0 < s < element.length and math.dist(element.position(s), (x, y, z)) < 1e-12


def _line(trial: Trial, index: int, line: Line) -> Recomputed:
    cycles = _cycles(trial, index, line)
    machine = trial.setup.machine
    joints, velocity = trial.axis_setpoint[cycles, :, 0], trial.axis_setpoint[cycles, :, 1]
    errors = [trial.evaluation.errors[cycle] for cycle in cycles]
    left, up = {"nearest": np.array([e.left for e in errors])}, {"nearest": np.array([e.up for e in errors])}
    direction = tcp_velocity(machine, joints, velocity)
    for name, lag in (
        ("recorded", trial.tracking_error[cycles]),
        ("estimated", estimated_tracking_error(velocity, _gains(trial))),
    ):
        left[name], up[name] = left_and_up(line_contour_error(machine, joints, velocity, lag), direction)
    path = np.array([error.path_length for error in errors]) - trial.evaluation.starts[index]
    return Recomputed(line, path, left, up)


def _circle(trial: Trial, index: int, arc: Arc) -> Recomputed:
    cycles = _cycles(trial, index, arc)
    machine, clockwise = trial.setup.machine, arc.sweep < 0.0
    joints, velocity = trial.axis_setpoint[cycles, :, 0], trial.axis_setpoint[cycles, :, 1]
    lag = trial.tracking_error[cycles]
    estimate = estimated_tracking_error(velocity, _gains(trial))
    x, y = (trial.evaluation.true[cycles, :2] - np.array(arc.center[:2])).T

    def by_velocity(rate: Array) -> Array:
        return circle_radial_deviation_by_velocity(machine, joints, rate, lag, arc.radius, clockwise)

    deviation = {
        "nearest": np.asarray(arc.radius - np.hypot(x, y)),
        "recorded": circle_radial_deviation(machine, joints, lag, arc.center, arc.radius),
        "velocity": by_velocity(velocity),
        "estimated": circle_radial_deviation(machine, joints, estimate, arc.center, arc.radius),
        "actual velocity": by_velocity(_gains(trial) * lag),
    }
    up = {
        "nearest": np.array([trial.evaluation.errors[cycle].up for cycle in cycles]),
        "recorded": -tcp_tracking_error(machine, joints, lag)[:, 2],
        "estimated": -tcp_tracking_error(machine, joints, estimate)[:, 2],
    }
    return Recomputed(arc, np.arctan2(y, x) % math.tau, deviation, up)


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup()
    if not {"x", "y"} <= set(setup.kinematics.coordinates):
        raise InputError(f"experiment drive-based: {setup.machine_name} moves in no plane; take a machine with x and y")
    lab.tell(0.0, "star")
    star = lab.run(setup, star_program(options.feed, options.headings, options.pivot, options.length), "star")
    lab.tell(0.6, "circles")
    circles = circle_program(
        feed_mm_min=options.circle_feed,
        radius_mm=options.radius,
        center_mm=options.center,
        direction="both",
        overshoot_deg=90.0,
        acceleration_mm_s2=1e3 * setup.motion.acceleration,
    )
    segments = [*recomputed(star), *recomputed(lab.run(setup, circles, "circles"))]
    lab.tell(0.95, "lag of the drives")
    lags = [steady_lag(setup, axis) for axis in setup.axes]
    ratio = _expected_ratio(lags, _gains(star))
    lines = [segment for segment in segments if isinstance(segment.element, Line)]
    arcs = [segment for segment in segments if isinstance(segment.element, Arc)]
    entries = [_entry(segment) for segment in segments]
    largest = max(max(entry["recorded_largest_difference_pm"].values()) for entry in entries)
    return Findings(
        tables=[_table("Lines, mean over the middle half", lines, entries), _table("Circles, mean", arcs, entries)],
        figures=[_star_figure(lines), *_circle_figures(arcs)],
        data={
            "machine": setup.machine_name,
            "segments": entries,
            "recorded_largest_difference_pm": largest,
            "expected_ratio_estimated_to_nearest": ratio,
            "lag_mean_s": [lag.mean for lag in lags],
            "kappa_s2": [lag.kappa for lag in lags],
            "kv_per_s": _gains(star).tolist(),
        },
        remarks=_remarks(ratio, largest),
    )


def _expected_ratio(lags: Sequence[Lag], kv: Array) -> float | None:
    """-1/(2 Kv^2) : kappa, for drives that are all alike."""
    alike = len({*lags}) == 1 and len({*kv.tolist()}) == 1
    return float(-0.5 / (kv[0] * kv[0] * lags[0].kappa)) if alike else None


def _entry(segment: Recomputed) -> dict[str, Any]:
    element = segment.element
    deviations = {("left" if isinstance(element, Line) else "radial_deviation"): segment.first, "z": segment.up}
    entry: dict[str, Any] = {"kind": "line", "heading_deg": heading_deg(element)} if isinstance(element, Line) else {}
    if isinstance(element, Arc):
        entry = {"kind": "circle", "direction": "cw" if element.sweep < 0.0 else "ccw"}
        entry["radius_mm"] = 1e3 * element.radius
    entry["feed_mm_min"] = 60e3 * element.feed
    for part, values in deviations.items():
        entry[f"{part}_mean_um"] = {name: UM * float(value.mean()) for name, value in values.items()}
    for name in list(segment.first)[1:]:
        entry[f"{name.replace(' ', '_')}_largest_difference_pm"] = {
            part: PM * float(np.abs(values[name] - values["nearest"]).max())
            for part, values in deviations.items()
            if name in values
        }
    return entry


def _table(title: str, segments: Sequence[Recomputed], entries: Sequence[dict[str, Any]]) -> Table:
    kind = "line" if isinstance(segments[0].element, Line) else "circle"
    first, word = ("left", "heading_deg") if kind == "line" else ("radial_deviation", "direction")
    short = "left" if kind == "line" else "dR"
    columns = [word]
    for part in (short, "z"):
        columns += [
            f"{part}_nearest_um",
            f"{part}_recorded_um",
            f"{part}_estimated_um",
            f"{part}_recorded_largest_diff_pm",
        ]
    rows: list[list[str | float | None]] = []
    for entry in entries:
        if entry["kind"] != kind:
            continue
        row: list[str | float | None] = [entry[word]]
        for part in (first, "z"):
            means = entry[f"{part}_mean_um"]
            row += [means["nearest"], means["recorded"], means["estimated"]]
            row.append(entry["recorded_largest_difference_pm"][part])
        if kind == "circle":
            row.append(entry["velocity_largest_difference_pm"][first])
            row.append(1e-6 * entry["actual_velocity_largest_difference_pm"][first])
        rows.append(row)
    if kind == "circle":
        columns += ["dR_by_5_27_largest_diff_pm", "dR_by_5_27_with_Kv_dU_largest_diff_um"]
    return Table(title, columns, rows)


def _star_figure(lines: Sequence[Recomputed]) -> Figure:
    headings = np.array([heading_deg(line.element) for line in lines if isinstance(line.element, Line)], dtype=float)
    order = np.argsort(headings, kind="stable")

    def curves(part: str) -> list[Curve]:
        looks: list[tuple[str, str, Any]] = [
            ("nearest", "nearest point of the contour", "line"),
            ("recorded", "joint signals, recorded tracking error", "points"),
            ("estimated", "joint signals, tracking error by 4-15", "line and points"),
        ]
        values = [line.first if part == "left" else line.up for line in lines]
        return [
            Curve(label, headings[order], UM * np.array([value[name].mean() for value in values])[order], kind)
            for name, label, kind in looks
        ]

    panels = [
        Panel("In the plane", "heading (deg)", "mean contour error, + = left of travel (um)", curves("left")),
        Panel("Across it", "heading (deg)", "mean contour error in z, + = above (um)", curves("z")),
    ]
    caption = "The recorded tracking error gives the exact contour error; the one of constant velocity, its opposite."
    return Figure(
        "drive_based_star", "Contour error of the star's lines from joint signals", panels, caption, share_x=True
    )


def _circle_figures(arcs: Sequence[Recomputed]) -> list[Figure]:
    panels = []
    for circle in arcs:
        clockwise = isinstance(circle.element, Arc) and circle.element.sweep < 0.0
        order = np.argsort(circle.path, kind="stable")
        angle = np.degrees(circle.path[order])
        curves = [
            Curve(label, angle, UM * circle.first[name][order])
            for name, label in (
                ("nearest", "nearest point of the contour"),
                ("recorded", "5-26, recorded tracking error"),
                ("estimated", "5-26, tracking error by 4-15"),
                ("actual velocity", "5-27 with Kv Delta-U, as printed"),
            )
        ]
        panels.append(
            Panel(
                "clockwise" if clockwise else "counter-clockwise",
                "actual angle (deg)",
                "radial deviation, + = too small (um)",
                curves,
            )
        )
    caption = "5-27 with the setpoint's velocity lies on 5-26; with the actual velocity it is wrong by the lag's angle."
    return [Figure("drive_based_circle", "Radial deviation of the circles from joint signals", panels, caption)]


def _remarks(ratio: float | None, largest: float) -> list[str]:
    explained = (
        f"with these drives it is {ratio:.4f} times the true one"
        if ratio is not None
        else "these drives are not alike, and it is also tilted by their different gains"
    )
    return [
        "Nearest: shortest distance from the programmed contour to the true TCP. Recorded: 5-21 and 5-26 from "
        "setpoint, its rate and recorded tracking error of the joints, through the controller's kinematics. Only "
        "cycles with setpoint and tool on one line or circle count; of lines the middle half.",
        f"The largest difference between the two is {largest:.3g} pm. They part when the scales do not read the "
        "sliders, or when the actual geometry is not the controller's: joint signals cannot see that.",
        "Estimated: Delta-U = (dU_s/dt)/Kv (4-15), the lag at constant velocity. A linear drive lags by "
        "(dU_s/dt)/Kv - (1/(2 Kv^2) + kappa) d2U_s/dt2, kappa = half the variance of its impulse response. So the tool "
        "leaves the contour by kappa J d2U_s/dt2, while the estimate, which never brakes, leaves it by "
        f"-1/(2 Kv^2) J d2U_s/dt2: about as far, on the other side; {explained}.",
    ]


EXPERIMENT = Experiment(
    name="drive-based",
    question="Do joint signals alone tell the contour error, with the recorded and with the estimated tracking error? "
    "(thesis 5.3: 5-19..5-21, 5-26, 5-27, 4-15)",
    machine="tripod",
    options=Options,
    run=_run,
)
