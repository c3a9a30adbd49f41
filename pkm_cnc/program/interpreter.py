"""Blocks -> modal state -> toolpath: the machine-independent reading of a part program.

Read are `%`, N, G0 G1 G2 G3 (center I J relative to the start, or radius R), G17, G21, G90, F, M2, M30, X Y Z, as NIST
RS274/NGC version 3 means them; everything else is refused by name. At the start G17, G21 and G90 hold, there is no
motion mode and no feed. Millimetres and mm/min end here: what leaves is m and m/s in `base_link`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

from pkm_cnc.errors import InputError
from pkm_cnc.program.blocks import Block, Program, read_blocks
from pkm_cnc.program.toolpath import Arc, Element, Line, Toolpath
from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ARC_RADII, ZERO_LENGTH

__all__ = ["NOT_EVALUATED_COMMENT", "canonical_motion", "interpret", "read_motions"]

NOT_EVALUATED_COMMENT = "(pkm_cnc: not evaluated)"
"""A comment with this text, in any case and spacing, takes the contour error of its block's motion out of account."""

MM_PER_M = 1000.0
MM_PER_MIN = 60_000.0  # per m/s

_TRAVERSE, _FEED, _ARC_CW, _ARC_CCW = 0.0, 1.0, 2.0, 3.0
_ARCS = (_ARC_CW, _ARC_CCW)
_MODAL_GROUPS = {
    ("G", _TRAVERSE): "motion",
    ("G", _FEED): "motion",
    ("G", _ARC_CW): "motion",
    ("G", _ARC_CCW): "motion",
    ("G", 17.0): "plane",
    ("G", 21.0): "units",
    ("G", 90.0): "distance mode",
    ("M", 2.0): "end",
    ("M", 30.0): "end",
}
_VALUES = frozenset("FXYZIJR")
_GEOMETRY = frozenset("XYZIJR")
_NOT_EVALUATED = "".join(NOT_EVALUATED_COMMENT.split()).lower()


def interpret(program: Program, *, start: Vector, zero: Vector, rapid: float) -> Toolpath:
    """The toolpath of a program.

    `start` is where the TCP stands when motion begins, `zero` where the program's x = y = z = 0 lies (both m, in
    `base_link`), `rapid` the path speed of G0 (m/s). A motion to where the tool already is makes no element.
    Raises ProgramError for a block that cannot be run, InputError for a program without motion.
    """
    motions = read_motions(program, start=start, zero=zero, rapid=rapid)
    elements = tuple(motion for motion in motions if motion.length > 0.0)
    if not elements:
        raise InputError(f"part program {program.name}: contains no motion")
    return Toolpath(elements)


def read_motions(program: Program, *, start: Vector, zero: Vector, rapid: float) -> Iterator[Element]:
    """Every motion of a program as it is read; arguments and errors are those of `interpret`.

    A motion to where the tool already is (nearer than ZERO_LENGTH) comes as a line of length 0.
    """
    position, mode, feed = start, None, 0.0
    for block in read_blocks(program):
        words = _words_by_meaning(block)
        if "F" in words:
            feed = _feed(block, words["F"])
        mode = words.get("motion", mode)
        # an arc's own word asks for a motion even alone: what is missing is then an error, not nothing to do
        if not _GEOMETRY.isdisjoint(words) or words.get("motion") in _ARCS:
            motion = _motion(block, words, mode, position, zero, rapid if mode == _TRAVERSE else feed)
            position = motion.end
            yield motion
        if "end" in words:
            return


def canonical_motion(motions: Iterable[Element], zero: Vector) -> list[dict[str, Any]]:
    """The motions (of `read_motions`, or a toolpath) as `pkm_cnc check --json` lists them.

    Each has "kind" ("traverse", "feed", "arc"), "line", "end_mm" [x, y, z] relative to `zero` (m, in `base_link`) and
    "feed_mm_min" (for a traverse the rapid); an arc also "center_mm", relative to `zero` and as programmed if it is,
    "turns" (+1 counter-clockwise, -1 clockwise) and "plane".
    """
    return [_listed(motion, zero) for motion in motions]


