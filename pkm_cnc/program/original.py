"""The contour that a part program carries to be judged by, and where on it each of its motions belongs.

A compensated program moves along another path than the one it is judged by. It carries the program that it was made
from line by line in comments "(pkm_cnc original: ...)", whose own parentheses are written as braces, and before the
motions that stand for element i of that program's contour, from 0, the comment "(pkm_cnc element: i)". An ordinary CNC
ignores both. Where there are no such marks, the motions go along the contour by their share of the path length.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate

from pkm_cnc.errors import InputError
from pkm_cnc.program.blocks import Program
from pkm_cnc.program.toolpath import Place, Toolpath
from pkm_cnc.tolerances import TIE

__all__ = [
    "carried_original",
    "carry_original",
    "element_comment",
    "element_of_comment",
    "places_by_element",
    "places_by_length",
]

_ORIGINAL = "(pkm_cnc original:"
_ELEMENT = "(pkm_cnc element:"
_TO_COMMENT = str.maketrans("(){}", "{}[]")
_FROM_COMMENT = str.maketrans("{}", "()")


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


def element_comment(index: int) -> str:
    """The comment before the motions that stand for element `index` of the original contour."""
    return f"{_ELEMENT} {index})"


def element_of_comment(comment: str) -> int | None:
    """The index that such a comment tells; None for any other comment."""
    if not comment.startswith(_ELEMENT):
        return None
    number = comment[len(_ELEMENT) : -1].strip()
    return int(number) if number.isascii() and number.isdecimal() else None


def places_by_element(name: str, lengths: Sequence[float], owners: Sequence[int], contour: Toolpath) -> list[Place]:
    """Where on `contour` each motion belongs: motion j, `lengths[j]` m long, stands for part of element `owners[j]`.

    Raises InputError, calling the program `name`, for owners that skip an element, turn back or are none of it.
    """
    count = len(contour.elements)
    steps = [after - before for before, after in zip([-1, *owners], [*owners, count - 1], strict=True)]
    if any(step not in (0, 1) for step in steps) or steps[0] != 1 or steps[-1] != 0:
        raise InputError(
            f"part program {name}: its element comments do not go through the {count} elements of the original that it "
            "carries one by one: it was changed by hand, or made for a machine with another start pose"
        )
    total = [0.0] * count
    for length, owner in zip(lengths, owners, strict=True):
        total[owner] += length
    places = []
    done, last = 0.0, -1
    for length, owner in zip(lengths, owners, strict=True):
        done = done if owner == last else 0.0
        rate = contour.elements[owner].length / total[owner]
        places.append(Place(owner, contour.starts[owner] + done * rate, rate))
        done, last = done + length, owner
    return places


def places_by_length(lengths: Sequence[float], contour: Toolpath) -> list[Place]:
    """Where on `contour` each motion belongs if nothing but the order is known: by its share of the path length."""
    starts = [0.0, *accumulate(lengths)]
    rate = contour.length / starts.pop()
    return [Place(bisect_right(contour.starts, rate * start + TIE) - 1, rate * start, rate) for start in starts]
