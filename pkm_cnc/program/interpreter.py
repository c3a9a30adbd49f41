"""Blocks -> modal state -> toolpath: the machine-independent reading of a part program.

The language is RS-274 as LinuxCNC reads it; docs/part_programs.md has all of it. At the start G17, G21, G90 and G91.1
hold, there is no motion mode and no feed. What a block holds is done in the order of NIST RS274/NGC version 3, table 8,
not in that of its words. Millimetres and inches end here: what leaves is m and m/s in `base_link`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter
from pkm_cnc.program.arcs import LARGEST_TURNS, ArcError, ArcFeed, ArcWords, arc_about_center, arc_of_radius
from pkm_cnc.program.blocks import Block, Program
from pkm_cnc.program.codes import ARCS, EVENTS, FEED, NO_MOTION, TRAVERSE, words_by_meaning
from pkm_cnc.program.expressions import WHOLE
from pkm_cnc.program.flow import executed_blocks
from pkm_cnc.program.original import Mark, element_of_comment
from pkm_cnc.program.parameters import Key, Parameters
from pkm_cnc.program.toolpath import EXACT_PATH, Element, Event, EventKind, Line, PathMode, Plane, Toolpath
from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ARC_RADII_INCH, ARC_RADII_MM, ZERO_LENGTH

__all__ = [
    "NOT_EVALUATED_COMMENT",
    "Motion",
    "ProgramParameters",
    "interpret",
    "read_elements",
    "read_marked_elements",
    "read_motions",
]

NOT_EVALUATED_COMMENT = "(pkm_cnc: not evaluated)"
"""A comment with this text, in any case and spacing, takes the contour error of its block's motion out of account."""

MM_PER_M = 1000.0
MM_PER_MIN = 60_000.0  # per m/s
MM_PER_INCH = 25.4

_AXES = "XYZ"
_OFFSETS = "IJK"
_GEOMETRY = frozenset("XYZIJKR")
_ARC_ONLY = "IJKR"
_PLAIN = frozenset("XYZIJKRF") | {"motion"}
_PLANES = {17.0: Plane.XY, 18.0: Plane.ZX, 19.0: Plane.YZ}
_PLANE_CODES = {plane: f"G{code:g}" for code, plane in _PLANES.items()}
_NOT_EVALUATED = "".join(NOT_EVALUATED_COMMENT.split()).lower()
_MESSAGE = "(msg,"

Motion = Line | ArcFeed
"""A motion as programmed."""


@dataclass(frozen=True)
class ProgramParameters:
    """How part programs are read: the section `program` of a machine file."""

    g28_pose: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "where G28 goes: TCP in base_link", unit="m", minimum=-100.0, maximum=100.0
    )
    g30_pose: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "where G30 goes: TCP in base_link", unit="m", minimum=-100.0, maximum=100.0
    )
    block_delete: bool = parameter(True, "skip the blocks that begin with a slash; otherwise they are run")
    optional_stop: bool = parameter(
        False, "stop at M1 and wait for the operator, as at M0, where there is one; otherwise M1 is passed"
    )
    block_limit: int = parameter(
        1_000_000,
        "by how many lines a program may run more than it has, in loops and subroutines, before it is taken to run for "
        "ever; the default is some 20 s of reading and many hours of machining",
        unit="blocks",
        minimum=0,
        maximum=1_000_000_000,
    )


def interpret(
    program: Program, *, start: Vector, zero: Vector, rapid: float, parameters: ProgramParameters | None = None
) -> Toolpath:
    """The toolpath of a program.

    `start` is where the TCP stands when motion begins, `zero` where the program's x = y = z = 0 lies (both m, in
    `base_link`), `rapid` the path speed of G0 (m/s). A motion to where the tool already is makes no element.
    Raises ProgramError for a block that cannot be run, InputError for a program without motion.
    """
    elements: list[Element] = []
    events: list[Event] = []
    for item in read_elements(program, start=start, zero=zero, rapid=rapid, parameters=parameters):
        if isinstance(item, Event):
            events.append(item)
        else:
            elements.append(item)
    if not elements:
        raise InputError(f"part program {program.name}: contains no motion")
    return Toolpath(tuple(elements), tuple(events))


