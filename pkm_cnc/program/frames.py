"""Places on many lines and arcs at once.

A row is the same to the bit as `frame` of its element gives it: + - * / are exactly rounded for floats and arrays
alike, and sine and cosine are those of `math` in both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.program.toolpath import Element, Line, Plane, on_arc, turned

__all__ = ["frames"]

Array = NDArray[np.float64]

LINE = -1
"""What a line is among the planes of arcs."""


def frames(elements: Sequence[Element], which: NDArray[np.intp], s: Array) -> Array:
    """Position (m), unit tangent and curvature (1/m) at `s` (k,), m, of `elements[which]`; shape (3, 3, k)."""
    kinds = np.array([LINE if isinstance(element, Line) else element.plane for element in elements])[which]
    numbers = np.array([_numbers(element) for element in elements])[which].T
    result = np.empty((3, 3, len(s)))
    for kind in sorted({*kinds.tolist()}):
        rows = np.flatnonzero(kinds == kind)
        part = numbers[:, rows], s[rows]
        for vector, components in zip(
            result, _on_lines(*part) if kind == LINE else _on_arcs(Plane(kind), *part), strict=True
        ):
            for row, component in zip(vector, components, strict=True):
                row[rows] = component
    start, end, length = numbers[:3], numbers[3:6], numbers[6]
    result[0] = np.where(s <= 0.0, start, np.where(s >= length, end, result[0]))
    return result


def _numbers(element: Element) -> tuple[float, ...]:
    if isinstance(element, Line):
        return *element.start, *element.end, element.length, *element.tangent(0.0), 0.0, 0.0, 0.0, 0.0
    center = element.plane.coordinates(element.center)
    return *element.start, *element.end, element.length, *center, *element.spoke, element.turning, element.climb


def _on_lines(numbers: Array, s: Array) -> tuple[Any, Any, Any]:
    tangent = numbers[7:10]
    return numbers[:3] + s * tangent, tangent, (0.0, 0.0, 0.0)


def _on_arcs(plane: Plane, numbers: Array, s: Array) -> Iterator[Sequence[Any]]:
    length, a, b, c, x, y, turning, climb = numbers[6:]
    angles = (np.minimum(s, length) * turning).tolist()
    cosine, sine = (np.array([*map(function, angles)]) for function in (math.cos, math.sin))
    there = turned((x, y), cosine, sine)
    spoke = np.where(s > 0.0, there[0], x), np.where(s > 0.0, there[1], y)
    return (plane.vector(*components) for components in on_arc((a, b, c), spoke, turning, climb, s))
