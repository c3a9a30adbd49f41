"""The contour that a part program carries to be judged by, and where on it each of its motions belongs.

A compensated program moves along another path than the one it is judged by. It carries the program that it was made
from line by line in comments "(pkm_cnc original: ...)", whose own parentheses are written as braces, and before the
motions that stand for element i of that program's contour, from 0, the comment "(pkm_cnc element: i)". An ordinary CNC
ignores both. Where there are no such marks, the motions go along the contour by their share of the path length.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from pkm_cnc.errors import InputError
from pkm_cnc.program.blocks import Program
from pkm_cnc.program.toolpath import Element, Event, Place
from pkm_cnc.tolerances import TIE

__all__ = [
    "Mark",
    "carried_original",
    "carry_original",
    "element_comment",
    "element_of_comment",
    "is_marked",
    "led_by_length",
    "led_by_marks",
    "with_reference",
]

_ORIGINAL = "(pkm_cnc original:"
_ELEMENT = "(pkm_cnc element:"
_TO_COMMENT = str.maketrans("(){}", "{}[]")
_FROM_COMMENT = str.maketrans("{}", "()")


class Mark(NamedTuple):
    """Among the items of a program: what follows stands for this element of the original contour, counted from 0."""

    element: int


def carry_original(program: Program) -> list[str]:
    """The comments that carry `program`; braces in its comments come back as brackets."""
    return [f"{_ORIGINAL} {line.translate(_TO_COMMENT)})" for line in program.text.splitlines()]


def with_reference(program: Program, reference: Program) -> Program:
    """`program`, to be judged by the contour of `reference`, which is run in the same order.

    Its lines stay where they are, the reference is carried behind them in place of what it carried before.
    """
    lines = ["" if line.startswith((_ORIGINAL, _ELEMENT)) else line for line in program.text.splitlines()]
    return Program(program.name, "\n".join([*lines, *carry_original(reference), ""]))


def carried_original(program: Program) -> Program | None:
    """The program that `program` was made from, or None; it has the same name, for messages."""
    lines = [line for line in program.text.splitlines() if line.startswith(_ORIGINAL)]
    if not lines:
        return None
    text = "\n".join(line[len(_ORIGINAL) :].strip()[:-1].translate(_FROM_COMMENT) for line in lines)
    return Program(program.name, text + "\n")


def is_marked(program: Program) -> bool:
    """Whether it tells which of its motions stands for which element of the original."""
    return f"\n{_ELEMENT}" in program.text


def element_comment(index: int) -> str:
    """The comment before the motions that stand for element `index` of the original contour."""
    return f"{_ELEMENT} {index})"


def element_of_comment(comment: str) -> int | None:
    """The index that such a comment tells; None for any other comment."""
    if not comment.startswith(_ELEMENT):
        return None
    number = comment[len(_ELEMENT) : -1].strip()
    return int(number) if number.isascii() and number.isdecimal() else None


def led_by_marks(
    items: Iterable[Element | Event | Mark], contour: Iterable[Element], name: str
) -> Iterator[Element | Event]:
    """The motions of a compensated program, called `name`, each with its place on the `contour` that it carries, and
    with the line of that: an operator who stops, resumes or begins at a line means one of what he wrote.

    Raises InputError for marks that do not go through the elements of the contour one by one.
    """
    reason = (
        f"part program {name}: its element comments do not go through the original that it carries one by one: it was "
        "changed by hand, or made for a machine with another start pose"
    )
    elements = iter(contour)
    count = 0
    owner: Element | None = None
    group: list[Element | Event] = []
    for item in items:
        if isinstance(item, Mark):
            yield from _led_along(owner, group)
            owner, group = next(elements, None), []
            if owner is None or item.element != count:
                raise InputError(reason)
            count += 1
        elif owner is None and not isinstance(item, Event):
            raise InputError(reason)
        else:
            group.append(item)
    yield from _led_along(owner, group)
    if next(elements, None) is not None:
        raise InputError(reason)


def _led_along(owner: Element | None, group: list[Element | Event]) -> Iterator[Element | Event]:
    """`group` with each motion's place on `owner`, by its share of their time.

    A compensated motion takes as long as the piece of the contour that it stands for; as long it is not.
    """
    time = sum(item.length / item.feed for item in group if not isinstance(item, Event))
    done = 0.0
    for item in group:
        if isinstance(item, Event) or owner is None:
            yield item
            continue
        rate = owner.length / (time * item.feed)
        yield dataclasses.replace(item, line=owner.line, places=(Place(0.0, owner, done, rate),))
        done += item.length * rate


def led_by_length(
    items: Iterable[Element | Event], contour: Iterable[Element], rate: float
) -> Iterator[Element | Event]:
    """Motions that go along a contour that is `rate` times as long as they are, each with its places and line there."""
    elements = iter(contour)
    element, offset = next(elements), 0.0
    for item in items:
        if isinstance(item, Event):
            yield item
            continue
        if offset >= element.length - TIE and (following := next(elements, None)) is not None:
            element, offset = following, 0.0
        places, s = [Place(0.0, element, offset, rate)], 0.0
        offset += rate * item.length
        while offset > element.length + TIE and (following := next(elements, None)) is not None:
            offset -= element.length
            element, s = following, item.length - offset / rate
            places.append(Place(s, element, 0.0, rate))
        yield dataclasses.replace(item, line=places[0].element.line, places=tuple(places))
