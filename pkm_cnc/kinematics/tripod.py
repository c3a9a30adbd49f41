"""Tripod: three sliders on vertical columns carry, by struts of constant length, a platform that cannot rotate.

Geometry (thesis 6-1, Fig. 6-7). Strut i leads from the slider joint B_i + E_i, on its column, to the platform joint
P - W + A_i, at radius Rp and azimuth phi_i about the platform's centre P - W:

    B_i + E_i + L_i - A_i + W - P = 0,   A_i = Rp (cos phi_i, sin phi_i, 0),   E_i = (0, 0, u_i),
    B_i = ((Rb + dRb_i) cos(phi_i + dphi_i), (Rb + dRb_i) sin(phi_i + dphi_i), H_i),   |L_i| = L + dL_i,

W the tool vector from the platform's centre to the TCP P. What a real machine has that a drawing has not, is by strut:
its length error dL_i, the errors dRb_i and dphi_i of where its column stands (the platform joint stays, as with the
tower angle offsets of delta printers), and the height H_i of its base point, which is where its slider is at u_i = 0.
Because the platform only translates, strut i keeps the TCP on a sphere of radius |L_i| about

    C_i = (c_i, u_i + H_i + Wz),  c_i = (B_i - A_i + W)_xy                      (6-12..6-14 corrected, W taken in)

and these three spheres, each with its own radius and height, are all the kinematics needs.

Inverse (6-4). With d_i = (x, y) - c_i, which is what strut i spans horizontally,

    h_i = sqrt(L_i^2 - d_i . d_i),   u_i = z - Wz - H_i + h_i.

The root is positive: the sliders are above the platform. A pose is out of reach of strut i if |d_i| >= L_i.

Derivatives. h_i depends on x and y only, dh_i = -d_i . dP / h_i. For a TCP with velocity v and acceleration a (v_h, a_h
their horizontal parts)

    du_i/dt   = v_z - q_i,                                     q_i = d_i . v_h / h_i
    d2u_i/dt2 = a_z - (v_h . v_h + d_i . a_h + q_i^2) / h_i

so row i of J = du/dP is (-d_i / h_i, 1), and d2u_i/ds2 along a straight line with unit vector t is
-(t_h . t_h + (d_i . t_h / h_i)^2) / h_i.

Forward, closed form (6-5..6-11 corrected). Take C_1 as the origin, q = P - C_1 and e_i = C_i - C_1. The difference of
the spheres i and 1 is the plane q . e_i = m_i, m_i = (e_i . e_i + L_1^2 - L_i^2) / 2. Planes 2 and 3 meet in the line

    q_x = i q_z + j,   q_y = k q_z + l,

normal to the plane of the three slider joints C_i. Put into sphere 1, a q_z^2 + 2 b q_z + c = 0 with

    a = i^2 + k^2 + 1,   b = i j + k l,   c = j^2 + l^2 - L_1^2,   q_z = (-b - sqrt(b^2 - a c)) / a.

The line runs upward, so the lower root is the TCP below the plane of the slider joints; the upper root is its mirror
image in that plane. The pose counts if it is also below every single slider joint. Only differences of the u_i + H_i
enter, so a high common position of the sliders costs no accuracy. Without a root (b^2 < a c) the struts do not meet;
struts of sqrt(L_i^2 + (a c - b^2) / a), longer but on the same planes, would meet in the plane of the slider joints.

Forward, Newton (6-15, 6-16 corrected). f_i(P) = |P - C_i|^2 - L_i^2, rows of its Jacobi matrix 2 (P - C_i). The
differences of the f_i are linear, so from the first step on the iterates are on the line above; there the iteration is
Heron's for a square root: it never leaves the side of the plane of the slider joints on which the guess is.

Singularities. Row i of J is parallel to strut i, divided by h_i, so
- J grows without bound where h_i = 0: strut i is horizontal, at the border of the workspace, slider i cannot follow;
- det J = 0 where the three struts lie in one plane, which is the plane of the slider joints: both roots of the forward
  kinematics fall together and the platform is not held. With the barycentric coordinates w_i of (x, y) in the triangle
  of the c_i (w_1 = d_2 x d_3 / D, D the sum of the three cross products, a constant), that plane is at (x, y) by

      clearance = w_1 h_1 + w_2 h_2 + w_3 h_3

  above the TCP, whatever the lengths of the struts. Within the triangle all w_i are positive, and so is the clearance.
  With equal struts and columns spaced by 120 deg it is positive in all the workspace: the w_i add up to 1; beyond a
  corner c_1 only w_1 is positive, and h_1 is the largest; beyond a side c_2 c_3 only w_1 is negative, and h_1 is the
  smallest. Other machines can have such a singularity inside the workspace; the poses beyond it are on the wrong branch
  and are refused.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc import tolerances
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics._newton import newton
from pkm_cnc.kinematics._pointwise import Component, everywhere, pointwise, square_root
from pkm_cnc.kinematics._refusals import by_row, not_finite, refuse_rates
from pkm_cnc.kinematics.machine import Array, Motion, Segment, Violation, unreachable
from pkm_cnc.parameters import parameter, read_section

__all__ = ["Tripod", "TripodGeometry"]

Components = Sequence[Component]


@dataclasses.dataclass(frozen=True)
class TripodGeometry:
    """Geometry of the Tripod, thesis Table 6-1, and by strut in what the machine is not as drawn (all 0 there)."""

    base_radius: float = parameter(0.513, "radius Rb of the slider joints about the z axis", unit="m", above=0.0)
    platform_radius: float = parameter(
        0.150, "radius Rp of the platform joints about the platform's centre", unit="m", minimum=0.0
    )
    strut_length: float = parameter(0.600, "length L of the struts between their joints", unit="m", above=0.0)
    azimuth: tuple[float, ...] = parameter(
        (math.radians(45.0), math.radians(165.0), math.radians(285.0)),
        "azimuth of the columns, counter-clockwise from +x",
        unit="rad",
    )
    tool: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "tool vector W from the platform's centre to the TCP", unit="m"
    )
    strut_length_error: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "by strut: how much longer than L it is", unit="m"
    )
    base_radius_error: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "by strut: how much further than Rb its column stands from the z axis", unit="m"
    )
    azimuth_error: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "by strut: how much its column, not its platform joint, is turned about the z axis, counter-clockwise",
        unit="rad",
    )
    base_height: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "by strut: z of its base point, where its slider is at u = 0", unit="m"
    )


class _Sphere(NamedTuple):
    """Where strut i keeps the TCP: centre (x, y, u_i + z), radius and its square, m and m^2."""

    x: float
    y: float
    z: float
    radius: float
    square: float


class _Meeting(NamedTuple):
    """Forward kinematics before its root: line, quadratic equation, heights of slider joints 2, 3 above the first."""

    i: Component
    j: Component
    k: Component
    l: Component  # noqa: E741 (6-5..6-11)
    a: Component
    b: Component
    discriminant: Component
    z2: Component
    z3: Component


class Tripod:
    """Kinematics of the Tripod; see `pkm_cnc.kinematics.Machine` for what each function answers, this module for how.

    u_i is the z of slider i in `base_link`, above its base point. `geometry` is the checked geometry.
    """

    Geometry: ClassVar[type[Any]] = TripodGeometry
    axes: ClassVar[tuple[str, ...]] = ("u1", "u2", "u3")
    coordinates: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    def __init__(self, geometry: TripodGeometry) -> None:
        """Take the geometry. Raises InputError naming key and bound if the struts cannot hold the platform."""
        self.geometry = read_section(TripodGeometry, vars(geometry), "geometry.")
        self._columns = _columns(self.geometry)
        self._spheres = tuple(
            _sphere(self.geometry, strut, column[0], column[1]) for strut, column in enumerate(self._columns)
        )
        self._check_spans()
        first, second, third = self._spheres
        self._e2 = second.x - first.x, second.y - first.y
        self._e3 = third.x - first.x, third.y - first.y
        self._cross = self._e2[0] * self._e3[1] - self._e3[0] * self._e2[1]
        self._check_columns()

    def inverse(self, tcp: ArrayLike) -> Array:
        """u (..., 3), m, of the poses `tcp` (..., 3), m, in `base_link` (6-4).

        Raises UnreachableError naming row, strut and excess.
        """
        return pointwise(self._inverse, tcp)

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 3), m, in `base_link` of the sliders `joints` (..., 3), m (6-5..6-14 corrected).

        Raises UnreachableError naming row, slider and excess if the struts do not meet below all sliders.
        """
        return pointwise(self._forward, joints)

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, iterated from `guess` (..., 3), m (6-15, 6-16 corrected); None: below the columns' middle.

        Raises UnreachableError as `forward`, and for a guess above the plane of the slider joints.
        """
        sliders = np.asarray(joints, dtype=float)
        start = pointwise(self._below, sliders) if guess is None else np.broadcast_to(guess, sliders.shape)
        rows = np.array(start, dtype=float).reshape(-1, 3)
        with np.errstate(all="ignore"):  # rows that do not converge are refused next
            poses, failed = self._iterate(sliders.reshape(-1, 3).T, rows.T)
        if failed.size:
            if found := self.joint_violations(sliders):
                raise unreachable(found)
            where = "" if sliders.ndim == 1 else f"row {failed[0]}: "
            x, y, z = (1e3 * rows[failed[0]]).tolist()
            raise UnreachableError(
                f"{where}Newton's method does not lead from the guess ({x:.3f}, {y:.3f}, {z:.3f}) mm to the pose below "
                "the sliders: start below the plane of the slider joints"
            )
        return np.ascontiguousarray(poses.T).reshape(sliders.shape)

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dP (..., 3, 3), 1: rows are struts. Raises UnreachableError."""
        return pointwise(self._jacobian, tcp)

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dP/du (..., 3, 3), 1: columns are struts. Raises UnreachableError."""
        return pointwise(lambda pose: _inverted(self._jacobian(pose)), tcp)

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/ds2 (..., 3), 1/m, through `tcp` along the unit vectors `direction` (..., 3). Raises UnreachableError."""
        return self.motion(tcp, direction, (0.0, 0.0, 0.0))[2]

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., 3), m, m/s, m/s^2, of the TCP's position, velocity and acceleration (..., 3).

        Raises UnreachableError, also for a velocity or an acceleration that is not finite.
        """
        result = pointwise(self._motion, tcp, velocity, acceleration)
        return result[..., 0, :], result[..., 1, :], result[..., 2, :]

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion`: three drives have no choice."""
        return self.motion

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Why poses `tcp` (..., 3) cannot be used: not finite, a strut too short, wrong branch, singular; by row."""
        poses = np.asarray(tcp, dtype=float)
        rows = poses.reshape(-1, 3)
        found = not_finite(rows, self.coordinates)
        finite = np.isfinite(rows).all(axis=1)
        with np.errstate(all="ignore"):
            x, y, _ = rows.T
            squares = np.stack(self._squares(x, y), axis=1)
            heights = np.sqrt(squares)
            clearance = self._clearance(x, y, heights.T)
        reached = (squares > 0.0).all(axis=1)
        for row, strut in np.argwhere(finite[:, None] & ~(squares > 0.0)).tolist():
            found.append(self._too_far(row, strut, *rows[row, :2].tolist()))
        for row in np.flatnonzero(finite & reached & ~(clearance > 0.0)).tolist():
            strut, excess = int(heights[row].argmin()), -float(clearance[row])
            reason = (
                f"strut {self.axes[strut]}: wrong assembly branch: the TCP is {1e3 * excess:.4g} mm above the plane of "
                "the slider joints, this strut lies most horizontal"
            )
            found.append(Violation(row, self.axes[strut], excess, reason))
        usable = np.flatnonzero(finite & reached & (clearance > 0.0))
        ratios = self.reciprocal_condition(rows[usable])
        for row, ratio in zip(usable.tolist(), ratios.tolist(), strict=True):
            if ratio < tolerances.SINGULAR:
                strut = int(heights[row].argmin())
                reason = (
                    f"strut {self.axes[strut]}: singular pose: reciprocal condition {ratio:.3g} is below "
                    f"{tolerances.SINGULAR:g}, this strut lies most horizontal, {1e3 * heights[row, strut]:.4g} mm high"
                )
                found.append(Violation(row, self.axes[strut], tolerances.SINGULAR - ratio, reason))
        return by_row(found, single=poses.ndim == 1)

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        """Why sliders `joints` (..., 3) cannot be used: not finite, struts do not meet, wrong branch; by row."""
        sliders = np.asarray(joints, dtype=float)
        rows = sliders.reshape(-1, 3)
        found = not_finite(rows, self.axes)
        finite = np.isfinite(rows).all(axis=1)
        with np.errstate(all="ignore"):
            meeting = self._meeting(*rows.T)
            meets = meeting.discriminant > 0.0
            depth = self._depth(meeting)
            above = depth[:, None] - np.stack((0.0 * depth, meeting.z2, meeting.z3), axis=1)
            missing = -meeting.discriminant / meeting.a
        for row in np.flatnonzero(finite & ~meets).tolist():
            found.append(self._apart(row, rows[row], float(missing[row])))
        for row, strut in np.argwhere((finite & meets)[:, None] & ~(above < 0.0)).tolist():
            axis, excess = self.axes[strut], float(above[row, strut])
            reason = f"slider {axis}: wrong assembly branch: it would be {1e3 * excess:.4g} mm below the platform"
            found.append(Violation(row, axis, excess, reason))
        return by_row(found, single=sliders.ndim == 1)

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """Reciprocal condition number (...) of J in the 2-norm: 1 isotropic, 0 singular. Raises UnreachableError."""
        values = np.linalg.svd(self.jacobian(tcp), compute_uv=False)
        return np.asarray(values[..., -1] / values[..., 0])

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """Named lines of columns, struts, platform and tool for `joints` (3,) and `tcp` (3,), m, in `base_link`.

        "column u1" (2, 3), "strut u1" (2, 3) from slider joint to platform joint, ..., "platform" (4, 3), closed,
        "tool" (2, 3). The columns stand on their base points, two strut lengths high or as far as their sliders are.
        """
        geometry = self.geometry
        end = np.asarray(tcp, dtype=float)
        centre = end - np.array(geometry.tool)
        radial = np.array([(math.cos(azimuth), math.sin(azimuth), 0.0) for azimuth in geometry.azimuth])
        corners = centre + geometry.platform_radius * radial
        feet = [np.array((*column, height)) for column, height in zip(self._columns, geometry.base_height, strict=True)]
        segments: list[Segment] = []
        for axis, foot, corner, slider in zip(
            self.axes, feet, corners, np.asarray(joints, dtype=float).tolist(), strict=True
        ):
            low, joint, high = (
                foot + np.array((0.0, 0.0, u))
                for u in (min(0.0, slider), slider, max(2.0 * geometry.strut_length, slider))
            )
            segments.append((f"column {axis}", np.stack((low, high))))
            segments.append((f"strut {axis}", np.stack((joint, corner))))
        return [*segments, ("platform", corners[[0, 1, 2, 0]]), ("tool", np.stack((centre, end)))]

    def _spans(self) -> list[float]:
        """What the struts span horizontally when the platform's centre is on the z axis, m."""
        tool_x, tool_y, _ = self.geometry.tool
        return [math.hypot(sphere.x - tool_x, sphere.y - tool_y) for sphere in self._spheres]

    def _check_spans(self) -> None:
        """Raise InputError if a strut does not reach its platform joint with the platform in the middle."""
        spans = self._spans()
        for axis, sphere, span in zip(self.axes, self._spheres, spans, strict=True):
            if not sphere.radius > span:
                raise InputError(
                    f"geometry.strut_length: {sphere.radius:.6g} m is not above {span:.6g} m, the distance that strut "
                    f"{axis} spans from its column (geometry.base_radius) to its joint (geometry.platform_radius) when "
                    "the platform is in the middle, errors included"
                )
        if not max(spans) > tolerances.SINGULAR * self.geometry.strut_length:
            raise InputError(
                f"geometry.platform_radius: {self.geometry.platform_radius} m equals geometry.base_radius: "
                "parallel struts do not hold the platform"
            )

    def _check_columns(self) -> None:
        """Raise InputError if two columns stand at one place, or the three so that the struts hold nothing."""
        azimuth = ", ".join(map(str, self.geometry.azimuth))
        for one, other in ((0, 1), (0, 2), (1, 2)):
            (x1, y1), (x2, y2) = self._columns[one], self._columns[other]
            if not math.hypot(x2 - x1, y2 - y1) > tolerances.SINGULAR * self.geometry.base_radius:
                raise InputError(
                    f"geometry.azimuth: {azimuth} rad: two columns stand at the same place, those of "
                    f"{self.axes[one]} and {self.axes[other]}, errors included"
                )
        span = max(self._spans())
        if not abs(self._cross) > tolerances.SINGULAR * span * span:
            raise InputError(
                f"geometry.azimuth: {azimuth} rad: the columns less their platform joints stand in one line, errors "
                "included: the struts do not hold the platform"
            )

    def _squares(self, x: Component, y: Component) -> tuple[Component, ...]:
        """h_i^2, m^2: not positive where strut i does not reach."""
        return tuple([c.square - ((x - c.x) * (x - c.x) + (y - c.y) * (y - c.y)) for c in self._spheres])

    def _heights(self, pose: Components) -> tuple[Component, ...]:
        """h_i, m. Raises UnreachableError for what is no pose of the machine."""
        x, y, z = pose
        s1, s2, s3 = self._squares(x, y)
        if everywhere((s1 > 0.0) & (s2 > 0.0) & (s3 > 0.0) & (z - z == 0.0)):  # the last fails for NaN and infinity
            heights = square_root(s1), square_root(s2), square_root(s3)
            if everywhere(self._clearance(x, y, heights) > 0.0):
                return heights
        raise unreachable(self.violations(np.stack((x, y, z), axis=-1)))

    def _clearance(self, x: Component, y: Component, heights: Components) -> Component:
        """How far above the TCP the plane of the slider joints is, m: zero where J is singular."""
        h1, h2, h3 = heights
        c1, c2, c3 = self._spheres
        x1, y1, x2, y2, x3, y3 = x - c1.x, y - c1.y, x - c2.x, y - c2.y, x - c3.x, y - c3.y
        return (h1 * (x2 * y3 - x3 * y2) + h2 * (x3 * y1 - x1 * y3) + h3 * (x1 * y2 - x2 * y1)) / self._cross

    def _inverse(self, pose: Components) -> tuple[Component, ...]:
        z = pose[2]
        return tuple([z - c.z + h for c, h in zip(self._spheres, self._heights(pose), strict=True)])

    def _jacobian(self, pose: Components) -> tuple[Components, ...]:
        x, y, _ = pose
        heights = self._heights(pose)
        return tuple([((c.x - x) / h, (c.y - y) / h, h / h) for c, h in zip(self._spheres, heights, strict=True)])

    def _motion(self, pose: Components, velocity: Components, acceleration: Components) -> tuple[Components, ...]:
        refuse_rates(self.coordinates, velocity, acceleration)
        (x, y, z), (vx, vy, vz), (ax, ay, az) = pose, velocity, acceleration
        position, speed, rate = [], [], []
        for c, h in zip(self._spheres, self._heights(pose), strict=True):
            dx, dy = x - c.x, y - c.y
            q = (dx * vx + dy * vy) / h
            position.append(z - c.z + h)
            speed.append(vz - q)
            rate.append(az - (vx * vx + vy * vy + dx * ax + dy * ay + q * q) / h)
        return position, speed, rate

    def _meeting(self, u1: Component, u2: Component, u3: Component) -> _Meeting:
        """Line and quadratic equation of the forward kinematics, relative to slider joint 1."""
        c1, c2, c3 = self._spheres
        (x2, y2), (x3, y3), cross = self._e2, self._e3, self._cross
        z2, z3 = (u2 - u1) + (c2.z - c1.z), (u3 - u1) + (c3.z - c1.z)
        m2 = 0.5 * (x2 * x2 + y2 * y2 + z2 * z2 + (c1.square - c2.square))
        m3 = 0.5 * (x3 * x3 + y3 * y3 + z3 * z3 + (c1.square - c3.square))
        i, j = (z3 * y2 - z2 * y3) / cross, (m2 * y3 - m3 * y2) / cross
        k, l = (z2 * x3 - z3 * x2) / cross, (m3 * x2 - m2 * x3) / cross  # noqa: E741
        a, b, c = i * i + k * k + 1.0, i * j + k * l, j * j + l * l - c1.square
        return _Meeting(i, j, k, l, a, b, b * b - a * c, z2, z3)

    def _depth(self, meeting: _Meeting) -> Component:
        """z of the TCP relative to slider joint 1, m; the lower root."""
        return (-meeting.b - square_root(meeting.discriminant)) / meeting.a

    def _forward(self, joints: Components) -> tuple[Component, ...]:
        u1, u2, u3 = joints
        meeting = self._meeting(u1, u2, u3)
        if everywhere(meeting.discriminant > 0.0):
            z = self._depth(meeting)
            if everywhere((z < 0.0) & (z < meeting.z2) & (z < meeting.z3)):
                c1 = self._spheres[0]
                return meeting.i * z + meeting.j + c1.x, meeting.k * z + meeting.l + c1.y, z + (u1 + c1.z)
        raise unreachable(self.joint_violations(np.stack((u1, u2, u3), axis=-1)))

    def _below(self, joints: Components) -> tuple[Component, ...]:
        """A pose well below the plane of the slider joints: a strut length under their middle."""
        u1, u2, u3 = joints
        c1, c2, c3 = self._spheres
        z = (u1 + u2 + u3 + c1.z + c2.z + c3.z) / 3.0 - self.geometry.strut_length
        return (c1.x + c2.x + c3.x) / 3.0 + 0.0 * z, (c1.y + c2.y + c3.y) / 3.0 + 0.0 * z, z

    def _iterate(self, sliders: Array, start: Array) -> tuple[Array, NDArray[np.intp]]:
        """Newton's method on columns (3, N): poses (3, N), and the columns that did not end on the right branch."""
        first = self._spheres[0]
        base = sliders[0] + first.z
        tops = np.stack([u - sliders[0] + (c.z - first.z) for u, c in zip(sliders, self._spheres, strict=True)])
        poses, unfinished = newton(
            lambda pose, rows: self._newton_step(pose, tops[:, rows]),
            np.stack((start[0], start[1], start[2] - base)),
        )
        heights = tops - poses[2]
        right = (heights > 0.0).all(axis=0) & (self._clearance(poses[0], poses[1], heights) > 0.0)
        right[unfinished] = False
        poses[2] += base
        return poses, np.flatnonzero(~right)

    def _newton_step(self, poses: Array, tops: Array) -> Array:
        """J^-1 f of 6-15 and 6-16 (corrected), their factor 2 divided out of both J and f."""
        rows = [(poses[0] - c.x, poses[1] - c.y, poses[2] - top) for c, top in zip(self._spheres, tops, strict=True)]
        f1, f2, f3 = (
            0.5 * (x * x + y * y + z * z - c.square) for c, (x, y, z) in zip(self._spheres, rows, strict=True)
        )
        return np.stack([x * f1 + y * f2 + z * f3 for x, y, z in _inverted(rows)])

    def _too_far(self, row: int, strut: int, x: float, y: float) -> Violation:
        sphere = self._spheres[strut]
        distance = math.hypot(x - sphere.x, y - sphere.y)
        excess = max(distance - sphere.radius, 0.0)
        reason = (
            f"strut {self.axes[strut]}: the TCP is {1e3 * excess:.4g} mm too far from its slider column "
            f"(horizontal span {1e3 * distance:.3f} mm > strut length {1e3 * sphere.radius:.3f} mm)"
        )
        return Violation(row, self.axes[strut], excess, reason)

    def _apart(self, row: int, joints: Array, missing: float) -> Violation:
        """The struts meet nowhere; their squared lengths would have to be larger by `missing`, m^2."""
        heights = [u + sphere.z for u, sphere in zip(joints.tolist(), self._spheres, strict=True)]
        offsets = [height - (sum(heights) - height) / 2.0 for height in heights]
        strut = max(range(3), key=lambda index: abs(offsets[index]))
        sphere, offset = self._spheres[strut], offsets[strut]
        excess = max(math.sqrt(sphere.square + missing) - sphere.radius, 0.0)
        reason = (
            f"slider {self.axes[strut]}: the struts do not meet, they are {1e3 * excess:.4g} mm too short: it is "
            f"{1e3 * abs(offset):.3f} mm {'above' if offset > 0.0 else 'below'} the middle of the other sliders"
        )
        return Violation(row, self.axes[strut], excess, reason)


