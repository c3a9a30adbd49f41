"""Numbers as they stand in part programs: six decimals of a mm, so that a coordinate is good to 1 nm."""

import math
from collections.abc import Sequence

from pkm_cnc.errors import InputError

__all__ = ["coordinate", "number", "require_finite", "require_positive", "rounded"]


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
