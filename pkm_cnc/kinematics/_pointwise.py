"""Arithmetic that is written once for a single pose (python floats) and for arrays of poses (numpy columns).

+ - * / and the square root are exactly rounded by IEEE 754 in both, so a row of an array result equals the result of
that row alone bit for bit. Python floats are about ten times faster than numpy for one pose, numpy for many.
"""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Component", "everywhere", "pointwise", "square_root"]

Component: TypeAlias = Any
"""A python float, or an array of floats with one element per pose."""


def pointwise(function: Callable[..., Any], *vectors: ArrayLike) -> NDArray[np.float64]:
    """Apply `function` to the components of `vectors`, single or arrays.

    Each vector has shape (..., n), the leading shapes broadcast. `function` gets each as a sequence of its n components
    and returns nested tuples of components; the result has shape (..., *nesting).
    """
    arrays = [np.asarray(vector, dtype=float) for vector in vectors]
    for array in arrays:
        if array.ndim != 1:
            break
    else:
        return np.array(function(*[array.tolist() for array in arrays]))
    shape = np.broadcast_shapes(*[array.shape[:-1] for array in arrays])
    columns = [np.moveaxis(np.broadcast_to(array, shape + array.shape[-1:]), -1, 0) for array in arrays]
    with np.errstate(all="ignore"):  # `function` refuses infinities and NaN itself, with the row
        result = np.array(function(*columns))
    nesting = result.ndim - len(shape)
    return np.ascontiguousarray(np.moveaxis(result, range(nesting), range(-nesting, 0)))


def square_root(value: Component) -> Component:
    """Square root of a float or of each element of an array, none of them negative."""
    return math.sqrt(value) if isinstance(value, float) else np.sqrt(value)


def everywhere(condition: Component) -> bool:
    """Whether `condition`, the result of a comparison, holds for the one pose or for all poses."""
    return condition if isinstance(condition, bool) else bool(condition.all())