def _columns(geometry: TripodGeometry) -> tuple[tuple[float, float], ...]:
    """Where the columns stand, (x, y), m. Raises InputError for one without a radius."""
    columns = []
    for strut, (azimuth, turn, error) in enumerate(
        zip(geometry.azimuth, geometry.azimuth_error, geometry.base_radius_error, strict=True)
    ):
        radius = geometry.base_radius + error
        if not radius > 0.0:
            raise InputError(
                f"geometry.base_radius_error[{strut}]: {error} m leaves {radius:.6g} m of geometry.base_radius: it "
                "must stay above 0"
            )
        columns.append((radius * math.cos(azimuth + turn), radius * math.sin(azimuth + turn)))
    return tuple(columns)


def _sphere(geometry: TripodGeometry, strut: int, column_x: float, column_y: float) -> _Sphere:
    """The sphere of a strut whose column is there. Raises InputError for a strut without a length."""
    error = geometry.strut_length_error[strut]
    length = geometry.strut_length + error
    if not length > 0.0:
        raise InputError(
            f"geometry.strut_length_error[{strut}]: {error} m leaves {length:.6g} m of geometry.strut_length: it must "
            "stay above 0"
        )
    radial_x, radial_y = math.cos(geometry.azimuth[strut]), math.sin(geometry.azimuth[strut])
    offset = geometry.base_radius - geometry.platform_radius
    tool_x, tool_y, tool_z = geometry.tool
    return (
        _Sphere(  # along the strut's azimuth and then away from it, so that a column without errors costs no rounding
            offset * radial_x + tool_x + (column_x - geometry.base_radius * radial_x),
            offset * radial_y + tool_y + (column_y - geometry.base_radius * radial_y),
            tool_z + geometry.base_height[strut],
            length,
            length * length,
        )
    )


def _inverted(rows: Sequence[Components]) -> tuple[Components, ...]:
    """Rows of the inverse of the 3 x 3 matrix with these `rows`."""
    first, second, third = rows
    columns = _cross(second, third), _cross(third, first), _cross(first, second)
    determinant = first[0] * columns[0][0] + first[1] * columns[0][1] + first[2] * columns[0][2]
    return tuple([(x / determinant, y / determinant, z / determinant) for x, y, z in zip(*columns, strict=True)])


def _cross(a: Components, b: Components) -> Components:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
