"""tcp_controller: setpoints, actuals, the TCP's state -> a velocity correction for every drive, in the same cycle."""

from __future__ import annotations

from typing import Any

from pkm_cnc.errors import MachineFault, UnreachableError
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.runner import run_node
from pkm_cnc.records import AxisSetpoint, AxisState, TcpSetpoint, TcpState
from pkm_cnc.topics import TCP_CONTROLLER

__all__ = ["TcpControllerNode", "main"]


class TcpControllerNode(GraphNode):
    """tcp/setpoint, uN/setpoint, uN/actual, tcp/state -> uN/correction."""

    def prepare(self) -> None:
        """Make the controller. Raises InputError where `tcp_control` asks for none."""
        self._controller = self.setup.tcp_controller()
        self._names = [f"{axis}/correction" for axis in self.setup.axes]

    def step(self, cycle: int, inputs: list[tuple[Any, ...]]) -> None:
        """One cycle; the inputs are tcp/setpoint, setpoint and actual of each axis in turn, tcp/state."""
        setpoint, *of_axes, state = inputs
        axis_setpoints = [AxisSetpoint(*values) for values in of_axes[0::2]]
        states = [AxisState(*values) for values in of_axes[1::2]]
        try:
            corrections = self._controller.step(TcpSetpoint(*setpoint), axis_setpoints, states, TcpState(*state))
        except UnreachableError as error:
            raise MachineFault(f"cycle {cycle}: {error}") from None
        for name, correction in zip(self._names, corrections, strict=True):
            self.publish(name, cycle, correction)


def main() -> None:
    """Entry point of `ros2 run pkm_cnc tcp_controller`."""
    run_node(TcpControllerNode, TCP_CONTROLLER)
