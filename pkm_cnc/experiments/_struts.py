"""The angle of every strut to the plane normal to its slider's column: thesis beta, "strut angle to the horizontal"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.kinematics import Machine

__all__ = ["strut_angles"]

Array = NDArray[np.float64]

CONSTANT = 1e-3
"""Of the longest: by how much the length of a strut may differ between poses, far more than a run's errors make it."""


def strut_angles(machine: Machine, joints: Array, tcp: Array) -> dict[str, Array]:
    """Angles (n,), deg, by axis, for the poses `tcp` (n, 3) with `joints` (n, m), m; only of struts of constant length.

    90 deg is a strut along its column, 0 one across it. On the Tripod, whose columns are vertical, it is the angle to
    the horizontal. Taken from the machine's drawing, lines "strut AXIS" and "column AXIS".
    """
    found: dict[str, Array] = {}
    drawings = [dict(machine.sketch(sliders, pose)) for pose, sliders in zip(tcp, joints, strict=True)]
    for axis in machine.axes:
        if {f"strut {axis}", f"column {axis}"} <= set(drawings[0]):
            strut, column = (
                np.array([drawing[f"{part} {axis}"][-1] - drawing[f"{part} {axis}"][0] for drawing in drawings])
                for part in ("strut", "column")
            )
            length = np.linalg.norm(strut, axis=1)
            if length.min() > 0.0 and np.ptp(length) < CONSTANT * length.max():
                along = np.abs((strut * column).sum(axis=1)) / (length * np.linalg.norm(column, axis=1))
                found[axis] = np.degrees(np.arcsin(np.minimum(along, 1.0)))
    return found
