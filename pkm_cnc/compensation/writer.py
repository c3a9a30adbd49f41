"""A corrected contour as a part program that any CNC reads: G1 and arcs of the contour's planes, in mm and mm/min.

Every element is cut where the correction bends. Between two cuts a line takes the place of a line, an arc through three
points that of an arc (with the deviation along its normal as a helix has it); either keeps within `tolerance` of the
corrected contour. Cuts of what is straight lie off it to the outer side by two thirds of that, so that the mean of the
deviation is zero: what is left of it is a ripple that is much too fast for the drives. The feed of each piece makes it
take as long as the piece of the original contour that it stands for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.compensation.correction import Correction
from pkm_cnc.errors import InputError
from pkm_cnc.program import Arc, Element, Event, PathMode, Plane, Program, carry_original, element_comment
from pkm_cnc.records import Vector

__all__ = ["DECIMALS", "compensated_program"]

Array = NDArray[np.float64]

DECIMALS = 7
"""Of a mm: rounding by 0.05 nm at most. What a third pass leaves of a circle R 100 at 9000 mm/min, 0.79 nm, is 0.82 nm
with six, 4.6 nm with five, 53 nm with four."""
FEED_DECIMALS = 4
"""Of a mm/min: 1e-8 of usual feeds."""
SHORTEST = 2e-5
"""m. Pieces are never made shorter than this: usual feeds take a servo period for more."""
LONGEST = 2e-3
"""m. Pieces are never made longer than this, or than a knot interval of the correction."""
LESS = 0.45
"""1. The part of the tolerance that pieces are cut for."""
LOOKED_AT = 4
"""Places in a knot interval of the correction at which its bend is looked at."""
STEEPEST, LARGEST = 1.0, 0.5
"""1. A correction that grows faster than this along the contour, so that the path leads away from it rather than along
it, is refused, and one that is larger than this part of an arc's radius."""
NOTHING = 1e-11
"""m. A smaller correction of a whole element is none."""
STRAIGHT = 1e-7
"""1. An arc that rises less over its chord than this part of it is written as a line."""

_EVENT_WORDS = {
    "program_stop": "M0",
    "optional_stop": "M1",
    "program_end": "M2",
    "spindle_clockwise": "M3",
    "spindle_counterclockwise": "M4",
    "spindle_stop": "M5",
    "tool_change": "M6",
    "mist_on": "M7",
    "flood_on": "M8",
    "coolant_off": "M9",
}
_PLANE_WORDS = {Plane.XY: "G17", Plane.ZX: "G18", Plane.YZ: "G19"}
_NUMBER_WORDS = {"spindle_speed": "S", "tool_select": "T", "dwell": "G4 P"}


def compensated_program(
    original: Program,
    items: Iterable[Element | Event],
    correction: Correction,
    *,
    zero: Vector,
    tolerance: float,
    remarks: Iterable[str] = (),
) -> str:
    """The text of the compensated program, which carries `original`.

    `items` are the elements and events of the original in order, `zero` the program's zero in `base_link`, m,
    `tolerance` the largest distance of the pieces from the corrected contour, m. Raises InputError for a correction
    that is too steep.
    """
    writer = _Writer(correction, zero, tolerance, original.name)
    for item in items:
        if isinstance(item, Event):
            writer.event(item)
        else:
            writer.element(item)
    head = [f"({remark})" for remark in remarks]
    start = ["G21 G90 G91.1 G17 G94 G61"]
    return "\n".join([*head, *carry_original(original), *start, *writer.blocks, ""])


