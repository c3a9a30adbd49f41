"""Newton's method on many poses at once; each goes its own way and stops when it has arrived."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc import tolerances
from pkm_cnc.kinematics.machine import Array

__all__ = ["newton"]

NEWTON_STEPS = 60
"""A far step halves the distance to the root, a near one squares its relative error: enough from 1e15 m away."""


def newton(step: Callable[[Array, NDArray[np.intp]], Array], start: Array) -> tuple[Array, NDArray[np.intp]]:
    """Poses (n, N), m, from the guesses `start` (n, N), and the columns of those that did not converge.

    `step` gives J^-1 f (n, M), m, at poses (n, M), which are the columns (M,) of all.
    """
    poses = np.array(start, dtype=float)
    active = np.arange(poses.shape[1])
    for _ in range(NEWTON_STEPS):
        change = step(poses[:, active], active)
        poses[:, active] -= change
        squares: Any = 0.0
        for component in change:
            squares = squares + component * component
        active = active[~(np.sqrt(squares) < tolerances.NEWTON)]
        if not active.size:
            break
    return poses, active
