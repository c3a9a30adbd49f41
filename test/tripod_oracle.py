"""The Tripod once more, derived from its closure alone and with none of the package's kinematics, and how tests run it.

Strut i holds the TCP at distance L from (c_i, u_i), c_i = (Rb - Rp) (cos phi_i, sin phi_i): the columns at radius Rb
less the platform's joints at radius Rp. Lengths in m, long double where derivatives are taken by differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.program import Program, Toolpath
from pkm_cnc.simulation import Cycle, simulate

LENGTH = 0.600
AZIMUTH = np.radians(np.array([45.0, 165.0, 285.0], dtype=np.longdouble))
CENTERS = (0.513 - 0.150) * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)

Path = Callable[[np.longdouble], NDArray[np.longdouble]]


def inverse(points: ArrayLike) -> NDArray[np.longdouble]:
    """Sliders (N, 3) above the TCP points (N, 3)."""
    points = np.asarray(points, dtype=np.longdouble)
    spans = points[:, None, :2] - CENTERS[None]
    return points[:, 2:] + np.sqrt(LENGTH**2 - (spans * spans).sum(axis=2))


def forward(sliders: ArrayLike) -> NDArray[np.float64]:
    """The TCP (3,) below three sliders (3,): Newton on the three distances, from below the sliders."""
    joints = np.column_stack([CENTERS.astype(float), np.asarray(sliders, dtype=float)])
    point = np.array([0.0, 0.0, joints[:, 2].mean() - 0.478])
    for _ in range(10):
        strut = point - joints
        point = point - np.linalg.solve(2.0 * strut, (strut * strut).sum(axis=1) - LENGTH**2)
    return point


def drift(path: Path, s: float) -> NDArray[np.float64]:
    """J^-1 d2u/ds2 (1/m) at path length s of a path s -> TCP (3,): what e = kappa v^2 * drift says, by differences."""
    step = np.longdouble(1e-5)
    here = np.longdouble(s)
    point = path(here)
    sides = [point + sign * step * axis for axis in np.eye(3, dtype=np.longdouble) for sign in (1, -1)]
    u = inverse(sides)
    jacobian = np.stack([(u[2 * column] - u[2 * column + 1]) / (2 * step) for column in range(3)], axis=1)
    before, at, after = inverse([path(here - step), point, path(here + step)])
    second = (before - 2 * at + after) / step**2
    return np.linalg.solve(jacobian.astype(float), second.astype(float))


def sampled_kappa(kv: float, period: float) -> float:
    """Half the variance (s^2) of the impulse response of x[k+1] = x[k] + Kv T (xs[k] - x[k])."""
    return (1.0 - kv * period) / (2.0 * kv * kv)


def run(program: str, overrides: Sequence[str] = ()) -> tuple[Toolpath, list[Cycle]]:
    """Simulate a part program's text on the default Tripod, from text to cycles."""
    setup = load_setup("tripod", overrides)
    source = Program("test.ngc", program)
    checked = prepare(setup, source)
    cycles: list[Cycle] = []
    simulate(setup, source, checked, watch=cycles.append)
    return checked.toolpath(), cycles
