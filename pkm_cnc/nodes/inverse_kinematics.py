"""inverse_kinematics: setpoint of the TCP -> setpoint of every drive."""

from __future__ import annotations

from typing import Any

from pkm_cnc.errors import MachineFault, UnreachableError
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.topics import INVERSE_KINEMATICS

__all__ = ["InverseKinematicsNode", "main"]


class InverseKinematicsNode(GraphNode):
    """tcp/setpoint -> u1/setpoint, u2/setpoint, ...: position, velocity and acceleration, analytic."""

    def prepare(self) -> None:
        """Names of the topics to publish; the motion from rest at the start pose."""
        self._motion = self.setup.machine.setpoint_motion(self.setup.start_pose, self.setup.servo_period)
        self._names = [f"{axis}/setpoint" for axis in self.setup.axes]

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """Transform one setpoint."""
        tcp = inputs[0]
        try:
            motion = self._motion(tcp[0:3], tcp[3:6], tcp[6:9])
        except UnreachableError as error:
            raise MachineFault(f"cycle {cycle}: {error}") from None
        for name, setpoint in zip(self._names, zip(*(part.tolist() for part in motion), strict=True), strict=True):
            self.publish(name, cycle, setpoint)


def main() -> None:
    """Entry point of `ros2 run pkm_cnc inverse_kinematics`."""
    run_node(InverseKinematicsNode, INVERSE_KINEMATICS)
