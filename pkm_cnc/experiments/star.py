"""Star test: straight lines of many headings through pivots, at several feeds (thesis 5.3.1, 6.5.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from pkm_cnc.config import Setup
from pkm_cnc.contour import line_report, star_program
from pkm_cnc.experiments._as_measured import star_as_measured
from pkm_cnc.experiments._law import drift, kappa
from pkm_cnc.experiments._machine import place, points, require_plane, resting
from pkm_cnc.experiments._traces import Trace, plan_panel, traces_of
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Line
from pkm_cnc.report.figure import Array, Curve, Figure, Panel, Table
from pkm_cnc.tolerances import TIE

__all__ = ["EXPERIMENT"]

NEAR_ZERO = 2e-4
"""Of the largest error of a star: a heading with less is a zero itself. Where the error is a third harmonic of the
heading, as on the Tripod, that is 0.004 deg."""
ZERO_RESOLUTION = 0.005
"""deg, to which zero headings are found."""
WIDEST_BRACKET = 45.0
"""deg between neighbouring headings; over a wider gap a change of side is not followed up."""

DRAWN = 181
"""Headings at which the law is drawn."""

HEADING = "heading (deg, counter-clockwise from +x)"
LEFT, UP = "in the plane (um, + = left of travel)", "z (um, + = above)"
LAW = "law: kappa v^2 J^-1 d2u/ds2"


@dataclass(frozen=True)
class Options:
    """What is run: every pivot at every feed."""

    headings: tuple[float, ...] = parameter(
        tuple(float(heading) for heading in range(-15, 106, 15)),
        "headings counter-clockwise from +x: first:last:step or a comma list",
        unit="deg",
        minimum=-3600.0,
        maximum=3600.0,
        any_length=True,
    )
    feeds: tuple[float, ...] = parameter(
        (6000.0, 9000.0), "feeds: a comma list or first:last:step", unit="mm/min", above=0.0, any_length=True
    )
    pivot: tuple[float, ...] = parameter(
        (0.0, 0.0, 50.0, 0.0, 0.0, 50.0), "point that all lines are centred on", unit="mm", any_length=True, each=2
    )
    length: float = parameter(200.0, "length of each line", unit="mm", above=0.0)
    as_measured: bool = parameter(False, "read by a probe on a straightedge, as in thesis 6.4.1")
    slow_feed: float = parameter(
        600.0, "with --as-measured: of the run for what is not dynamic", unit="mm/min", above=0.0
    )
    repeats: int = parameter(5, "with --as-measured: runs of each star", unit="runs", minimum=1, maximum=1000)


@dataclass(frozen=True)
class Judged:
    """Mean signed errors of lines over their middle halves, um: in the plane and in z, shape (n,) each."""

    left: Array
    up: Array


@dataclass(frozen=True)
class Star:
    """One star; everything sorted by heading, deg."""

    pivot: tuple[float, float]
    feed: float
    headings: Array
    lines: Sequence[dict[str, Any]]
    """As `evaluate --json` has them."""
    mean: Judged
    law: Judged | None
    law_curve: tuple[Array, Judged] | None
    """The law at headings of its own, close enough to draw a line through."""
    traces: Sequence[Trace]
    zeros: Sequence[float] | None
    """Headings without error in the plane, deg; None where they were not looked for."""
    law_zeros: Sequence[float]

    @property
    def name(self) -> str:
        """For tables and pictures."""
        return f"pivot {place(self.pivot)}, {self.feed:g} mm/min"


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup(resting(lab.setup()))
    require_plane(setup, "star")
    if options.as_measured:
        headings, pivots = sorted(set(options.headings)), points(options.pivot)
        return star_as_measured(
            lab, headings, options.feeds, pivots, options.length, options.slow_feed, options.repeats
        )
    factor = kappa(setup)
    wanted = [(pivot, feed) for pivot in points(options.pivot) for feed in options.feeds]
    stars = []
    for number, (pivot, feed) in enumerate(wanted):
        lab.tell(number / len(wanted), f"pivot {place(pivot)}, {feed:g} mm/min")
        stars.append(_star(lab, setup, options, pivot, feed, factor))
    return Findings(_tables(stars), _figures(setup, stars), _data(stars, factor), _remarks(stars))


def _star(
    lab: Lab, setup: Setup, options: Options, pivot: tuple[float, float], feed: float, factor: float | None
) -> Star:
    def run(headings: Sequence[float]) -> Trial:
        text = star_program(feed, headings, pivot, options.length)
        return lab.run(setup, text, f"star about {place(pivot)}")

    def judge(heading: float) -> float:
        return float(_figure(_lines(run([heading])), "contour_error_um", "mean")[0])

    headings = sorted(set(options.headings))
    trial = run(headings)
    lines = _lines(trial)
    mean = Judged(*(_figure(lines, key, "mean") for key in ("contour_error_um", "contour_error_z_um")))
    zeros = None
    if feed == options.feeds[0]:
        zeros = _zeros(headings, mean.left, judge)
    law, law_curve, law_zeros = None, None, []
    if factor is not None:
        scale = 1e6 * factor * (feed / 60e3) ** 2

        def expected(heading: float) -> tuple[float, float]:
            return _law(setup, pivot, heading, options.length, scale)

        law = Judged(*np.array([expected(heading) for heading in headings]).T)
        dense = np.linspace(headings[0], headings[-1], DRAWN)
        law_curve = dense, Judged(*np.array([expected(heading) for heading in dense.tolist()]).T)
        law_zeros = _zeros(headings, law.left, lambda heading: expected(heading)[0])
    return Star(pivot, feed, np.array(headings), lines, mean, law, law_curve, traces_of(trial), zeros, law_zeros)


def _lines(trial: Trial) -> list[dict[str, Any]]:
    evaluation = trial.evaluation
    return [
        line_report(element, summary)
        for index, summary in evaluation.summaries.items()
        if isinstance(element := evaluation.elements[index], Line)
    ]


def _figure(lines: Sequence[dict[str, Any]], key: str, part: str) -> Array:
    return np.array([line[key][part] for line in lines], dtype=float)


def _law(setup: Setup, pivot: tuple[float, float], heading: float, length: float, scale: float) -> tuple[float, float]:
    """The law's mean over the middle half of a line, left and up: scale times that of J^-1 d2u/ds2 (1/m)."""
    cosine, sine = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    tangent = np.array([cosine, sine, 0.0])
    middle = np.array([*pivot, 0.0]) * 1e-3 + np.array(setup.program_zero) * (1.0, 1.0, 0.0)
    middle[2] = setup.start_pose[2]  # a star is run at the height where the tool stands
    along = (np.arange(100) + 0.5) / 100 * 0.5 - 0.25
    vectors = drift(setup.machine, middle + 1e-3 * length * along[:, None] * tangent, np.tile(tangent, (100, 1)))
    x, y, z = vectors.mean(axis=0)
    return scale * float(cosine * y - sine * x), scale * float(z)


