"""Hybrid machine: the Tripod carries the tool over a cross table that carries the workpiece (thesis 6.2, Fig. 6-1).

What is machined is where the tool is on the workpiece. The workpiece moves with the table, so with the Tripod's TCP T
in `base_link`, T = Tripod.forward(u1, u2, u3), and the table at t = (t_x, t_y)

    P = T - (t_x, t_y, 0),

the TCP in the workpiece's coordinates, which are those of `base_link` while the table is at 0. Programs, setpoints and
contour errors are in these coordinates: a contour error is one of the relative motion. Five drives move three
coordinates; x and y have one way too many, and something must divide them.

Divided by share, 0 <= split <= 1: T = S P with S = diag(split, split, 1), t = (split - 1) (P_x, P_y). Static, so with
J_T, J of the Tripod at T,

    J = du/dP = [ J_T S ; (split - 1) I 0 ]  (5 x 3),    dP/du = [ J_T^-1 , -I ; 0 ]  (3 x 5),    dP/du J = I,

and along a straight line with unit vector n the sliders have the second derivative of the Tripod along S n, the table
none. So with equal drives the contour error kappa v^2 dP/du d2u/ds2 of a horizontal line is split^2 times that of the
Tripod alone on the line through T: the table leaves none, half a share a quarter.

Divided by frequency: the table takes the slow part of x and y, the tool the fast rest (`_crossover`), so that the
heavy table is spared and the Tripod stays near its middle, where it has workspace on all sides. This depends on what
came before and exists for successive setpoints only (`setpoint_motion`). All else (`inverse`, `jacobian`, `violations`,
`motion`, ...) answers for its limit of slow motion, which is split = 0: the table has all of x and y. At constant
velocity v the Tripod runs ahead by v / (pi crossover).

Singular or out of reach is the Tripod or nothing, wherever it stands; how far the table goes is a matter of its travel.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pkm_cnc.errors import UnreachableError
from pkm_cnc.kinematics._crossover import Crossover, Division
from pkm_cnc.kinematics._refusals import by_row, not_finite
from pkm_cnc.kinematics.machine import Array, Motion, Segment, Violation, unreachable
from pkm_cnc.kinematics.tripod import Tripod, TripodGeometry
from pkm_cnc.parameters import parameter, parameters_of, read_section

__all__ = ["Hybrid"]

RATES = ("vx", "vy", "vz"), ("ax", "ay", "az")


@dataclasses.dataclass(frozen=True)
class _Geometry(TripodGeometry):
    """Geometry of the Tripod, and how x and y are divided between it and the table."""

    divide: str = parameter(
        "share",
        "how x and y are divided: share = by geometry.split; frequency = the table takes what is slow, the Tripod the "
        "rest, by geometry.crossover",
        choices=("share", "frequency"),
        decided=True,
    )
    split: float = parameter(
        0.5,
        "by share: the Tripod's part of x and y, 0 = all by the table, 1 = all by the Tripod",
        minimum=0.0,
        maximum=1.0,
        decided=True,
    )
    crossover: float = parameter(
        1.0,
        "by frequency: a sine of this frequency is passed by half to the table, a slower one by more; at a constant "
        "speed v the Tripod runs v / (pi crossover) ahead, 32 mm at 6000 mm/min",
        unit="Hz",
        minimum=0.01,
        maximum=1000.0,
        decided=True,
    )


class Hybrid:
    """Kinematics of the hybrid machine; see `pkm_cnc.kinematics.Machine` for what each function answers.

    Joints are the Tripod's three sliders and the table's place, poses (..., 3) the TCP on the workpiece, m.
    """

    Geometry: ClassVar[type[Any]] = _Geometry
    axes: ClassVar[tuple[str, ...]] = (*Tripod.axes, "table_x", "table_y")
    coordinates: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    def __init__(self, geometry: _Geometry) -> None:
        """Take the geometry. Raises InputError naming key and bound, for what the Tripod refuses too."""
        self.geometry = read_section(_Geometry, vars(geometry), "geometry.")
        own = {spec.name: getattr(self.geometry, spec.name) for spec in parameters_of(TripodGeometry)}
        self._tripod = Tripod(TripodGeometry(**own))
        split = self.geometry.split if self.geometry.divide == "share" else 0.0
        self._share = np.array((split, split, 1.0))

    def inverse(self, tcp: ArrayLike) -> Array:
        """u (..., 5), m, of the poses `tcp` (..., 3), m. Raises UnreachableError."""
        tool, table = self._divided(_finite(tcp, self.coordinates))
        return _with_table(self._tripod.inverse(tool), table)

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 3), m, of sliders and table `joints` (..., 5), m, closed form. Raises UnreachableError."""
        table = self._table(joints)
        tcp = self._tripod.forward(_sliders(joints))
        tcp[..., :2] -= table
        return tcp

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, the Tripod's part by Newton's method. Raises UnreachableError."""
        table = self._table(joints)
        first = None if guess is None else self._tool(guess, table)
        tcp = self._tripod.forward_newton(_sliders(joints), first)
        tcp[..., :2] -= table
        return tcp

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dP (..., 5, 3), 1, at the poses `tcp`, divided by share. Raises UnreachableError."""
        tool, _ = self._divided(_finite(tcp, self.coordinates))
        sliders = self._tripod.jacobian(tool) * self._share
        table = np.diag(self._share - 1.0)[:2]
        return np.concatenate((sliders, np.broadcast_to(table, (*sliders.shape[:-2], 2, 3))), axis=-2)

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dP/du (..., 3, 5), 1, at the poses `tcp`, divided by share. Raises UnreachableError."""
        tool, _ = self._divided(_finite(tcp, self.coordinates))
        sliders = self._tripod.inverse_jacobian(tool)
        table = ((-1.0, 0.0), (0.0, -1.0), (0.0, 0.0))
        return np.concatenate((sliders, np.broadcast_to(table, (*sliders.shape[:-2], 3, 2))), axis=-1)

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/ds2 (..., 5), 1/m, through `tcp` along the unit vectors `direction` (..., 3). Raises UnreachableError."""
        return self.motion(tcp, direction, (0.0, 0.0, 0.0))[2]

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., 5), m, m/s, m/s^2, of the TCP's motion (..., 3), divided by share.

        Raises UnreachableError, also for a velocity or an acceleration that is not finite.
        """
        given = _finite_motion(tcp, velocity, acceleration)
        tools, tables = zip(*map(self._divided, given), strict=True)
        return _all_with_table(self._tripod.motion(*tools), tables)

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion`, or, divided by frequency, one that goes on from rest at `start` (3,) with `period` s to each row.

        A call that raises UnreachableError leaves it as it was before.
        """
        if self.geometry.divide == "share":
            return self.motion
        return _DividedByFrequency(self._tripod, Crossover(self.geometry.crossover, period), start)

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Why poses `tcp` (..., 3) cannot be used: not finite, or what the Tripod says where it stands then; by row."""
        poses = np.asarray(tcp, dtype=float)
        rows = poses.reshape(-1, 3)
        usable = np.flatnonzero(np.isfinite(rows).all(axis=1))
        found = not_finite(rows, self.coordinates)
        for violation in self._tripod.violations(self._divided(rows[usable])[0]):
            found.append(violation._replace(row=int(usable[violation.row or 0])))
        return by_row(found, single=poses.ndim == 1)

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        """Why joints (..., 5) cannot be used: what the Tripod says of its sliders, a table not finite; by row."""
        given = np.asarray(joints, dtype=float)
        rows = given.reshape(-1, 5)
        found = [*self._tripod.joint_violations(rows[:, :3]), *not_finite(rows[:, 3:], self.axes[3:])]
        return by_row(found, single=given.ndim == 1)

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """Reciprocal condition number (...) of the Tripod's J where it stands with its share: 1 isotropic, 0 singular.

        Not of the 5 x 3 matrix, which the table keeps far from 0 where the Tripod does not hold its platform any more.
        Raises UnreachableError.
        """
        return self._tripod.reciprocal_condition(self._divided(_finite(tcp, self.coordinates))[0])

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """The Tripod's lines, "table" (5, 3), closed, and "workpiece" (3, 3): its x axis, its zero, its y axis.

        All in `base_link`, table and workpiece where the table is and at the height of the workpiece's zero. The table
        is drawn Rb wide, the axes half as long as it reaches.
        """
        given = np.asarray(joints, dtype=float)
        zero = np.append(given[3:], 0.0)
        edge = 0.5 * self.geometry.base_radius
        corners = edge * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
        axes = 0.5 * edge * np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
        return [
            *self._tripod.sketch(given[:3], np.asarray(tcp, dtype=float) + zero),
            ("table", zero + corners[[0, 1, 2, 3, 0]]),
            ("workpiece", zero + axes),
        ]

    def _divided(self, vectors: Array) -> tuple[Array, Array]:
        """Positions, velocities or accelerations (..., 3) by share: the tool's (..., 3) and the table's (..., 2)."""
        tool = vectors * self._share
        return tool, tool[..., :2] - vectors[..., :2]

    def _table(self, joints: ArrayLike) -> Array:
        """The table's place (..., 2) of `joints` (..., 5). Raises UnreachableError if it is not finite."""
        table = np.asarray(joints, dtype=float)[..., 3:]
        if not np.isfinite(table).all():
            raise unreachable(self.joint_violations(joints))
        return table

    def _tool(self, tcp: ArrayLike, table: Array) -> Array:
        """The Tripod's TCP (..., 3) in `base_link`, of the TCP on the workpiece and the table's place (..., 2)."""
        return np.asarray(tcp, dtype=float) + np.concatenate((table, np.zeros((*table.shape[:-1], 1))), axis=-1)


