"""The canonical motion of a program: what `pkm_cnc check --json` lists, in mm relative to the program's zero."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pkm_cnc.program.arcs import ArcFeed
from pkm_cnc.program.interpreter import MM_PER_M, MM_PER_MIN, Motion
from pkm_cnc.program.toolpath import Event
from pkm_cnc.records import Vector

__all__ = ["canonical_events", "canonical_motion"]


def canonical_motion(items: Iterable[Motion | Event], zero: Vector) -> list[dict[str, Any]]:
    """The motions among the items of `read_motions`, in order.

    Each has "kind" ("traverse", "feed", "arc"), "line", "end_mm" [x, y, z] relative to `zero` (m, in `base_link`) and
    "feed_mm_min" (for a traverse the rapid); an arc also "center_mm" as programmed, relative to `zero` and with the
    start's coordinate along the plane's normal, "turns" (+ counter-clockwise, - clockwise; the P word) and "plane".
    """
    return [_listed(item, zero) for item in items if not isinstance(item, Event)]


def canonical_events(items: Iterable[Motion | Event]) -> list[dict[str, Any]]:
    """The events among the items of `read_motions`, in order.

    Each has "kind", "line", "path_length_mm" (where on the toolpath it happens) and, where it has them, "value" (rpm,
    tool number, s) or "text".
    """
    return [
        {"kind": item.kind, "line": item.line, "path_length_mm": _mm(item.path_length)}
        | ({} if item.value is None else {"value": item.value})
        | ({"text": item.text} if item.text else {})
        for item in items
        if isinstance(item, Event)
    ]


def _listed(motion: Motion, zero: Vector) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "kind": "arc" if isinstance(motion, ArcFeed) else "traverse" if motion.traverse else "feed",
        "line": motion.line,
        "end_mm": _program_mm(motion.end, zero),
        "feed_mm_min": round(motion.feed * MM_PER_MIN, 9),
    }
    if isinstance(motion, ArcFeed):
        entry["center_mm"] = _program_mm(motion.center, zero)
        entry["turns"] = motion.turns
        entry["plane"] = motion.plane.name.lower()
    return entry


def _program_mm(point: Vector, zero: Vector) -> list[float]:
    return [_mm(value - origin) for value, origin in zip(point, zero, strict=True)]


def _mm(length: float) -> float:
    # a pm is far below the resolution of a program (1 nm); adding 0.0 turns -0.0 into 0.0
    return round(length * MM_PER_M, 9) + 0.0
