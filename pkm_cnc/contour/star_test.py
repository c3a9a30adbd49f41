"""Star test: straight lines of many headings through one pivot point (thesis 6.5.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pkm_cnc.contour.program_text import coordinate, number, parse_numbers, require_finite, require_positive, rounded
from pkm_cnc.contour.summary import SegmentSummary, contour_error_report
from pkm_cnc.errors import InputError
from pkm_cnc.program import Line
from pkm_cnc.tolerances import VERTICAL

__all__ = ["heading_deg", "line_report", "parse_headings", "star_program"]


def parse_headings(text: str) -> list[float]:
    """Headings in degrees from "first:last:step" (last included where a step meets it) or from a comma list.

    Raises InputError for what is no such list, a step that is 0 or leads away from `last`, too many headings.
    """
    return parse_numbers(text, "headings", "deg")


def star_program(feed_mm_min: float, headings_deg: Sequence[float], pivot_mm: Sequence[float], length_mm: float) -> str:
    """The star test as a part program (mm): per heading a rapid to the line's start and a feed through its middle.

    `pivot_mm` is the point x, y that all lines are centred on; z stays where it is. Headings are degrees
    counter-clockwise from +x. Raises InputError for a feed or a length that is not above 0, a
    pivot that is not finite, or no headings.
    """
    require_positive(feed_mm_min=feed_mm_min, length_mm=length_mm)
    require_finite(pivot_mm=pivot_mm)
    if not headings_deg:
        raise InputError("headings: none given")
    x, y = pivot_mm
    blocks = [
        f"(star test: {len(headings_deg)} lines of {number(length_mm)} mm"
        f" through X{number(x)} Y{number(y)} mm at {number(feed_mm_min)} mm/min)",
        "G21 G90 G17",
    ]
    for heading in headings_deg:
        dx = 0.5 * length_mm * math.cos(math.radians(heading))
        dy = 0.5 * length_mm * math.sin(math.radians(heading))
        blocks += [
            f"(heading {number(heading)} deg)",
            f"G0 X{coordinate(x - dx)} Y{coordinate(y - dy)}",
            f"G1 X{coordinate(x + dx)} Y{coordinate(y + dy)} F{number(feed_mm_min)}",
        ]
    return "\n".join([*blocks, "M2", ""])


def heading_deg(line: Line) -> float | None:
    """Direction of travel in the x-y plane, degrees counter-clockwise from +x in (-180, 180]; None for a vertical line.

    Rounded to 1e-6 deg: what the coordinates of a part program tell of it.
    """
    x, y, _ = line.tangent(0.0)
    if math.hypot(x, y) <= VERTICAL:
        return None
    heading = rounded(math.degrees(math.atan2(y, x)))
    return 180.0 if heading == -180.0 else heading


def line_report(line: Line, summary: SegmentSummary) -> dict[str, object]:
    """JSON entry of an evaluated line: keys carry their units, None = not available."""
    return {
        "kind": "line",
        "line": line.line,
        "heading_deg": heading_deg(line),
        "feed_mm_min": rounded(line.feed * 60e3),
        "length_mm": rounded(line.length * 1e3),
        **contour_error_report(summary),
    }
