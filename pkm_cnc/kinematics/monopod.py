"""Monopod: one slider pushes, by a strut of constant length, a carriage with the TCP along the x axis.

Geometry (thesis 4-5..4-8, Fig. 4-4). The slider runs on a guide through the point o of the x axis; the angle from +x to
+u is 90 deg + gamma. With the slider's distance U and the TCP's distance X from o the strut closes the triangle

    U^2 + 2 U X sin(gamma) + X^2 = Lambda^2.

The controller counts from elsewhere: U = u + du, X = x + dx. So o is at x = -dx in `base_link`, the guides lie in its
x-y plane, and for perfect geometry (gamma = dx = du = 0, Lambda = L) u^2 + x^2 = L^2 with u along y (4-1).

The length (4.2.2). gamma, dx and du are what a calibration looks for; the length of the strut then follows, because the
machine has a start point (u0, x0) where it has been seen: the strut closes the triangle there,

    Lambda^2 = U0^2 + 2 U0 X0 sin(gamma) + X0^2,   U0 = u0 + du,  X0 = x0 + dx                     (closure: start)

unless it is known, Lambda = L + dL (closure: given). u0 is that of perfect geometry, +-sqrt(L^2 - x0^2), unless it is
given. So a nominal and an actual geometry that share L and x0 agree at the start point and part from it.

With s = sin(gamma), c = cos(gamma) let

    h = U + X s   how far the slider is from the TCP along the slider's guide,   h^2 = Lambda^2 - X^2 c^2
    a = X + U s   how far the TCP is from the slider along the x axis,           a^2 = Lambda^2 - U^2 c^2.

Inverse (4-9):  U = h - X s, the sign of h is that of the slider's side: + above the x axis, - below.
Forward (4-10): X = a - U s, the sign of a is that of the TCP's side: + right of the slider, - left.
|X| c is the TCP's distance from the slider's guide, |U| c the slider's from the x axis: Lambda must be longer.

Derivatives. Along the closure h dU = -a dX, so the gear ratio is J = dU/dX = -a / h (4-13), and with h' = J + s and
a' = 1 + J s

    d2U/dX2 = -(1 + 2 s J + J^2) / h,   d2U/dt2 = J d2X/dt2 + d2U/dX2 (dX/dt)^2.

Forward, Newton. f(X) = X^2 + 2 U X s + U^2 - Lambda^2 has the derivative 2 a; in a the iteration is Heron's for the
square root of Lambda^2 - U^2 c^2, so it never leaves the side of the slider on which the guess is.

Singularities. The matrix J has one element, so its condition is 1; what can fail is its value.
- a = 0, J = 0: the dead point. The strut stands across the x axis, the slider is at the end of its way, and the TCP is
  not held. Beyond it the same u belongs to the TCP on the other side, which is another assembly branch and refused.
- h = 0, J without bound: the strut stands across the slider's guide, at the border of the workspace.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pkm_cnc import tolerances
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics._newton import newton
from pkm_cnc.kinematics._pointwise import Component, everywhere, pointwise, square_root
from pkm_cnc.kinematics._refusals import by_row, not_finite, refuse_rates
from pkm_cnc.kinematics.machine import Array, Motion, Segment, Violation, unreachable
from pkm_cnc.parameters import parameter, read_section

__all__ = ["Monopod"]

SIGNS = {"above": 1.0, "below": -1.0, "right": 1.0, "left": -1.0}
"""Of h for the slider's sides, of a for the TCP's."""
OTHER = {"above": "below", "below": "above", "right": "left", "left": "right"}


@dataclasses.dataclass(frozen=True)
class _Geometry:
    """Geometry of the Monopod, thesis Fig. 4-4. The thesis gives no length."""

    strut_length: float = parameter(0.600, "length L of the strut between its joints", unit="m", above=0.0)
    inclination: float = parameter(
        0.0,
        "gamma: angle between the slider's guide and the x axis less 90 deg",
        unit="rad",
        minimum=-1.0,
        maximum=1.0,
    )
    tcp_offset: float = parameter(0.0, "dx: true TCP X less the controller's x", unit="m", minimum=-1.0, maximum=1.0)
    slider_offset: float = parameter(
        0.0, "du: true slider U less the controller's u", unit="m", minimum=-1.0, maximum=1.0
    )
    closure: str = parameter(
        "start",
        "length of the strut: start = as the triangle closes at the start point, given = L + strut_length_error",
        choices=("start", "given"),
    )
    start_x: float = parameter(
        0.300, "x0 of the start point, of closure start", unit="m", minimum=-100.0, maximum=100.0
    )
    start_u: float = parameter(
        0.0,
        "u0 of the start point, of closure start; 0 = that of perfect geometry, sqrt(L^2 - x0^2) on the slider's side",
        unit="m",
        minimum=-100.0,
        maximum=100.0,
    )
    strut_length_error: float = parameter(
        0.0, "dL: true length of the strut less L, of closure given", unit="m", minimum=-1.0, maximum=1.0
    )
    slider_side: str = parameter(
        "above", "side of the x axis on which the slider is (root of the inverse)", choices=("above", "below")
    )
    tcp_side: str = parameter(
        "right", "side of the dead point on which the TCP is (root of the forward)", choices=("right", "left")
    )


class Monopod:
    """Kinematics of the Monopod; see `pkm_cnc.kinematics.Machine` for what each function answers, this module for how.

    u and x are the controller's coordinates. `geometry` is the checked geometry, `strut_length` the true length of the
    strut, Lambda, m.
    """

    Geometry: ClassVar[type[Any]] = _Geometry
    axes: ClassVar[tuple[str, ...]] = ("u",)
    coordinates: ClassVar[tuple[str, ...]] = ("x",)

    def __init__(self, geometry: _Geometry) -> None:
        """Take the geometry. Raises InputError naming key and bound if the strut cannot close."""
        self.geometry = read_section(_Geometry, vars(geometry), "geometry.")
        self._dx, self._du = self.geometry.tcp_offset, self.geometry.slider_offset
        self._sin, self._cos = math.sin(self.geometry.inclination), math.cos(self.geometry.inclination)
        self._above, self._right = SIGNS[self.geometry.slider_side], SIGNS[self.geometry.tcp_side]
        self._square = self._start_square() if self.geometry.closure == "start" else self._given_square()
        self.strut_length = math.sqrt(self._square)

    def _given_square(self) -> float:
        length, error = self.geometry.strut_length, self.geometry.strut_length_error
        if not length + error > 0.0:
            raise InputError(
                f"geometry.strut_length_error: {error} m leaves nothing of geometry.strut_length {length} m"
            )
        return (length + error) * (length + error)

    def _start_square(self) -> float:
        """Lambda^2 by closure at the start point, m^2, such that it is L^2 to the last bit for perfect geometry."""
        geometry = self.geometry
        if geometry.strut_length_error != 0.0:
            raise InputError(
                f"geometry.strut_length_error: {geometry.strut_length_error} m given, but with geometry.closure: start "
                "it follows from the start point; leave it out, or choose geometry.closure: given"
            )
        x0, u0 = geometry.start_x, geometry.start_u
        perfect = u0 * u0 + x0 * x0
        if u0 == 0.0:
            perfect = geometry.strut_length * geometry.strut_length
            if not perfect > x0 * x0:
                raise InputError(
                    f"geometry.start_x: {x0} m is not within geometry.strut_length {geometry.strut_length} m"
                )
            u0 = self._above * math.sqrt(perfect - x0 * x0)
        slider, tcp = u0 + self._du, x0 + self._dx
        if not self._above * (slider + tcp * self._sin) > 0.0:
            raise InputError(
                f"geometry.start_u: {u0:.6g} m is not {geometry.slider_side} the TCP at the start point, as "
                "geometry.slider_side says"
            )
        if not self._right * (tcp + slider * self._sin) > 0.0:
            raise InputError(
                f"geometry.start_x: {x0:.6g} m is not {geometry.tcp_side} of the dead point, as geometry.tcp_side says"
            )
        gained = self._du * (2.0 * u0 + self._du) + self._dx * (2.0 * x0 + self._dx)
        return perfect + gained + 2.0 * slider * tcp * self._sin

    def inverse(self, tcp: ArrayLike) -> Array:
        """u (..., 1), m, of the poses `tcp` (..., 1), m (4-9). Raises UnreachableError naming row and excess."""
        return pointwise(self._inverse, tcp)

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 1), m, of the slider `joints` (..., 1), m (4-10). Raises UnreachableError naming row, excess."""
        return pointwise(self._forward, joints)

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, iterated from `guess` (..., 1), m; None: a strut's length to the TCP's side of the slider.

        Raises UnreachableError as `forward`, and for a guess on the other side.
        """
        sliders = np.asarray(joints, dtype=float)
        with np.errstate(all="ignore"):  # rows that do not converge are refused next
            true = sliders.reshape(1, -1) + self._du
            if guess is None:
                start = self._right * self.strut_length - true * self._sin
            else:
                start = np.broadcast_to(guess, sliders.shape).reshape(1, -1) + self._dx
            poses, unfinished = newton(lambda pose, rows: self._newton_step(pose, true[:, rows]), start)
            right = (self._right * (poses + true * self._sin) > 0.0)[0]
        right[unfinished] = False
        if found := self.joint_violations(sliders):
            raise unreachable(found)
        if not right.all():
            row = int(np.flatnonzero(~right)[0])
            where = "" if sliders.ndim == 1 else f"row {row}: "
            raise UnreachableError(
                f"{where}Newton's method does not lead from the guess {1e3 * (start[0, row] - self._dx):.3f} mm to the "
                f"TCP: start {self.geometry.tcp_side} of the slider"
            )
        return np.ascontiguousarray(poses.reshape(sliders.shape) - self._dx)

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dx (..., 1, 1), 1: the gear ratio (4-13). Raises UnreachableError."""
        return pointwise(lambda pose: ((self._ratio(pose),),), tcp)

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dx/du (..., 1, 1), 1. Raises UnreachableError."""
        return pointwise(lambda pose: ((1.0 / self._ratio(pose),),), tcp)

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/dx2 (..., 1), 1/m, through `tcp` along `direction` (..., 1), 1 or -1. Raises UnreachableError."""
        return self.motion(tcp, direction, (0.0,))[2]

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., 1), m, m/s, m/s^2, of the TCP's position, velocity and acceleration (..., 1).

        Raises UnreachableError, also for a velocity or an acceleration that is not finite.
        """
        result = pointwise(self._motion, tcp, velocity, acceleration)
        return result[..., 0, :], result[..., 1, :], result[..., 2, :]

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion`: one drive has no choice."""
        return self.motion

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Why poses `tcp` (..., 1) cannot be used: not finite, too far, beyond the dead point, singular; by row."""
        poses = np.asarray(tcp, dtype=float)
        rows = poses.reshape(-1, 1)
        found = not_finite(rows, self.coordinates)
        for row in np.flatnonzero(np.isfinite(rows[:, 0])).tolist():
            violation = self._pose_violation(row, float(rows[row, 0]))
            found += [] if violation is None else [violation]
        return by_row(found, single=poses.ndim == 1)

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        """Why sliders `joints` (..., 1) cannot be used: not finite, too far from the x axis, wrong side; by row."""
        sliders = np.asarray(joints, dtype=float)
        rows = sliders.reshape(-1, 1)
        found = not_finite(rows, self.axes)
        for row in np.flatnonzero(np.isfinite(rows[:, 0])).tolist():
            violation = self._joint_violation(row, float(rows[row, 0]))
            found += [] if violation is None else [violation]
        return by_row(found, single=sliders.ndim == 1)

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """1 (...): J has one element; how near a dead point is, J itself says. Raises UnreachableError."""
        return np.ones(self.inverse(tcp).shape[:-1])

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """Named lines of guides and strut for `joints` (1,) and `tcp` (1,), m, in `base_link`.

        "column u" (2, 3), "column x" (2, 3), the guides of slider and TCP, and "strut u" (2, 3) from slider to TCP.
        """
        (u,), (x,) = np.asarray(joints, dtype=float).tolist(), np.asarray(tcp, dtype=float).tolist()
        origin = np.array((-self._dx, 0.0, 0.0))
        along_u, along_x = np.array((-self._sin, self._cos, 0.0)), np.array((1.0, 0.0, 0.0))
        slider, end = origin + (u + self._du) * along_u, np.array((x, 0.0, 0.0))
        way_u = max(self.strut_length, abs(u + self._du)) * self._above
        way_x = max(self.strut_length, abs(x + self._dx)) * self._right
        return [
            ("column u", np.stack((origin, origin + way_u * along_u))),
            ("column x", np.stack((origin, origin + way_x * along_x))),
            ("strut u", np.stack((slider, end))),
        ]

    def _sides(self, pose: list[Component]) -> tuple[Component, Component, Component]:
        """X, h, a, m. Raises UnreachableError for what is no pose of the machine."""
        tcp = pose[0] + self._dx
        across = tcp * self._cos
        square = self._square - across * across
        if everywhere(square > 0.0):  # fails for NaN and infinity
            h = self._above * square_root(square)
            a = tcp * self._cos * self._cos + h * self._sin
            if everywhere(self._right * a > 0.0):
                return tcp, h, a
        raise unreachable(self.violations(np.stack((pose[0],), axis=-1)))

    def _inverse(self, pose: list[Component]) -> tuple[Component, ...]:
        tcp, h, _ = self._sides(pose)
        return (h - tcp * self._sin - self._du,)

    def _ratio(self, pose: list[Component]) -> Component:
        _, h, a = self._sides(pose)
        return -a / h

    def _motion(
        self, pose: list[Component], velocity: list[Component], acceleration: list[Component]
    ) -> tuple[tuple[Component, ...], ...]:
        refuse_rates(self.coordinates, velocity, acceleration)
        tcp, h, a = self._sides(pose)
        (v,), (rate,) = velocity, acceleration
        ratio = -a / h
        bend = -(1.0 + 2.0 * self._sin * ratio + ratio * ratio) / h
        return (h - tcp * self._sin - self._du,), (ratio * v,), (ratio * rate + bend * v * v,)

    def _forward(self, joints: list[Component]) -> tuple[Component, ...]:
        slider = joints[0] + self._du
        across = slider * self._cos
        square = self._square - across * across
        if everywhere(square > 0.0):
            a = self._right * square_root(square)
            h = slider * self._cos * self._cos + a * self._sin
            if everywhere(self._above * h > 0.0):
                return (a - slider * self._sin - self._dx,)
        raise unreachable(self.joint_violations(np.stack((joints[0],), axis=-1)))

    def _newton_step(self, tcp: Array, slider: Array) -> Array:
        a = tcp + slider * self._sin
        across = slider * self._cos
        return (a * a + across * across - self._square) / (2.0 * a)

    def _pose_violation(self, row: int, x: float) -> Violation | None:
        tcp, length = x + self._dx, self.strut_length
        distance = abs(tcp) * self._cos
        square = self._square - distance * distance
        if not square > 0.0:
            excess = max(distance - length, 0.0)
            reason = (
                f"strut u: the TCP is {1e3 * excess:.4g} mm too far from the slider's guide (distance "
                f"{1e3 * distance:.3f} mm, strut length {1e3 * length:.3f} mm)"
            )
            return Violation(row, "u", excess, reason)
        h = self._above * math.sqrt(square)
        a = tcp * self._cos * self._cos + h * self._sin
        side = self.geometry.tcp_side
        if not self._right * a > 0.0:
            reason = (
                f"x: wrong assembly branch: the TCP is {1e3 * abs(a):.4g} mm {OTHER[side]} of the slider, at or beyond "
                f"the dead point; geometry.tcp_side is {side}"
            )
            return Violation(row, "x", abs(a), reason)
        ratio = abs(a / h)
        if ratio > tolerances.SINGULAR:
            return None
        reason = f"strut u: singular pose: dead point, gear ratio {ratio:.3g} is below {tolerances.SINGULAR:g}"
        return Violation(row, "u", tolerances.SINGULAR - ratio, reason)

    def _joint_violation(self, row: int, u: float) -> Violation | None:
        slider, length = u + self._du, self.strut_length
        distance = abs(slider) * self._cos
        square = self._square - distance * distance
        if not square > 0.0:
            excess = max(distance - length, 0.0)
            reason = (
                f"slider u: the strut does not reach the x axis, it is {1e3 * excess:.4g} mm too short (distance "
                f"{1e3 * distance:.3f} mm, strut length {1e3 * length:.3f} mm)"
            )
            return Violation(row, "u", excess, reason)
        h = slider * self._cos * self._cos + self._right * math.sqrt(square) * self._sin
        side = self.geometry.slider_side
        if not self._above * h > 0.0:
            reason = (
                f"slider u: wrong assembly branch: it would be {1e3 * abs(h):.4g} mm {OTHER[side]} the TCP; "
                f"geometry.slider_side is {side}"
            )
            return Violation(row, "u", abs(h), reason)
        return None
