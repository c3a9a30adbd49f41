"""Contour error: the shortest vector from the programmed contour to the tool, exact on the geometry, cycle by cycle.

Which part of the contour the tool is on is not a matter of distance alone: contours cross themselves, run back on
themselves and round the same circle again. So the nearest point is looked for only between a progress pointer, the
element of the last foot, and the element the setpoint is on; the pointer never goes back.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.errors import MachineFault
from pkm_cnc.program import Arc, Element, frames
from pkm_cnc.records import ContourError, Vector
from pkm_cnc.tolerances import TIE, VERTICAL

__all__ = ["ContourTracker"]

_COMPACT_AT = 256  # dropped elements that may pile up before the lists are shortened: keeps dropping O(1) on average


class ContourTracker:
    """Finds the contour error of one run; memory grows only with the elements between the tool and the setpoint."""

    def __init__(self) -> None:
        self._elements: list[Element] = []
        self._path_starts: list[float] = []
        self._reaches: list[float] = []  # m along the geometry to each element's start, gaps between elements included
        self._tail: tuple[Vector, float] | None = None  # where the last element ends, and its reach
        self._offset = 0  # index of the toolpath segment at place 0 of the lists
        self._place = 0  # the progress pointer
        self._s = 0.0  # m, the last foot on the pointer's element
        self._furthest = 0.0  # m, the furthest foot so far on the pointer's element

    def add(self, index: int, element: Element, path_start: float) -> None:
        """Append toolpath segment `index` (counts up by one), which begins `path_start` m along the contour.

        Raises MachineFault if the index does not follow the last one.
        """
        if not self._elements:
            self._offset = index
        expected = self._offset + len(self._elements)
        if index != expected:
            raise MachineFault(f"contour: toolpath segment {index} arrived where segment {expected} was expected")
        end, reach = self._tail or (element.start, 0.0)
        reach += math.dist(end, element.start)
        self._elements.append(element)
        self._path_starts.append(path_start)
        self._reaches.append(reach)
        self._tail = (element.end, reach + _extent(element))

    def follow(self, points: NDArray[np.float64], setpoint_segments: Sequence[int]) -> list[ContourError]:
        """What `step` answers, to the bit, for each row of `points` (n, 3) and its segment; raises as that."""
        passed: dict[int, tuple[Element, float]] = {}
        places, segments = [], []
        for point, setpoint_segment in zip(zip(*points.T.tolist(), strict=True), setpoint_segments, strict=True):
            self._advance(point, setpoint_segment)
            segment = self._offset + self._place
            if segment not in passed:
                passed[segment] = self._elements[self._place], self._path_starts[self._place]
            places.append(self._s)
            segments.append(segment)
        return _errors(points, passed, np.array(places), segments)

    def step(self, point: Vector, setpoint_segment: int) -> ContourError:
        """Contour error of the true TCP `point` (m, base_link) while the setpoint is on segment `setpoint_segment`.

        The foot is the nearest point of the elements from the progress pointer to the setpoint's own; of elements
        whose distances are within TIE of the smallest, the earliest has it. The pointer's own gives way, too, where
        the tool has run back on it by more than a later one is away: a tool that follows the setpoint does not run
        back, the contour has turned back, on itself or closely beside. left = (z x t)/|z x t| and up = t x left with
        the unit tangent t at the foot; both NaN where t is parallel to z.

        Raises MachineFault if that segment has not been added, or lies behind the progress pointer.
        """
        self._advance(point, setpoint_segment)
        place, s = self._place, self._s
        return _error(point, self._elements[place], s, self._path_starts[place] + s, self._offset + place)

    def _advance(self, point: Vector, setpoint_segment: int) -> None:
        """Take pointer and foot on to where `point` has them."""
        place = self._place
        last = setpoint_segment - self._offset
        if not place <= last < len(self._elements):
            known = f"{self._offset + place} to {self._offset + len(self._elements) - 1}" if self._elements else "none"
            raise MachineFault(f"contour: the setpoint is on toolpath segment {setpoint_segment}, known are {known}")
        element = self._elements[place]
        s = element.nearest(point, self._s)
        if last > place:
            place, s = self._earliest_of_nearest(point, s, last)
        if place != self._place:
            element = self._elements[place]
            self._place = place
            self._furthest = s
        elif s > self._furthest:
            self._furthest = s
        self._s = s
        if place >= _COMPACT_AT and 2 * place >= len(self._elements):
            self._drop_passed()

    def _earliest_of_nearest(self, point: Vector, s: float, last: int) -> tuple[int, float]:
        """Place and foot of the element that has `point`, from the pointer (where the foot is `s`) to place `last`.

        Elements out of reach are passed over, and exactly so: walking a length l along the contour brings no point
        nearer by more than l, so from a start D away all within D - nearest of it is further than the nearest.
        """
        nearest = max(math.dist(point, self._elements[self._place].position(s)), self._furthest - s)
        near = [(nearest, self._place, s)]
        place = self._place + 1
        while place <= last:
            element = self._elements[place]
            spare = math.dist(point, element.start) - nearest - TIE
            if spare > 0.0:
                beyond = bisect_right(self._reaches, self._reaches[place] + spare, place + 1, last + 1) - 1
                if beyond > place:
                    place = beyond
                    continue
            candidate = element.nearest(point, 0.0)
            distance = math.dist(point, element.position(candidate))
            if distance <= nearest + TIE:
                near.append((distance, place, candidate))
                nearest = min(nearest, distance)
            place += 1
        return next((place, s) for distance, place, s in near if not distance > nearest + TIE)

    def _drop_passed(self) -> None:
        passed = self._place
        del self._elements[:passed], self._path_starts[:passed], self._reaches[:passed]
        self._offset += passed
        self._place = 0


def _extent(element: Element) -> float:
    """Path length, and by how much an arc's end misses the circle through its start (programs are rounded)."""
    if isinstance(element, Arc):
        end_a, end_b, _ = element.plane.coordinates(element.end)
        center_a, center_b, _ = element.plane.coordinates(element.center)
        return element.length + abs(math.dist((end_a, end_b), (center_a, center_b)) - element.radius)
    return element.length


