"""The rule for everything that is numbered: 0, 1, 2, ..., each once; again is ignored and counted, a gap is a fault."""

from __future__ import annotations

from pkm_cnc.errors import MachineFault

__all__ = ["InOrder"]


class InOrder:
    """Follows one numbered stream; `topic` and `what` (cycle, segment) name it in a fault."""

    def __init__(self, topic: str, what: str = "cycle") -> None:
        self.expected = 0
        """The number that comes next."""
        self.ignored = 0
        """How many came again."""
        self._topic = topic
        self._what = what

    def take(self, number: int) -> bool:
        """Note a number; return whether it is new. Raises MachineFault where one was skipped."""
        if number == self.expected:
            self.expected = number + 1
            return True
        if number < self.expected:
            self.ignored += 1
            return False
        raise MachineFault(f"{self._topic}: {self._what} {number} received, {self._what} {self.expected} expected")
