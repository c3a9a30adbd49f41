"""Bipod: two sliders on guides along y carry, by two struts of constant length, the TCP above them in the x-y plane.

Geometry (thesis 5-1 corrected, Fig. 5-2). The guides stand b to the right and b to the left of the y axis. Strut i, of
length L_i, leads from the slider joint C_i to the TCP P, B_i + u_i + L_i - P = 0:

    C_1 = (b + dB_1, u_1 + H_1),   C_2 = (-b + dB_2, u_2 + H_2),   |P - C_i| = L_i,   L_i = L + dL_i

with the offsets dB_i of the guides, the heights H_i of the sliders' zero and the errors dL_i of the struts, all zero
for perfect geometry.

Inverse (5-3, 5-4). With d_i = x - C_ix, what strut i spans along x,

    h_i = sqrt(L_i^2 - d_i^2),   u_i = y - h_i - H_i.

The root is negative: the sliders are below the TCP. A pose is out of reach of strut i if |d_i| >= L_i.

Derivatives. h_i depends on x only, dh_i = -d_i dx / h_i. For a TCP with velocity v and acceleration a

    du_i/dt   = v_y + q_i,                                 q_i = d_i v_x / h_i
    d2u_i/dt2 = a_y + (v_x^2 + d_i a_x + q_i^2) / h_i

so row i of J = du/dP is (d_i / h_i, 1) (5-8; the thesis' J of 5-11 is the inverse of it).

Forward, closed form. 5-5..5-7 (with n = u_1^2 - u_2^2 + L_2^2 - L_1^2) squares the u_i, which stand far from zero and
differ little. The same intersection of two circles, with C_1 as the origin, takes only their difference: with
e = C_2 - C_1 and q = P - C_1, the difference of the circles is q . e = m, m = (e . e + L_1^2 - L_2^2) / 2, so

    q = t e + k n,   t = m / e . e,   k = sqrt((L_1^2 - t m) / e . e),   n = (e_y, -e_x), as long as e and upward.

The other root, -k, is the mirror image of the TCP in the line of the slider joints, below it. The pose counts if it is
also above both sliders.

Forward, Newton. f_i(P) = |P - C_i|^2 - L_i^2, rows of its Jacobi matrix 2 (P - C_i). The difference of the f_i is
linear, so from the first step on the iterates have the t above; with it the iteration is Heron's for k and never leaves
the side of the line of the slider joints on which the guess is.

Singularities. Row i of J is parallel to strut i, divided by h_i, so
- J grows without bound where h_i = 0: strut i is horizontal, at the border of the workspace;
- det J = 0 where both struts lie in one line, which is that of the slider joints: k = 0. That line is at x by

      clearance = (d_2 h_1 - d_1 h_2) / (d_2 - d_1)

  below the TCP. Between the guides d_1 < 0 < d_2 and it is positive; with equal struts it is so everywhere, because
  beyond a guide the nearer strut stands higher. Only unequal struts can come into one line inside the workspace; the
  poses beyond that are on the wrong branch and are refused.
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

__all__ = ["Bipod"]

Components = Sequence[Component]


@dataclasses.dataclass(frozen=True)
class _Geometry:
    """Geometry of the Bipod, thesis Fig. 5-2. The thesis gives no lengths."""

    base_half_distance: float = parameter(
        0.200, "b: half the distance between the two guides, at x = b and x = -b", unit="m", above=0.0
    )
    strut_length: float = parameter(0.600, "length L of the struts between their joints", unit="m", above=0.0)
    strut_length_error: tuple[float, ...] = parameter(
        (0.0, 0.0), "true lengths of the struts less L", unit="m", minimum=-1.0, maximum=1.0
    )
    base_offset: tuple[float, ...] = parameter(
        (0.0, 0.0), "true x of the guides less b and -b", unit="m", minimum=-1.0, maximum=1.0
    )
    base_height: tuple[float, ...] = parameter(
        (0.0, 0.0), "true y of the slider joints less u1 and u2", unit="m", minimum=-1.0, maximum=1.0
    )


class _Circle(NamedTuple):
    """Where strut i keeps the TCP: centre (x, u_i + y), radius, m; its square, m^2."""

    x: float
    y: float
    radius: float
    square: float


class _Meeting(NamedTuple):
    """Forward kinematics before its root: q = t e + sqrt(square) n, n = (e_y, -e_x)."""

    ex: Component
    ey: Component
    t: Component
    square: Component


class Bipod:
    """Kinematics of the Bipod; see `pkm_cnc.kinematics.Machine` for what each function answers, this module for how.

    u_i is the y of slider i in `base_link`. `geometry` is the checked geometry.
    """

    Geometry: ClassVar[type[Any]] = _Geometry
    axes: ClassVar[tuple[str, ...]] = ("u1", "u2")
    coordinates: ClassVar[tuple[str, ...]] = ("x", "y")

    def __init__(self, geometry: _Geometry) -> None:
        """Take the geometry. Raises InputError naming key and bound if the struts cannot hold the TCP."""
        self.geometry = checked = read_section(_Geometry, vars(geometry), "geometry.")
        lengths = [checked.strut_length + error for error in checked.strut_length_error]
        for index, length in enumerate(lengths):
            if not length > 0.0:
                raise InputError(
                    f"geometry.strut_length_error[{index}]: {checked.strut_length_error[index]} m leaves nothing of "
                    f"geometry.strut_length {checked.strut_length} m"
                )
        right, left = checked.base_half_distance, -checked.base_half_distance
        right, left = right + checked.base_offset[0], left + checked.base_offset[1]
        if not right - left > tolerances.SINGULAR * sum(lengths):
            raise InputError(
                f"geometry.base_offset: {checked.base_offset[0]}, {checked.base_offset[1]} m puts the guide of u1 at "
                f"x = {right:.6g} m, not right of the guide of u2 at x = {left:.6g} m"
            )
        if not sum(lengths) > right - left:
            raise InputError(
                f"geometry.strut_length: struts of {lengths[0]:.6g} and {lengths[1]:.6g} m do not meet between guides "
                f"{right - left:.6g} m apart"
            )
        first, second = (
            _Circle(x, height, length, length * length)
            for x, height, length in zip((right, left), checked.base_height, lengths, strict=True)
        )
        self._circles = first, second
        self._ex = second.x - first.x
        self._difference = first.square - second.square

    def inverse(self, tcp: ArrayLike) -> Array:
        """u (..., 2), m, of the poses `tcp` (..., 2), m, in `base_link` (5-3, 5-4).

        Raises UnreachableError naming row, strut and excess.
        """
        return pointwise(self._inverse, tcp)

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 2), m, in `base_link` of the sliders `joints` (..., 2), m.

        Raises UnreachableError naming row, slider and excess if the struts do not meet above both sliders.
        """
        return pointwise(self._forward, joints)

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, iterated from `guess` (..., 2), m; None: a strut's length above the sliders' middle.

        Raises UnreachableError as `forward`, and for a guess below the line of the slider joints.
        """
        sliders = np.asarray(joints, dtype=float)
        start = pointwise(self._above, sliders) if guess is None else np.broadcast_to(guess, sliders.shape)
        rows = np.array(start, dtype=float).reshape(-1, 2)
        with np.errstate(all="ignore"):  # rows that do not converge are refused next
            poses, failed = self._iterate(sliders.reshape(-1, 2).T, rows.T)
        if failed.size:
            if found := self.joint_violations(sliders):
                raise unreachable(found)
            where = "" if sliders.ndim == 1 else f"row {failed[0]}: "
            x, y = (1e3 * rows[failed[0]]).tolist()
            raise UnreachableError(
                f"{where}Newton's method does not lead from the guess ({x:.3f}, {y:.3f}) mm to the pose above the "
                "sliders: start above the line of the slider joints"
            )
        return np.ascontiguousarray(poses.T).reshape(sliders.shape)

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dP (..., 2, 2), 1: rows are struts (5-8). Raises UnreachableError."""
        return pointwise(self._jacobian, tcp)

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dP/du (..., 2, 2), 1: columns are struts (5-11). Raises UnreachableError."""
        return pointwise(self._inverse_jacobian, tcp)

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/ds2 (..., 2), 1/m, through `tcp` along the unit vectors `direction` (..., 2). Raises UnreachableError."""
        return self.motion(tcp, direction, (0.0, 0.0))[2]

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., 2), m, m/s, m/s^2, of the TCP's position, velocity and acceleration (..., 2).

        Raises UnreachableError, also for a velocity or an acceleration that is not finite.
        """
        result = pointwise(self._motion, tcp, velocity, acceleration)
        return result[..., 0, :], result[..., 1, :], result[..., 2, :]

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion`: two drives have no choice."""
        return self.motion

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Why poses `tcp` (..., 2) cannot be used: not finite, a strut too short, wrong branch, singular; by row."""
        poses = np.asarray(tcp, dtype=float)
        rows = poses.reshape(-1, 2)
        found = not_finite(rows, self.coordinates)
        finite = np.isfinite(rows).all(axis=1)
        with np.errstate(all="ignore"):
            squares = np.stack(self._squares(rows[:, 0]), axis=1)
            heights = np.sqrt(squares)
            clearance = self._clearance(rows[:, 0], heights.T)
        reached = (squares > 0.0).all(axis=1)
        for row, strut in np.argwhere(finite[:, None] & ~(squares > 0.0)).tolist():
            found.append(self._too_far(row, strut, float(rows[row, 0])))
        for row in np.flatnonzero(finite & reached & ~(clearance > 0.0)).tolist():
            strut, excess = int(heights[row].argmin()), -float(clearance[row])
            reason = (
                f"strut {self.axes[strut]}: wrong assembly branch: the TCP is {1e3 * excess:.4g} mm below the line of "
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
        """Why sliders `joints` (..., 2) cannot be used: not finite, struts do not meet, wrong branch; by row."""
        sliders = np.asarray(joints, dtype=float)
        rows = sliders.reshape(-1, 2)
        found = not_finite(rows, self.axes)
        finite = np.isfinite(rows).all(axis=1)
        with np.errstate(all="ignore"):
            meeting = self._meeting(*rows.T)
            meets = meeting.square > 0.0
            y = self._height(meeting)
            below = np.stack((-y, meeting.ey - y), axis=1)
        for row in np.flatnonzero(finite & ~meets).tolist():
            found.append(self._apart(row, float(meeting.ey[row])))
        for row, strut in np.argwhere((finite & meets)[:, None] & ~(below < 0.0)).tolist():
            axis, excess = self.axes[strut], float(below[row, strut])
            reason = f"slider {axis}: wrong assembly branch: it would be {1e3 * excess:.4g} mm above the TCP"
            found.append(Violation(row, axis, excess, reason))
        return by_row(found, single=sliders.ndim == 1)

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """Reciprocal condition number (...) of J in the 2-norm: 1 isotropic, 0 singular. Raises UnreachableError."""
        values = np.linalg.svd(self.jacobian(tcp), compute_uv=False)
        return np.asarray(values[..., -1] / values[..., 0])

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """Named lines of guides and struts for `joints` (2,) and `tcp` (2,), m, in `base_link`.

        "column u1" (2, 3), "strut u1" (2, 3) from slider joint to TCP, ... The guides hang from y = 0, two strut
        lengths long or as far as their sliders are.
        """
        end = np.array((*np.asarray(tcp, dtype=float).tolist(), 0.0))
        segments: list[Segment] = []
        for axis, circle, u in zip(self.axes, self._circles, np.asarray(joints, dtype=float).tolist(), strict=True):
            slider = u + circle.y
            low, joint, high = (
                np.array((circle.x, y, 0.0))
                for y in (min(-2.0 * self.geometry.strut_length, slider), slider, max(0.0, slider))
            )
            segments.append((f"column {axis}", np.stack((low, high))))
            segments.append((f"strut {axis}", np.stack((joint, end))))
        return segments

    def _squares(self, x: Component) -> tuple[Component, ...]:
        """h_i^2, m^2: not positive where strut i does not reach."""
        return tuple([c.square - (x - c.x) * (x - c.x) for c in self._circles])

    def _heights(self, pose: Components) -> tuple[Component, ...]:
        """h_i, m. Raises UnreachableError for what is no pose of the machine."""
        x, y = pose
        s1, s2 = self._squares(x)
        if everywhere((s1 > 0.0) & (s2 > 0.0) & (y - y == 0.0)):  # the last fails for NaN and infinity
            heights = square_root(s1), square_root(s2)
            if everywhere(self._clearance(x, heights) > 0.0):
                return heights
        raise unreachable(self.violations(np.stack((x, y), axis=-1)))

    def _clearance(self, x: Component, heights: Components) -> Component:
        """How far below the TCP the line of the slider joints is, m: zero where J is singular."""
        (h1, h2), (c1, c2) = heights, self._circles
        return ((x - c1.x) * h2 - (x - c2.x) * h1) / self._ex

    def _inverse(self, pose: Components) -> tuple[Component, ...]:
        y = pose[1]
        return tuple([y - h - c.y for c, h in zip(self._circles, self._heights(pose), strict=True)])

    def _jacobian(self, pose: Components) -> tuple[Components, ...]:
        x = pose[0]
        return tuple([((x - c.x) / h, h / h) for c, h in zip(self._circles, self._heights(pose), strict=True)])

    def _inverse_jacobian(self, pose: Components) -> tuple[Components, ...]:
        (slope1, one), (slope2, _) = self._jacobian(pose)
        determinant = slope1 - slope2
        return (one / determinant, -one / determinant), (-slope2 / determinant, slope1 / determinant)

    def _motion(self, pose: Components, velocity: Components, acceleration: Components) -> tuple[Components, ...]:
        refuse_rates(self.coordinates, velocity, acceleration)
        (x, y), (vx, vy), (ax, ay) = pose, velocity, acceleration
        position, speed, rate = [], [], []
        for c, h in zip(self._circles, self._heights(pose), strict=True):
            d = x - c.x
            q = d * vx / h
            position.append(y - h - c.y)
            speed.append(vy + q)
            rate.append(ay + (vx * vx + d * ax + q * q) / h)
        return position, speed, rate

    def _meeting(self, u1: Component, u2: Component) -> _Meeting:
        """The line q = t e + k n of the forward kinematics, relative to slider joint 1, and k^2."""
        c1, c2 = self._circles
        ex, ey = self._ex, (u2 - u1) + (c2.y - c1.y)
        square = ex * ex + ey * ey
        m = 0.5 * (square + self._difference)
        t = m / square
        return _Meeting(ex, ey, t, (c1.square - t * m) / square)

    def _height(self, meeting: _Meeting) -> Component:
        """y of the TCP relative to slider joint 1, m; the upper root."""
        return meeting.t * meeting.ey - square_root(meeting.square) * meeting.ex

    def _forward(self, joints: Components) -> tuple[Component, ...]:
        u1, u2 = joints
        meeting = self._meeting(u1, u2)
        if everywhere(meeting.square > 0.0):
            y = self._height(meeting)
            if everywhere((y > 0.0) & (y > meeting.ey)):
                c1 = self._circles[0]
                x = meeting.t * meeting.ex + square_root(meeting.square) * meeting.ey
                return x + c1.x, y + (u1 + c1.y)
        raise unreachable(self.joint_violations(np.stack((u1, u2), axis=-1)))

    def _above(self, joints: Components) -> tuple[Component, ...]:
        """A pose well above the line of the slider joints: a strut's length over their middle."""
        (u1, u2), (c1, c2) = joints, self._circles
        y = (u1 + u2 + c1.y + c2.y) / 2.0 + self.geometry.strut_length
        return (c1.x + c2.x) / 2.0 + 0.0 * y, y

    def _iterate(self, sliders: Array, start: Array) -> tuple[Array, NDArray[np.intp]]:
        """Newton's method on columns (2, N): poses (2, N), and the columns that did not end on the right branch."""
        c1, c2 = self._circles
        base, top = sliders[0] + c1.y, (sliders[1] - sliders[0]) + (c2.y - c1.y)

        def step(poses: Array, columns: NDArray[np.intp]) -> Array:
            """J^-1 f, a factor 2 divided out of both."""
            (x, y), above = poses, top[columns]
            x1, y1, x2, y2 = x - c1.x, y, x - c2.x, y - above
            f1 = 0.5 * (x1 * x1 + y1 * y1 - c1.square)
            f2 = 0.5 * (x2 * x2 + y2 * y2 - c2.square)
            determinant = x1 * y2 - x2 * y1
            return np.stack(((y2 * f1 - y1 * f2) / determinant, (x1 * f2 - x2 * f1) / determinant))

        poses, unfinished = newton(step, np.stack((start[0], start[1] - base)))
        heights = poses[1], poses[1] - top
        right = (heights[0] > 0.0) & (heights[1] > 0.0) & (self._clearance(poses[0], heights) > 0.0)
        right[unfinished] = False
        poses[1] += base
        return poses, np.flatnonzero(~right)

    def _too_far(self, row: int, strut: int, x: float) -> Violation:
        circle = self._circles[strut]
        distance = abs(x - circle.x)
        excess = max(distance - circle.radius, 0.0)
        reason = (
            f"strut {self.axes[strut]}: the TCP is {1e3 * excess:.4g} mm too far from its slider's guide "
            f"(span along x {1e3 * distance:.3f} mm, strut length {1e3 * circle.radius:.3f} mm)"
        )
        return Violation(row, self.axes[strut], excess, reason)

    def _apart(self, row: int, offset: float) -> Violation:
        """Slider joint 2 is `offset`, m, above joint 1, and no point has the struts' distances from both."""
        (c1, c2), distance = self._circles, math.hypot(self._ex, offset)
        longest, difference = c1.radius + c2.radius, abs(c1.radius - c2.radius)
        if distance > difference:
            excess, bound = max(distance - longest, 0.0), f"more than both struts, {1e3 * longest:.3f} mm"
        else:
            excess, bound = difference - distance, f"less than the struts differ by, {1e3 * difference:.3f} mm"
        reason = (
            f"slider u2: the struts do not meet, by {1e3 * excess:.4g} mm: the slider joints are "
            f"{1e3 * distance:.3f} mm apart, {bound}"
        )
        return Violation(row, "u2", excess, reason)
