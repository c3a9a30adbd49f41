"""Equations 6-5..6-16 of the Tripod, corrected or as printed, to show what a misprint does.

They are for comparison only and stand beside, not in, `pkm_cnc.kinematics`. Lengths in m; geometry of table 6-1, no
tool, base points and platform joints without z.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

__all__ = ["LENGTH", "forward", "newton_steps", "sphere_centers"]

Array = NDArray[np.float64]

LENGTH = 0.600
AZIMUTH = np.radians([45.0, 165.0, 285.0])
BASE = 0.513 * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)
JOINT = 0.150 * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)
ARRIVED = 1e-12
BESIDE = np.array([0.005, -0.003, 0.004])
MOST_STEPS = 50


def sphere_centers(sliders: Array) -> Array:
    """Where the struts hold the TCP from: (..., 3 struts, 3) of sliders (..., 3) (6-12..6-14)."""
    ground = np.broadcast_to(BASE - JOINT, (*sliders.shape, 2))
    return np.concatenate([ground, sliders[..., None]], axis=-1)


def forward(sliders: Array, misprints: Collection[str] = ()) -> Array:
    """TCP (3,) by 6-5..6-11 of sliders (3,); the equations named in `misprints` ("6-7", "6-9", "6-11") as printed."""
    (c1x, c1y, c1z), (c2x, c2y, c2z), (c3x, c3y, c3z) = sphere_centers(sliders).tolist()
    s1, s2, s3 = (x * x + y * y + z * z - LENGTH**2 for x, y, z in sphere_centers(sliders).tolist())
    below_ij = c1x * (c2y - c3y) + c2x * (c3y - c1y) + c3x * (c1y - c2y)
    below_kl = c1x * (c3y - c2y) + c2x * (c1y - c3y) + c3x * (c2y - c1y)
    i = -((c2z - c1z) * (c3y - c2y) - (c3z - c2z) * (c2y - c1y)) / below_ij
    k = -((c2z - c1z) * (c3x - c1x) - (c3z - c1z) * (c2x - c1x)) / below_kl
    first, second = (c3y - c2y) * (s1 - s2), (c2y - c1y) * (s2 - s3)
    if "6-9" in misprints:
        first, second = (c2z - c2y) * (s1 - s2), -second
    j = -first / (2.0 * below_ij) + second / (2.0 * below_ij)
    first, second = (c3x - c1x) * (s1 - s2), (c2x - c1x) * (s1 - s3)
    if "6-11" in misprints:
        second = -second
    l = -first / (2.0 * below_kl) + second / (2.0 * below_kl)  # noqa: E741 (the thesis' letter)
    a = i * i + k * k + 1.0
    b = i * (j - c1x) + k * (l - c1y) - c1z
    c = (j - c1x) ** 2 + (l - c1y) ** 2 + c1z * c1z - LENGTH**2
    square = (b / a) ** 2 - (0.0 if "6-7" in misprints else c / a)
    z = -b / a - math.sqrt(square) if square >= 0.0 else math.nan
    return np.array([z * i + j, z * k + l, z])


def newton_steps(sliders: Array, *, corrected: bool) -> int | None:
    """Steps of 6-15 to the TCP within 1e-12 m from some mm beside, with 6-16 corrected or as printed; None: never."""
    reach = JOINT - BASE
    columns = reach if corrected else reach**2
    goal = forward(sliders)
    point = goal + BESIDE
    for step in range(1, MOST_STEPS + 1):
        strut = np.column_stack([point[:2] + reach, point[2] - sliders])
        matrix = 2.0 * np.column_stack([point[:2] + columns, point[2] - sliders])
        try:
            point = point - np.linalg.solve(matrix, (strut * strut).sum(axis=1) - LENGTH**2)
        except np.linalg.LinAlgError:
            return None
        if np.abs(point - goal).max() < ARRIVED:
            return step
    return None
