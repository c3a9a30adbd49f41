"""The angle of every strut to the plane normal to its slider's column: thesis beta, "strut angle to the horizontal"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.kinematics import Machine

__all__ = ["strut_angles"]

Array = NDArray[np.float64]


def strut_angles(machine: Machine, joints: Array, tcp: Array) -> dict[str, Array]:
    """Angles (n,), deg, by axis, for the poses `tcp` (n, 3) with `joints` (n, m), m; no axes for a machine without.

    90 deg is a strut along its column, 0 one across it, which cannot move its slider's load. On the Tripod, whose
    columns are vertical, it is the angle to the horizontal. Taken from the machine's drawing, lines "strut AXIS" and
    "column AXIS".
    """
    found: dict[str, list[float]] = {}
    for pose, sliders in zip(tcp, joints, strict=True):
        lines = {name: points[-1] - points[0] for name, points in machine.sketch(sliders, pose)}
        for axis in machine.axes:
            strut, column = lines.get(f"strut {axis}"), lines.get(f"column {axis}")
            if strut is not None and column is not None:
                along = abs(float(np.vdot(strut, column))) / float(np.linalg.norm(strut) * np.linalg.norm(column))
                found.setdefault(axis, []).append(float(np.degrees(np.arcsin(min(along, 1.0)))))
    return {axis: np.array(angles) for axis, angles in found.items()}
