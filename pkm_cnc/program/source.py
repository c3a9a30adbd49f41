"""A part program as a stream: read anew whenever it is asked for, so that memory does not grow with the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pkm_cnc.errors import InputError
from pkm_cnc.program.blocks import Program
from pkm_cnc.program.interpreter import ProgramParameters, read_elements, read_marked_elements
from pkm_cnc.program.original import carried_original, is_marked, led_by_length, led_by_marks
from pkm_cnc.program.toolpath import Element, Event, Line, Toolpath
from pkm_cnc.records import Vector
from pkm_cnc.tolerances import ZERO_LENGTH

__all__ = ["ProgramSource", "approach"]

_GROUPS = {
    "spindle_speed": "speed",
    "spindle_clockwise": "spindle",
    "spindle_counterclockwise": "spindle",
    "spindle_stop": "spindle",
    "tool_select": "tool",
    "tool_change": "change",
    "mist_on": "mist",
    "flood_on": "flood",
    "coolant_off": "coolant",
}
"""Events that stay in force, and what they give way to: the next of their group."""


@dataclass(frozen=True)
class ProgramSource:
    """A part program for a machine; `start`, `zero`, `rapid`, `parameters` as for `interpret`.

    `from_line`: it is run from the first motion whose line is not before that; 0 = from its beginning.
    """

    program: Program
    start: Vector
    zero: Vector
    rapid: float
    parameters: ProgramParameters
    from_line: int = 0

    def items(self) -> Iterator[Element | Event]:
        """The elements in order, each starting exactly where the one before ends, and the events between them.

        With `from_line` spindle, coolant and tool are first set as the lines left out do, then the TCP goes with a
        rapid to where the first motion begins. Raises ProgramError, InputError for a program without motion (there).
        """
        items = self._led()
        empty = True
        for item in self._from_line(items) if self.from_line else items:
            empty = empty and isinstance(item, Event)
            yield item
        if empty:
            where = f" at or after line {self.from_line} (from_line)" if self.from_line else ""
            raise InputError(f"part program {self.program.name}: contains no motion{where}")

    def _led(self) -> Iterator[Element | Event]:
        """The items of the program; the motions with their places on the contour that it carries, if it does."""
        original = carried_original(self.program)
        if original is None:
            return self._read(self.program)
        contour = (item for item in self._read(original) if not isinstance(item, Event))
        if is_marked(self.program):
            items = read_marked_elements(
                self.program, start=self.start, zero=self.zero, rapid=self.rapid, parameters=self.parameters
            )
            return led_by_marks(items, contour, self.program.name)
        lengths = [
            sum(item.length for item in self._read(program) if not isinstance(item, Event))
            for program in (original, self.program)
        ]
        if not all(lengths):
            return self._read(self.program if lengths[0] else original)
        return led_by_length(self._read(self.program), contour, lengths[0] / lengths[1])

    def _read(self, program: Program) -> Iterator[Element | Event]:
        return read_elements(program, start=self.start, zero=self.zero, rapid=self.rapid, parameters=self.parameters)

    def _from_line(self, items: Iterator[Element | Event]) -> Iterator[Element | Event]:
        in_force: dict[str, Event] = {}
        for item in items:
            if not isinstance(item, Event):
                if item.line >= self.from_line:
                    yield from self._resumed(item, items, in_force)
                    return
            elif item.kind in _GROUPS:
                in_force.pop(_GROUPS[item.kind], None)  # to the end: they happen again in the order of the last ones
                if item.kind == "coolant_off":
                    in_force.pop("mist", None)
                    in_force.pop("flood", None)
                in_force[_GROUPS[item.kind]] = item

    def _resumed(
        self, first: Element, others: Iterator[Element | Event], in_force: dict[str, Event]
    ) -> Iterator[Element | Event]:
        path_length = 0.0
        for event in in_force.values():
            yield event._replace(path_length=path_length)
        rapid = approach(self.start, first, self.rapid)
        for element in (first,) if rapid is None else (rapid, first):
            yield element
            path_length += element.length
        for item in others:
            if isinstance(item, Event):
                yield item._replace(path_length=path_length)
            else:
                yield item
                path_length += item.length

    def toolpath(self) -> Toolpath:
        """All of it in memory. Raises as `items`."""
        items = list(self.items())
        return Toolpath(
            tuple(item for item in items if not isinstance(item, Event)),
            tuple(item for item in items if isinstance(item, Event)),
        )


def approach(point: Vector, first: Element, rapid: float) -> Line | None:
    """The rapid (m/s) from `point` (m) to where `first` begins; None for a TCP that stands there."""
    line = Line(first.line, point, first.start, rapid, traverse=True, evaluated=False)
    return line if line.length >= ZERO_LENGTH else None
