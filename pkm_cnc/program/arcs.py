"""What the words of an arc (G2, G3) mean: center, direction, turns, and the arcs that really join start and end.

Words are rounded, so the radii at an arc's start and end never quite agree. Up to tolerances, those of
LinuxCNC's interpreter (`arc_data_ijk`, `arc_data_r`), they count as agreeing. What is run is put through start and end
exactly, and is always made of true circles or helices: one, with its center moved onto the perpendicular bisector of
start and end as near to the programmed one as that allows, or, where that would take it further than ARC_RADII off the
programmed circle (more than half a turn between ends close together), several of at most half a turn each, between
points whose radius goes evenly from the one to the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from pkm_cnc.program.toolpath import Arc, PathMode, Plane
from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ARC_RADII, ARC_RADII_RATIO, ARC_RADII_RELATIVE, ARC_RADIUS, ZERO_LENGTH

__all__ = ["LARGEST_TURNS", "ArcError", "ArcFeed", "ArcWords", "arc_about_center", "arc_of_radius"]

LARGEST_TURNS = 1000
"""Largest P of an arc: far more than the threads of any hole, and it bounds the time to check one block."""

_FULL_TURN = 1e-14
"""m^2. Where the cross product of the spokes to start and end is below this, the end lies behind the start: a turn."""


class ArcError(Exception):
    """The words of an arc describe none; the text says why."""


@dataclass(frozen=True, slots=True)
class ArcFeed:
    """An arc as programmed, and the elements it is run as: `arcs` join `start` and `end` exactly.

    `center` (m, in `base_link`, with the coordinate of `start` along the plane's normal) is as the program gives it;
    `turns` is the number of full and begun turns, + counter-clockwise seen from the tip of the plane's normal.
    """

    line: int
    start: Vector
    end: Vector
    center: Vector
    turns: int
    plane: Plane
    feed: float
    arcs: tuple[Arc, ...]

    @property
    def length(self) -> float:
        """Path length, m."""
        return sum(arc.length for arc in self.arcs)


@dataclass(frozen=True)
class ArcWords:
    """What an arc has besides its geometry: `direction` +1 counter-clockwise or -1, `turns` >= 1, the elements' own."""

    line: int
    plane: Plane
    direction: float
    turns: int
    feed: float
    evaluated: bool
    path_mode: PathMode


def arc_about_center(words: ArcWords, start: Vector, end: Vector, i: float, j: float, radii: float) -> ArcFeed:
    """The arc from `start` to `end` (m) about the center that lies `i`, `j` (m, along the plane's axes) off `start`.

    `radii` is the absolute tolerance of the radii, ARC_RADII_MM or ARC_RADII_INCH.
    Raises ArcError for a radius of zero, and for radii at start and end that disagree.
    """
    sa, sb, height = words.plane.coordinates(start)
    end = _level(start, end, words.plane)
    ea, eb, end_height = words.plane.coordinates(end)
    dx, dy = ea - sa, eb - sb
    at_start, at_end = math.sqrt(i * i + j * j), math.sqrt((i - dx) * (i - dx) + (j - dy) * (j - dy))
    _check_radii(at_start, at_end, radii)
    center = words.plane.vector(sa + i, sb + j, height)
    chord = math.sqrt(dx * dx + dy * dy)
    if chord < ZERO_LENGTH:
        end = words.plane.vector(sa, sb, end_height)
        return _feed(words, start, end, center, (_arc(words, start, end, center, math.tau * words.turns),))
    angle = _angle(words.direction, (-i, -j), (dx - i, dy - j))
    shift = abs((dx * i + dy * j) / chord - 0.5 * chord)
    if shift <= ARC_RADII or (angle <= math.pi and words.turns == 1):
        left = words.direction * (dx * j - dy * i) / chord
        return _feed(words, start, end, center, (_through(words, start, end, left, words.turns),))
    return _feed(words, start, end, center, _divided(words, start, end, center, (at_start, at_end), angle))


def arc_of_radius(words: ArcWords, start: Vector, end: Vector, radius: float) -> ArcFeed:
    """The arc of `radius` (m) from `start` to `end`: the shorter one for a positive radius, the longer for a negative.

    Raises ArcError where there is none, or more than one (start = end).
    """
    end = _level(start, end, words.plane)
    sa, sb, _ = words.plane.coordinates(start)
    ea, eb, _ = words.plane.coordinates(end)
    chord = math.sqrt((ea - sa) * (ea - sa) + (eb - sb) * (eb - sb))
    if chord < ZERO_LENGTH:
        raise ArcError("an arc with R needs an end other than its start: a full circle takes its center (I J K)")
    if abs(radius) < ARC_RADIUS:
        raise ArcError(f"the arc's radius is zero: {mm(abs(radius))}")
    if 0.5 * chord - abs(radius) > ARC_RADIUS:
        raise ArcError(
            f"radius too small: the end is {mm(chord)} from the start, twice the radius is {mm(2.0 * abs(radius))}"
        )
    left = math.copysign(math.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0)), radius)
    arc = _through(words, start, end, left, words.turns)
    return _feed(words, start, end, arc.center, (arc,))


