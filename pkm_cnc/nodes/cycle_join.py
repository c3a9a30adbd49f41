"""The cycle contract of a node's inputs: a cycle is stepped when every input for it is there, in cycle order, once."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

from pkm_cnc.errors import MachineFault
from pkm_cnc.nodes.in_order import InOrder
from pkm_cnc.topics import Topic

__all__ = ["CycleJoin"]

NOT_A_NUMBER_ALLOWED = {"motor_speed", "current", "torque"}
"""Fields that are NaN where the drive model has no motor."""


class CycleJoin:
    """Joins servo-rate inputs by cycle, whatever order they arrive in.

    Every topic must deliver cycles first, first + 1, ... A cycle seen before is ignored and counted in `ignored`.
    """

    def __init__(self, inputs: Sequence[Topic]) -> None:
        self.inputs = tuple(inputs)
        self.cycle = 0
        """The cycle to be stepped next."""
        self._queues: list[deque[tuple[Any, ...]]] = [deque() for _ in inputs]
        self._streams = [InOrder(topic.name) for topic in self.inputs]
        self._checked = [_leading_finite(topic) for topic in self.inputs]

    def offer(self, slot: int, cycle: int, values: tuple[Any, ...]) -> bool:
        """Take the message of input number `slot`; return whether the next cycle is complete now.

        Raises MachineFault for a skipped cycle or a value that is not a finite number.
        """
        if not self._streams[slot].take(cycle):
            return False
        if not math.isfinite(sum(values[: self._checked[slot]])):
            self._refuse(slot, cycle, values)
        self._queues[slot].append(values)
        return all(self._queues)

    @property
    def ignored(self) -> int:
        """Number of messages ignored because their cycle had been received before."""
        return sum(stream.ignored for stream in self._streams)

    def take(self) -> list[tuple[Any, ...]]:
        """The inputs of `cycle`, in the order of `inputs`; the next cycle is then awaited."""
        self.cycle += 1
        return [queue.popleft() for queue in self._queues]

    @property
    def complete(self) -> bool:
        """Whether every input of the next cycle is there; never, without inputs."""
        return bool(self._queues) and all(self._queues)

    def peek(self, slot: int) -> tuple[Any, ...]:
        """The values of input number `slot` for the next cycle, which must be complete."""
        return self._queues[slot][0]

    def missing(self) -> list[Topic]:
        """The inputs that the next cycle still lacks."""
        return [topic for topic, queue in zip(self.inputs, self._queues, strict=True) if not queue]

    def _refuse(self, slot: int, cycle: int, values: tuple[Any, ...]) -> None:
        topic = self.inputs[slot]
        names = topic.codec.dtype.names or ()
        for name, value in zip(names[1:], values[: self._checked[slot]], strict=False):
            if not math.isfinite(value):
                raise MachineFault(f"{topic.name}: {name} is {value} in cycle {cycle}, a finite number expected")


def _leading_finite(topic: Topic) -> int:
    names = (topic.codec.dtype.names or ())[1:]
    return next((place for place, name in enumerate(names) if name in NOT_A_NUMBER_ALLOWED), len(names))
