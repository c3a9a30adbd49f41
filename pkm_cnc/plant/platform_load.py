"""What all axes carry together: platform and tool, as a point mass at the TCP.

By the principle of virtual work a force F at the TCP acts on the joints as (dP/du)^T F. The force is weight and
inertia,

    F = m (g - d2P/dt2),

with the acceleration of the TCP that the sliders had over the last period. So what an axis takes of the others is half
a period old when it is found, and is held over the next period: it is late by one period on average and by one and a
half at its end. The force at the TCP is wrong by at most 1.5 T m times the jerk of the TCP: for 20 kg, 1 ms and
50 m/s^3 by 1.5 N, on what the default motor and screw have as 3435 kg at the slider (drive.inertia (2 pi / pitch)^2).
"""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.kinematics import Machine
from pkm_cnc.plant.imperfect_axis import STANDARD_GRAVITY
from pkm_cnc.records import AxisState

__all__ = ["PlatformLoad"]


class PlatformLoad:
    """The load of a machine whose true kinematics are `machine`: `mass` kg, `period` s."""

    def __init__(self, machine: Machine, mass: float, period: float) -> None:
        self._machine = machine
        self._mass = mass
        self._period = period
        self._velocity: tuple[float, ...] = (0.0, 0.0, 0.0)

    def at_rest(self, joints: Sequence[float]) -> list[float]:
        """The force on each slider, N, when all rest at `joints`, m."""
        at_rest = [AxisState(joint, joint, 0.0, 0.0, 0.0, 0.0, 0) for joint in joints]
        return PlatformLoad(self._machine, self._mass, self._period).step(at_rest)

    def step(self, states: Sequence[AxisState]) -> list[float]:
        """The force on each slider, N, along its travel, from all axes at t_k: for the period that begins there.

        Raises UnreachableError where the sliders have no TCP, or a singular one.
        """
        tcp = self._machine.forward([state.slider_position for state in states])
        rows = self._machine.inverse_jacobian(tcp).tolist()
        speeds = [state.slider_velocity for state in states]
        velocity = tuple(sum([a * b for a, b in zip(row, speeds, strict=True)]) for row in rows)
        x, y, z = [(now - before) / self._period for now, before in zip(velocity, self._velocity, strict=True)]
        self._velocity = velocity
        force = (-self._mass * x, -self._mass * y, -self._mass * (z + STANDARD_GRAVITY))
        return [sum([f * d for f, d in zip(force, column, strict=True)]) for column in zip(*rows, strict=True)]
