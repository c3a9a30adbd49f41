"""Observations that an identification of drives explains: what each drive did, or the contour errors of the tool.

`AxisData`: actual position of one drive in every cycle. `ContourData`: contour errors over the place on the contour, as
an instrument at the TCP tells them (a cross-grid encoder): when the tool was there is not used, so the lag along the
path is not seen. Both predict what a machine with other drives would have shown for the same setpoints, by the exact
array path of the drives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.array_path import respond
from pkm_cnc.config import Setup
from pkm_cnc.contour import judged_range
from pkm_cnc.errors import InputError
from pkm_cnc.identification.drive_run import STANDING, DriveRun
from pkm_cnc.identification.drive_unknowns import DriveUnknown
from pkm_cnc.program import Arc, Element, Line, Plane
from pkm_cnc.servo import DriveParameters

__all__ = ["AxisData", "ContourData", "DriveData", "contour_places", "scatter"]

Array = NDArray[np.float64]

BIN = 0.010
"""m. Contour errors are averaged over such lengths of the contour: they change over the length of a strut."""
ASIDE = 0.25
"""s at feed, left out at both ends of an arc: by so much another machine's tool may be ahead or behind, some 1/Kv."""
VERTICAL = 1e-6
"""1. Below this horizontal part of its tangent a line has no left and up."""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the magnitude of a standard normal variable."""


class DriveData(Protocol):
    """`name` of what was observed, for errors."""

    @property
    def name(self) -> str: ...

    @property
    def observed(self) -> Array:
        """(m,), m."""

    @property
    def noise(self) -> float:
        """Standard deviation of one observation, m, as far as it changes from each to the next."""

    def predicted(self, model: Setup) -> Array:
        """(m,), m: `observed` as `model` has it."""

    def missing(self, unknown: DriveUnknown) -> str:
        """Which motion is missing when `unknown` cannot be estimated."""


def scatter(series: Array) -> float:
    """Standard deviation of white noise on a smooth series (n,), same unit; by its third differences, n > 3.

    Of their magnitude the median is taken: starts and stops are rare. The variance of a third difference is 20 times
    that of a value (1 + 9 + 9 + 1).
    """
    return float(np.median(np.abs(np.diff(series, n=3)))) / (NORMAL_MEDIAN * math.sqrt(20.0))


@dataclass(frozen=True)
class AxisData:
    """The reading of the linear scale of `axis` in every cycle of `runs`, less the setpoint: minus tracking error."""

    axis: str
    runs: Sequence[DriveRun]

    @property
    def name(self) -> str:
        """As errors call it."""
        return self.axis

    @cached_property
    def observed(self) -> Array:
        """(m,), m."""
        return np.concatenate([run.readings[self.axis] - run.setpoints[self.axis][0] for run in self.runs])

    @property
    def noise(self) -> float:
        """m."""
        return max(scatter(run.readings[self.axis]) for run in self.runs)

    def predicted(self, model: Setup) -> Array:
        """(m,), m."""
        return np.concatenate(
            [-respond(model, self.axis, *run.setpoints[self.axis]).tracking_error for run in self.runs]
        )

    def missing(self, unknown: DriveUnknown) -> str:
        """Which motion is missing."""
        commanded = [run.setpoints[self.axis] for run in self.runs]
        span = max(float(np.ptp(setpoint[0])) for setpoint in commanded)
        if span <= STANDING:
            return f"{self.axis} does not move: run a program that moves it, at different speeds, with starts and stops"
        speed, change = (max(float(np.abs(setpoint[part]).max()) for setpoint in commanded) for part in (1, 2))
        return (
            f"{self.axis} moves by {1e3 * span:.4g} mm at up to {60e3 * speed:.4g} mm/min and {change:.4g} m/s^2: run "
            "longer or faster motions with starts and stops"
        )


class _Piece(NamedTuple):
    """An evaluated element of one run: its cycles, and the edges (b + 1,) of its bins on it, m."""

    run: int
    element: Element
    cycles: slice
    edges: Array
    middle: tuple[int, float]
    """A cycle, counted in `cycles`, and about where on the element the tool is there, m."""


@dataclass(frozen=True)
class ContourData:
    """Contour errors, left and up, of the evaluated lines and horizontal arcs of `runs`, averaged over bins.

    Raises InputError where there is none.
    """

    runs: Sequence[DriveRun]
    _last: dict[tuple[str, str], tuple[DriveParameters, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self._pieces:
            raise InputError(
                f"{', '.join(run.name for run in self.runs)}: too little motion: no evaluated line or horizontal arc "
                "of two bins of 10 mm; run a star test and a circular test"
            )

    @property
    def name(self) -> str:
        """As errors call it."""
        return "contour"

    @cached_property
    def _pieces(self) -> list[_Piece]:
        return [
            piece
            for number, run in enumerate(self.runs)
            for index in range(len(run.elements))
            if (piece := _piece(number, run, index)) is not None
        ]

    @cached_property
    def observed(self) -> Array:
        """(m,), m: piece by piece, left of all bins, then up."""
        return self._errors([run.tcp for run in self.runs])

    @cached_property
    def noise(self) -> float:
        """m: what is left of the noise of the measured TCP in the average over a bin."""
        noise = max(scatter(run.tcp[:, axis]) for run in self.runs for axis in range(3))
        cycles = min((piece.cycles.stop - piece.cycles.start) / (len(piece.edges) - 1) for piece in self._pieces)
        return noise / math.sqrt(max(1.0, cycles))

    def predicted(self, model: Setup) -> Array:
        """(m,), m."""
        tcp = []
        for run in self.runs:
            sliders = [self._slider(model, run, axis) for axis in model.axes]
            tcp.append(model.true_tcp(np.stack(sliders, axis=-1)))
        return self._errors(tcp)

    def _slider(self, model: Setup, run: DriveRun, axis: str) -> Array:
        """(n,), m; the last answer is kept, because mostly the drive of another axis is changed."""
        drive = model.axes[axis].drive
        if self._last.get((run.name, axis), (None, None))[0] != drive:
            self._last[run.name, axis] = (drive, respond(model, axis, *run.setpoints[axis]).position)
        return self._last[run.name, axis][1]

    def missing(self, unknown: DriveUnknown) -> str:
        """Which motion is missing."""
        return (
            f"these contours do not show what {unknown.axis} does: run lines of several headings and circles, fast, "
            f"where {unknown.axis} changes its speed along them"
        )

    def _errors(self, tcp: Sequence[Array]) -> Array:
        parts = []
        for piece in self._pieces:
            places, left, up = contour_places(piece.element, tcp[piece.run][piece.cycles], piece.middle)
            parts += [_averages(places, left, piece.edges), _averages(places, up, piece.edges)]
        return np.concatenate(parts)


def _piece(number: int, run: DriveRun, index: int) -> _Piece | None:
    element = run.elements[index]
    cycles = np.flatnonzero(run.segment == index)
    if not (_can_be_judged(element) and len(cycles)):
        return None
    begin, end = (place - run.starts[index] for place in judged_range(element, run.starts[index]))
    aside = ASIDE * element.feed if isinstance(element, Arc) else 0.0
    bins = round((end - begin - 2.0 * aside) / BIN)
    if bins < 2:
        return None
    first, last = int(cycles[0]), int(cycles[-1]) + 1
    middle = len(cycles) // 2
    where = float(run.path[first + middle] - run.starts[index])
    edges = np.asarray(np.linspace(begin + aside, end - aside, bins + 1), dtype=np.float64)
    return _Piece(number, element, slice(first, last), edges, (middle, where))


def _can_be_judged(element: Element) -> bool:
    if not element.evaluated:
        return False
    if isinstance(element, Line):
        return math.hypot(*element.tangent(0.0)[:2]) > VERTICAL
    return element.plane == Plane.XY and element.start[2] == element.end[2]


def contour_places(element: Element, tcp: Array, middle: tuple[int, float]) -> tuple[Array, Array, Array]:
    """Place on the element, contour error left and up, (n,) each, m, of the TCP (n, 3), m.

    On a line produced beyond its ends, on an arc turn by turn: `middle` is a row of `tcp` and about its place, m.
    """
    if isinstance(element, Arc):
        return _arc_places(element, tcp, middle)
    along = np.array(element.tangent(0.0))
    left = np.array([-along[1], along[0], 0.0]) / math.hypot(along[0], along[1])
    up = np.cross(along, left)
    x, y, z = (tcp - np.array(element.start)).T
    place, sideways, above = (a * x + b * y + c * z for a, b, c in (along, left, up))
    return place, sideways, above


def _arc_places(arc: Arc, tcp: Array, middle: tuple[int, float]) -> tuple[Array, Array, Array]:
    x, y, z = (tcp - np.array(arc.center)).T
    start_x, start_y, _ = np.array(arc.start) - np.array(arc.center)
    way = math.copysign(1.0, arc.sweep)
    angle = np.unwrap(way * (np.arctan2(y, x) - math.atan2(start_y, start_x)))
    row, place = middle
    angle += 2.0 * math.pi * round((place / arc.radius - angle[row]) / (2.0 * math.pi))
    return arc.radius * angle, way * (arc.radius - np.hypot(x, y)), z


def _averages(places: Array, errors: Array, edges: Array) -> Array:
    """Means of the errors (n,) between the edges (b + 1,), (b,): the integral over the place, by trapezoids."""
    ahead = np.maximum.accumulate(places)  # noise may set it back
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (errors[1:] + errors[:-1]) * np.diff(ahead))])
    return np.asarray(np.diff(np.interp(edges, ahead, integral)) / np.diff(edges))