def _listed(motion: Element, zero: Vector) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "kind": "arc" if isinstance(motion, Arc) else "traverse" if motion.traverse else "feed",
        "line": motion.line,
        "end_mm": _program_mm(motion.end, zero),
        "feed_mm_min": round(motion.feed * MM_PER_MIN, 9),
    }
    if isinstance(motion, Arc):
        entry["center_mm"] = _program_mm(motion.programmed_center or motion.center, zero)
        entry["turns"] = 1 if motion.sweep > 0.0 else -1
        entry["plane"] = "xy"
    return entry


def _program_mm(point: Vector, zero: Vector) -> list[float]:
    # a pm is far below the resolution of a program (1 nm); adding 0.0 turns -0.0 into 0.0
    return [round((value - origin) * MM_PER_M, 9) + 0.0 for value, origin in zip(point, zero, strict=True)]


def _words_by_meaning(block: Block) -> dict[str, float]:
    """The block's numbers by letter or, for G and M, by modal group. Raises ProgramError for what is not read here."""
    words: dict[str, float] = {}
    for word in block.words:
        letter, number = word
        meaning = letter if letter in _VALUES else _MODAL_GROUPS.get(word)
        if meaning is None:
            raise block.error(_why_not_supported(letter, number))
        if meaning in words:
            if meaning in _VALUES:
                raise block.error(f"two {letter} words")
            both = f"{letter}{words[meaning]:g} and {letter}{number:g}"
            raise block.error(f"{both} are of one modal group ({meaning}), only one is allowed in a block")
        words[meaning] = number
    return words


def _why_not_supported(letter: str, number: float) -> str:
    if letter == "N":
        return "N word not at the start of the block"
    known = [f"{letter}{code:g}" for group, code in _MODAL_GROUPS if group == letter]
    spelled = f"{letter}{number:.12g}"
    return f"{spelled} is not supported" + (f" (known: {' '.join(known)})" if known else "")


def _feed(block: Block, number: float) -> float:
    if number < 0.0:
        raise block.error(f"the feed F{number:g} is negative")
    return number / MM_PER_MIN


def _motion(
    block: Block, words: dict[str, float], mode: float | None, position: Vector, zero: Vector, speed: float
) -> Element:
    if mode is None:
        raise block.error("a motion needs G0, G1, G2 or G3 before it or in its block")
    if speed <= 0.0:
        raise block.error(f"G{mode:g} needs a feed: no F word above 0 in this block or before")
    x, y, z = position
    x0, y0, z0 = zero
    end = (
        x0 + words["X"] / MM_PER_M if "X" in words else x,
        y0 + words["Y"] / MM_PER_M if "Y" in words else y,
        z0 + words["Z"] / MM_PER_M if "Z" in words else z,
    )
    evaluated = mode != _TRAVERSE and not (block.comments and _marked_not_evaluated(block))
    if mode in _ARCS:
        return _arc(block, words, 1.0 if mode == _ARC_CCW else -1.0, position, end, speed, evaluated)
    for letter in "IJR":
        if letter in words:
            raise block.error(f"{letter} belongs to G2 and G3, the motion here is G{mode:g}")
    line = Line(block.line, position, end, speed, mode == _TRAVERSE, evaluated)
    if line.length < ZERO_LENGTH:
        return Line(block.line, position, position, speed, mode == _TRAVERSE, evaluated)
    return line


def _marked_not_evaluated(block: Block) -> bool:
    return any("".join(comment.split()).lower() == _NOT_EVALUATED for comment in block.comments)


