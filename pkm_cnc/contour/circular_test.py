"""Circular test: one full circle at constant feed in each direction, evaluated as in ISO 230-4 (and thesis 6.5.2).

Every figure is about equal weight per actual angle, not per cycle: the deviations are resampled to equal steps of the
actual angle by linear interpolation. Largest and smallest values are those of the cycles themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.contour.program_text import coordinate, number, require_finite, require_positive, rounded
from pkm_cnc.contour.summary import SegmentSummary, contour_error_report
from pkm_cnc.errors import InputError
from pkm_cnc.program import NOT_EVALUATED_COMMENT, Arc, Plane
from pkm_cnc.tolerances import ARC_RADII, TIE

__all__ = [
    "CirclePath",
    "arc_report",
    "circle_pair_report",
    "circle_pairs",
    "circle_path",
    "circle_program",
    "circle_report",
    "extrema",
    "is_full_circle",
    "least_squares_circle",
]

Array = NDArray[np.float64]

_FEED_IN = 10.0  # mm, shortest feed-in and feed-out line
_STEPS = 7200  # per turn, of the resampled deviation
_WIDEST_GAP = math.radians(5.0)  # between neighbouring actual angles; wider, and the circle is incomplete
_HARMONICS = 12  # of the deviation, in which its maxima are looked for: detail finer than 15 deg is ripple
_PROMINENCE = 0.05  # of the fitted deviation's range, by which a maximum must stand out to be one
_DIRECTIONS = {"ccw": ("ccw",), "cw": ("cw",), "both": ("ccw", "cw")}


def circle_program(
    *,
    feed_mm_min: float,
    radius_mm: float,
    center_mm: Sequence[float],
    direction: str,
    overshoot_deg: float,
    acceleration_mm_s2: float,
) -> str:
    """The circular test as a part program (mm) at the z where the tool stands.

    Per direction ("ccw", "cw", or "both" in this order): tangential feed-in line, overshoot arc, full circle from the
    angle 0 (the data arc), overshoot arc, tangential feed-out line; all but the data arc are marked as not evaluated.
    The lines are 10 mm or twice what reaching the feed takes at `acceleration_mm_s2`, whichever is longer.

    Raises InputError for a feed, radius or acceleration not above 0, a center that is not finite, an overshoot that is
    no arc, another direction.
    """
    require_positive(feed_mm_min=feed_mm_min, radius_mm=radius_mm, acceleration_mm_s2=acceleration_mm_s2)
    require_finite(center_mm=center_mm)
    if direction not in _DIRECTIONS:
        raise InputError(f"direction: {direction!r} is not one of {', '.join(_DIRECTIONS)}")
    if not 0.0 < overshoot_deg < 360.0:
        raise InputError(f"overshoot_deg: {overshoot_deg} is not between 0 and 360 deg")
    if 2.0 * radius_mm * math.sin(math.radians(overshoot_deg) / 2.0) < 1e-3:
        raise InputError(f"overshoot_deg: {overshoot_deg} makes arcs whose ends are closer than 0.001 mm")
    feed_mm_s = feed_mm_min / 60.0
    run_up = max(_FEED_IN, feed_mm_s * feed_mm_s / acceleration_mm_s2)
    x, y = center_mm
    blocks = [
        f"(circular test: radius {number(radius_mm)} mm about X{number(x)} Y{number(y)} mm"
        f" at {number(feed_mm_min)} mm/min, overshoot {number(overshoot_deg)} deg)",
        "G21 G90 G17",
    ]
    for each in _DIRECTIONS[direction]:
        blocks += _circle_blocks(feed_mm_min, radius_mm, (x, y), each, math.radians(overshoot_deg), run_up)
    return "\n".join([*blocks, "M2", ""])


def _circle_blocks(
    feed: float, radius: float, center: tuple[float, float], direction: str, overshoot: float, run_up: float
) -> list[str]:
    sense, code = (1.0, "G3") if direction == "ccw" else (-1.0, "G2")

    def point(angle: float, along: float = 0.0) -> tuple[float, float]:
        """On the circle at `angle` travelled from the data arc's start, then `along` the tangent (mm)."""
        x, y = math.cos(angle), sense * math.sin(angle)
        return center[0] + radius * x - sense * along * y, center[1] + radius * y + sense * along * x

    def words(end: tuple[float, float]) -> str:
        return f"X{coordinate(end[0])} Y{coordinate(end[1])}"

    def arc(start: tuple[float, float], end: tuple[float, float]) -> str:
        return f"{code} {words(end)} I{coordinate(center[0] - start[0])} J{coordinate(center[1] - start[1])}"

    entry, zero, leave = point(-overshoot), point(0.0), point(overshoot)
    return [
        f"({'counter-clockwise' if sense > 0.0 else 'clockwise'})",
        f"G0 {words(point(-overshoot, -run_up))}",
        f"G1 {words(entry)} F{number(feed)} {NOT_EVALUATED_COMMENT}",
        f"{arc(entry, zero)} {NOT_EVALUATED_COMMENT}",
        arc(zero, zero),
        f"{arc(zero, leave)} {NOT_EVALUATED_COMMENT}",
        f"G1 {words(point(overshoot, run_up))} {NOT_EVALUATED_COMMENT}",
    ]


