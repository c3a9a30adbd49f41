"""Least squares of the coefficients of a spline that shall be smooth and end in zeros."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SmoothFit"]

Array = NDArray[np.float64]


class SmoothFit:
    """min |A x - b|^2 + weight |second differences of x|^2 over x (p, m), with zeros before its first and behind its
    last row (P-spline of Eilers and Marx, 1996).

    `normal` is A^T A, sparse (p, p). Without observations x is zero.
    """

    def __init__(self, normal: Any, weight: float) -> None:
        from scipy.linalg import cholesky_banded

        count = normal.shape[0]
        self._stiffness = weight * _bending(count)
        whole = (normal + self._stiffness).tocoo()
        width = int((whole.col - whole.row).max())
        banded = np.zeros((width + 1, count))  # upper form
        upper = whole.col >= whole.row
        row, column = whole.row[upper], whole.col[upper]
        banded[width - (column - row), column] = whole.data[upper]
        self._factors = cholesky_banded(banded), False

    def solve(self, right: Array) -> Array:
        """x (p, m) from A^T b (p, m)."""
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded(self._factors, right))

    def improved(self, before: Array, right: Array) -> Array:
        """x (p, m) where b (A^T b = `right`) is what `before` (p, m) leaves: it is x that is smooth, not the change."""
        return np.asarray(before + self.solve(right - self._stiffness @ before))


def _bending(count: int) -> Any:
    """D^T D, D the second differences, sparse (count, count)."""
    from scipy.sparse import diags

    differences = diags([1.0, -2.0, 1.0], [0, -1, -2], shape=(count + 2, count))
    return (differences.T @ differences).tocsr()