class _Writer:
    """Blocks so far, and the modal state behind them."""

    def __init__(self, correction: Correction, zero: Vector, tolerance: float, name: str) -> None:
        self.blocks: list[str] = []
        self._correction = correction
        self._zero = np.array(zero)
        self._tolerance = tolerance
        self._name = name
        self._index = 0
        self._path = 0.0
        self._at: Array | None = None  # where the last block ends, as it is written, mm
        self._feed = ""
        self._plane = Plane.XY
        self._mode = "G61"

    def event(self, event: Event) -> None:
        if event.kind == "message":
            self.blocks.append(f"(MSG, {event.text})")
        elif event.kind in _NUMBER_WORDS:
            self.blocks.append(f"{_NUMBER_WORDS[event.kind]}{event.value:.10g}")
        elif event.kind in _EVENT_WORDS:
            self.blocks.append(_EVENT_WORDS[event.kind])

    def element(self, element: Element) -> None:
        self.blocks.append(element_comment(self._index))
        begin, end = self._path, self._path + element.length
        if self._at is None:
            self._at = self._written(np.array(element.start))
        if element.traverse:
            self._straight("G0", element, np.array(element.end), 0.0)
        else:
            self._pieces(element, begin, end)
        self._index += 1
        self._path = end

    def _pieces(self, element: Element, begin: float, end: float) -> None:
        span = next((span for span in self._correction.spans if span.begin <= begin and end <= span.end), None)
        if span is None:
            self._as_it_is(element)
            return
        count = max(9, math.ceil(LOOKED_AT * element.length / span.step) + 1)
        looked_at: Array = np.linspace(begin, end, count, dtype=np.float64)
        c = self._correction.at(looked_at)
        if float(np.abs(c).max()) < NOTHING:
            self._as_it_is(element)
            return
        self._refuse_steep(element, looked_at, c)
        longest = np.minimum(max(LONGEST, span.step), self._longest(element, looked_at))
        cuts = _cuts(looked_at, np.maximum(longest, SHORTEST))
        ends = self._ends(element, begin, cuts)
        middles = self._corrected(element, begin, 0.5 * (cuts[:-1] + cuts[1:]))
        for number, (point, middle, length) in enumerate(zip(ends, middles, np.diff(cuts).tolist(), strict=True), 1):
            self._set_mode(element.path_mode if number == len(ends) else PathMode("G61"))
            self._piece(element, length, point, middle)

    def _as_it_is(self, element: Element) -> None:
        self._set_mode(element.path_mode)
        self._piece(element, element.length, np.array(element.end), None)

    def _refuse_steep(self, element: Element, s: Array, c: Array) -> None:
        slope = float(np.sqrt((self._correction.at(s, 1) ** 2).sum(axis=1)).max())
        size = float(np.sqrt((c**2).sum(axis=1)).max())
        radius = element.radius if isinstance(element, Arc) else math.inf
        if slope > STEEPEST or size > LARGEST * radius:
            raise InputError(
                f"{self._name}:{element.line}: the correction, {size * 1e6:.4g} um at most, is too large or too steep "
                f"({slope:.3g} of the way): a lower feed or fewer passes help"
            )

    def _longest(self, element: Element, s: Array) -> Array:
        """The longest pieces that keep the tolerance, m, at `s`.

        Of length h, a line through the outer sides is off by h^2 / 12 times the second derivative at its ends; an arc
        through three points by h^3 / 125 times the third at most. A little less is taken, because they change.
        """
        bend = np.abs(self._straight_part(element, self._correction.at(s, 2)))
        longest = np.sqrt(LESS * 12.0 * self._tolerance / np.maximum(bend, 1e-12))
        if isinstance(element, Arc):
            third = np.sqrt((self._correction.at(s, 3) ** 2).sum(axis=1))
            longest = np.minimum(longest, np.cbrt(LESS * 125.0 * self._tolerance / np.maximum(third, 1e-12)))
        return np.asarray(longest)

    def _straight_part(self, element: Element, vectors: Array) -> Array:
        """Size of what pieces of `element` approximate by straight lines, (n,): on arcs what is along their axis."""
        if isinstance(element, Arc):
            return np.asarray(vectors[:, (element.plane + 2) % 3])
        return np.asarray(np.sqrt((vectors**2).sum(axis=1)))

    def _corrected(self, element: Element, begin: float, s: Array) -> Array:
        points = np.array([element.position(place - begin) for place in s.tolist()])
        return np.asarray(points + self._correction.at(s))

    def _ends(self, element: Element, begin: float, cuts: Array) -> Array:
        """Where the pieces end, (n, 3): on the corrected contour, to the outer side of what they run straight."""
        points = self._corrected(element, begin, cuts[1:])
        lengths = np.diff(cuts)
        around = 0.5 * (lengths + np.append(lengths[1:], lengths[-1]))
        shift = -(around**2)[:, None] / 12.0 * self._correction.at(cuts[1:], 2)
        if isinstance(element, Arc):
            axis = (element.plane + 2) % 3
            shift[:, [(axis + 1) % 3, (axis + 2) % 3]] = 0.0
        return np.asarray(points + shift)

    def _piece(self, element: Element, length: float, end: Array, middle: Array | None) -> None:
        """One block: `length` (m) of the contour, up to `end`; an arc by way of `middle`, or the element's own."""
        if isinstance(element, Arc):
            self._arc(element, length, end, middle)
        else:
            self._straight("G1", element, end, length)

    def _straight(self, code: str, element: Element, end: Array, length: float) -> None:
        assert self._at is not None
        to = self._written(end)
        feed = ""
        if code == "G1":
            if not (to != self._at).any():
                return
            feed = self._feed_word(element, float(np.linalg.norm(to - self._at)) * 1e-3, length)
        self._at = to
        self.blocks.append(f"N{element.line} {code} {_words('XYZ', to)}{feed}")

    def _arc(self, element: Arc, length: float, end: Array, middle: Array | None) -> None:
        assert self._at is not None
        to = self._written(end)
        plane = element.plane
        first, second, axis = plane, (plane + 1) % 3, (plane + 2) % 3
        if middle is None:
            center = (np.array(element.center) - self._zero) * 1e3
            turned = element.sweep
        else:
            found = _circle(self._at[[first, second]], self._mm(middle)[[first, second]], to[[first, second]])
            if found is None:
                self._straight("G1", element, end, length)
                return
            center = np.zeros(3)
            center[[first, second]], turned = found
        self._set_plane(plane)
        offsets = center - self._at
        radius = math.hypot(offsets[first], offsets[second])
        angle = abs(turned)
        travelled = math.hypot(radius * angle, to[axis] - self._at[axis]) * 1e-3
        turns = f" P{math.ceil(angle / math.tau - 1e-9)}" if angle > math.tau * (1.0 + 1e-9) else ""
        code = "G3" if turned > 0.0 else "G2"
        center_words = _words("IJK"[first] + "IJK"[second], offsets[[first, second]])
        feed = self._feed_word(element, travelled, length)
        self._at = to
        self.blocks.append(f"N{element.line} {code} {_words('XYZ', to)} {center_words}{turns}{feed}")

    def _feed_word(self, element: Element, travelled: float, length: float) -> str:
        text = f"{element.feed * travelled / length * 60e3:.{FEED_DECIMALS}f}".rstrip("0").rstrip(".")
        if text == self._feed:
            return ""
        self._feed = text
        return f" F{text}"

    def _set_mode(self, mode: PathMode) -> None:
        """Without the joining of lines (Q of G64), which would take the correction away."""
        word = mode.code
        if mode.tolerance is not None:
            word += f" P{_number(mode.tolerance * 1e3)} Q0"
        if word != self._mode:
            self._mode = word
            self.blocks.append(word)

    def _set_plane(self, plane: Plane) -> None:
        if plane != self._plane:
            self._plane = plane
            self.blocks.append(_PLANE_WORDS[plane])

    def _mm(self, point: Array) -> Array:
        return np.asarray((point - self._zero) * 1e3)

    def _written(self, point: Array) -> Array:
        """Program coordinates, mm, as they are written."""
        return np.round(self._mm(point), DECIMALS) + 0.0


