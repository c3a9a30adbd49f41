"""The items of a program on their way to the planner: which segment is which, and what happens at its start."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from pkm_cnc.program import Element, Event, Numbering

__all__ = ["Segment", "Supply"]


class Segment(NamedTuple):
    """Element `number` of the contour that a run is judged by, counted from 0, and the path length at its start, m."""

    number: int
    element: Element
    path_start: float


class Supply:
    """Counts the elements that the planner takes, and holds segments and events until the TCP comes to them.

    Numbers and path lengths go on from `index` and `path_length` (m). Held is what lies between TCP and planner.
    """

    def __init__(self, items: Iterable[Element | Event], index: int = 0, path_length: float = 0.0) -> None:
        self._items = iter(items)
        self._numbering = Numbering(index, path_length)
        self._segments: deque[Segment] = deque()
        self._events: deque[tuple[int, Event]] = deque()

    def __iter__(self) -> Iterator[Element | Event]:
        for item in self._items:
            if isinstance(item, Event):
                place = item._replace(path_length=self._numbering.path_length)
                self._events.append((self._numbering.index, place))
            else:
                self._add(item)
            yield item

    def _add(self, motion: Element) -> None:
        before = self._numbering.index
        for spot in self._numbering.spots(motion):
            if spot.number >= before:
                before = spot.number + 1
                self._segments.append(Segment(spot.number, spot.segment, spot.begin))

    def segments(self, index: int) -> Iterator[Segment]:
        """Those not asked for yet, up to segment `index`."""
        while self._segments and self._segments[0].number <= index:
            yield self._segments.popleft()

    def event(self, index: int) -> Event | None:
        """The next that happens before or at the start of segment `index`; None if there is none (yet)."""
        return self._events.popleft()[1] if self._events and self._events[0][0] <= index else None