def is_full_circle(arc: Arc) -> bool:
    """Whether the arc is one full turn in the x-y plane, and so the data arc of a circular test."""
    return abs(arc.sweep) == math.tau and arc.plane == Plane.XY and arc.start == arc.end


@dataclass(frozen=True)
class CirclePath:
    """The actual path over one data arc, complete all around.

    `angle` (rad in [0, 2 pi), shape (N,)) is the actual angle about the programmed centre and `deviation` (m, (N,)) the
    radial deviation dR = programmed - actual radius (+ = the circle came out too small; -dR is ISO 230-4's F), both in
    the order of the cycles. `by_angle` (m, (7200,)) is dR at equal steps of the actual angle from 0.
    """

    arc: Arc
    angle: Array
    deviation: Array
    by_angle: Array


def circle_path(arc: Arc, points: Array) -> CirclePath:
    """The actual path over a data arc from the true TCP points (m, base_link, (N, 2) or (N, 3); z is not looked at).

    Raises InputError if `arc` is no full circle, or the points leave a gap of more than 5 deg: not all of it was run.
    """
    if not is_full_circle(arc):
        raise InputError(f"line {arc.line}: an arc of {math.degrees(arc.sweep):g} deg is no full circle")
    points = np.asarray(points, dtype=float)
    x, y = points[:, 0] - arc.center[0], points[:, 1] - arc.center[1]
    angle = np.arctan2(y, x) % math.tau
    ordered = np.sort(angle)
    gaps = np.diff(ordered, append=ordered[:1] + math.tau)
    widest = float(gaps.max()) if len(gaps) else math.tau
    if not widest <= _WIDEST_GAP:
        raise InputError(
            f"line {arc.line}: the circle is incomplete, {math.degrees(widest):.1f} deg of it without a point"
        )
    deviation: Array = arc.radius - np.hypot(x, y)
    by_angle = np.asarray(np.interp(_grid(), angle, deviation, period=math.tau), dtype=np.float64)
    return CirclePath(arc, angle, deviation, by_angle)


def _grid() -> Array:
    return np.asarray(np.linspace(0.0, math.tau, _STEPS, endpoint=False), dtype=np.float64)


def extrema(path: CirclePath) -> list[float]:
    """Actual angles (rad in [0, 2 pi)) of the local maxima of dR, the largest dR first.

    They are zeros of the derivative of the first twelve harmonics of dR by angle: found between the samples, and hardly
    moved by quantisation or noise. A maximum that does not stand out of its surroundings by 5 % of the range is ripple.
    A deviation that is constant to 1 nm has no maximum.
    """
    orders = np.arange(_HARMONICS + 1)
    harmonics = np.fft.rfft(path.by_angle)[: _HARMONICS + 1]
    fitted = np.fft.irfft(harmonics, _STEPS)
    slope = np.fft.irfft(1j * orders * harmonics, _STEPS)
    extent = float(np.ptp(fitted))
    if extent < TIE:
        return []
    after = np.roll(slope, -1)
    tops = np.flatnonzero((slope > 0.0) & (after <= 0.0))
    found = [top for top in tops.tolist() if _prominence(fitted, top) >= _PROMINENCE * extent]
    found.sort(key=lambda top: -fitted[top])
    return [float((top + slope[top] / (slope[top] - after[top])) * (math.tau / _STEPS)) % math.tau for top in found]


def _prominence(values: Array, top: int) -> float:
    """Height of values[top] (closed curve) over the higher of the two lowest points on the ways to anything higher."""
    around = np.roll(values, -top)
    top_index = int(np.argmax(around[:2]))  # the grid has the top before or behind the zero of the slope
    around = np.roll(around, -top_index)
    height = around[0]
    higher = np.flatnonzero(around > height)
    if not len(higher):
        return float(height - around.min())
    return float(height - max(around[: higher[0]].min(), around[higher[-1] :].min()))


