"""The items of a program on their way to the planner: which segment is which, and what happens at its start."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from pkm_cnc.program import Element, Event

__all__ = ["Segment", "Supply"]


class Segment(NamedTuple):
    """Element `number` of a run, counted from 0; `path_start` m is the path length at its start."""

    number: int
    element: Element
    path_start: float


class Supply:
    """Counts the elements that the planner takes, and holds segments and events until the TCP comes to them.

    Numbers and path lengths go on from `index` and `path_length` (m). Held is what lies between TCP and planner.
    """

    def __init__(self, items: Iterable[Element | Event], index: int = 0, path_length: float = 0.0) -> None:
        self._items = iter(items)
        self._index = index
        self._path_length = path_length
        self._segments: deque[Segment] = deque()
        self._events: deque[tuple[int, Event]] = deque()

    def __iter__(self) -> Iterator[Element | Event]:
        for item in self._items:
            if isinstance(item, Event):
                self._events.append((self._index, item._replace(path_length=self._path_length)))
            else:
                self._segments.append(Segment(self._index, item, self._path_length))
                self._index += 1
                self._path_length += item.length
            yield item

    def segments(self, index: int) -> Iterator[Segment]:
        """Those not asked for yet, up to segment `index`."""
        while self._segments and self._segments[0].number <= index:
            yield self._segments.popleft()

    def event(self, index: int) -> Event | None:
        """The next that happens before or at the start of segment `index`; None if there is none (yet)."""
        return self._events.popleft()[1] if self._events and self._events[0][0] <= index else None
