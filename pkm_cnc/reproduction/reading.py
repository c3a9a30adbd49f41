"""How claims read their figures: angles, exponents, zeros, and the geometry of a circle on a machine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.contour import CirclePath
from pkm_cnc.reproduction.evidence import Evidence

__all__ = [
    "Array",
    "around",
    "circle_motion",
    "exponent",
    "left_um",
    "maxima_of",
    "nearest",
    "per_degree",
    "strut_angles",
    "turning_points",
    "zero_heading",
]

Array = NDArray[np.floating[Any]]

STEPS = 3600
"""Of a full turn."""


def left_um(line: Mapping[str, Any]) -> float:
    """Mean in-plane contour error of a line's middle half, um, + = left of travel."""
    return float(line["contour_error_um"]["mean"])


def around(angle: float) -> float:
    """An angle in [-180, 180), deg."""
    return (angle + 180.0) % 360.0 - 180.0


def nearest(angles: Array, to: float) -> float:
    """Of angles (n,), the nearest to another around the circle, deg; NaN if there is none."""
    return min(angles.tolist(), key=lambda angle: abs(around(angle - to)), default=math.nan)


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """p of y = c x^p, by least squares of the logarithms; NaN where a value is not above 0."""
    if min(*x, *y) <= 0.0:
        return math.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def zero_heading(
    evidence: Evidence, machine: str, feed: float, expected: float, pivot: tuple[float, float], beside: float = 1.0
) -> float:
    """Heading (deg) at which the in-plane error is zero, on the secant of the lines `beside` deg to either side."""
    before, after = expected - beside, expected + beside
    lines = evidence.star(machine, feed, (before, after), pivot=pivot)
    one, other = left_um(lines[before]), left_um(lines[after])
    return before - one * (after - before) / (other - one)


def per_degree(path: CirclePath) -> Array:
    """Radial deviation, um, at 0, 1, ..., 359 deg of actual angle, (360,)."""
    return np.asarray(1e6 * path.by_angle[:: len(path.by_angle) // 360])


def _turn(setup: Setup, radius: float) -> tuple[Array, Array, Array]:
    """Angles (deg, (n,)), unit vectors outward (n, 3) and points (m, (n, 3)) of a circle about the program zero."""
    angles = np.arange(STEPS) * (360.0 / STEPS)
    turned = np.radians(angles)
    outward = np.stack([np.cos(turned), np.sin(turned), 0.0 * turned], axis=1)
    return angles, outward, np.array(setup.program_zero) + radius * outward


def circle_motion(setup: Setup, radius: float, speed: float) -> tuple[Array, Array, Array, Array]:
    """Angles (deg, (n,)) of a programmed counter-clockwise circle (m, m/s); u, du/dt, d2u/dt2 of the axes, (n, m)."""
    angles, outward, points = _turn(setup, radius)
    along = np.stack([-outward[:, 1], outward[:, 0], outward[:, 2]], axis=1)
    u, velocity, acceleration = setup.machine.motion(points, speed * along, -speed * speed / radius * outward)
    return angles, u, velocity, acceleration


def strut_angles(setup: Setup, radius: float) -> tuple[Array, Array]:
    """Angles (deg, (n,)) of a programmed circle (m); beta of each strut, between it and its slider's axis, rad, (n, m).

    A row of J = du/dP points along its strut and has the length 1 / cos(beta).
    """
    angles, _, points = _turn(setup, radius)
    rows = setup.machine.jacobian(points)
    return angles, np.asarray(np.arccos(1.0 / np.sqrt((rows * rows).sum(axis=2))))


def maxima_of(angles: Array, values: Array) -> Array:
    """Angles at which a closed curve (n,) has a local maximum."""
    top = (values >= np.roll(values, 1)) & (values > np.roll(values, -1))
    return np.asarray(angles[top])


def turning_points(angles: Array, velocity: Array) -> Array:
    """Angles at which the velocity (n,) along a closed curve changes sign."""
    return np.asarray(angles[np.sign(velocity) * np.sign(np.roll(velocity, -1)) <= 0.0])