def least_squares_circle(points: Array) -> tuple[float, float, float]:
    """Centre x, y and radius (m) of the circle with the least sum of squared radial distances to `points` (m, (N, 2)).

    Gauss-Newton from their centroid; for a path that is a circle but for deviations far below its radius.
    """
    x, y = float(points[:, 0].mean()), float(points[:, 1].mean())
    radius = 0.0
    for _ in range(10):
        dx, dy = points[:, 0] - x, points[:, 1] - y
        distance = np.hypot(dx, dy)
        system = np.stack([dx / distance, dy / distance, np.ones_like(distance)], axis=1)
        step = np.linalg.lstsq(system, distance, rcond=None)[0]
        x, y, radius = x + float(step[0]), y + float(step[1]), float(step[2])
        if math.hypot(step[0], step[1]) < 1e-6 * TIE:
            break
    return x, y, radius


def _cartesian(angle: Array, radius: Array) -> Array:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _zone(paths: Sequence[CirclePath]) -> tuple[float, float]:
    """Width (m) of the zone between two circles about the least squares centre of the paths, and its radius."""
    fit = [_cartesian(_grid(), path.arc.radius - path.by_angle) for path in paths]
    x, y, radius = least_squares_circle(np.concatenate(fit))
    cycles = np.concatenate([_cartesian(path.angle, path.arc.radius - path.deviation) for path in paths])
    distances = np.hypot(cycles[:, 0] - x, cycles[:, 1] - y)
    return float(np.ptp(distances)), radius


def circle_report(path: CirclePath) -> dict[str, object]:
    """JSON entry of a data arc.

    `radial_deviation_um` is dR, its mean with equal weight per actual angle; `circularity_um` the largest less the
    smallest actual radius about the programmed centre (thesis 6.5.2); `extrema_deg` as `extrema`. ISO 230-4: `G_um`,
    the circular deviation, is the width of the zone that holds the path, about its least squares circle's centre;
    `F_max_um` and `F_min_um` the largest and smallest radial deviation, actual - programmed radius about the
    programmed centre.
    """
    arc, deviation = path.arc, path.deviation * 1e6
    smallest, largest = float(deviation.min()), float(deviation.max())
    width, _ = _zone([path])
    return {
        "kind": "circle",
        "direction": _direction(arc),
        "radius_mm": rounded(arc.radius * 1e3),
        "center_mm": [rounded(arc.center[0] * 1e3), rounded(arc.center[1] * 1e3)],
        "feed_mm_min": rounded(arc.feed * 60e3),
        "radial_deviation_um": {"mean": float(path.by_angle.mean()) * 1e6, "min": smallest, "max": largest},
        "circularity_um": largest - smallest,
        "extrema_deg": [math.degrees(angle) for angle in extrema(path)],
        "iso230_4": {"G_um": width * 1e6, "F_max_um": -smallest, "F_min_um": -largest},
    }


def circle_pair_report(first: CirclePath, second: CirclePath) -> dict[str, object]:
    """JSON entry of the same circle run in both directions, ISO 230-4.

    `Gb_um`, the bi-directional circular deviation, is the width of the zone that holds both paths, about the centre of
    the least squares circle of both; `D_um`, the mean bi-directional radial deviation, that circle's radius less the
    programmed one (+ = larger, as F).
    """
    width, radius = _zone([first, second])
    return {"kind": "circle_pair", "iso230_4": {"Gb_um": width * 1e6, "D_um": (radius - first.arc.radius) * 1e6}}


def circle_pairs(paths: Sequence[CirclePath]) -> list[tuple[CirclePath, CirclePath]]:
    """Each counter-clockwise path with the next unpaired clockwise one of the same circle at the same feed."""
    clockwise = [path for path in paths if path.arc.sweep < 0.0]
    pairs = []
    for path in paths:
        partners = [i for i, other in enumerate(clockwise) if path.arc.sweep > 0.0 and _same(path.arc, other.arc)]
        if partners:
            pairs.append((path, clockwise.pop(partners[0])))
    return pairs


def _same(one: Arc, other: Arc) -> bool:
    return (
        math.dist(one.center, other.center) < ARC_RADII
        and abs(one.radius - other.radius) < ARC_RADII
        and one.feed == other.feed
    )


def arc_report(arc: Arc, summary: SegmentSummary) -> dict[str, object]:
    """JSON entry of an evaluated arc that is no full circle: keys carry their units, None = not available.

    One in another plane than x-y has its "plane" and all three coordinates of its center.
    """
    coordinates = 2 if arc.plane == Plane.XY else 3
    return {
        "kind": "arc",
        "line": arc.line,
        "direction": _direction(arc),
        "radius_mm": rounded(arc.radius * 1e3),
        "center_mm": [rounded(value * 1e3) for value in arc.center[:coordinates]],
        **({} if arc.plane == Plane.XY else {"plane": arc.plane.name.lower()}),
        "feed_mm_min": rounded(arc.feed * 60e3),
        "length_mm": rounded(arc.length * 1e3),
        **contour_error_report(summary),
    }


def _direction(arc: Arc) -> str:
    return "ccw" if arc.sweep > 0.0 else "cw"