def mm(length: float) -> str:
    """A length in m as it reads in messages."""
    return f"{length * 1000.0:.6f} mm"


def _check_radii(at_start: float, at_end: float, largest: float) -> None:
    radii = f"{mm(at_start)} at its start, {mm(at_end)} at its end"
    smaller, larger = sorted((at_start, at_end))
    if smaller < ARC_RADIUS:
        raise ArcError(f"the arc's radius is zero: {radii}")
    difference = larger - smaller
    most = min(max(largest, ARC_RADII_RELATIVE * larger), ARC_RADII_RATIO * largest)
    if difference > most:
        raise ArcError(f"the arc's radii disagree: {radii}, difference {mm(difference)} (at most {mm(most)})")


def _level(start: Vector, end: Vector, plane: Plane) -> Vector:
    """`end`, exactly as high over the plane as `start` if it is so but for rounding."""
    a, b, c = plane.coordinates(end)
    height = plane.coordinates(start)[2]
    return plane.vector(a, b, height) if abs(c - height) < ZERO_LENGTH else end


def _feed(words: ArcWords, start: Vector, end: Vector, center: Vector, arcs: tuple[Arc, ...]) -> ArcFeed:
    turns = int(words.direction) * words.turns
    return ArcFeed(words.line, start, end, center, turns, words.plane, words.feed, arcs)


def _angle(direction: float, from_spoke: tuple[float, float], to_spoke: tuple[float, float]) -> float:
    """The angle in (0, 2 pi] from one spoke to another in the direction of travel."""
    (a, b), (c, d) = from_spoke, to_spoke
    cross, dot = direction * (a * d - b * c), a * c + b * d
    angle = math.atan2(abs(cross), dot)
    return angle if cross >= _FULL_TURN else math.tau - angle


def _through(words: ArcWords, start: Vector, end: Vector, left: float, turns: int) -> Arc:
    """The arc through both ends with its center `left` (m) off their chord, + to the left for counter-clockwise."""
    sa, sb, height = words.plane.coordinates(start)
    ea, eb, _ = words.plane.coordinates(end)
    dx, dy = ea - sa, eb - sb
    chord = math.sqrt(dx * dx + dy * dy)
    side = words.direction * left
    center = words.plane.vector(0.5 * (sa + ea) - side * dy / chord, 0.5 * (sb + eb) + side * dx / chord, height)
    angle = 2.0 * math.atan2(0.5 * chord, left)
    return _arc(words, start, end, center, angle + math.tau * (turns - 1))


def _arc(words: ArcWords, start: Vector, end: Vector, center: Vector, angle: float) -> Arc:
    sweep = words.direction * angle
    return Arc(words.line, start, end, words.feed, False, words.evaluated, center, sweep, words.plane, words.path_mode)


def _divided(
    words: ArcWords, start: Vector, end: Vector, center: Vector, radii: tuple[float, float], angle: float
) -> tuple[Arc, ...]:
    """Arcs of at most half a turn through points on the way from the radius at the start to that at the end."""
    sa, sb, height = words.plane.coordinates(start)
    ca, cb, _ = words.plane.coordinates(center)
    at_start, at_end = radii
    rise = words.plane.coordinates(end)[2] - height
    total = angle + math.tau * (words.turns - 1)
    count = math.ceil(total / math.pi)
    from_angle = math.atan2(sb - cb, sa - ca)
    points = [start]
    for part in (number / count for number in range(1, count)):
        radius, at = at_start + part * (at_end - at_start), from_angle + words.direction * part * total
        points.append(words.plane.vector(ca + radius * math.cos(at), cb + radius * math.sin(at), height + part * rise))
    points.append(end)
    return tuple(_half_turn(words, a, b, (ca, cb)) for a, b in pairwise(points))


def _half_turn(words: ArcWords, start: Vector, end: Vector, center: tuple[float, float]) -> Arc:
    sa, sb, _ = words.plane.coordinates(start)
    ea, eb, _ = words.plane.coordinates(end)
    dx, dy = ea - sa, eb - sb
    i, j = center[0] - sa, center[1] - sb
    left = words.direction * (dx * j - dy * i) / math.sqrt(dx * dx + dy * dy)
    return _through(words, start, end, left, 1)
