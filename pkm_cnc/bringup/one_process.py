"""All nodes in this process: the fastest way, because the recorder takes the bytes where they are published."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pkm_cnc.bringup.description import describe_graph
from pkm_cnc.bringup.environment import sole_machine
from pkm_cnc.bringup.listener import HEARD, Hear
from pkm_cnc.config import Setup
from pkm_cnc.run_messages import NEUTRAL, End, RunOptions
from pkm_cnc.topics import RECORDER

if TYPE_CHECKING:
    from pkm_cnc.nodes.graph_node import Tap

__all__ = ["run_in_one_process"]


def run_in_one_process(
    setup: Setup,
    program: str,
    bag: str,
    pacing: str,
    tick: Callable[[int], None] = lambda cycle: None,
    options: RunOptions = NEUTRAL,
    hear: Hear | None = None,
) -> End:
    """Run the graph in this process; `tick` is told the recorded cycles some ten times a second.

    `hear` gets the messages of the topics HEARD. Raises MachineFault where another machine runs in the ROS
    domain.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    from pkm_cnc.nodes.all_nodes import NODE_CLASSES
    from pkm_cnc.nodes.recorder import RecorderNode
    from pkm_cnc.nodes.runner import run_nodes

    parameters = {key: value for key, (value, _) in setup.parameters.items()}
    context = Context()
    with sole_machine():
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            recorder = RecorderNode(RECORDER, tapped=True, context=context, parameters={**parameters, "bag": bag})
            others = [
                NODE_CLASSES[spec.executable](
                    spec.executable,
                    context=context,
                    namespace=spec.namespace,
                    parameters={**parameters, **spec.parameters},
                    tap=recorder.tap_in if hear is None else _both(recorder.tap_in, hear),
                )
                for spec in describe_graph(tuple(setup.axes), program, bag, pacing, setup.tcp_control.active, options)
                if spec.executable != RECORDER
            ]
            return run_nodes([*others, recorder], context, lambda: tick(recorder.cycles))
        finally:
            context.try_shutdown()


def _both(tap: Tap, hear: Hear) -> Tap:
    def both(topic: str, cycle: int, time: int, data: bytes) -> None:
        tap(topic, cycle, time, data)
        if topic in HEARD:
            hear(topic, data)

    return both
