"""From the elements of a toolpath to the pieces that are run: what is joined, what is rounded, where the TCP stops.

| mode | at the end of an element |
|---|---|
| G61 | passed where the directions differ by motion.tangent_angle at most, else a stop |
| G61.1 | a stop |
| G64 P Q | lines whose points lie within Q of a common one are run as that; corners are rounded by a curve within P |

A rapid begins and ends in a stop, and so does what lies between two events for which the machine must stand. The curve
leaves the path the same distance before a corner as it meets it behind, at most half an element, with tangent and
curvature of the elements, so that the acceleration has no jump. The deviation is meant both ways: no point of the curve
is further from the path than P, and no point of the path from the curve. Where lines were joined, at most half of P was
used for that, and the curves at their ends have the rest. G64 without P has motion.blend_tolerance as its P, without Q
joins as much as it may.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from itertools import pairwise

from pkm_cnc.motion.limits import MotionParameters
from pkm_cnc.motion.piece import Curve, Mark, Piece
from pkm_cnc.program import Arc, Element, Event, Line, Numbering, PathMode
from pkm_cnc.records import Vector
from pkm_cnc.tolerances import TIE, ZERO_LENGTH

__all__ = ["pieces"]

PASSED_EVENTS = frozenset(("message", "tool_select", "program_end"))
"""Events that happen while the TCP moves on; for the others it stops."""

STRAIGHT_ON = 1e-6
"""rad. Elements that meet at a smaller angle have one tangent: a curve there would be shorter than rounding."""
SAME_CURVATURE = 1e-6
"""1/m. Curvatures that differ by less are one."""
TURNS_BACK = -0.98
"""1. Elements that meet with a smaller cosine of the angle turn back: a stop, a curve would be a sharp bend."""
LINE_DEVIATION = 0.375
"""1. Distance of a curve between two lines from their corner by its reach and sin(half the angle): at p = 1/2 of the
quintic whose control points are evenly spaced on the lines, (16 - 25 * 2/5) / 32 * 2."""
LONGEST_JOIN = 100
"""Elements joined to one line at most, so that work per element is bounded."""
SAMPLES = 32
"""Places at which the deviation of a curve at an arc is measured."""
MEASURED = 1.02
"""1. By how much the deviation may be larger between these places."""


def pieces(
    items: Iterable[Element | Event],
    parameters: MotionParameters,
    smooth: bool,
    index: int = 0,
    path_length: float = 0.0,
) -> Iterator[Piece]:
    """The pieces in order, one at a time: never more than a few elements are held.

    `index` and `path_length` (m) are those of the first element's start. `smooth`: jumps of the curvature at tangent
    junctions under G64 are rounded too (with a limit of jerk they would cost more time than the curve). The last piece
    has `stop`, and so has one that an event follows for which the machine must stand.
    """
    before: Piece | None = None
    for after in _joined(items, parameters, index, path_length):
        if before is not None:
            curve = None
            if before.stop or _stops(before, after, parameters):
                before = dataclasses.replace(before, stop=True)
            elif _rounded(before.mode, parameters):
                curve = _curve(before, after, parameters, smooth)
            if curve is not None:
                reach, joint = curve
                before = dataclasses.replace(before, length=before.length - reach)
                after = dataclasses.replace(after, begin=reach, length=after.length - reach)
            if before.length > ZERO_LENGTH:
                yield before
            if curve is not None:
                yield joint
        before = after
    if before is not None:
        yield dataclasses.replace(before, stop=True)


def _joined(
    items: Iterable[Element | Event], parameters: MotionParameters, index: int, start: float
) -> Iterator[Piece]:
    """One piece for each element, or for the lines that G64 Q joins; with `stop` where an event wants it."""
    numbering = Numbering(index, start)
    held: list[Element] = []
    for item in items:
        if isinstance(item, Event) and item.kind in PASSED_EVENTS:
            continue
        if held and (isinstance(item, Event) or not _in_line(held, item, parameters)):
            piece = _piece(held, numbering)
            yield dataclasses.replace(piece, stop=True) if isinstance(item, Event) else piece
            held = []
        if not isinstance(item, Event):
            held.append(item)
    if held:
        yield _piece(held, numbering)


def _tolerances(mode: PathMode, parameters: MotionParameters) -> tuple[float, float]:
    """P, and what of it lines are joined within, m."""
    tolerance = parameters.blend_tolerance if mode.tolerance is None else mode.tolerance
    joining = tolerance if mode.naive_cam is None else mode.naive_cam
    return tolerance, min(joining, 0.5 * tolerance)


def _rounded(mode: PathMode, parameters: MotionParameters) -> bool:
    """Whether corners are; G64 P0 is G61."""
    return mode.code == "G64" and _tolerances(mode, parameters)[0] > TIE


def _in_line(held: list[Element], element: Element, parameters: MotionParameters) -> bool:
    """Whether all points between `held` and the end of `element` lie on one line within the tolerance, in order."""
    first = held[0]
    tolerance = _tolerances(first.path_mode, parameters)[1]
    if first.path_mode.code != "G64" or tolerance <= 0.0 or len(held) >= LONGEST_JOIN:
        return False
    for one in (first, element):
        if not isinstance(one, Line) or one.traverse or one.feed != first.feed or one.path_mode != first.path_mode:
            return False
    if element.evaluated != first.evaluated or math.dist(first.start, element.end) <= ZERO_LENGTH:
        return False
    chord = Line(first.line, first.start, element.end, first.feed, False, first.evaluated)
    before = 0.0
    for one in held:
        s = chord.nearest(one.end, 0.0)
        if math.dist(chord.position(s), one.end) > tolerance or not before < s < chord.length:
            return False
        before = s
    return True


def _piece(held: list[Element], numbering: Numbering) -> Piece:
    shape = held[0]
    if len(held) == 1:
        marks = [Mark(spot.s, spot.number, spot.path_length, spot.rate, shape.line) for spot in numbering.spots(shape)]
    else:
        shape = Line(shape.line, shape.start, held[-1].end, shape.feed, False, shape.evaluated)
        knots = [0.0, *(shape.nearest(one.end, 0.0) for one in held)]
        marks = []
        for one, (s0, s1) in zip(held, pairwise(knots), strict=True):
            rate = one.length / (s1 - s0)
            for spot in numbering.spots(one):
                marks.append(Mark(s0 + spot.s / rate, spot.number, spot.path_length, spot.rate * rate, one.line))
    first = held[0]
    return Piece(shape, 0.0, shape.length, first.feed, first.line, tuple(marks), first.path_mode, first.traverse)


def _stops(before: Piece, after: Piece, parameters: MotionParameters) -> bool:
    if before.traverse or after.traverse or before.mode.code == "G61.1":
        return True
    angle = _angle(before, after)
    if _rounded(before.mode, parameters):
        return math.cos(angle) < TURNS_BACK
    return angle > parameters.tangent_angle


def _angle(before: Piece, after: Piece) -> float:
    chord = math.dist(before.shape.tangent(before.shape.length), after.shape.tangent(0.0))
    return 2.0 * math.asin(min(0.5 * chord, 1.0))


def _curve(before: Piece, after: Piece, parameters: MotionParameters, smooth: bool) -> tuple[float, Piece] | None:
    """Its reach, m, along either element, and the curve; None where the elements go on into each other."""
    angle = _angle(before, after)
    jump = math.dist(before.shape.curvature(before.shape.length), after.shape.curvature(0.0))
    if angle <= STRAIGHT_ON and not (smooth and jump > SAME_CURVATURE):
        return None
    tolerance, joining = _tolerances(before.mode, parameters)
    if len(before.marks) > 1 or len(after.marks) > 1:
        tolerance -= joining
    reach = min(_half(before), _half(after))
    if isinstance(before.shape, Line) and isinstance(after.shape, Line):
        reach = min(reach, tolerance / (LINE_DEVIATION * math.sin(0.5 * angle)))
        curve = _between(before, after, reach)
    else:
        curve = _between(before, after, reach)
        while (deviation := _deviation(curve, before, after)) * MEASURED > tolerance:
            reach *= max(0.1, min(0.9, tolerance / (MEASURED * deviation)))
            curve = _between(before, after, reach)
    half = 0.5 * curve.length
    first, first_place = before.place(before.shape.length - reach)
    second, second_place = after.place(0.0)
    _, end_place = after.place(reach)
    marks = (
        Mark(0.0, first, first_place, (second_place - first_place) / half, before.marks[-1].line),
        Mark(half, second, second_place, (end_place - second_place) / half, after.marks[0].line),
    )
    feed = min(before.feed, after.feed)
    return reach, Piece(curve, 0.0, curve.length, feed, marks[0].line, marks, before.mode, False)


def _half(piece: Piece) -> float:
    """How far a curve may reach into it, m: half of it, which leaves the other half to the next; on an arc 0.5 rad."""
    shape = piece.shape
    return min(0.5 * shape.length, 0.5 * shape.radius) if isinstance(shape, Arc) else 0.5 * shape.length


def _between(before: Piece, after: Piece, reach: float) -> Curve:
    return Curve(before.shape.frame(before.shape.length - reach), after.shape.frame(reach), 2.0 * reach)


def _deviation(curve: Curve, before: Piece, after: Piece) -> float:
    """Largest distance of the curve from the two elements, or of their corner from the curve, m, at the samples."""
    worst, corner = 0.0, math.inf
    joint = before.shape.position(before.shape.length)
    for k in range(SAMPLES + 1):
        point = curve.position(curve.length * k / SAMPLES)
        near = min(_distance(point, before, before.shape.length), _distance(point, after, 0.0))
        worst, corner = max(worst, near), min(corner, math.dist(point, joint))
    return max(worst, corner)


def _distance(point: Vector, piece: Piece, near: float) -> float:
    shape = piece.shape
    assert isinstance(shape, (Line, Arc))
    return math.dist(shape.position(shape.nearest(point, near)), point)