def _cuts(s: Array, longest: Array) -> Array:
    """Places from the first to the last of `s` that are no further apart than `longest` there."""
    steps = np.diff(s) * 0.5 * (1.0 / longest[:-1] + 1.0 / longest[1:])
    needed = np.concatenate(([0.0], np.cumsum(steps)))
    pieces = max(1, math.ceil(needed[-1]))
    cuts = np.interp(np.linspace(0.0, needed[-1], pieces + 1), needed, s)
    cuts[0], cuts[-1] = s[0], s[-1]
    return cuts


def _circle(start: Array, middle: Array, end: Array) -> tuple[Array, float] | None:
    """Center (2,) of the circle through three points, angle of travel (rad, + ccw); None for a straight line."""
    chord, leg = end - start, middle - start
    length = float(np.hypot(*chord))
    if length == 0.0:
        return None
    along, across = chord / length, np.array([-chord[1], chord[0]]) / length
    x, y = float(leg @ along) - 0.5 * length, float(leg @ across)  # of the middle, from the middle of the chord
    if abs(y) < STRAIGHT * length:
        return None
    half = 0.5 * length
    offset = (x * x + y * y - half * half) / (2.0 * y)
    angle = 2.0 * math.atan2(half, abs(offset))
    if offset * y > 0.0:  # the center lies on the side of the middle point: more than half a turn
        angle = math.tau - angle
    return start + half * along + offset * across, -math.copysign(angle, y)


def _words(letters: str, values: Array) -> str:
    return " ".join(f"{letter}{_number(value)}" for letter, value in zip(letters, values.tolist(), strict=True))


def _number(value: float) -> str:
    text = f"{value:.{DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
