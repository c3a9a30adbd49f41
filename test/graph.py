"""Graphs in this process for the tests, and a node beside them that listens and speaks."""

import contextlib

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from running import AXES

from pkm_cnc.bag import BagWriter
from pkm_cnc.bringup import describe_graph, run_in_one_process
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.nodes.all_nodes import NODE_CLASSES
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.nodes.recorder import RecorderNode
from pkm_cnc.nodes.runner import run_nodes
from pkm_cnc.program import read_program
from pkm_cnc.run_messages import NEUTRAL
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import RECORDER, recorded_topics, topics

TOPICS = topics(AXES)
RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)


def simulated(program, bag, *overrides, machine="tripod"):
    """Simulate the program in a file; return the number of cycles."""
    setup, content = load_setup(machine, overrides), read_program(str(program))
    with BagWriter(bag, recorded_topics(tuple(setup.axes), setup.tcp_control.active)) as sink:
        return simulate(setup, content, prepare(setup, content), sink)


def run_graph(program, bag, *overrides, machine="tripod", pacing="fast", tick=lambda cycle: None, options=NEUTRAL):
    """Run the program in a file through the graph in this process; return how it ended."""
    return run_in_one_process(load_setup(machine, overrides), str(program), str(bag), pacing, tick, options)


@contextlib.contextmanager
def ros_context():
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield context
    finally:
        context.try_shutdown()


def run_in_order(program, bag, order, late):
    """Run the graph with its nodes made in an order of their own, and one of them started when all others wait."""
    setup = load_setup("tripod")
    parameters = {key: value for key, (value, _) in setup.parameters.items()}
    specs = {spec.full_name: spec for spec in describe_graph(AXES, str(program), str(bag), "fast")}
    ticks = iter(range(1000))

    def start_late():
        if next(ticks) == 2:
            nodes[late].trigger_configure()
            nodes[late].trigger_activate()

    with ros_context() as context:

        def given(name):
            return {**parameters, **specs[name].parameters, **({"autostart": False} if name == late else {})}

        recorder = RecorderNode(RECORDER, tapped=True, context=context, parameters=given(RECORDER))
        nodes = {
            name: NODE_CLASSES[specs[name].executable](
                specs[name].executable,
                context=context,
                namespace=specs[name].namespace,
                parameters=given(name),
                tap=recorder.tap_in,
            )
            for name in order
            if name != RECORDER
        }
        nodes[RECORDER] = recorder
        return run_nodes([nodes[name] for name in order], context, start_late)


class Visitor:
    """A node of somebody else in the same domain. It does something only while it is spun."""

    def __init__(self, context):
        self.node = Node("visitor", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def hear(self, name, kind):
        """The list that gets every message of a topic from now on."""
        heard = []
        self.node.create_subscription(kind, name, heard.append, RELIABLE)
        return heard

    def spin(self):
        """Take whatever has arrived."""
        for _ in range(50):
            self._executor.spin_once(timeout_sec=0)

    def speaker(self, name):
        """A publisher on a topic of the graph."""
        return self.node.create_publisher(message_class(TOPICS[name].typename), f"/{name}", RELIABLE)

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()


@contextlib.contextmanager
def visitor():
    with ros_context() as context:
        guest = Visitor(context)
        try:
            yield guest
        finally:
            guest.close()
