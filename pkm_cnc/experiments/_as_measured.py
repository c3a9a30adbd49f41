"""Star and circle as they are measured: instrument at the TCP, several runs, slow ones for what is not dynamic.

Thesis 6.4.1.2. A line has four intervals: a while the setpoint speeds up and the lag builds up, b at its feed, c while
it brakes, d after its end; b is evaluated. What a slow run reads - straightedge, geometry, setting - is taken off what
the fast run reads at the same place. A repeat has noise of its own: its scales have the next seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.config import Setup
from pkm_cnc.contour import ball_bar, circle_program, heading_deg, is_full_circle, star_program, straightedge
from pkm_cnc.contour.instruments import Readings
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._machine import place
from pkm_cnc.experiments.experiment import Findings, Lab
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.program import Arc, Line
from pkm_cnc.report.figure import Array, Curve, Figure, Panel, Table

__all__ = ["circles_as_measured", "star_as_measured"]

LAGS = 5.0
"""Of 1/Kv, after which the lag of an acceleration is no longer seen: e^-5 of it."""
AT_FEED = 1e-3
"""1, by how much the speed of a setpoint may miss the feed in interval b."""
SECTOR = math.radians(15.0)
"""rad to either side of an axis, over which dR of that axis is averaged."""


@dataclass(frozen=True)
class _LineReadings:
    heading: float
    readings: Readings
    interval_b: tuple[float, float]
    """Where it begins and ends, m along the line, by the TCP."""


def star_as_measured(
    lab: Lab,
    headings: Sequence[float],
    feeds: Sequence[float],
    pivots: Sequence[tuple[float, float]],
    length: float,
    slow_feed: float,
    repeats: int,
) -> Findings:
    """The star test with probe and straightedge. Lengths in mm, feeds in mm/min, headings in deg."""
    rows: list[list[str | float | None]] = []
    panels, data = [], []
    jobs, done = len(pivots) * (len(feeds) + 1) * repeats, 0
    for pivot in pivots:
        slow: list[dict[float, _LineReadings]] = []
        for feed in (slow_feed, *feeds):
            found = []
            for repeat in range(repeats):
                lab.tell(done / jobs, f"pivot {place(pivot)}, {feed:g} mm/min, {repeat + 1} of {repeats}")
                done += 1
                text = star_program(feed, headings, pivot, length)
                trial = lab.run(_seeded(lab, repeat), text, f"star about {place(pivot)}")
                found.append({line.heading: line for line in _lines(trial)})
            if feed == slow_feed:
                slow = found
                continue
            means, stds = [], []
            for heading in headings:
                values = [_dynamic(one[heading], still[heading]) for one, still in zip(found, slow, strict=True)]
                means.append(float(np.mean(values)))
                stds.append(float(np.std(values, ddof=1)) if repeats > 1 else math.nan)
                rows.append([place(pivot)[:-3], feed, heading, means[-1], stds[-1]])
            data.append(
                {
                    "pivot_mm": pivot,
                    "feed_mm_min": feed,
                    "headings_deg": list(headings),
                    "left_mean_um": means,
                    "left_std_um": stds,
                }
            )
            title = f"pivot {place(pivot)}, {feed:g} mm/min"
            curve = Curve("mean", np.array(headings, float), np.array(means), kind="line and points")
            panels.append(
                Panel(title, "heading (deg, counter-clockwise from +x)", "in the plane (um, + = left)", [curve])
            )
    columns = ["pivot_mm", "feed_mm_min", "heading_deg", "left_mean_um", "left_std_um"]
    return Findings(
        [Table("Contour error as a probe on a straightedge reads it, interval b, slow run taken off", columns, rows)],
        [
            Figure(
                "star-as-measured",
                "Star test as measured: mean contour error over interval b",
                panels,
                f"Probe of +-1 mm, 0.1 um, 100 readings/s; {repeats} repeats; less a run at {slow_feed:g} mm/min.",
                columns=2,
            )
        ],
        {"as_measured": data, "slow_feed_mm_min": slow_feed, "repeats": repeats},
        [
            f"Interval b: setpoint at its feed, from {LAGS:g}/Kv after it reached it. A probe out of its range of "
            "+-1 mm reads nothing; a mean without readings is left empty.",
            "Mean and standard deviation (n - 1) are over the repeats, each with noise of its own.",
        ],
    )


def circles_as_measured(
    lab: Lab,
    centers: Sequence[tuple[float, float]],
    radii: Sequence[float],
    feeds: Sequence[float],
    overshoot: float,
    repeats: int,
) -> Findings:
    """The circular test with a ball bar. Lengths in mm, feeds in mm/min, overshoot in deg."""
    columns = ["center_mm", "radius_mm", "feed_mm_min", "direction"]
    figures = ("dR_mean_um", "dR_x_um", "dR_y_um", "circularity_um")
    for name in figures:
        columns += [name, name.replace("_um", "_std_um")]
    rows: list[list[str | float | None]] = []
    data: list[dict[str, Any]] = []
    wanted = [(center, radius, feed) for center in centers for radius in radii for feed in feeds]
    for number, (center, radius, feed) in enumerate(wanted):
        found: dict[str, list[dict[str, float]]] = {}
        for repeat in range(repeats):
            lab.tell(
                (number + repeat / repeats) / len(wanted), f"centre {place(center)}, R {radius:g} mm, {feed:g} mm/min"
            )
            setup = _seeded(lab, repeat)
            text = circle_program(
                feed_mm_min=feed,
                radius_mm=radius,
                center_mm=center,
                direction="both",
                overshoot_deg=overshoot,
                acceleration_mm_s2=setup.motion.acceleration * 1e3,
            )
            trial = lab.run(setup, text, f"circle about {place(center)}")
            for direction, readings in _circles(trial).items():
                found.setdefault(direction, []).append(_ball_bar_figures(readings))
        for direction, repeated in found.items():
            row: list[str | float | None] = [place(center)[:-3], radius, feed, direction]
            entry: dict[str, Any] = {"center_mm": center, "radius_mm": radius, "feed_mm_min": feed}
            entry["direction"] = direction
            for name in figures:
                values = [one[name] for one in repeated]
                mean, std = float(np.mean(values)), float(np.std(values, ddof=1)) if repeats > 1 else math.nan
                row += [mean, std]
                entry |= {name: mean, name.replace("_um", "_std_um"): std}
            rows.append(row)
            data.append(entry)
    return Findings(
        [Table("Circular test as a ball bar reads it", columns, rows)],
        [],
        {"as_measured": data, "repeats": repeats},
        [
            "dR = programmed less measured radius, about the programmed centre. dR_x is its mean within 15 deg of the "
            "directions +x and -x, dR_y of +y and -y: a platform that tilts shows in their difference (thesis 6.5.2).",
            "Ball bar of +-1 mm, 0.1 um, 100 readings a second; the circle is the data arc alone.",
        ],
    )


def _seeded(lab: Lab, repeat: int) -> Setup:
    setup = lab.setup()
    seeds = [f"{axis}.scale.seed={parts.scale.seed + repeat}" for axis, parts in setup.axes.items()]
    return lab.setup(seeds)


def _lines(trial: Trial) -> list[_LineReadings]:
    setup, evaluation = trial.setup, trial.evaluation
    found = []
    for index in evaluation.summaries:
        line = evaluation.elements[index]
        heading = heading_deg(line) if isinstance(line, Line) else None
        if not isinstance(line, Line) or heading is None:
            continue
        rows = trial.cycles_of(index)
        readings = straightedge(line, evaluation.true[rows], setup.servo_period)
        speed = np.sqrt((trial.tcp_setpoint[rows, 1] ** 2).sum(axis=1))
        at_feed = np.flatnonzero(np.abs(speed - line.feed) <= AT_FEED * line.feed)
        lag = LAGS / min(parts.drive.kv for parts in setup.axes.values())
        at_feed = at_feed[int(lag / setup.servo_period) :]
        if len(at_feed) < 2:
            raise InputError(
                f"star --as-measured: the line of {heading:g} deg is too short for its feed of {line.feed * 60e3:g} "
                f"mm/min: nothing of it is left {lag:g} s after the feed is reached"
            )
        along = (evaluation.true[rows[at_feed[[0, -1]]]] - np.array(line.start)) @ np.array(line.tangent(0.0))
        found.append(_LineReadings(heading, readings, (float(along[0]), float(along[1]))))
    return found


def _dynamic(fast: _LineReadings, slow: _LineReadings) -> float:
    """Mean over interval b of the fast run's readings less the slow run's at the same places, um."""
    begin, end = fast.interval_b
    inside = (fast.readings.place >= begin) & (fast.readings.place <= end)
    still = np.interp(fast.readings.place[inside], slow.readings.place, slow.readings.value)
    return 1e6 * float(np.mean(fast.readings.value[inside] - still))


def _circles(trial: Trial) -> dict[str, Readings]:
    found = {}
    for index in trial.evaluation.summaries:
        arc = trial.evaluation.elements[index]
        if isinstance(arc, Arc) and is_full_circle(arc):
            rows = trial.cycles_of(index)
            found["ccw" if arc.sweep > 0.0 else "cw"] = ball_bar(
                arc, trial.evaluation.true[rows], trial.setup.servo_period
            )
    return found


def _ball_bar_figures(readings: Readings) -> dict[str, float]:
    deviation = -1e6 * readings.value

    def about(*axes: float) -> float:
        near = [np.abs((readings.place - axis + math.pi) % math.tau - math.pi) <= SECTOR for axis in axes]
        return float(np.mean([_mean(deviation[one]) for one in near]))

    return {
        "dR_mean_um": _mean(deviation),
        "dR_x_um": about(0.0, math.pi),
        "dR_y_um": about(0.5 * math.pi, 1.5 * math.pi),
        "circularity_um": float(np.ptp(deviation)),
    }


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else math.nan