def read_marked_elements(
    program: Program, *, start: Vector, zero: Vector, rapid: float, parameters: ProgramParameters
) -> Iterator[Element | Event | Mark]:
    """As `read_elements`, with the marks of a compensated program (`original`)."""
    for item in _Interpreter(program, start, zero, rapid, parameters).run():
        if isinstance(item, ArcFeed):
            yield from item.arcs
        elif isinstance(item, Event | Mark) or item.length > 0.0:
            yield item


def read_elements(
    program: Program,
    *,
    start: Vector,
    zero: Vector,
    rapid: float,
    parameters: ProgramParameters | None = None,
) -> Iterator[Element | Event]:
    """The elements of the toolpath and the events between them, each made when it is asked for and not kept.

    Arguments and errors are those of `interpret`, but that a program may be without motion.
    """
    for item in read_motions(program, start=start, zero=zero, rapid=rapid, parameters=parameters):
        if isinstance(item, ArcFeed):
            yield from item.arcs
        elif isinstance(item, Event) or item.length > 0.0:
            yield item


def read_motions(
    program: Program,
    *,
    start: Vector,
    zero: Vector,
    rapid: float,
    parameters: ProgramParameters | None = None,
) -> Iterator[Motion | Event]:
    """Every motion of a program as it is programmed, and every event, as they are read; else as `read_elements`.

    A straight motion to where the tool already is (nearer than ZERO_LENGTH) comes as a line of length 0.
    """
    for item in _Interpreter(program, start, zero, rapid, parameters or ProgramParameters()).run():
        if not isinstance(item, Mark):
            yield item


