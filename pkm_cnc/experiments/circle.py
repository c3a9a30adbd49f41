"""Circular test: circles of several radii, feeds and centres in both directions (thesis 5.3.2, 6.4.2, 6.5.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from pkm_cnc.config import Setup
from pkm_cnc.contour import CirclePath, circle_pair_report, circle_pairs, circle_program, circle_report, extrema
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._as_measured import circles_as_measured
from pkm_cnc.experiments._circles import DIRECTIONS, ORDERS, by_direction, harmonics, polar_panel
from pkm_cnc.experiments._law import drift, kappa
from pkm_cnc.experiments._machine import place, points, require_plane
from pkm_cnc.experiments._struts import strut_angles
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Array, Curve, Figure, Panel, Table

__all__ = ["EXPERIMENT"]

DRAWN = 361
"""Points of a drawn circle, and angles at which strut angles and drive velocities are shown."""
ANGLE = "actual angle about the programmed centre (deg)"


@dataclass(frozen=True)
class Options:
    """What is run: every centre with every radius at every feed, both directions."""

    radii: tuple[float, ...] = parameter(
        (100.0, 50.0), "radii: a comma list or first:last:step", unit="mm", above=0.0, any_length=True
    )
    feeds: tuple[float, ...] = parameter(
        (3000.0, 6000.0), "feeds: a comma list or first:last:step", unit="mm/min", above=0.0, any_length=True
    )
    center: tuple[float, ...] = parameter(
        (0.0, 0.0, 50.0, 0.0, 0.0, 50.0), "centre of the circles", unit="mm", any_length=True, each=2
    )
    overshoot: float = parameter(
        60.0,
        "arc before and after the judged circle, in which transients die out",
        unit="deg",
        above=0.0,
        maximum=359.0,
    )
    as_measured: bool = parameter(False, "read by a ball bar, as in thesis 2.2.5")
    repeats: int = parameter(5, "with --as-measured: runs of each circle", unit="runs", minimum=1, maximum=1000)


@dataclass(frozen=True)
class Circle:
    """The circular test about one centre, with one radius (mm) at one feed (mm/min), by direction."""

    center: tuple[float, float]
    radius: float
    feed: float
    paths: dict[str, CirclePath]
    reports: dict[str, Any]
    pair: dict[str, Any]
    law: Array | None
    """dR that the law expects, um, at DRAWN angles from 0 to 360 deg."""
    drives: dict[str, Any]
    """Of the counter-clockwise run at DRAWN angles: `velocity` mm/s and `strut_angle` deg, both by axis."""

    @property
    def name(self) -> str:
        """For tables and pictures."""
        return f"centre {place(self.center)}, R {self.radius:g} mm, {self.feed:g} mm/min"

    def figure(self, direction: str, *keys: str) -> float:
        """A figure of the report of one direction."""
        value: Any = self.reports[direction]
        for key in keys:
            value = value[key]
        return float(value)


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup()
    require_plane(setup, "circle")
    if options.as_measured:
        centers = points(options.center)
        return circles_as_measured(lab, centers, options.radii, options.feeds, options.overshoot, options.repeats)
    factor = kappa(setup)
    wanted = list(product(points(options.center), options.radii, options.feeds))
    circles = []
    for number, (center, radius, feed) in enumerate(wanted):
        lab.tell(number / len(wanted), f"centre {place(center)}, R {radius:g} mm, {feed:g} mm/min")
        text = circle_program(
            feed_mm_min=feed,
            radius_mm=radius,
            center_mm=center,
            direction="both",
            overshoot_deg=options.overshoot,
            acceleration_mm_s2=setup.motion.acceleration * 1e3,
        )
        circles.append(_circle(center, radius, feed, lab.run(setup, text, f"circle about {place(center)}"), factor))
    return Findings(_tables(circles), _figures(setup, circles), _data(circles, factor), _remarks(factor))


def _circle(center: tuple[float, float], radius: float, feed: float, trial: Trial, factor: float | None) -> Circle:
    found = by_direction(trial)
    if set(found) != set(DIRECTIONS):
        raise InputError(f"circle: R {radius:g} mm at {feed:g} mm/min is too short: the servo period steps over it")
    paths = {direction: path for direction, (_, path) in found.items()}
    reports: dict[str, Any] = {
        direction: {**circle_report(path), "harmonics": harmonics(path)} for direction, path in paths.items()
    }
    (pair,) = (circle_pair_report(*both) for both in circle_pairs(list(paths.values())))
    law = None if factor is None else 1e6 * factor * (feed / 60e3) ** 2 * _inward(trial.setup, paths["ccw"])
    return Circle(center, radius, feed, paths, reports, pair, law, _drives(trial, *found["ccw"]))


def _inward(setup: Setup, path: CirclePath) -> Array:
    """1 / R less the part of J^-1 d2u/ds2 (straight lines) along the radius, 1/m, at DRAWN angles: dR / (kappa v^2)."""
    angle = np.linspace(0.0, math.tau, DRAWN)
    radial = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    tangent = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    vectors = drift(setup.machine, np.array(path.arc.center) + path.arc.radius * radial, tangent)
    return np.asarray(1.0 / path.arc.radius - (vectors * radial).sum(axis=1), dtype=np.float64)


def _drives(trial: Trial, segment: int, path: CirclePath) -> dict[str, Any]:
    """Drive velocities and strut angles over the actual angle, DRAWN values from 0 to 360 deg each."""
    rows = trial.cycles_of(segment)
    rows = rows[:: max(1, len(rows) // (2 * DRAWN))]
    true = trial.evaluation.true[rows]
    x, y = true[:, 0] - path.arc.center[0], true[:, 1] - path.arc.center[1]
    angle, drawn = np.arctan2(y, x), np.linspace(0.0, math.tau, DRAWN)

    def over_angle(values: Array) -> Array:
        return np.asarray(np.interp(drawn, angle % math.tau, values, period=math.tau), dtype=np.float64)

    struts = strut_angles(trial.setup.actual, trial.axis_position[rows], true)
    velocity = 1e3 * trial.axis_velocity[rows]
    return {
        "velocity": {axis: over_angle(velocity[:, place]) for place, axis in enumerate(trial.setup.axes)},
        "strut_angle": {axis: over_angle(angles) for axis, angles in struts.items()},
    }


def _tables(circles: Sequence[Circle]) -> list[Table]:
    columns = ["center_mm", "radius_mm", "feed_mm_min", "direction", "dR_mean_um", "dR_min_um", "dR_max_um"]
    columns += ["circularity_um", "G_um", "F_max_um", "F_min_um", "maxima_of_dR_deg"]
    rows: list[list[str | float | None]] = []
    pairs: list[list[str | float | None]] = []
    for circle in circles:
        what: list[str | float | None] = [place(circle.center)[:-3], circle.radius, circle.feed]
        for direction, report in circle.reports.items():
            deviation, iso = report["radial_deviation_um"], report["iso230_4"]
            rows.append(
                [*what, direction, deviation["mean"], deviation["min"], deviation["max"], report["circularity_um"]]
                + [iso["G_um"], iso["F_max_um"], iso["F_min_um"]]
                + [" ".join(f"{angle:.1f}" for angle in report["extrema_deg"]) or "none"]
            )
        pairs.append([*what, circle.pair["iso230_4"]["Gb_um"], circle.pair["iso230_4"]["D_um"]])
    first = circles[0]
    spectra = [first.reports[direction]["harmonics"] for direction in DIRECTIONS]
    orders: list[list[str | float | None]] = [
        [order, *(float(each[key][order]) for each in spectra for key in ("amplitude_um", "phase_deg"))]
        for order in range(ORDERS + 1)
    ]
    return [
        Table("Radial deviation by actual angle about the programmed centre", columns, rows),
        Table("Both directions together, ISO 230-4", ["center_mm", "radius_mm", "feed_mm_min", "Gb_um", "D_um"], pairs),
        Table(
            f"Harmonics of dR, {first.name}",
            ["order", "ccw_um", "ccw_phase_deg", "cw_um", "cw_phase_deg"],
            orders,
        ),
    ]


def _figures(setup: Setup, circles: Sequence[Circle]) -> list[Figure]:
    first = circles[0]
    same = [circle for circle in circles if (circle.radius, circle.feed) == (first.radius, first.feed)]
    machine = setup.machine_name
    found = [
        Figure(
            "circle-polar",
            f"Circular test, {machine}: R {first.radius:g} mm, {first.feed:g} mm/min",
            [polar_panel(circle.paths, f"centre {place(circle.center)}") for circle in same],
            "Actual path, its distance to the programmed circle magnified as each title says; inside = too small.",
            columns=min(len(same), 2),
        ),
        _over_angle(machine, first),
    ]
    for name, label, key, other in (
        ("radius", "radius (mm)", "radius", "feed"),
        ("feed", "feed (mm/min)", "feed", "radius"),
    ):
        if len({getattr(circle, key) for circle in circles}) > 1:
            chosen = [circle for circle in circles if getattr(circle, other) == getattr(first, other)]
            found.append(_over(machine, chosen, name, label))
    return found


def _over_angle(machine: str, circle: Circle) -> Figure:
    """Radial deviation, strut angles and drive velocities on one angle axis (figs 5-8, 6-24 to 6-26)."""
    degrees = np.linspace(0.0, 360.0, DRAWN)
    curves = []
    for direction, path in circle.paths.items():
        at = np.arange(len(path.by_angle)) * (360.0 / len(path.by_angle))
        tops = np.degrees(sorted(extrema(path)))
        curves.append(Curve(DIRECTIONS[direction], at[::10], 1e6 * path.by_angle[::10]))
        values = 1e6 * np.interp(tops, at, path.by_angle, period=360.0)
        curves.append(Curve("", tops, values, kind="points"))
    if circle.law is not None:
        curves.append(Curve("law: kappa v^2 (1/R - r . J^-1 d2u/ds2)", degrees, circle.law, role="programmed"))
    panels = [Panel("Radial deviation (+ = the circle came out too small)", ANGLE, "dR (um)", curves)]
    struts, velocities = circle.drives["strut_angle"], circle.drives["velocity"]
    if struts:
        panels.append(
            Panel("Angle of the struts to the plane across their columns", ANGLE, "beta (deg)", _marked(struts))
        )
    panels.append(Panel("Velocity of the drives, counter-clockwise", ANGLE, "velocity (mm/s)", _marked(velocities)))
    return Figure(
        "circle-drives",
        f"Circular test, {machine}: {circle.name}",
        panels,
        "Points: local maxima of dR, and largest and smallest strut angles and drive velocities.",
        share_x=True,
    )


def _marked(series: dict[str, Array]) -> list[Curve]:
    """A curve per axis over the drawn angles, with its largest and smallest value marked."""
    degrees = np.linspace(0.0, 360.0, DRAWN)
    curves = []
    for axis, values in series.items():
        ends = np.array([int(values.argmax()), int(values.argmin())])
        curves += [Curve(axis, degrees, values), Curve("", degrees[ends], values[ends], kind="points")]
    return curves


def _over(machine: str, circles: Sequence[Circle], key: str, label: str) -> Figure:
    """Largest and smallest radial deviation and circularity over radius or feed, a curve for every centre."""
    panels = []
    for title, unit, *where in (
        ("Largest radial deviation", "dR (um)", "radial_deviation_um", "max"),
        ("Smallest radial deviation", "dR (um)", "radial_deviation_um", "min"),
        ("Circularity: largest less smallest radius", "circularity (um)", "circularity_um"),
    ):
        curves = []
        for center in dict.fromkeys(circle.center for circle in circles):
            group = sorted(
                (getattr(circle, key), circle.figure("ccw", *where)) for circle in circles if circle.center == center
            )
            x, y = np.array(group).T
            curves.append(Curve(f"centre {place(center)}", x, y, kind="line and points"))
        panels.append(Panel(title, label, unit, curves))
    fixed = f"{circles[0].feed:g} mm/min" if key == "radius" else f"R {circles[0].radius:g} mm"
    return Figure(
        f"circle-{key}",
        f"Circular test, {machine}, over the {key}: {fixed}",
        panels,
        "Counter-clockwise runs.",
        columns=3,
    )


def _data(circles: Sequence[Circle], factor: float | None) -> dict[str, Any]:
    return {
        "kappa_s2": factor,
        "circles": [
            {
                "center_mm": circle.center,
                "radius_mm": circle.radius,
                "feed_mm_min": circle.feed,
                **circle.reports,
                "pair": circle.pair["iso230_4"],
                "angle_deg": np.linspace(0.0, 360.0, DRAWN),
                "law_um": circle.law,
                "drive_velocity_mm_s": circle.drives["velocity"],
                "strut_angle_deg": circle.drives["strut_angle"],
            }
            for circle in circles
        ],
    }


def _remarks(factor: float | None) -> list[str]:
    remarks = [
        "dR = programmed - actual radius by the actual angle about the programmed centre, + = the circle came out too "
        "small. circularity = largest less smallest actual radius about the programmed centre (thesis 6.5.2).",
        "ISO 230-4: G, circular deviation = width of the zone between two circles about the least squares centre that "
        "holds the path; G(b), bi-directional = the same of both directions together; F_max and F_min, radial "
        "deviation = largest and smallest actual - programmed radius about the programmed centre (F = -dR); D, mean "
        "bi-directional radial deviation = radius of the least squares circle of both - programmed radius.",
        f"Harmonics: dR = sum of a[n] cos(n angle - p[n]), n = 0 to {ORDERS}, a in um, p in deg.",
    ]
    if factor is None:
        remarks.append("The drives are not equal: the law for equal drives is left out.")
    return remarks


EXPERIMENT = Experiment(
    name="circle",
    question="How far and where does a circle come out too small or out of round, by radius, feed and place, and what "
    "do struts and drives do there? (thesis figs 5-8, 6-19, 6-23 to 6-29)",
    machine="tripod",
    options=Options,
    run=_run,
)
