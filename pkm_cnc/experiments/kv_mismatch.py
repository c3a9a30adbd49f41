"""Unequal velocity gains on a serial machine beside equal ones on a parallel machine (thesis 2.2.2, 6.6, fig. 2-12)."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.config import Setup
from pkm_cnc.contour import CirclePath, circle_program, star_program
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._circles import by_direction, harmonics, polar_panel
from pkm_cnc.experiments._machine import resting
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Array, Curve, Figure, Panel, Table
from pkm_cnc.tolerances import TIE

__all__ = ["EXPERIMENT"]

HEADING = "heading (deg, counter-clockwise from +x)"
LEFT = "mean contour error (um, + = left of travel)"


@dataclass(frozen=True)
class Options:
    """What is run on the serial machine (--machine) and on the parallel one beside it."""

    kv: float = parameter(20.0, "velocity gain of the drives but for y of the serial machine", unit="1/s", above=0.0)
    mismatch: float = parameter(
        18.0, "by how much the gain of y is lower on the serial machine", unit="%", minimum=-100.0, maximum=99.0
    )
    parallel: str = parameter("tripod", "parallel machine beside it, all its drives with the same gain")
    headings: tuple[float, ...] = parameter(
        tuple(float(heading) for heading in range(0, 360, 30)),
        "headings of the lines, with their reverses: first:last:step or a comma list",
        unit="deg",
        minimum=0.0,
        maximum=359.0,
        any_length=True,
    )
    feed: float = parameter(
        4500.0, "lower feed of the lines; they are run at twice this, too", unit="mm/min", above=0.0
    )
    length: float = parameter(200.0, "length of each line", unit="mm", above=0.0)
    radius: float = parameter(100.0, "radius of the circles", unit="mm", above=0.0)
    circle_feed: float = parameter(3000.0, "feed of the circles", unit="mm/min", above=0.0)
    periods: tuple[float, ...] = parameter(
        (4.0, 2.0, 1.0),
        "servo periods at which 2-12 is looked at, ideal velocity loop",
        unit="ms",
        above=0.0,
        any_length=True,
    )


@dataclass(frozen=True)
class Lines:
    """Mean signed error in the plane (um) of lines of one machine by heading (deg), at the feed and at twice it."""

    machine: str
    headings: Array
    slow: Array
    fast: Array

    def fitted(self) -> float | None:
        """How much of the fast lines' errors a multiple of sin 2 theta, the form of 6-21, explains: 1 all, 0 nothing.

        None for headings at which that form is zero throughout, and for lines without error.
        """
        form = np.sin(2.0 * np.radians(self.headings))
        if not ((form * form).sum() > 1e-9 and np.abs(self.fast).max() * 1e-6 > TIE):
            return None
        amplitude = float((form * self.fast).sum() / (form * form).sum())
        left_over = ((self.fast - amplitude * form) ** 2).sum() / (self.fast**2).sum()
        return round(1.0 - float(left_over), 12) + 0.0

    def on_reversal(self) -> float | None:
        """Error at heading + 180 deg over that at the heading, median over the larger ones; None without reverses.

        +1: left of travel stays left of travel, which is the other side in space. -1: the same side in space.
        """
        by_heading = dict(zip(self.headings.tolist(), self.fast.tolist(), strict=True))
        return _median_ratio([(by_heading[h + 180.0], e) for h, e in by_heading.items() if h + 180.0 in by_heading])

    def on_doubled_feed(self) -> float | None:
        """Error at twice the feed over that at the feed, median over the larger ones."""
        return _median_ratio(list(zip(self.fast.tolist(), self.slow.tolist(), strict=True)))


def _median_ratio(pairs: Sequence[tuple[float, float]]) -> float | None:
    largest = max((abs(below) for _, below in pairs), default=0.0)
    ratios = [above / below for above, below in pairs if abs(below) > 0.2 * largest]
    return float(np.median(ratios)) if ratios else None


@dataclass(frozen=True)
class Ellipse:
    """The second harmonic of dR of a circle on the serial machine, simulated and expected, by direction."""

    paths: dict[str, CirclePath]
    amplitude: dict[str, float]
    phase: dict[str, float]
    """deg: dR is largest at half this angle, and there the circle is too small."""
    expected: float


def _run(lab: Lab, options: Options) -> Findings:
    equal = [f"drive.kv={options.kv}"]
    lower = options.kv * (1.0 - options.mismatch / 100.0)
    given = lab.setup()  # before the overrides, which another machine would not know
    if not {"x", "y"} <= set(given.axes):
        raise InputError(
            f"experiment kv-mismatch: it needs a serial machine with axes x and y; "
            f"{given.machine_name} has {', '.join(given.axes)}"
        )
    serial = lab.setup([*equal, f"y.drive.kv={lower}", *resting(given)])
    _ideal(lab, options)  # what it refuses is refused before minutes of runs
    parallel = lab.setup([*equal, *resting(lab.setup())], machine=options.parallel)
    lab.tell(0.0, f"lines on {serial.machine_name}")
    mismatched = _lines(lab, serial, options)
    lab.tell(0.4, f"lines on {parallel.machine_name}")
    nonlinear = _lines(lab, parallel, options)
    lab.tell(0.8, "circles")
    ellipse = _ellipse(lab, serial, options, lower)
    lab.tell(0.9, "radial error over the servo period")
    radial = _radial(lab, options)
    expected = _expected(options, lower, mismatched.headings)
    return Findings(
        _tables(options, mismatched, nonlinear, expected, ellipse, radial),
        _figures(mismatched, nonlinear, expected, ellipse, radial),
        _data(options, mismatched, nonlinear, expected, ellipse, radial),
        _remarks(options, lower, mismatched, nonlinear),
    )


def _lines(lab: Lab, setup: Setup, options: Options) -> Lines:
    headings = sorted(set(options.headings))

    def errors(feed: float) -> Array:
        text = star_program(feed, headings, (0.0, 0.0), options.length)
        evaluation = lab.run(setup, text, f"lines at {feed:g} mm/min").evaluation
        return np.array([1e6 * summary.left_mean for summary in evaluation.summaries.values()])

    return Lines(setup.machine_name, np.array(headings), errors(options.feed), errors(2.0 * options.feed))


def _expected(options: Options, lower: float, headings: Array) -> Array:
    """6-21 in the sign used here (um, + = left), at twice the feed: v sin(2 theta) / 2 (1 / Kvx - 1 / Kvy)."""
    speed = 2.0 * options.feed / 60e3
    return np.asarray(1e6 * speed * np.sin(2.0 * np.radians(headings)) / 2.0 * (1.0 / options.kv - 1.0 / lower))


def _circles(lab: Lab, setup: Setup, options: Options, direction: str) -> dict[str, CirclePath]:
    text = circle_program(
        feed_mm_min=options.circle_feed,
        radius_mm=options.radius,
        center_mm=(0.0, 0.0),
        direction=direction,
        overshoot_deg=60.0,
        acceleration_mm_s2=setup.motion.acceleration * 1e3,
    )
    found = by_direction(lab.run(setup, text, "circle"))
    if not found:
        raise InputError("kv-mismatch: the circles are too short: the servo period steps over them")
    return {direction: path for direction, (_, path) in found.items()}


def _ellipse(lab: Lab, setup: Setup, options: Options, lower: float) -> Ellipse:
    """Lags 1 / Kv that differ by d put dR = v d / 2 sin(2 angle) on a circle, for clockwise travel with a minus."""
    paths = _circles(lab, setup, options, "both")
    spectra = {direction: harmonics(path) for direction, path in paths.items()}
    return Ellipse(
        paths,
        {direction: float(spectrum["amplitude_um"][2]) for direction, spectrum in spectra.items()},
        {direction: float(spectrum["phase_deg"][2]) for direction, spectrum in spectra.items()},
        1e6 * options.circle_feed / 60e3 * abs(1.0 / lower - 1.0 / options.kv) / 2.0,
    )


def _ideal(lab: Lab, options: Options) -> dict[float, Setup]:
    """The machine with equal gains and an ideal velocity loop by servo period, ms, the longest first."""
    same = [f"drive.kv={options.kv}", "drive.kind=first_order"]
    return {
        period: lab.setup([*same, f"servo_period={period / 1e3!r}"])
        for period in sorted(set(options.periods), reverse=True)
    }


def _radial(lab: Lab, options: Options) -> list[dict[str, float]]:
    """Mean dR of a circle with equal gains and an ideal velocity loop over the servo period, beside closed forms."""
    speed, radius = options.circle_feed / 60e3, options.radius / 1e3
    rows = []
    for period, setup in _ideal(lab, options).items():
        path = _circles(lab, setup, options, "ccw")["ccw"]
        gain = options.kv * period / 1e3
        response = abs(gain / (cmath.exp(1j * speed / radius * period / 1e3) - 1.0 + gain))
        rows.append(
            {
                "servo_period_ms": period,
                "simulated_um": 1e6 * float(path.by_angle.mean()),
                "kappa_v2_over_R_um": 1e6 * (1.0 - gain) / (2.0 * options.kv**2) * speed**2 / radius,
                "sampled_response_um": 1e6 * radius * (1.0 - response),
            }
        )
    return rows


def _limit(options: Options) -> float:
    """2-12: radial error of the continuous loop, um."""
    return 1e6 * (options.circle_feed / 60e3 / options.kv) ** 2 / (2.0 * options.radius / 1e3)


def _extrapolated(radial: Sequence[dict[str, float]]) -> float | None:
    """The simulated radial error, um, at servo period 0, on the straight line through the two shortest periods."""
    if len(radial) < 2:
        return None
    one, other = radial[-2:]
    slope = (one["simulated_um"] - other["simulated_um"]) / (one["servo_period_ms"] - other["servo_period_ms"])
    return other["simulated_um"] - slope * other["servo_period_ms"]


def _tables(
    options: Options,
    mismatched: Lines,
    nonlinear: Lines,
    expected: Array,
    ellipse: Ellipse,
    radial: Sequence[dict[str, float]],
) -> list[Table]:
    lines: list[list[str | float | None]] = [
        [float(value) for value in row]
        for row in zip(
            mismatched.headings,
            expected / 2.0,
            mismatched.slow,
            expected,
            mismatched.fast,
            nonlinear.slow,
            nonlinear.fast,
            strict=True,
        )
    ]
    slow, fast = f"{options.feed:g}", f"{2.0 * options.feed:g}"
    columns = ["heading_deg", f"6-21_{slow}_um", f"{mismatched.machine}_{slow}_um", f"6-21_{fast}_um"]
    columns += [f"{mismatched.machine}_{fast}_um", f"{nonlinear.machine}_{slow}_um", f"{nonlinear.machine}_{fast}_um"]
    compared: list[list[str | float | None]] = [
        ["error at twice the feed / at the feed", 2.0, mismatched.on_doubled_feed(), nonlinear.on_doubled_feed()],
        ["left of travel reversed / forward", 1.0, mismatched.on_reversal(), nonlinear.on_reversal()],
        ["share explained by sin(2 heading)", 1.0, mismatched.fitted(), nonlinear.fitted()],
    ]
    ovals: list[list[str | float | None]] = [
        [direction, ellipse.expected, ellipse.amplitude[direction], ellipse.phase[direction] / 2.0 % 180.0]
        for direction in ellipse.paths
    ]
    periods: list[list[str | float | None]] = [[*row.values(), _limit(options)] for row in radial]
    periods.append([0.0, _extrapolated(radial), _limit(options), None, _limit(options)])
    return [
        Table("Mean contour error in the plane, um by feed in mm/min (+ = left of travel)", columns, lines),
        Table(
            "What tells unequal gains from a nonlinear machine",
            ["", "6-21", f"{mismatched.machine}, unequal gains", f"{nonlinear.machine}, equal gains"],
            compared,
        ),
        Table(
            f"Circle on {mismatched.machine} with unequal gains: the ellipse",
            ["direction", "expected_um", "second_harmonic_um", "largest_dR_at_deg"],
            ovals,
        ),
        Table(
            f"Radial error with equal gains, R {options.radius:g} mm, {options.circle_feed:g} mm/min (2-12)",
            [*radial[0], "2-12_um"],
            periods,
        ),
    ]


def _figures(
    mismatched: Lines, nonlinear: Lines, expected: Array, ellipse: Ellipse, radial: Sequence[dict[str, float]]
) -> list[Figure]:
    panels = []
    for lines, name in ((mismatched, "unequal gains"), (nonlinear, "equal gains")):
        curves = [
            Curve("feed", lines.headings, lines.slow, kind="line and points"),
            Curve("twice the feed", lines.headings, lines.fast, kind="line and points"),
        ]
        if lines is mismatched:
            curves.append(Curve("6-21 at twice the feed", lines.headings, expected, role="programmed"))
        panels.append(Panel(f"{lines.machine}, {name}", HEADING, LEFT, curves))
    periods = np.array([row["servo_period_ms"] for row in radial])
    return [
        Figure(
            "kv-mismatch-lines",
            "Unequal gains on a serial machine, equal gains on a parallel one",
            panels,
            "Unequal gains: linear in the feed, and left of travel stays left when the direction is reversed, so that "
            "the side in space changes. The parallel machine with equal gains has a law of its own.",
            share_x=True,
        ),
        Figure(
            "kv-mismatch-circle",
            f"Circle on {mismatched.machine} with unequal gains",
            [polar_panel(ellipse.paths, "both directions")],
            "The circle becomes an ellipse at 45 deg, which the direction of travel turns by 90 deg.",
        ),
        Figure(
            "kv-mismatch-radius",
            "Radial error of a circle with equal gains over the servo period (2-12 is the value at 0)",
            [
                Panel(
                    f"{mismatched.machine}, ideal velocity loop",
                    "servo period (ms)",
                    "dR (um, + = too small)",
                    [
                        Curve("simulated", periods, np.array([row["simulated_um"] for row in radial]), kind="points"),
                        Curve(
                            "(1 - Kv T) v^2 / (2 R Kv^2)",
                            periods,
                            np.array([row["kappa_v2_over_R_um"] for row in radial]),
                            role="programmed",
                        ),
                    ],
                )
            ],
        ),
    ]


def _data(
    options: Options,
    mismatched: Lines,
    nonlinear: Lines,
    expected: Array,
    ellipse: Ellipse,
    radial: Sequence[dict[str, float]],
) -> dict[str, Any]:
    return {
        "headings_deg": mismatched.headings,
        "expected_um": expected,
        **{
            key: {
                "machine": lines.machine,
                "at_feed_um": lines.slow,
                "at_twice_the_feed_um": lines.fast,
                "ratio_on_doubled_feed": lines.on_doubled_feed(),
                "ratio_on_reversal": lines.on_reversal(),
                "explained_by_sin_2_heading": lines.fitted(),
            }
            for key, lines in (("unequal_gains", mismatched), ("equal_gains", nonlinear))
        },
        "ellipse": {
            "expected_um": ellipse.expected,
            "second_harmonic_um": ellipse.amplitude,
            "largest_dR_at_deg": {direction: phase / 2.0 % 180.0 for direction, phase in ellipse.phase.items()},
        },
        "radial_error": {"by_period": radial, "extrapolated_um": _extrapolated(radial), "eq_2_12_um": _limit(options)},
    }


def _remarks(options: Options, lower: float, mismatched: Lines, nonlinear: Lines) -> list[str]:
    remarks = [
        f"Gains on {mismatched.machine}: Kv {options.kv:g} 1/s, of y {lower:g} 1/s ({options.mismatch:g} % off). "
        f"On {nonlinear.machine}: {options.kv:g} 1/s in every drive.",
        "6-21 in the sign used here: left = v sin(2 heading) / 2 (1 / Kvx - 1 / Kvy). It is linear in v, and left of "
        "travel stays left when the direction is reversed, so in space the side changes.",
        "2-12 is the limit of v small against R Kv; the exact response of the sampled loop is beside it.",
    ]
    doubled, reversal = nonlinear.on_doubled_feed(), nonlinear.on_reversal()
    if doubled is not None and reversal is not None and doubled > 3.5 and reversal < -0.9:
        remarks.append(
            f"The errors of {nonlinear.machine} go with the square of v and stay on the same side in space: they come "
            "from the curvature of the inverse kinematics along the line, e = kappa v^2 J^-1 d2u/ds2. That 6-21 "
            "explains them, as thesis 6.6 says, is contradicted: equal gains in the drives do not become unequal gains "
            "in x and y."
        )
    return remarks


EXPERIMENT = Experiment(
    name="kv-mismatch",
    question="What do unequal velocity gains do to lines and circles on a serial machine, and why do they not explain "
    "the star test of the Tripod? (thesis 2-12, fig. 2-12, 6-17 to 6-21)",
    machine="cartesian",
    options=Options,
    run=_run,
)