def _zeros(headings: Sequence[float], left: Array, judge: Callable[[float], float]) -> list[float]:
    """Headings (deg) at which the mean error in the plane changes side, between sampled ones and at them.

    `left` (um) belongs to `headings`, in order; `judge` answers for any other heading. Without any error there is none.
    """
    from scipy.optimize import brentq

    largest = float(np.abs(left).max())
    if largest * 1e-6 < TIE:
        return []
    known: dict[float, float] = dict(zip(headings, left.tolist(), strict=True))

    def value(heading: float) -> float:
        if heading not in known:
            known[heading] = judge(heading)
        return known[heading]

    near = [heading for heading in headings if abs(known[heading]) <= NEAR_ZERO * largest]
    brackets = [
        (one, other)
        for one, other in pairwise(headings)
        if not {one, other} & set(near) and other - one <= WIDEST_BRACKET and known[one] * known[other] < 0.0
    ]
    return sorted([*near, *(float(brentq(value, *bracket, xtol=ZERO_RESOLUTION)) for bracket in brackets)])


def _tables(stars: Sequence[Star]) -> list[Table]:
    columns = ["pivot_mm", "feed_mm_min", "heading_deg"]
    columns += ["left_mean_um", "left_std_um", "left_max_um", "left_law_um", "z_mean_um", "z_law_um"]
    rows: list[list[str | float | None]] = []
    for star in stars:
        for row, line in enumerate(star.lines):
            law = (None, None) if star.law is None else (float(star.law.left[row]), float(star.law.up[row]))
            error, up = line["contour_error_um"], line["contour_error_z_um"]
            rows.append(
                [place(star.pivot)[:-3], star.feed, line["heading_deg"]]
                + [error["mean"], error["std"], error["max_abs"], law[0], up["mean"], law[1]]
            )
    zeros: list[list[str | float | None]] = [
        [place(star.pivot)[:-3], star.feed, _listed(star.zeros), _listed(star.law_zeros)]
        for star in stars
        if star.zeros is not None
    ]
    return [
        Table("Contour error of every line over its middle half", columns, rows),
        Table("Headings without error in the plane", ["pivot_mm", "feed_mm_min", "zeros_deg", "law_zeros_deg"], zeros),
    ]


