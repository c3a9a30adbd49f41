"""Contour error: exact, cycle by cycle, summed up per segment; star test and circular test, written and evaluated.

Signs: left + = the tool is left of travel, seen from +z; up + = above; radial deviation + = the circle is too small.
"""

from pkm_cnc.contour.circular_test import (
    CirclePath,
    arc_report,
    circle_pair_report,
    circle_pairs,
    circle_path,
    circle_program,
    circle_report,
    extrema,
    is_full_circle,
    least_squares_circle,
)
from pkm_cnc.contour.contour_error import ContourTracker
from pkm_cnc.contour.drive_based import (
    circle_radial_deviation,
    circle_radial_deviation_by_velocity,
    estimated_tracking_error,
    left_and_up,
    line_contour_error,
    tcp_tracking_error,
    tcp_velocity,
)
from pkm_cnc.contour.instruments import ball_bar, straightedge
from pkm_cnc.contour.monitor import ContourMonitor, in_position
from pkm_cnc.contour.program_text import parse_numbers
from pkm_cnc.contour.star_test import heading_deg, line_report, parse_headings, star_program
from pkm_cnc.contour.summary import SegmentStatistics, SegmentSummary, contour_error_report, judged_range

__all__ = [
    "CirclePath",
    "ContourMonitor",
    "ContourTracker",
    "SegmentStatistics",
    "SegmentSummary",
    "arc_report",
    "ball_bar",
    "circle_pair_report",
    "circle_pairs",
    "circle_path",
    "circle_program",
    "circle_radial_deviation",
    "circle_radial_deviation_by_velocity",
    "circle_report",
    "contour_error_report",
    "estimated_tracking_error",
    "extrema",
    "heading_deg",
    "in_position",
    "is_full_circle",
    "judged_range",
    "least_squares_circle",
    "left_and_up",
    "line_contour_error",
    "line_report",
    "parse_headings",
    "parse_numbers",
    "star_program",
    "straightedge",
    "tcp_tracking_error",
    "tcp_velocity",
]
