"""What a command hears of a graph that runs in processes of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from pkm_cnc.topics import STATUS, topics

__all__ = ["HEARD", "Hear", "listening"]

HEARD = (STATUS, "contour_error")
"""The topics that tell a person how a run is going."""

Hear = Callable[[str, bytes], None]
"""Takes a message of one of them: topic and CDR bytes."""

DEPTH = 20_000
"""Messages that wait for the next look, which comes ten times a second."""


@contextlib.contextmanager
def listening(axes: Sequence[str], hear: Hear) -> Iterator[Callable[[], None]]:
    """Give a function that hands to `hear` whatever has arrived since it was last called.

    It takes the messages from the subscriptions itself: an executor would need half of the time between two looks.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from rclpy.signals import SignalHandlerOptions

    from pkm_cnc.nodes.message_types import message_class

    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("listener", context=context)
        subscriptions = {}
        for name in HEARD:
            latched = DurabilityPolicy.TRANSIENT_LOCAL if name == STATUS else DurabilityPolicy.VOLATILE
            kind = message_class(topics(axes)[name].typename)
            qos = QoSProfile(depth=DEPTH, durability=latched)
            subscriptions[name] = node.create_subscription(kind, name, lambda data: None, qos, raw=True)

        def look() -> None:
            for name, subscription in subscriptions.items():
                with subscription.handle:
                    while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                        hear(name, taken[0])

        try:
            yield look
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()
