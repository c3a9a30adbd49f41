"""servo_drive: setpoint and actual of one axis -> its command. One node per axis, in the axis' namespace."""

from __future__ import annotations

from typing import Any

from pkm_cnc.errors import MachineFault
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.records import AxisCorrection, AxisSetpoint, AxisState
from pkm_cnc.servo import ServoDrive

__all__ = ["ServoDriveNode", "main"]


class ServoDriveNode(GraphNode):
    """setpoint, actual, and correction where there is one -> command."""

    def prepare(self) -> None:
        """Make the drive."""
        self._drive = ServoDrive(self.setup.axes[self.axis].drive, self.setup.servo_period)
        self._command = f"{self.axis}/command"

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """One period of the position loop."""
        setpoint, actual, *correction = inputs
        correction_or_none = AxisCorrection(*correction[0]) if correction else None
        try:
            command = self._drive.step(AxisSetpoint(*setpoint), AxisState(*actual), correction_or_none)
        except MachineFault as error:
            raise MachineFault(f"cycle {cycle}: {self.axis}: {error}") from None
        self.publish(self._command, cycle, command)


def main() -> None:
    """Entry point of `ros2 run pkm_cnc servo_drive --ros-args -r __ns:=/u1`."""
    run_node(ServoDriveNode, "servo_drive")
