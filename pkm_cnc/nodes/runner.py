"""Runs nodes of one process from configuration to the end of the run."""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from pkm_cnc.errors import InputError
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.run_messages import COMPLETED, End

__all__ = ["make_executor", "run_node", "run_nodes"]

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SLICE = 0.1
"""s of wall time after which the executor is left to look for signals and the end."""
LEAVE_TIMEOUT = 5.0
"""s of wall time that the nodes of one process have to hear the end after the first of them did."""


def make_executor(context: Context) -> Any:
    """The events executor where this rclpy has it (a tenth of the cost of a hop), else the ordinary one."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def run_nodes(nodes: Sequence[GraphNode], context: Context, tick: Callable[[], None] = lambda: None) -> End:
    """Configure and activate `nodes`, spin until all have heard the end of the run, and return it.

    A node whose parameter autostart is false waits for life cycle commands instead. SIGINT, SIGTERM and SIGHUP end the
    run cleanly. `tick` is called some ten times a second. The nodes are gone afterwards: what they said last, they
    would say to the next run as well.
    """
    try:
        with _signals() as caught:
            return _configure_and_spin(nodes, context, tick, caught)
    finally:
        for node in nodes:
            node.destroy_node()
        gc.unfreeze()  # or what stays to the end of the process is torn down with DDS's threads at work: it may crash


def _configure_and_spin(
    nodes: Sequence[GraphNode], context: Context, tick: Callable[[], None], caught: list[int]
) -> End:
    started = [node for node in nodes if node.get_parameter_or("autostart", Parameter("autostart", value=True)).value]
    for node in started:
        node.trigger_configure()
        if node.ended is not None:
            return node.ended
    for node in started:
        node.trigger_activate()
    gc.freeze()  # what is there by now stays to the end: the garbage collector need not look at it in the run
    return _spin(nodes, context, tick, caught)


def _spin(nodes: Sequence[GraphNode], context: Context, tick: Callable[[], None], caught: list[int]) -> End:
    executor = make_executor(context)
    for node in nodes:
        executor.add_node(node)
    pause = [Future()]
    # The time-out of the events executor waits for a quiet moment, and a machine that runs has none.
    nodes[0].create_timer(SLICE, lambda: pause[0].set_result(None), clock=Clock(clock_type=ClockType.STEADY_TIME))
    leave_by = float("inf")
    try:
        while any(node.ended is None for node in nodes) and time.monotonic() < leave_by:
            pause[0] = Future()
            executor.spin_until_future_complete(pause[0], SLICE)
            tick()
            if caught:
                nodes[0].fail(f"stopped by {signal.Signals(caught.pop()).name}")
            if leave_by == float("inf") and any(node.ended is not None for node in nodes):
                leave_by = time.monotonic() + LEAVE_TIMEOUT
        for node in nodes:
            node.leave()
    except ExternalShutdownException:
        pass
    except Exception as error:  # a mistake of ours: the others must hear of it and the bag must be closed
        for node in nodes:
            node.fail(f"internal error: {error!r}")
        raise
    ends = [node.ended for node in nodes if node.ended is not None]
    return next((end for end in ends if not end.completed), ends[0])


@contextmanager
def _signals() -> Iterator[list[int]]:
    caught: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        caught.append(number)

    before = {number: signal.signal(number, note) for number in STOP_SIGNALS}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)  # who starts nodes as processes holds them back till here
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_node(kind: Callable[..., GraphNode], name: str) -> None:
    """Run one node as its own process and exit: 0 at the end of the run, 1 after a fault, 2 for bad input."""
    context = Context()
    try:
        rclpy.init(args=sys.argv, context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = kind(name, context=context)
    except rclpy_implementation.RCLError as error:  # e.g. a parameter file that is missing or no YAML
        print(f"pkm_cnc: {name}: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(InputError.exit_code)
    try:
        end = run_nodes([node], context)
    finally:
        context.try_shutdown()
    if not end.completed:
        print(f"pkm_cnc: {end.node}: {end.reason}", file=sys.stderr)
        sys.exit(end.exit_code)
    print(f"{COMPLETED}{end.cycle}")
