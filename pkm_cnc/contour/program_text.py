"""Numbers as they stand in part programs: six decimals of a mm, so that a coordinate is good to 1 nm."""

import math
from collections.abc import Sequence

from pkm_cnc.errors import InputError

__all__ = ["coordinate", "number", "parse_numbers", "require_finite", "require_positive", "rounded"]

_MOST = 3600
"""Numbers that a list first:last:step may have."""


def parse_numbers(text: str, name: str, unit: str) -> list[float]:
    """Numbers from "first:last:step" (last included where a step meets it) or from a comma list.

    Raises InputError, calling the list `name`, for what is no such list, a step that is 0 or leads away from `last`,
    too many numbers.
    """
    separator = ":" if ":" in text else ","
    try:
        numbers = [float(part) for part in text.split(separator)]
    except ValueError:
        numbers = []
    if not numbers or not all(map(math.isfinite, numbers)) or (separator == ":" and len(numbers) != 3):
        raise InputError(f"{name}: {text!r} is neither first:last:step nor a comma list of numbers, in {unit}")
    if separator == ",":
        return numbers
    first, last, step = numbers
    if step == 0.0 or (last - first) / step < 0.0:
        raise InputError(f"{name}: a step of {step:g} {unit} does not lead from {first:g} to {last:g} {unit}")
    steps = (last - first) / step + 1e-9  # the last one counts in spite of rounding
    if steps >= _MOST:
        raise InputError(f"{name}: {text!r} makes {steps + 1:.0f} numbers, over the most of {_MOST}")
    return [first + index * step for index in range(int(steps) + 1)]


def rounded(value: float) -> float:
    """`value` to six decimals, never a negative zero."""
    return round(value, 6) + 0.0


def coordinate(value: float) -> str:
    """`value` with six decimals."""
    return f"{rounded(value):.6f}"


def number(value: float) -> str:
    """`value` as short as it reads, at most six decimals, never as a power of ten."""
    return coordinate(value).rstrip("0").rstrip(".")


def require_finite(**points: Sequence[float]) -> None:
    """Raise InputError naming the first of `points` that has a coordinate that is not finite."""
    for name, point in points.items():
        if not all(map(math.isfinite, point)):
            raise InputError(f"{name}: {', '.join(map(str, point))}: not finite numbers")


def require_positive(**values: float) -> None:
    """Raise InputError naming the first of `values` that is not a finite number above 0 (its name carries the unit)."""
    for name, value in values.items():
        if not (math.isfinite(value) and round(value, 6) > 0.0):
            raise InputError(f"{name}: {value} is not a number above 0 (resolution 0.000001)")
