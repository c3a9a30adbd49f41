"""A machine of one or two coordinates, answering for poses in space: the other coordinates of the TCP stay 0."""

from __future__ import annotations

from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from pkm_cnc.kinematics.machine import Array, Machine, Motion, Segment, Violation, unreachable
from pkm_cnc.tolerances import OFF_MACHINE, OFF_MACHINE_RATE

__all__ = ["in_space"]

SPACE = ("x", "y", "z")
POSITION = "", "mm", OFF_MACHINE
VELOCITY, ACCELERATION = ("v", "mm/s", OFF_MACHINE_RATE), ("a", "mm/s^2", OFF_MACHINE_RATE)
"""What the name of a component begins with, its unit, in reasons; what counts as 0."""


def in_space(machine: Machine) -> Machine:
    """`machine` itself if it moves the TCP in x, y and z, else the same machine for poses (..., 3), m, in `base_link`.

    A pose whose other coordinates are not 0 is out of reach; in the derivatives they have zeros.
    """
    return machine if machine.coordinates == SPACE else cast(Machine, _InSpace(machine))


class _InSpace:
    """The machine's answers with the coordinates that it does not move filled in."""

    Geometry: ClassVar[type[Any]]
    axes: tuple[str, ...]
    coordinates: ClassVar[tuple[str, ...]] = SPACE

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.axes = machine.axes
        self.geometry = getattr(machine, "geometry", None)
        self._moved = [SPACE.index(name) for name in machine.coordinates]
        self._fixed = [column for column in range(3) if column not in self._moved]

    def inverse(self, tcp: ArrayLike) -> Array:
        return self._machine.inverse(self._own(tcp, *POSITION))

    def forward(self, joints: ArrayLike) -> Array:
        return self._filled(self._machine.forward(joints))

    def forward_newton(self, joints: ArrayLike, guess: ArrayLike | None = None) -> Array:
        own = None if guess is None else self._own(guess, *POSITION)
        return self._filled(self._machine.forward_newton(joints, own))

    def jacobian(self, tcp: ArrayLike) -> Array:
        return self._filled(self._machine.jacobian(self._own(tcp, *POSITION)))

    def inverse_jacobian(self, tcp: ArrayLike) -> Array:
        own = self._machine.inverse_jacobian(self._own(tcp, *POSITION))
        return np.swapaxes(self._filled(np.swapaxes(own, -1, -2)), -1, -2)

    def second_derivative(self, tcp: ArrayLike, direction: ArrayLike) -> Array:
        return self._machine.second_derivative(self._own(tcp, *POSITION), self._own(direction, *VELOCITY))

    def motion(self, tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
        return self._machine.motion(
            self._own(tcp, *POSITION), self._own(velocity, *VELOCITY), self._own(acceleration, *ACCELERATION)
        )

    def setpoint_motion(self, start: ArrayLike, period: float) -> Motion:
        motion = self._machine.setpoint_motion(self._own(start, *POSITION), period)
        if motion == self._machine.motion:
            return self.motion

        def in_space_motion(tcp: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> tuple[Array, Array, Array]:
            return motion(
                self._own(tcp, *POSITION), self._own(velocity, *VELOCITY), self._own(acceleration, *ACCELERATION)
            )

        return in_space_motion

    def violations(self, tcp: ArrayLike) -> list[Violation]:
        poses = np.asarray(tcp, dtype=float)
        found = [*self._outside(poses, *POSITION), *self._machine.violations(poses[..., self._moved])]
        return sorted(found, key=lambda violation: violation.row or 0)

    def joint_violations(self, joints: ArrayLike) -> list[Violation]:
        return self._machine.joint_violations(joints)

    def reciprocal_condition(self, tcp: ArrayLike) -> Array:
        return self._machine.reciprocal_condition(self._own(tcp, *POSITION))

    def sketch(self, joints: ArrayLike, tcp: ArrayLike) -> list[Segment]:
        return self._machine.sketch(joints, np.asarray(tcp, dtype=float)[..., self._moved])

    def _own(self, vectors: ArrayLike, kind: str, unit: str, nothing: float) -> Array:
        """The machine's coordinates of `vectors` (..., 3). Raises UnreachableError if another one is not 0."""
        array = np.asarray(vectors, dtype=float)
        outside = self._outside(array, kind, unit, nothing)
        if outside:
            raise unreachable(outside)
        return array[..., self._moved]

    def _outside(self, vectors: Array, kind: str, unit: str, nothing: float) -> list[Violation]:
        rows, single = vectors.reshape(-1, 3), vectors.ndim == 1
        moved = " and ".join(SPACE[column] for column in self._moved)
        found = []
        for row, place in np.argwhere(~(np.abs(rows[:, self._fixed]) <= nothing)).tolist():
            name, value = SPACE[self._fixed[place]], float(rows[row, self._fixed[place]])
            reason = f"{kind}{name}: {1e3 * value:.4g} {unit} is not 0: this machine moves the TCP in {moved} only"
            found.append(Violation(None if single else row, name, abs(value), reason))
        return found

    def _filled(self, own: Array) -> Array:
        """`own` (..., moved) with zeros for the other coordinates (..., 3)."""
        result = np.zeros((*own.shape[:-1], 3))
        result[..., self._moved] = own
        return result
