"""What every machine answers, and how it says that something cannot be reached."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import UnreachableError

__all__ = [
    "NOT_AS_DRAWN",
    "Array",
    "Machine",
    "Motion",
    "Segment",
    "Violation",
    "is_drawn",
    "reached_rows",
    "unreachable",
]

Array = NDArray[np.float64]

Motion = Callable[[ArrayLike, ArrayLike, ArrayLike], tuple[Array, Array, Array]]
"""From position, velocity, acceleration of the TCP to those of the joints, as `Machine.motion`."""

NOT_AS_DRAWN = (
    "inclination",
    "tcp_offset",
    "slider_offset",
    "strut_length_error",
    "base_offset",
    "base_radius_error",
    "azimuth_error",
    "base_height",
)
"""Parameters of a geometry, where a machine has them, that no drawing says: two machines of one drawing differ in these
alone, and a calibration looks for them."""

Segment = tuple[str, Array]
"""A named open polyline of a drawing: points of shape (m, 3), m, in `base_link`."""


class Violation(NamedTuple):
    """One reason why a pose or a set of joint positions cannot be used."""

    row: int | None
    """Row in the array (leading dimensions flattened); None if it was a single pose."""
    axis: str
    """The joint axis (the strut) or the coordinate at fault, a name of the machine's `axes` or `coordinates`."""
    excess: float
    """By how much: m, or a ratio for a singularity; NaN if the value at fault is not finite."""
    reason: str
    """What is wrong, where and by how much, for the reader: lengths in mm."""

    def __str__(self) -> str:
        return self.reason if self.row is None else f"row {self.row}: {self.reason}"


def unreachable(violations: Sequence[Violation]) -> UnreachableError:
    """The one-line error for `violations` (at least one): the first in words, the number of the others."""
    others = f" (and {len(violations) - 1} more)" if len(violations) > 1 else ""
    return UnreachableError(f"{violations[0]}{others}")


def is_drawn(key: str) -> bool:
    """Whether the parameter `key` is a dimension of the nominal geometry that all machines of a kind share."""
    section, _, name = key.rpartition(".")
    return section == "geometry" and name not in NOT_AS_DRAWN


def reached_rows(function: Callable[..., Array], *tables: Array) -> tuple[Array, UnreachableError | None]:
    """The rows of `function(*tables)` up to the first that it refuses, and that refusal, which then names no row.

    A function that goes on where it ended must not do so after a refusal (`Machine.setpoint_motion`).
    """
    try:
        return function(*tables), None
    except UnreachableError:
        rows: list[Array] = []
        for row in zip(*tables, strict=True):
            try:
                rows.append(function(*row))
            except UnreachableError as error:
                return np.array(rows), error
        raise


class Machine(Protocol):
    """Kinematics of one machine: n joint coordinates u (m), TCP coordinates P in `base_link` (m).

    All functions take one pose, shape (3,) or (n,), or an array of poses, shape (..., 3) or (..., n), and a row of an
    array result equals the result of that row alone bit for bit. They keep no state, change no argument and return new
    arrays. A machine with fewer coordinates than three has len(coordinates) in the place of 3.
    """

    Geometry: ClassVar[type[Any]]
    """Frozen dataclass of `pkm_cnc.parameters.parameter` fields: section `geometry.*` of the machine file."""
    axes: ClassVar[tuple[str, ...]]
    """Names of the joint axes, in the order of u."""
    coordinates: ClassVar[tuple[str, ...]]
    """Names of the TCP's coordinates, in the order of P."""

    def __init__(self, geometry: Any) -> None:
        """Take a `Geometry`. Raises InputError naming key and bound if the machine cannot be built like that."""

    def inverse(self, tcp: ArrayLike) -> Array:
        """Joint coordinates u (..., n), m, of the poses `tcp` (..., 3), m.

        Raises UnreachableError for a pose that no joint position reaches on the machine's assembly branch.
        """

    def forward(self, joints: ArrayLike) -> Array:
        """Poses (..., 3), m, of the joint coordinates `joints` (..., n), m, on the machine's assembly branch.

        In closed form. Raises UnreachableError if there is none.
        """

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """As `forward`, by Newton's method from the pose `guess` (..., 3), m; None: the machine's own.

        Raises UnreachableError if there is no pose, or if the guess leads to another assembly branch.
        """

    def jacobian(self, tcp: ArrayLike) -> Array:
        """J = du/dP (..., n, 3), 1, at the poses `tcp`. Raises UnreachableError."""

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        """dP/du (..., 3, n), 1, at the poses `tcp`. Raises UnreachableError."""

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        """d2u/ds2 (..., n), 1/m, along straight lines through `tcp` with unit vector `direction` (..., 3).

        Raises UnreachableError.
        """

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        """u, du/dt, d2u/dt2 (..., n), m, m/s, m/s^2, of a TCP moving with `velocity` and `acceleration` (..., 3).

        Raises UnreachableError, also for a velocity or an acceleration that is not finite.
        """

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        """`motion` for the setpoints of successive cycles, `period` s apart, from rest at `start` (3,); one a run.

        It is `motion` itself but for a redundant machine that divides the motion by what came before. Each call goes on
        where the last one ended; how many cycles are in a call changes nothing. A call that raises changes nothing.
        """

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        """Why poses cannot be used, by row: all that `inverse` refuses, and singular poses. Empty: all can."""

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        """Why joint coordinates cannot be used, by row: all that `forward` refuses. Empty: all can."""

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        """Reciprocal condition number (...) of J in the 2-norm: 1 isotropic, 0 singular. Raises UnreachableError.

        Of a redundant machine that of the part that can be singular; it says of which.
        """

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        """The machine as named lines, for one pose: `joints` (n,) and `tcp` (3,) are drawn as given, unchecked."""