class _Interpreter:
    """The modal state, and what a block does to it."""

    def __init__(
        self, program: Program, start: Vector, zero: Vector, rapid: float, parameters: ProgramParameters
    ) -> None:
        self._program = program
        self._parameters = parameters
        self._zero = zero
        self._rapid = rapid
        self._position = start
        self._origin = zero  # where x = y = z = 0 of the words lies: zero, moved by G92
        self._path_length = 0.0
        self._line = 0
        self._mode: float | None = None
        self._plane = Plane.XY
        self._unit = 1.0  # mm
        self._absolute = True
        self._absolute_center = False
        self._path_mode = EXACT_PATH
        self._feed = 0.0
        self._speed = 0.0  # of the spindle, rpm
        self._tool = 0.0

    def run(self) -> Iterator[Motion | Event | Mark]:
        delete, limit = self._parameters.block_delete, self._parameters.block_limit
        for block in executed_blocks(self._program, Parameters(self._known()), block_delete=delete, block_limit=limit):
            self._line = block.line
            words = words_by_meaning(block)
            if block.comments:
                yield from self._messages(block)
            if "F" in words:
                self._feed = self._not_negative(block, words, "F", "the feed") * self._unit / MM_PER_MIN
            machine_coordinates = False
            if not words.keys() <= _PLAIN:
                self._check_takers(block, words)
                yield from self._machine_words(block, words)
                self._modes(block, words)
                machine_coordinates = words.get("non-modal") == 53.0
                yield from self._axis_words_without_motion(block, words)
            mode = words.get("motion")
            if mode is not None:
                self._mode = None if mode == NO_MOTION else mode
            # an arc's own word asks for a motion even alone: what is missing is then an error, not nothing to do
            if not _GEOMETRY.isdisjoint(words) or mode in ARCS or machine_coordinates:
                yield self._moved(self._motion(block, words, machine_coordinates))
            if "stop" in words:
                yield self._event(EVENTS[words["stop"]])
                if words["stop"] in (2.0, 30.0):
                    return

    def _moved(self, motion: Motion) -> Motion:
        self._position = motion.end
        for element in motion.arcs if isinstance(motion, ArcFeed) else (motion,):
            self._path_length += element.length
        return motion

    def _event(self, kind: EventKind, value: float | None = None, text: str = "") -> Event:
        return Event(self._line, kind, self._path_length, value, text)

    def _messages(self, block: Block) -> Iterator[Event | Mark]:
        for comment in block.comments:
            element = element_of_comment(comment)
            if element is not None:
                yield Mark(element)
            elif comment[: len(_MESSAGE)].lower() == _MESSAGE:
                yield self._event("message", text=comment[len(_MESSAGE) : -1].strip())

    # what concerns spindle, tool, coolant and time

    def _machine_words(self, block: Block, words: dict[str, float]) -> Iterator[Event]:
        if "S" in words:
            self._speed = self._not_negative(block, words, "S", "the spindle speed")
            yield self._event("spindle_speed", self._speed)
        if "T" in words:
            self._tool = float(self._whole(block, words, "T", "the tool"))
            yield self._event("tool_select", self._tool)
        if "tool change" in words:
            yield self._event("tool_change", self._tool)
        if "spindle" in words:
            code = words["spindle"]
            yield self._event(EVENTS[code], None if code == 5.0 else self._speed)
        if "coolant" in words:
            yield self._event(EVENTS[words["coolant"]])
        if words.get("non-modal") == 4.0:
            if "P" not in words:
                raise block.error("G4 needs its time: P, in seconds")
            yield self._event("dwell", self._not_negative(block, words, "P", "the time"))

    # the modes

    def _modes(self, block: Block, words: dict[str, float]) -> None:
        """Take over what stays in force; the words of neutral states (G40, G49, G54, G94) need nothing done."""
        if "plane" in words:
            self._plane = _PLANES[words["plane"]]
        if "units" in words:
            self._unit = MM_PER_INCH if words["units"] == 20.0 else 1.0
        if "path mode" in words:
            self._path_mode = self._read_path_mode(block, words)
        if "distance mode" in words:
            self._absolute = words["distance mode"] == 90.0
        if "arc distance mode" in words:
            self._absolute_center = words["arc distance mode"] == 90.1

    def _read_path_mode(self, block: Block, words: dict[str, float]) -> PathMode:
        code = f"G{words['path mode']:g}"
        if code != "G64":
            return PathMode(code)
        if "Q" in words and "P" not in words:
            raise block.error("G64 with Q needs P, the largest deviation from the path")
        if "P" not in words:
            return PathMode(code)
        tolerance = self._not_negative(block, words, "P", "the deviation from the path")
        naive_cam = self._not_negative(block, words, "Q", "the deviation of the points") if "Q" in words else tolerance
        return PathMode(code, tolerance * self._unit / MM_PER_M, naive_cam * self._unit / MM_PER_M)

    # words of the axes that ask for something else than the motion in force

    def _axis_words_without_motion(self, block: Block, words: dict[str, float]) -> Iterator[Motion]:
        code = words.get("non-modal", 4.0)
        if code in (4.0, 53.0):
            return
        axes = {axis: words[axis] for axis in _AXES if axis in words}
        if code != 92.1 and words.get("motion", NO_MOTION) != NO_MOTION:
            raise block.error(f"G{code:g} and G{words['motion']:g} both take the words of the axes: make it two blocks")
        if code == 92.1:
            self._origin = self._zero
            return
        if code == 92.0:
            if not axes:
                raise block.error("G92 needs X, Y or Z: what the position is to be called")
            self._rename(axes)
        else:
            yield from self._reference(
                block, axes, self._parameters.g28_pose if code == 28.0 else self._parameters.g30_pose
            )
        for axis in axes:
            del words[axis]

    def _rename(self, axes: dict[str, float]) -> None:
        """G92: the origin comes to lie so that the position has these coordinates."""
        x, y, z = (
            self._position[index] - axes[axis] * self._unit / MM_PER_M if axis in axes else self._origin[index]
            for index, axis in enumerate(_AXES)
        )
        self._origin = (x, y, z)

    def _reference(self, block: Block, axes: dict[str, float], pose: tuple[float, ...]) -> Iterator[Motion]:
        """G28, G30: by way of the point that is programmed, if one is, to the pose; only in the axes that are named."""
        end = (pose[0], pose[1], pose[2])
        if axes:
            by_way_of = self._target(axes, self._origin, self._absolute)
            yield self._moved(self._straight(block, by_way_of, TRAVERSE, self._rapid))
            x, y, z = (pose[index] if axis in axes else self._position[index] for index, axis in enumerate(_AXES))
            end = (x, y, z)
        yield self._moved(self._straight(block, end, TRAVERSE, self._rapid))

    def _check_takers(self, block: Block, words: dict[str, float]) -> None:
        """Refuse a P or Q that no word of the block takes, and a P that two could."""
        arc = words.get("motion", self._mode) in ARCS and not (_GEOMETRY | {"motion"}).isdisjoint(words)
        possible = {"G4": words.get("non-modal") == 4.0, "G64": words.get("path mode") == 64.0, "an arc": arc}
        takers = [name for name, takes in possible.items() if takes]
        if "P" in words and not takers:
            raise block.error("P belongs to G4, to G64, and to an arc (G2, G3)")
        if "P" in words and len(takers) > 1:
            raise block.error(f"P could belong to {' and to '.join(takers)}: make it two blocks")
        if "Q" in words and not possible["G64"]:
            raise block.error("Q belongs to G64")

    # motion

    def _motion(self, block: Block, words: dict[str, float], machine_coordinates: bool) -> Motion:
        mode = self._mode
        if mode is None:
            raise block.error("a motion needs G0, G1, G2 or G3 before it or in its block")
        speed = self._rapid if mode == TRAVERSE else self._feed
        if speed <= 0.0:
            raise block.error(f"G{mode:g} needs a feed: no F word above 0 in this block or before")
        if machine_coordinates:
            self._check_machine_coordinates(block, words, mode)
            end = self._target(words, (0.0, 0.0, 0.0), True)
        else:
            end = self._target(words, self._origin, self._absolute)
        if mode in ARCS:
            return self._arc(block, words, end)
        for letter in _ARC_ONLY:
            if letter in words:
                raise block.error(f"{letter} belongs to G2 and G3, the motion here is G{mode:g}")
        return self._straight(block, end, mode, speed)

    def _target(self, words: dict[str, float], origin: Vector, absolute: bool) -> Vector:
        x, y, z = base = self._position
        unit = self._unit
        if absolute:
            base = origin
        return (
            base[0] + words["X"] * unit / MM_PER_M if "X" in words else x,
            base[1] + words["Y"] * unit / MM_PER_M if "Y" in words else y,
            base[2] + words["Z"] * unit / MM_PER_M if "Z" in words else z,
        )

    def _straight(self, block: Block, end: Vector, mode: float, speed: float) -> Line:
        traverse = mode == TRAVERSE
        evaluated = mode == FEED and not (block.comments and _marked_not_evaluated(block))
        line = Line(block.line, self._position, end, speed, traverse, evaluated, self._path_mode)
        if line.length < ZERO_LENGTH:
            return Line(block.line, self._position, self._position, speed, traverse, evaluated, self._path_mode)
        return line

    def _check_machine_coordinates(self, block: Block, words: dict[str, float], mode: float) -> None:
        if mode in ARCS:
            raise block.error(f"G53 belongs to G0 and G1, the motion here is G{mode:g}")
        if not any(axis in words for axis in _AXES):
            raise block.error("G53 needs X, Y or Z")

    def _arc(self, block: Block, words: dict[str, float], end: Vector) -> ArcFeed:
        plane = self._plane
        own = [_OFFSETS[plane], _OFFSETS[(plane + 1) % 3]]
        for letter in _OFFSETS:
            if letter in words and letter not in own:
                raise block.error(
                    f"{letter} is not in the plane {_PLANE_CODES[plane]}: its arcs have {' '.join(sorted(own))}"
                )
        by_center, by_radius = any(letter in words for letter in own), "R" in words
        if by_center == by_radius:
            both = ", not both" if by_center else ""
            raise block.error(f"an arc takes a center ({' '.join(sorted(own))}) or a radius (R){both}")
        turns = self._whole(block, words, "P", "the number of turns") if "P" in words else 1
        if not 1 <= turns <= LARGEST_TURNS:
            raise block.error(f"the number of turns, P{turns}, is not from 1 to {LARGEST_TURNS}")
        evaluated = not (block.comments and _marked_not_evaluated(block))
        direction = 1.0 if self._mode == ARCS[1] else -1.0
        common = ArcWords(block.line, plane, direction, turns, self._feed, evaluated, self._path_mode)
        try:
            if by_radius:
                return arc_of_radius(common, self._position, end, words["R"] * self._unit / MM_PER_M)
            i, j = self._center(block, words, own)
            radii = ARC_RADII_MM if self._unit == 1.0 else ARC_RADII_INCH
            return arc_about_center(common, self._position, end, i, j, radii)
        except ArcError as error:
            raise block.error(str(error)) from None

    def _center(self, block: Block, words: dict[str, float], own: list[str]) -> list[float]:
        """From the start to the center, m, along the plane's axes."""
        if not self._absolute_center:
            return [words.get(letter, 0.0) * self._unit / MM_PER_M for letter in own]
        missing = [letter for letter in own if letter not in words]
        if missing:
            raise block.error(f"with G90.1 a center needs both its coordinates: {missing[0]} is missing")
        start, origin = self._plane.coordinates(self._position), self._plane.coordinates(self._origin)
        return [
            origin[index] + words[letter] * self._unit / MM_PER_M - start[index] for index, letter in enumerate(own)
        ]

    # numbers

    def _not_negative(self, block: Block, words: dict[str, float], letter: str, name: str) -> float:
        number = words[letter]
        if number < 0.0:
            raise block.error(f"{name} {letter}{number:g} is negative")
        return number

    def _whole(self, block: Block, words: dict[str, float], letter: str, name: str) -> int:
        number = words[letter]
        if number < 0.0 or abs(number - round(number)) > WHOLE:
            raise block.error(f"{name}, {letter}{number:g}, is not a whole number from 0 on")
        return round(number)

    def _known(self) -> dict[Key, Callable[[], float]]:
        """The parameters that a program can read of its own state, in its length unit."""

        def in_units(vector: Callable[[], tuple[float, ...]], index: int) -> Callable[[], float]:
            return lambda: vector()[index] * MM_PER_M / self._unit

        vectors: dict[int, Callable[[], tuple[float, ...]]] = {
            5161: lambda: self._parameters.g28_pose,
            5181: lambda: self._parameters.g30_pose,
            5211: lambda: tuple(a - b for a, b in zip(self._origin, self._zero, strict=True)),
            5221: lambda: self._zero,
            5420: lambda: tuple(a - b for a, b in zip(self._position, self._origin, strict=True)),
        }
        known: dict[Key, Callable[[], float]] = {
            first + index: in_units(vector, index) for first, vector in vectors.items() for index in range(3)
        }
        known |= {f"_{axis}": known[5420 + index] for index, axis in enumerate(_AXES)}
        known |= {
            5220: lambda: 1.0,
            "_FEED": lambda: self._feed * MM_PER_MIN / self._unit,
            "_RPM": lambda: self._speed,
            "_METRIC": lambda: float(self._unit == 1.0),
            "_IMPERIAL": lambda: float(self._unit != 1.0),
            "_ABSOLUTE": lambda: float(self._absolute),
            "_INCREMENTAL": lambda: float(not self._absolute),
        }
        return known


def _marked_not_evaluated(block: Block) -> bool:
    return any("".join(comment.split()).lower() == _NOT_EVALUATED for comment in block.comments)
