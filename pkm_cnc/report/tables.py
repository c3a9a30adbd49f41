"""The evaluation of a run as a table for a terminal."""

from __future__ import annotations

from typing import Any

from pkm_cnc.evaluation import Evaluation

__all__ = ["table"]

LINES = [
    ("line", "line", "{:d}"),
    ("heading_deg", "heading_deg", "{:.1f}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    ("length_mm", "length_mm", "{:.1f}"),
    ("left_mean_um", "contour_error_um.mean", "{:+.3f}"),
    ("left_std_um", "contour_error_um.std", "{:.3f}"),
    ("left_max_um", "contour_error_um.max_abs", "{:.3f}"),
    ("z_mean_um", "contour_error_z_um.mean", "{:+.3f}"),
    ("3d_max_um", "contour_error_3d_um.max", "{:.3f}"),
    ("lag_mm", "tracking_error_mm.mean", "{:.4f}"),
    ("below_feed", "below_feed", "{:d}"),
]
ARCS = [
    ("line", "line", "{:d}"),
    ("direction", "direction", "{}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    ("radius_mm", "radius_mm", "{:.3f}"),
    *LINES[3:],
]
CIRCLES = [
    ("direction", "direction", "{}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    ("radius_mm", "radius_mm", "{:.3f}"),
    ("dR_mean_um", "radial_deviation_um.mean", "{:.3f}"),
    ("dR_min_um", "radial_deviation_um.min", "{:.3f}"),
    ("dR_max_um", "radial_deviation_um.max", "{:.3f}"),
    ("circularity_um", "circularity_um", "{:.3f}"),
    ("G_um", "iso230_4.G_um", "{:.3f}"),
    ("maxima_of_dR_deg", "extrema_deg", "{}"),
]
PAIRS = [("Gb_um", "iso230_4.Gb_um", "{:.3f}"), ("D_um", "iso230_4.D_um", "{:+.3f}")]
GROUPS = [
    ("line", "Lines (left: + = tool left of travel; over the middle half)", LINES),
    ("arc", "Arcs (left: + = tool left of travel)", ARCS),
    ("circle", "Circles (dR: + = came out too small)", CIRCLES),
    ("circle_pair", "Pairs of circles, ISO 230-4", PAIRS),
]


def table(evaluation: Evaluation) -> str:
    """The evaluated segments as text, one table per kind; every column carries its unit."""
    entries = evaluation.segments()
    seconds = len(evaluation.errors) * evaluation.servo_period
    parts = [f"{evaluation.program_name} on {evaluation.machine}: {len(evaluation.errors)} cycles, {seconds:.3f} s"]
    for kind, title, columns in GROUPS:
        rows = [entry for entry in entries if entry["kind"] == kind]
        if rows:
            parts.append(f"{title}\n{_aligned(columns, rows)}")
    if not entries:
        parts.append("no evaluated segment was run")
    return "\n\n".join(parts)


def _aligned(columns: list[tuple[str, str, str]], rows: list[dict[str, Any]]) -> str:
    cells = [[name for name, _, _ in columns]]
    cells += [[_cell(row, path, form) for _, path, form in columns] for row in rows]
    widths = [max(len(line[place]) for line in cells) for place in range(len(columns))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in cells]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def _cell(row: dict[str, Any], path: str, form: str) -> str:
    value: Any = row
    for key in path.split("."):
        value = value[key]
    if value is None:
        return "-"
    if isinstance(value, list):
        return " ".join(f"{number:.2f}" for number in value)
    return form.format(value)
