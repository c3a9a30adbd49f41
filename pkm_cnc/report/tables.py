"""The evaluation of a run as tables."""

from __future__ import annotations

from typing import Any

from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.figure import Table

__all__ = ["run_headline", "run_remarks", "run_tables"]

CONTOUR_ERROR = [
    ("left_mean_um", "contour_error_um.mean", "{:+.3f}"),
    ("left_std_um", "contour_error_um.std", "{:.3f}"),
    ("left_max_um", "contour_error_um.max_abs", "{:.3f}"),
    ("z_mean_um", "contour_error_z_um.mean", "{:+.3f}"),
    ("z_max_um", "contour_error_z_um.max_abs", "{:.3f}"),
    ("3d_max_um", "contour_error_3d_um.max", "{:.3f}"),
    ("lag_mm", "tracking_error_mm.mean", "{:.4f}"),
    ("below_feed", "below_feed", "{:d}"),
]
LINES = [
    ("line", "line", "{:d}"),
    ("heading_deg", "heading_deg", "{:.1f}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    *CONTOUR_ERROR,
]
ARCS = [
    ("line", "line", "{:d}"),
    ("direction", "direction", "{}"),
    ("radius_mm", "radius_mm", "{:.3f}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    *CONTOUR_ERROR,
]
CIRCLES = [
    ("direction", "direction", "{}"),
    ("radius_mm", "radius_mm", "{:.3f}"),
    ("feed_mm_min", "feed_mm_min", "{:.0f}"),
    ("dR_mean_um", "radial_deviation_um.mean", "{:+.3f}"),
    ("dR_min_um", "radial_deviation_um.min", "{:+.3f}"),
    ("dR_max_um", "radial_deviation_um.max", "{:+.3f}"),
    ("circularity_um", "circularity_um", "{:.3f}"),
    ("G_um", "iso230_4.G_um", "{:.3f}"),
    ("maxima_of_dR_deg", "extrema_deg", "{:.2f}"),
]
PAIRS = [("Gb_um", "iso230_4.Gb_um", "{:.3f}"), ("D_um", "iso230_4.D_um", "{:+.3f}")]
GROUPS = [
    ("line", "Lines, each over its middle half", LINES),
    ("arc", "Arcs", ARCS),
    ("circle", "Circles, by actual angle about the programmed centre", CIRCLES),
    ("circle_pair", "Pairs of circles, ISO 230-4", PAIRS),
]
CONTOUR_ERROR_LEGEND = (
    "left: + = tool left of travel, seen from +z; z: + = tool above; max: largest size\n"
    "lag: mean tracking error of the TCP; below_feed: cycles in which the setpoint was slower than programmed"
)
CIRCLE_LEGEND = (
    "dR: programmed - actual radius, + = the circle came out too small; D: + = too large, as ISO 230-4 has it"
)


def run_tables(evaluation: Evaluation) -> list[Table]:
    """The evaluated segments, one table per kind; every column carries its unit."""
    entries = evaluation.segments()
    return [
        Table(
            title,
            [name for name, _, _ in columns],
            [[_cell(row, path, form) for _, path, form in columns] for row in rows],
        )
        for kind, title, columns in GROUPS
        if (rows := [entry for entry in entries if entry["kind"] == kind])
    ]


def run_remarks(evaluation: Evaluation) -> list[str]:
    """What the column names of `run_tables` mean."""
    kinds = {entry["kind"] for entry in evaluation.segments()}
    return [
        *([CONTOUR_ERROR_LEGEND] if kinds & {"line", "arc"} else []),
        *([CIRCLE_LEGEND] if "circle" in kinds else []),
        *([] if kinds else ["no evaluated segment was run"]),
    ]


def run_headline(evaluation: Evaluation) -> str:
    """Program, machine, length of the run."""
    seconds = len(evaluation.errors) * evaluation.servo_period
    return f"{evaluation.program_name} on {evaluation.machine}: {len(evaluation.errors)} cycles, {seconds:.3f} s"


def _cell(row: dict[str, Any], path: str, form: str) -> str:
    value: Any = row
    for key in path.split("."):
        value = value[key]
    if value is None:
        return "-"
    if isinstance(value, list):
        return " ".join(form.format(number) for number in value) or "none"
    text = form.format(value)
    return text if set(text) & set("123456789") else text.lstrip("+-")  # a zero has no side
