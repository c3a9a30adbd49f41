"""A whole star at once: the lines of one pivot as arrays, through the exact array path of the drives.

Every line begins at rest and is run with the feed profile of the interpolator, so the errors are those of the star test
that waits for rest before each line, within 1e-12 m; the rest of the program (rapids, stops) is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.array_path import respond
from pkm_cnc.config import Setup
from pkm_cnc.errors import MachineFault, UnreachableError
from pkm_cnc.motion import Cell, FeedProfile

__all__ = ["LineMotion", "StarErrors", "line_motion", "star_errors"]

Array = NDArray[np.float64]

CHECKED = 201
"""Points of a line that are checked against the workspace, ends included."""
SETTLED = 4.0
"""1/Kv: how long after its setpoint the tool has passed three quarters of the line. It lags by 1/Kv."""


class LineMotion(NamedTuple):
    """Path length (m), speed (m/s) and acceleration (m/s^2) in every cycle from rest on, shape (n,) each."""

    length: float
    s: Array
    v: Array
    a: Array


class StarErrors(NamedTuple):
    """Mean errors over the middle half by heading, m, shape (n,), or why there are none."""

    left: Array
    up: Array
    reason: str = ""


def line_motion(setup: Setup, length: float, feed: float) -> LineMotion:
    """The motion along a line of `length` (m) at `feed` (m/s) until the tool has passed three quarters of it.

    Only motion.acceleration limits it: no limit of a drive, no jerk.
    """
    line = Cell(length, feed * feed, ((0.0, setup.motion.acceleration),))
    profile = FeedProfile([line], [0.0, 0.0])
    lag = SETTLED / min(parts.drive.kv for parts in setup.axes.values())
    passed = profile.duration - (0.25 * length) / feed  # at the latest: the rest takes longer than at full feed
    cycles = math.ceil((passed + lag) / setup.servo_period)
    _, s, v, a = profile.at(np.arange(cycles + 1) * setup.servo_period)
    v[0] = a[0] = 0.0  # cycle 0 is the start at rest
    return LineMotion(length, s, v, a)


def star_errors(setup: Setup, pivot: Array, headings: Sequence[float], motion: LineMotion) -> StarErrors:
    """Mean errors of lines through `pivot` (3,), m, by heading, deg; NaN and the reason if one cannot be run."""
    nothing = np.full(len(headings), math.nan)
    angle = np.radians(np.array(headings))
    tangents = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    starts = pivot - 0.5 * motion.length * tangents
    reason = _unreachable(setup, starts, tangents, motion.length)
    if reason:
        return StarErrors(nothing, nothing, reason)
    try:
        sliders = _sliders(setup, starts, tangents, motion)
        tcp = setup.actual.forward(sliders)
    except UnreachableError:
        return StarErrors(nothing, nothing, "the struts do not meet")
    except MachineFault:
        return StarErrors(nothing, nothing, "following error")
    x, y, z = np.moveaxis(tcp - starts[:, None, :], -1, 0)
    cosine, sine = tangents[:, :1], tangents[:, 1:2]
    foot, left = cosine * x + sine * y, cosine * y - sine * x
    judged = (0.25 * motion.length <= foot) & (foot <= 0.75 * motion.length)
    count = judged.sum(axis=1)
    return StarErrors(np.where(judged, left, 0.0).sum(axis=1) / count, np.where(judged, z, 0.0).sum(axis=1) / count)


def _unreachable(setup: Setup, starts: Array, tangents: Array, length: float) -> str:
    """Why one of the lines leaves the workspace or a drive's travel, in few words; empty if none does."""
    along = np.linspace(0.0, length, CHECKED)
    points = (starts[:, None, :] + along[:, None] * tangents[:, None, :]).reshape(-1, 3)
    try:
        joints = setup.machine.inverse(points)
    except UnreachableError:
        return f"{setup.machine.violations(points)[0].axis} out of reach"
    for column, (axis, parts) in enumerate(setup.axes.items()):
        if joints[:, column].min() < parts.travel.minimum or joints[:, column].max() > parts.travel.maximum:
            return f"{axis} beyond its travel"
    return ""


def _sliders(setup: Setup, starts: Array, tangents: Array, motion: LineMotion) -> Array:
    """The true sliders on every line in every cycle, (lines, n, m)."""
    setpoints = []
    for start, tangent in zip(starts, tangents, strict=True):
        inverse = setup.machine.setpoint_motion(start, setup.servo_period)
        parts = inverse(start + motion.s[:, None] * tangent, motion.v[:, None] * tangent, motion.a[:, None] * tangent)
        setpoints.append(np.stack(parts))
    commanded = np.stack(setpoints, axis=1)  # (3, lines, n, m)
    return np.stack(
        [respond(setup, axis, *commanded[..., column]).position for column, axis in enumerate(setup.axes)], axis=-1
    )