def _error(point: Vector, element: Element, s: float, path_length: float, segment: int) -> ContourError:
    (foot_x, foot_y, foot_z), (tx, ty, tz), _ = element.frame(s)
    x, y, z = point[0] - foot_x, point[1] - foot_y, point[2] - foot_z
    horizontal = math.sqrt(tx * tx + ty * ty)
    left = up = math.nan
    if horizontal > VERTICAL:
        left, up = _left_and_up(x, y, z, tx, ty, tz, horizontal)
    return ContourError(x, y, z, left, up, math.sqrt(x * x + y * y + z * z), path_length, segment)


def _errors(
    points: NDArray[np.float64], passed: dict[int, tuple[Element, float]], s: NDArray[np.float64], segments: list[int]
) -> list[ContourError]:
    """`_error` of each point (n, 3) with its foot at `s` (n,) on one of the elements passed (and where they start)."""
    if not passed:
        return []
    elements, starts = zip(*passed.values(), strict=True)
    which = np.searchsorted([*passed], segments)
    feet, tangent, _ = frames(elements, which, s)
    x, y, z = points.T - feet
    tx, ty, tz = tangent
    horizontal = np.sqrt(tx * tx + ty * ty)
    left, up = _left_and_up(x, y, z, tx, ty, tz, np.where(horizontal > VERTICAL, horizontal, math.nan))
    magnitude = np.sqrt(x * x + y * y + z * z)
    columns = (x, y, z, left, up, magnitude, np.array(starts)[which] + s)
    return [*map(ContourError, *(column.tolist() for column in columns), segments)]


def _left_and_up(x: Any, y: Any, z: Any, tx: Any, ty: Any, tz: Any, horizontal: Any) -> tuple[Any, Any]:
    """Of floats or of arrays of them."""
    return (tx * y - ty * x) / horizontal, z * horizontal - tz * ((tx * x + ty * y) / horizontal)