def _arc(
    block: Block, words: dict[str, float], direction: float, start: Vector, end: Vector, feed: float, evaluated: bool
) -> Arc:
    """The arc of one block; `direction` is +1 counter-clockwise, -1 clockwise.

    An arc that does not close is put through exactly its start and end: its center lies on their perpendicular
    bisector, for I and J at the point of it nearest to the programmed center. Where that would take the arc further
    than ARC_RADII off the programmed circle (a long arc between ends close together) the block is refused.
    """
    by_center, by_radius = "I" in words or "J" in words, "R" in words
    if by_center == by_radius:
        raise block.error("an arc takes a center (I J) or a radius (R)" + (", not both" if by_center else ""))
    if abs(end[2] - start[2]) >= ZERO_LENGTH:
        raise block.error("a helix (an arc with a Z word that changes z) is not supported")
    end = (end[0], end[1], start[2])
    dx, dy = end[0] - start[0], end[1] - start[1]
    chord = math.sqrt(dx * dx + dy * dy)
    i, j = words.get("I", 0.0) / MM_PER_M, words.get("J", 0.0) / MM_PER_M
    if chord < ZERO_LENGTH:
        center = _center_of_full_circle(block, by_radius, start, i, j)
        return Arc(block.line, start, start, feed, False, evaluated, center, direction * math.tau)
    if by_radius:
        left = direction * _distance_to_chord(block, words["R"] / MM_PER_M, chord)
    else:
        left = _center_left_of_chord(block, direction, i, j, dx, dy, chord)
    center = (0.5 * (start[0] + end[0]) - left * dy / chord, 0.5 * (start[1] + end[1]) + left * dx / chord, start[2])
    sweep = 2.0 * direction * math.atan2(0.5 * chord, direction * left)
    programmed = (start[0] + i, start[1] + j, start[2]) if by_center else None
    return Arc(block.line, start, end, feed, False, evaluated, center, sweep, programmed)


def _center_of_full_circle(block: Block, by_radius: bool, start: Vector, i: float, j: float) -> Vector:
    if by_radius:
        raise block.error("an arc with R needs an end other than its start: a full circle takes I J")
    if math.sqrt(i * i + j * j) < ZERO_LENGTH:
        raise block.error("the arc's radius is zero")
    return start[0] + i, start[1] + j, start[2]


def _distance_to_chord(block: Block, radius: float, chord: float) -> float:
    """Distance from center to chord (m), + for the shorter arc (R > 0), - for the longer (R < 0)."""
    if chord - 2.0 * abs(radius) > ARC_RADII:
        raise block.error(
            f"radius too small: the end is {_mm(chord)} from the start, twice the radius is {_mm(2.0 * abs(radius))}"
        )
    return math.copysign(math.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0)), radius)


def _center_left_of_chord(
    block: Block, direction: float, i: float, j: float, dx: float, dy: float, chord: float
) -> float:
    """Distance of the programmed center from the chord (m), + to the left of the way from start to end."""
    at_start, at_end = math.sqrt(i * i + j * j), math.sqrt((i - dx) * (i - dx) + (j - dy) * (j - dy))
    radii = f"{_mm(at_start)} at its start, {_mm(at_end)} at its end"
    if min(at_start, at_end) < ZERO_LENGTH:
        raise block.error(f"the arc's radius is zero: {radii}")
    if abs(at_start - at_end) > ARC_RADII:
        difference = _mm(abs(at_start - at_end))
        raise block.error(f"the arc's radii disagree: {radii}, difference {difference} (at most {_mm(ARC_RADII)})")
    left = (dx * j - dy * i) / chord
    shift = abs((dx * i + dy * j) / chord - 0.5 * chord)
    if direction * left <= 0.0 and shift > ARC_RADII:
        raise block.error(
            f"no circle through start and end, {_mm(chord)} apart, is near the programmed one: radius {radii}; "
            "make the radii equal, or for a full circle the end equal to the start"
        )
    return left


def _mm(length: float) -> str:
    return f"{length * MM_PER_M:.6f} mm"
