"""Cartesian machine: three straight axes, each carrying the next; the serial reference.

Perfect geometry is u = P. A true machine has axes that are not quite square and scales that are not quite right: with
the unit vectors of its axes, A = squareness_yz, B = squareness_xz, C = squareness_xy,

    e_x = (1, 0, 0),   e_y = (-sin C, cos C, 0),   e_z = (-sin B, -sin A cos B, cos A cos B)

and the scale errors k_i, the TCP is at P = sum over i of (1 + k_i) u_i e_i = M u. M is triangular, so both directions
are exact: u = M^-1 P from the last row up. J = M^-1 is constant, the second derivative is zero, no pose is out of reach
and none is singular. (x is the reference direction; C is the angle between the y and the x axis less 90 deg, B that
between the z and the x axis, A how far the z axis leans towards -y as seen along x.)
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pkm_cnc.kinematics._pointwise import Component, pointwise
from pkm_cnc.kinematics._refusals import by_row, finite, not_finite, refuse_rates
from pkm_cnc.kinematics.machine import Array, Motion, Segment, Violation, unreachable
from pkm_cnc.parameters import parameter, read_section

__all__ = ["Cartesian"]

DRAWN = 0.5
"""m from its middle to either end of an axis as it is drawn."""

Components = Sequence[Component]


@dataclasses.dataclass(frozen=True)
class _Geometry:
    """Errors of the Cartesian machine's axes; zero, they make u = P."""

    squareness_xy: float = parameter(
        0.0, "C: angle between the y and the x axis less 90 deg", unit="rad", minimum=-0.5, maximum=0.5
    )
    squareness_xz: float = parameter(
        0.0, "B: angle between the z and the x axis less 90 deg", unit="rad", minimum=-0.5, maximum=0.5
    )
    squareness_yz: float = parameter(
        0.0, "A: lean of the z axis towards -y as seen along x", unit="rad", minimum=-0.5, maximum=0.5
    )
    scale_error: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "true travel of the axes less what is read, per travel read", minimum=-0.5, maximum=0.5
    )


class Cartesian:
    """Kinematics of the Cartesian machine; see `pkm_cnc.kinematics.Machine`, and this module for the geometry.

    `geometry` is the checked geometry.
    """

    Geometry: ClassVar[type[Any]] = _Geometry
    axes: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    coordinates: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    def __init__(self, geometry: _Geometry) -> None:
        """Take the geometry. Raises InputError naming key and bound."""
        self.geometry = read_section(_Geometry, vars(geometry), "geometry.")
        xy, xz, yz = self.geometry.squareness_xy, self.geometry.squareness_xz, self.geometry.squareness_yz
        self._directions = (
            (1.0, 0.0, 0.0),
            (-math.sin(xy), math.cos(xy), 0.0),
            (-math.sin(xz), -math.sin(yz) * math.cos(xz), math.cos(yz) * math.cos(xz)),
        )
        self._columns = tuple(
            tuple((1.0 + error) * part for part in direction)
            for error, direction in zip(self.geometry.scale_error, self._directions, strict=True)
        )

    def inverse(self, tcp: ArrayLike) -> Array:
        """u (..., 3), m, of the poses `tcp` (..., 3), m. Raises UnreachableError for what is not finite."""
        return pointwise(self._inverse, tcp)

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 3), m, of the axes' positions `joints` (..., 3), m. Raises UnreachableError."""
        return pointwise(self._forward, joints)

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, whatever the guess: of a linear machine Newton's first step is the answer."""
        return self.forward(joints)

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dP = M^-1 (..., 3, 3), 1, the same everywhere. Raises UnreachableError."""
        columns = [self._solved(unit) for unit in np.eye(3).tolist()]
        return np.tile(np.array(columns).T, (*self.inverse(tcp).shape[:-1], 1, 1))

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dP/du = M (..., 3, 3), 1, the same everywhere. Raises UnreachableError."""
        return np.tile(np.array(self._columns).T, (*self.inverse(tcp).shape[:-1], 1, 1))

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/ds2 (..., 3), 1/m: zero. Raises UnreachableError."""
        return self.motion(tcp, direction, (0.0, 0.0, 0.0))[2]

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., 3), m, m/s, m/s^2, of the TCP's position, velocity and acceleration (..., 3).

        Raises UnreachableError for what is not finite.
        """
        result = pointwise(self._motion, tcp, velocity, acceleration)
        return result[..., 0, :], result[..., 1, :], result[..., 2, :]

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion`: three drives have no choice."""
        return self.motion

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Which elements of the poses `tcp` (..., 3) are not finite; nothing else is wrong with any."""
        poses = np.asarray(tcp, dtype=float)
        return by_row(not_finite(poses.reshape(-1, 3), self.coordinates), single=poses.ndim == 1)

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        """Which elements of the positions `joints` (..., 3) are not finite; nothing else is wrong with any."""
        return self.violations(joints)  # axes and coordinates have the same names

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """Reciprocal condition number (...) of J in the 2-norm: 1 for perfect geometry. Raises UnreachableError."""
        values = np.linalg.svd(self.jacobian(tcp), compute_uv=False)
        return np.asarray(values[..., -1] / values[..., 0])

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """Named lines for `joints` (3,) and `tcp` (3,), m, in `base_link`: each axis carries the next.

        "column x" (2, 3) is the guide of the axis, "strut x" (2, 3) leads from its slider to that of the next axis; of
        the last to the TCP.
        """
        end = np.asarray(tcp, dtype=float)
        segments: list[Segment] = []
        middle = np.zeros(3)
        sliders = []
        for axis, direction, column, u in zip(
            self.axes, np.array(self._directions), np.array(self._columns), np.asarray(joints).tolist(), strict=True
        ):
            segments.append((f"column {axis}", np.stack((middle - DRAWN * direction, middle + DRAWN * direction))))
            middle = middle + u * column
            sliders.append(middle)
        for axis, slider, carried in zip(self.axes, sliders, [*sliders[1:], end], strict=True):
            segments.append((f"strut {axis}", np.stack((slider, carried))))
        return segments

    def _solved(self, vector: Components) -> tuple[Component, ...]:
        """M^-1 `vector`."""
        (xx, _, _), (xy, yy, _), (xz, yz, zz) = self._columns
        z = vector[2] / zz
        y = (vector[1] - yz * z) / yy
        return (vector[0] - xy * y - xz * z) / xx, y, z

    def _inverse(self, pose: Components) -> tuple[Component, ...]:
        self._refuse_infinite(pose)
        return self._solved(pose)

    def _forward(self, joints: Components) -> tuple[Component, ...]:
        self._refuse_infinite(joints)
        (xx, _, _), (xy, yy, _), (xz, yz, zz) = self._columns
        x, y, z = joints
        return xx * x + xy * y + xz * z, yy * y + yz * z, zz * z

    def _motion(self, pose: Components, velocity: Components, acceleration: Components) -> tuple[Components, ...]:
        refuse_rates(self.coordinates, velocity, acceleration)
        return self._inverse(pose), self._solved(velocity), self._solved(acceleration)

    def _refuse_infinite(self, position: Components) -> None:
        if not finite(position):
            raise unreachable(self.violations(np.stack(position, axis=-1)))
