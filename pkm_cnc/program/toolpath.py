"""The programmed contour: lines and arcs in `base_link`, each known by its path length s.

All is SI (m, rad, m/s). The methods of the elements run in every servo cycle, hence plain floats and `math`.
An arc is a circle or a helix: with the angle t travelled, on radius r and with the axial motion h per radian, its path
length is s = t sqrt(r^2 + h^2).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Literal, NamedTuple

from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ZERO_LENGTH

__all__ = [
    "EXACT_PATH",
    "Arc",
    "Element",
    "Event",
    "EventKind",
    "Frame",
    "Line",
    "Numbering",
    "PathMode",
    "Place",
    "Plane",
    "Spot",
    "Toolpath",
    "Totals",
    "on_arc",
    "turned",
]

_NEWTON_STEPS = 60
"""Steps of the safeguarded Newton iteration: from any bracket, bisection alone would be down to rounding by then."""
_NEWTON_END = 1e-15
"""1. A Newton step below this, relative to 1 rad and the angle, ends it: some rounding errors of either."""


class Plane(IntEnum):
    """The plane of an arc: its value is the index of its first axis; its second and its normal follow cyclically."""

    XY = 0
    YZ = 1
    ZX = 2

    def coordinates(self, v: Vector) -> Vector:
        """The coordinates of x y z along the plane's first and second axis and along its normal."""
        return v if self == 0 else (v[1], v[2], v[0]) if self == 1 else (v[2], v[0], v[1])

    def vector(self, a: float, b: float, c: float) -> Vector:
        """x y z of what has these coordinates along the plane's first and second axis and along its normal."""
        return (a, b, c) if self == 0 else (c, a, b) if self == 1 else (b, c, a)


class PathMode(NamedTuple):
    """How the path is kept between motions (G61, G61.1, G64), as the program asks for it.

    `code` is the word; for G64 `tolerance` (m) is the largest deviation allowed, None = as the machine likes, and
    `naive_cam` (m) the deviation within which points in a line may be joined, None = as the machine likes.
    """

    code: str
    tolerance: float | None = None
    naive_cam: float | None = None


EXACT_PATH = PathMode("G61")

Frame = tuple[Vector, Vector, Vector]
"""Position (m), unit tangent and curvature (the tangent's derivative by the path length, 1/m)."""


EventKind = Literal[
    "program_stop",
    "optional_stop",
    "program_end",
    "spindle_speed",
    "spindle_clockwise",
    "spindle_counterclockwise",
    "spindle_stop",
    "tool_select",
    "tool_change",
    "mist_on",
    "flood_on",
    "coolant_off",
    "dwell",
    "message",
]
"""What a program can ask for besides motion."""


class Event(NamedTuple):
    """What a program asks for besides motion, where it happens: between two motions, at `path_length` (m).

    `line` is its line in the part program, `value` its number: rpm, tool, seconds of a dwell; None where there is none.
    `text` is that of a message to the operator.
    """

    line: int
    kind: EventKind
    path_length: float
    value: float | None = None
    text: str = ""


class Place(NamedTuple):
    """Where a motion belongs on another contour, which it is judged by.

    From `s` (m, on the motion) on that is `offset` (m) behind the start of the contour's `element`, and from there on
    `rate` m of the contour go by with each m of the motion.
    """

    s: float
    element: Element
    offset: float
    rate: float


