"""plant: command of one axis -> where its slider is a period later. One node per axis, in the axis' namespace."""

from __future__ import annotations

from typing import Any

from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.records import AxisCommand
from pkm_cnc.simulation import make_plant

__all__ = ["PlantNode", "main"]


class PlantNode(GraphNode):
    """command of cycle k -> actual of cycle k + 1; the actual of cycle 0 is the start pose at rest."""

    def prepare(self) -> None:
        """Make the plant at the start pose."""
        self._plant = make_plant(self.setup, self.axis)
        self._actual = f"{self.axis}/actual"

    def start(self) -> None:
        """The state at rest starts the loop."""
        self.publish(self._actual, 0, self._plant.state)

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """One period of everything that is faster than the servo clock."""
        self.publish(self._actual, cycle + 1, self._plant.step(AxisCommand(*inputs[0])))


def main() -> None:
    """Entry point of `ros2 run pkm_cnc plant --ros-args -r __ns:=/u1`."""
    run_node(PlantNode, "plant")