class _DividedByFrequency:
    """The motion of the joints, setpoint by setpoint: the table has the slow part of x and y, the Tripod all else."""

    def __init__(self, tripod: Tripod, crossover: Crossover, start: ArrayLike) -> None:
        x, y, _ = np.asarray(start, dtype=float).tolist()
        self._tripod = tripod
        self._crossover = crossover
        self._divisions = Division(x, 0.0, 0.0), Division(y, 0.0, 0.0)

    def __call__(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        position, speed, rate = _finite_motion(tcp, velocity, acceleration)
        step, slow_acceleration = self._crossover.step, self._crossover.slow_acceleration
        x, y = self._divisions
        parts = []
        for x_value, y_value in position.reshape(-1, 3)[:, :2].tolist():
            x, y = step(x, x_value), step(y, y_value)
            parts.append((x.fast, y.fast, x.slow_velocity, y.slow_velocity, slow_acceleration(x), slow_acceleration(y)))
        divided = np.array(parts).reshape(*position.shape[:-1], 6)
        tables = divided[..., 0:2] - position[..., :2], -divided[..., 2:4], -divided[..., 4:6]
        tools = position.copy(), speed.copy(), rate.copy()
        tools[0][..., :2] = divided[..., 0:2]
        tools[1][..., :2] -= divided[..., 2:4]
        tools[2][..., :2] -= divided[..., 4:6]
        try:
            joints = self._tripod.motion(*tools)
        except UnreachableError as error:
            raise UnreachableError(
                f"{error}; it is too fast for the Tripod, which runs ahead of the table: a lower feed or a higher "
                "geometry.crossover helps"
            ) from None
        self._divisions = x, y
        return _all_with_table(joints, tables)


def _sliders(joints: ArrayLike) -> Array:
    return np.asarray(joints, dtype=float)[..., :3]


def _with_table(sliders: Array, table: Array) -> Array:
    joints = np.empty((*sliders.shape[:-1], 5))
    joints[..., :3], joints[..., 3:] = sliders, table
    return joints


def _all_with_table(sliders: Sequence[Array], tables: Sequence[Array]) -> tuple[Array, Array, Array]:
    position, velocity, acceleration = map(_with_table, sliders, tables)
    return position, velocity, acceleration


def _finite(vectors: ArrayLike, names: tuple[str, ...]) -> Array:
    """`vectors` (..., 3) as an array. Raises UnreachableError, naming row and component, if one is not finite."""
    array = np.asarray(vectors, dtype=float)
    if not np.isfinite(array).all():
        raise unreachable(by_row(not_finite(array.reshape(-1, len(names)), names), single=array.ndim == 1))
    return array


def _finite_motion(tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> list[Array]:
    """The three (..., 3), each in the shape of all. Raises UnreachableError as `_finite`."""
    vectors = [np.asarray(vector, dtype=float) for vector in (tcp, velocity, acceleration)]
    if len({vector.shape for vector in vectors}) > 1:
        vectors = list(np.broadcast_arrays(*vectors))
    return [_finite(vector, names) for vector, names in zip(vectors, (Hybrid.coordinates, *RATES), strict=True)]