def _listed(headings: Sequence[float]) -> str:
    return ", ".join(f"{heading:.2f}" for heading in headings) or "none"


def _figures(setup: Setup, stars: Sequence[Star]) -> list[Figure]:
    first = [star for star in stars if star.feed == stars[0].feed]
    zero = setup.program_zero
    return [
        Figure(
            "star-plan",
            f"Star test, {setup.machine_name}: actual paths at {first[0].feed:g} mm/min",
            [plan_panel(star.traces, (zero[0], zero[1]), _pivot_name(star)) for star in first],
            "Top view of the programmed lines and the actual paths over their middle halves, the distance magnified as "
            "each title says.",
            columns=min(len(first), 2),
        ),
        _over_heading(setup, stars, "star-by-feed", "pivot", lambda star: star.pivot, _feed_name),
        _over_heading(setup, stars, "star-by-pivot", "feed", lambda star: star.feed, _pivot_name),
    ]


def _feed_name(star: Star) -> str:
    return f"{star.feed:g} mm/min"


def _pivot_name(star: Star) -> str:
    return f"pivot {place(star.pivot)}"


def _over_heading(
    setup: Setup,
    stars: Sequence[Star],
    name: str,
    each: str,
    key: Callable[[Star], Any],
    curve_name: Callable[[Star], str],
) -> Figure:
    """Error over heading, a row of two panels for every pivot (or feed), a curve for every feed (or pivot) in it."""
    panels = []
    for kind in dict.fromkeys(map(key, stars)):
        group = [star for star in stars if key(star) == kind]
        title = _pivot_name(group[0]) if each == "pivot" else _feed_name(group[0])
        for part, label in (("left", LEFT), ("up", UP)):
            curves = []
            for star in group:
                values = getattr(star.mean, part)
                curves.append(Curve(curve_name(star), star.headings, values, kind="line and points"))
                if star.law_curve is not None:
                    dense, law = star.law_curve
                    curves.append(Curve(LAW, dense, getattr(law, part), role="programmed"))
            panels.append(Panel(title, HEADING, label, curves))
    return Figure(
        name,
        f"Star test, {setup.machine_name}: mean contour error by {each}",
        panels,
        "Mean over the middle half of each line: in the plane on the left, in z on the right.",
        columns=2,
    )


def _data(stars: Sequence[Star], factor: float | None) -> dict[str, Any]:
    return {
        "kappa_s2": factor,
        "stars": [
            {
                "pivot_mm": star.pivot,
                "feed_mm_min": star.feed,
                "lines": star.lines,
                "law_um": None if star.law is None else {"left": star.law.left, "z": star.law.up},
                "zero_headings_deg": star.zeros,
                "law_zero_headings_deg": star.law_zeros,
            }
            for star in stars
        ],
    }


def _remarks(stars: Sequence[Star]) -> list[str]:
    remarks = [
        "left: + = the tool is left of travel, seen from +z; z: + = above. Mean, std and largest size over the cycles "
        "whose actual TCP projects onto the middle half of the line.",
        f"zeros: headings at which the simulated mean error in the plane is zero, at the first feed, found to "
        f"{ZERO_RESOLUTION} deg by running lines between two sampled headings whose errors are on opposite sides. "
        "The law's are beside them.",
        "Every line begins at rest (in position within 1 nm), unless the scales have a resolution.",
    ]
    if all(star.law is None for star in stars):
        remarks.append("The drives are not equal: the law for equal drives is left out.")
    if all(np.abs(star.mean.left).max() * 1e-6 < TIE for star in stars):
        remarks.append("No error in the plane reaches 1 nm: there is no heading to be told from the others.")
    return remarks


EXPERIMENT = Experiment(
    name="star",
    question="How far and to which side does the tool leave straight lines, by heading, feed and place, and which "
    "headings are free of it? (thesis figs 5-6, 6-14, 6-15, 6-17, 6-18, 6-20 to 6-22)",
    machine="tripod",
    options=Options,
    run=_run,
)