@dataclass(frozen=True, slots=True)
class Line:
    """A straight motion from `start` to `end` (m, in `base_link`) with path speed `feed` (m/s).

    `line` is its line in the part program; `traverse` tells a rapid; `evaluated` whether its contour error counts;
    `path_mode` how the path is to be kept at its end; `places` are empty for a motion that is judged by itself.
    `length` (m) follows from the ends. A line without length has the tangent (0, 0, 0) and is no part of a toolpath.
    """

    line: int
    start: Vector
    end: Vector
    feed: float
    traverse: bool
    evaluated: bool
    path_mode: PathMode = EXACT_PATH
    places: tuple[Place, ...] = field(default=(), repr=False, compare=False)
    length: float = field(init=False, repr=False, compare=False)
    _tangent: Vector = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        dx, dy, dz = (b - a for a, b in zip(self.start, self.end, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        tangent = (dx / length, dy / length, dz / length) if length > 0.0 else (0.0, 0.0, 0.0)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "_tangent", tangent)

    def position(self, s: float) -> Vector:
        """Point at path length `s` (m), exactly `start` at and before 0, exactly `end` at and after `length`."""
        if s <= 0.0:
            return self.start
        if s >= self.length:
            return self.end
        x, y, z = self.start
        tx, ty, tz = self._tangent
        return x + s * tx, y + s * ty, z + s * tz

    def tangent(self, s: float) -> Vector:
        """Unit tangent in the direction of travel, the same at every `s`."""
        return self._tangent

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by the path length (1/m): zero."""
        return 0.0, 0.0, 0.0

    def frame(self, s: float) -> Frame:
        """Position (m), tangent and curvature (1/m) at path length `s` (m)."""
        return self.position(s), self._tangent, (0.0, 0.0, 0.0)

    def nearest(self, point: Vector, near: float) -> float:
        """Path length (m) in [0, length] of the point of the line nearest to `point` (m); `near` is not needed."""
        px, py, pz = point
        x, y, z = self.start
        tx, ty, tz = self._tangent
        s = (px - x) * tx + (py - y) * ty + (pz - z) * tz
        if s <= 0.0:
            return 0.0
        return s if s < self.length else self.length


@dataclass(frozen=True, slots=True)
class Arc:
    """A circular or helical motion about the axis through `center`, normal to `plane`.

    The first fields are those of `Line`. `sweep` (rad) is the angle travelled, + counter-clockwise seen from the tip
    of the plane's normal (+z, +x, +y); a full circle has `sweep` = +-2 pi, more turns have more. `center` (m) has the
    coordinate of `start` along the normal; where that of `end` differs the arc is a helix.

    What follows: `radius` (m), in the plane; `length` (m), along the path; `spoke` (m), from the axis to the start, in
    the plane; `turning` (rad/m of path, + counter-clockwise); `climb` (m along the normal per m of path).
    """

    line: int
    start: Vector
    end: Vector
    feed: float
    traverse: bool
    evaluated: bool
    center: Vector
    sweep: float
    plane: Plane = Plane.XY
    path_mode: PathMode = EXACT_PATH
    places: tuple[Place, ...] = field(default=(), repr=False, compare=False)
    radius: float = field(init=False, repr=False, compare=False)
    length: float = field(init=False, repr=False, compare=False)
    spoke: tuple[float, float] = field(init=False, repr=False, compare=False)
    turning: float = field(init=False, repr=False, compare=False)
    climb: float = field(init=False, repr=False, compare=False)
    _middle: Vector = field(init=False, repr=False, compare=False)  # the center in coordinates of the plane

    def __post_init__(self) -> None:
        a, b, c = self.plane.coordinates(self.start)
        middle = self.plane.coordinates(self.center)
        center_a, center_b, _ = middle
        x, y, rise = a - center_a, b - center_b, self.plane.coordinates(self.end)[2] - c
        radius = math.sqrt(x * x + y * y)
        length = radius * abs(self.sweep)
        turning, climb = math.copysign(1.0 / radius, self.sweep), 0.0
        if rise != 0.0:
            length = math.sqrt(length * length + rise * rise)
            turning, climb = self.sweep / length, rise / length
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "spoke", (x, y))
        object.__setattr__(self, "turning", turning)
        object.__setattr__(self, "climb", climb)
        object.__setattr__(self, "_middle", middle)

    def position(self, s: float) -> Vector:
        """Point at path length `s` (m), exactly `start` at and before 0, exactly `end` at and after `length`."""
        return self.frame(s)[0]

    def tangent(self, s: float) -> Vector:
        """Unit tangent in the direction of travel at path length `s` (m), clamped to [0, length]."""
        return self.frame(s)[1]

    def curvature(self, s: float) -> Vector:
        """Derivative of the tangent by the path length (1/m) at `s` (m), clamped to [0, length]: towards the axis."""
        return self.frame(s)[2]

    def frame(self, s: float) -> Frame:
        """Position (m), tangent and curvature (1/m) at `s` (m): together they cost little more than one of them."""
        spoke = self.spoke
        if s > 0.0:
            angle = min(s, self.length) * self.turning
            spoke = turned(spoke, math.cos(angle), math.sin(angle))
        vector = self.plane.vector
        position, tangent, curvature = on_arc(self._middle, spoke, self.turning, self.climb, s)
        point = self.start if s <= 0.0 else self.end if s >= self.length else vector(*position)
        return point, vector(*tangent), vector(*curvature)

    def nearest(self, point: Vector, near: float) -> float:
        """Path length (m) in [0, length] of the point of the arc nearest to `point` (m).

        Below a full turn that is the true nearest point; between equally near ones the first. From a full turn on one
        angle belongs to several path lengths: looked for is the nearest point within half a turn of the hint `near`
        (m, path length of the last known foot), so a tool that still lags behind the start of a circle has its foot
        at 0 and one that has run past the end has it at `length`. A point on a circle's axis is equally far from all
        of it: `near`, clamped.
        """
        a, b, c = self.plane.coordinates(point)
        center_a, center_b, center_c = self._middle
        dx, dy = a - center_a, b - center_b
        x, y = self.spoke
        angle = math.atan2(x * dy - y * dx, x * dx + y * dy)
        if self.turning < 0.0:
            angle = -angle
        if self.climb != 0.0:
            return self._nearest_on_helix(math.sqrt(dx * dx + dy * dy), angle, c - center_c, near)
        return self._nearest_on_circle(dx * dx + dy * dy, angle, near)

    def _nearest_on_circle(self, distance_squared: float, angle: float, near: float) -> float:
        length = self.length
        if distance_squared < ZERO_LENGTH * ZERO_LENGTH:
            return min(max(near, 0.0), length)
        turn = abs(self.sweep)
        if turn >= math.tau:
            s, circumference = angle * self.radius, self.radius * math.tau
            return min(max(s + circumference * round((near - s) / circumference), 0.0), length)
        if angle < 0.0:
            angle += math.tau
        if angle <= turn:
            return min(angle * self.radius, length)
        return length if angle - turn < math.tau - angle else 0.0

    def _nearest_on_helix(self, distance: float, angle: float, height: float, near: float) -> float:
        """The same for a helix, the point given by its distance from the axis, its angle (travel = +) and its height.

        Half the squared distance to the point at angle t is f(t) = (r^2 + d^2) / 2 - r d cos(t - angle) +
        (h t - height)^2 / 2, h the rise per radian. It is convex where cos(t - angle) >= -h^2 / (r d): once a turn, or
        everywhere. Its least value in a range is at an end of the range or the one minimum of a convex part.
        """
        turn = abs(self.sweep)
        speed = self.length / turn
        h, rd = self.climb * speed, self.radius * distance
        low, high = 0.0, turn
        if turn >= math.tau:
            middle = min(max(near / speed, 0.0), turn)
            low, high = max(middle - math.pi, 0.0), min(middle + math.pi, turn)

        def slope(t: float) -> float:
            return rd * math.sin(t - angle) + h * (h * t - height)

        def rate(t: float) -> float:
            return rd * math.cos(t - angle) + h * h

        found = [low]
        for begin, end in _convex_parts(low, high, angle, math.acos(-h * h / rd) if h * h < rd else math.inf):
            found.append(_zero(slope, rate, begin, end))
        found.append(high)
        best = min(found, key=lambda t: 0.5 * (h * t - height) ** 2 - rd * math.cos(t - angle))
        return min(best * speed, self.length)


def turned(spoke: tuple[Any, Any], cosine: Any, sine: Any) -> tuple[Any, Any]:
    """A spoke of an arc turned by an angle; floats, or arrays with one element per spoke."""
    x, y = spoke
    return x * cosine - y * sine, x * sine + y * cosine


def on_arc(center: Sequence[Any], spoke: tuple[Any, Any], turning: Any, climb: Any, s: Any) -> tuple[Any, Any, Any]:
    """Position, tangent and curvature by the arc's fields, in coordinates of its plane; floats, or arrays of them."""
    (a, b, c), (x, y), square = center, spoke, turning * turning
    return (a + x, b + y, c + s * climb), (-turning * y, turning * x, climb), (-square * x, -square * y, 0.0)


def _convex_parts(low: float, high: float, angle: float, half: float) -> Iterator[tuple[float, float]]:
    """What of [low, high] lies within `half` of `angle` or of a whole number of turns from it, in order."""
    if half == math.inf:
        yield low, high
        return
    for turn in range(math.ceil((low - angle - half) / math.tau), math.floor((high - angle + half) / math.tau) + 1):
        middle = angle + turn * math.tau
        begin, end = max(low, middle - half), min(high, middle + half)
        if begin < end:
            yield begin, end


def _zero(value: Callable[[float], float], rate: Callable[[float], float], low: float, high: float) -> float:
    """Where a function that does not fall is zero in [low, high], or the end that is nearest to that.

    Newton's iteration within a bracket; a step that would leave it is replaced by halving it.
    """
    if value(low) >= 0.0:
        return low
    if value(high) <= 0.0:
        return high
    t = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        f = value(t)
        if f < 0.0:
            low = t
        else:
            high = t
        slope = rate(t)
        newton = t - f / slope if slope > 0.0 else low
        if abs(newton - t) <= _NEWTON_END * (1.0 + abs(t)):
            return newton
        t = newton if low < newton < high else 0.5 * (low + high)
    return t


Element = Line | Arc


@dataclass(frozen=True, slots=True)
class Toolpath:
    """The elements of a part program in order, each starting exactly where the one before ends, and its events.

    `starts` is the path length (m) at each element's start, `length` (m) that at the end of the last.
    Raises ValueError for elements that do not connect, an element without length, no elements.
    """

    elements: tuple[Element, ...]
    events: tuple[Event, ...] = ()
    starts: tuple[float, ...] = field(init=False, repr=False, compare=False)
    length: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.elements:
            raise ValueError("a toolpath needs at least one element")
        starts = []
        length = 0.0
        end = self.elements[0].start
        for index, element in enumerate(self.elements):
            if element.start != end:
                raise ValueError(f"element {index} starts at {element.start}, the one before ends at {end}")
            if not element.length > 0.0:
                raise ValueError(f"element {index} has the length {element.length} m")
            starts.append(length)
            length += element.length
            end = element.end
        object.__setattr__(self, "starts", tuple(starts))
        object.__setattr__(self, "length", length)

    def __iter__(self) -> Iterator[Element]:
        return iter(self.elements)

    @property
    def contour(self) -> Toolpath:
        """What a run of it is judged by."""
        numbering = Numbering()
        spots = [spot for element in self.elements for spot in numbering.spots(element)]
        segments = {spot.number: spot.segment for spot in spots}
        return Toolpath(tuple(segments.values()))

    def items(self) -> Iterator[Element | Event]:
        """Elements and events in order."""
        events = deque(self.events)
        for element, start in zip(self.elements, self.starts, strict=True):
            while events and events[0].path_length <= start:
                yield events.popleft()
            yield element
        yield from events

    @property
    def totals(self) -> Totals:
        """What all of it adds up to."""
        totals = Totals()
        for item in self.items():
            totals.add(item)
        return totals


@dataclass
class Totals:
    """What elements and events add up to: number and length (m) of the elements; nominal times, s."""

    elements: int = 0
    length: float = 0.0
    feed_time: float = 0.0
    rapid_time: float = 0.0
    dwell_time: float = 0.0

    def add(self, item: Element | Event) -> None:
        """Count one more."""
        if isinstance(item, Event):
            if item.kind == "dwell":
                self.dwell_time += item.value or 0.0
            return
        self.elements += 1
        self.length += item.length
        if item.traverse:
            self.rapid_time += item.length / item.feed
        else:
            self.feed_time += item.length / item.feed


class Spot(NamedTuple):
    """From `s` (m, on a motion) on, s' stands for `path_length` + `rate` (s' - s) of the contour that counts.

    That is in its element `number`, which is `segment` and begins at `begin` (m).
    """

    s: float
    number: int
    path_length: float
    rate: float
    segment: Element
    begin: float


class Numbering:
    """Numbers the elements of the contour that counts while motions come along, from `index` and `path_length` (m) on.

    A motion without places is such an element itself.
    """

    def __init__(self, index: int = 0, path_length: float = 0.0) -> None:
        self.index = index
        """Of the next element."""
        self.path_length = path_length
        """At its start, m."""
        self._segment: Element | None = None
        self._begin = path_length

    def spots(self, motion: Element) -> list[Spot]:
        """Where the next motion belongs."""
        if not motion.places:
            self._enter(motion)
            return [Spot(0.0, self.index - 1, self._begin, 1.0, motion, self._begin)]
        spots = []
        for s, segment, offset, rate in motion.places:
            if segment is not self._segment:
                self._enter(segment)
            spots.append(Spot(s, self.index - 1, self._begin + offset, rate, segment, self._begin))
        return spots

    def _enter(self, segment: Element) -> None:
        self._segment, self._begin = segment, self.path_length
        self.index += 1
        self.path_length += segment.length
