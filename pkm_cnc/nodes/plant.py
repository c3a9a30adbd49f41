"""plant: command of one axis -> where its slider is a period later. One node per axis, in the axis' namespace."""

from __future__ import annotations

from typing import Any

from pkm_cnc.errors import MachineFault, UnreachableError
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.records import AxisCommand, AxisState
from pkm_cnc.simulation import make_load, make_plant

__all__ = ["PlantNode", "main"]


class PlantNode(GraphNode):
    """command of cycle k -> actual of cycle k + 1; the actual of cycle 0 is the start pose at rest.

    Where all axes carry something together, it hears the other axes' actual of cycle k as well.
    """

    def prepare(self) -> None:
        """Make the plant at the start pose."""
        self._plant = make_plant(self.setup, self.axis)
        self._load = make_load(self.setup) if self.setup.coupled else None
        self._actual = f"{self.axis}/actual"

    def start(self) -> None:
        """The state at rest starts the loop."""
        self.publish(self._actual, 0, self._plant.state)

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """One period of everything that is faster than the servo clock."""
        values = {topic.name: value for topic, value in zip(self.join.inputs, inputs, strict=True)}
        command = AxisCommand(*values.pop(f"{self.axis}/command"))
        load = 0.0 if self._load is None else self._load_of(cycle, values)
        self.publish(self._actual, cycle + 1, self._plant.step(command, load))

    def _load_of(self, cycle: int, others: dict[str, tuple[Any, ...]]) -> float:
        """The force on this axis, N; `others` are the states of the others by topic."""
        assert self._load is not None
        axes = list(self.setup.axes)
        states = [self._plant.state if axis == self.axis else AxisState(*others[f"{axis}/actual"]) for axis in axes]
        try:
            return self._load.step(states)[axes.index(self.axis)]
        except UnreachableError as error:
            raise MachineFault(f"cycle {cycle}: {error}") from None


def main() -> None:
    """Entry point of `ros2 run pkm_cnc plant --ros-args -r __ns:=/u1`."""
    run_node(PlantNode, "plant")
