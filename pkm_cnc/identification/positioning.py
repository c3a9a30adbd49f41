"""Statistics of a positioning test: VDI/DGQ 3441 (1977) and ISO 230-2 (2014), of one axis in both directions.

Target position j is approached n times from below (up) and n times from above (down). A deviation is actual less target
position; x_up_j, x_down_j its means, s_up_j, s_down_j its standard deviations (n - 1). Both share

    x_j = (x_up_j + x_down_j) / 2,   reversal error U_j = |x_up_j - x_down_j|   (ISO: B_j, with its sign).

VDI/DGQ 3441, the standard whose numbers thesis table 4-1 has (44 um is 12 + 6 * 5.3 um): s_j = (s_up_j + s_down_j) / 2
and the position scatter P_s_j = 6 s_j,

    position uncertainty   P   = max_j [x_j + (U_j + P_s_j) / 2] - min_j [x_j - (U_j + P_s_j) / 2]
    position deviation     P_a = max_j x_j - min_j x_j
    mean reversal error    U   = mean_j U_j,   mean standard deviation s = mean_j s_j.

A perfect calibration leaves P = U + 6 s, if both are the same everywhere: its floor.

ISO 230-2 counts two standard deviations instead of three, for each direction by itself:

    accuracy               A   = max_j,d [x_d_j + 2 s_d_j] - min_j,d [x_d_j - 2 s_d_j],   d = up, down
    systematic deviation   E   = max_j,d x_d_j - min_j,d x_d_j
    mean deviation         M   = max_j x_j - min_j x_j
    repeatability          R   = max_j max [2 s_up_j + 2 s_down_j + U_j, 4 s_up_j, 4 s_down_j]
    reversal error         B   = max_j U_j.

Both are set side by side in: B. Mullany, Evaluation and Comparison of the Different Standards Used to Define the
Positional Accuracy and Repeatability of Numerically Controlled Machining Center Axes, UNC Charlotte, 2007.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import InputError

__all__ = ["Positioning", "by_approach", "positioning"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Positioning:
    """Of one axis, all m. VDI/DGQ 3441: first five and their floor; ISO 230-2: the last five."""

    uncertainty: float
    """P."""
    deviation: float
    """P_a, the same as ISO 230-2's mean bidirectional deviation M."""
    reversal: float
    """Mean of U_j."""
    standard_deviation: float
    """Mean of s_j."""
    scatter: float
    """Largest P_s_j."""
    floor: float
    """U + 6 s: what a perfect calibration leaves of P, at the mean of U_j and s_j."""
    accuracy: float
    """A."""
    systematic: float
    """E."""
    repeatability: float
    """R."""
    largest_reversal: float
    """B."""


def by_approach(targets: Array, deviations: Array) -> Array:
    """Deviations (positions, 2, n) from rows in the order of measuring: `targets` (rows,), m, `deviations` (rows,), m.

    A target is approached from where the row before was; after the same target from the other side, because the test
    cycle of both standards overruns its ends and comes back. The first row is approached as the second. Raises
    InputError unless every target is approached as often from each side.
    """
    ways = np.sign(np.diff(targets))
    ways = np.concatenate((ways[:1], ways))
    for row in range(1, len(ways)):
        ways[row] = ways[row] or -ways[row - 1]
    groups = [deviations[(targets == target) & (ways == way)] for target in np.unique(targets) for way in (1.0, -1.0)]
    counts = sorted({len(group) for group in groups})
    if len(counts) != 1:
        raise InputError(
            f"positioning test: a target is approached from one side {counts[0]} times, another {counts[-1]} times: "
            "every target must be approached as often from below as from above"
        )
    return np.stack(groups).reshape(-1, 2, counts[0])


def positioning(deviations: ArrayLike) -> Positioning:
    """Statistics of `deviations` (positions, 2, n), m: actual less target, [:, 0] approached from below.

    Raises InputError for fewer than two positions or two approaches, and for what is no finite number.
    """
    values = np.asarray(deviations, dtype=float)
    if values.ndim != 3 or values.shape[0] < 2 or values.shape[1] != 2 or values.shape[2] < 2:
        raise InputError(
            f"positioning test: shape {values.shape} given; wanted are two or more positions, two directions, two or "
            "more approaches"
        )
    if not np.isfinite(values).all():
        raise InputError("positioning test: a deviation is no finite number")
    means, scatters = values.mean(axis=2), values.std(axis=2, ddof=1)
    middle, reversal, scatter = means.mean(axis=1), np.abs(means[:, 0] - means[:, 1]), 6.0 * scatters.mean(axis=1)
    half = 0.5 * (reversal + scatter)
    both = 2.0 * scatters.sum(axis=1) + reversal
    return Positioning(
        uncertainty=float((middle + half).max() - (middle - half).min()),
        deviation=float(np.ptp(middle)),
        reversal=float(reversal.mean()),
        standard_deviation=float(scatters.mean()),
        scatter=float(scatter.max()),
        floor=float((reversal + scatter).mean()),
        accuracy=float((means + 2.0 * scatters).max() - (means - 2.0 * scatters).min()),
        systematic=float(np.ptp(means)),
        repeatability=float(max(both.max(), 4.0 * scatters.max())),
        largest_reversal=float(reversal.max()),
    )
