"""The star test: its part program as the interpreter reads it, its headings, its report."""

import math

import pytest

from pkm_cnc.contour import (
    ContourMonitor,
    SegmentStatistics,
    heading_deg,
    line_report,
    parse_headings,
    star_program,
)
from pkm_cnc.errors import InputError
from pkm_cnc.program import Line, Program, interpret
from pkm_cnc.records import ContourError, TcpSetpoint


def toolpath_of(text):
    return interpret(Program("star.ngc", text), start=(0.0, 0.0, 0.0), zero=(0.0, 0.0, 0.0), rapid=0.5)


@pytest.mark.parametrize(
    ("text", "headings"),
    [
        ("-15:105:15", [-15, 0, 15, 30, 45, 60, 75, 90, 105]),
        ("105:-15:-60", [105, 45, -15]),
        ("0:100:30", [0, 30, 60, 90]),
        ("45:45:10", [45]),
        ("0,45,-7.5", [0, 45, -7.5]),
        (" 30 ", [30]),
    ],
)
def test_headings(text, headings):
    assert parse_headings(text) == headings


def test_the_last_heading_counts_in_spite_of_rounding():
    assert parse_headings("0:0.3:0.1") == pytest.approx([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "text",
    ["", "a", "1,,2", "1:2", "1:2:3:4", "0:90:0", "0:90:-15", "90:0:15", "nan", "0:inf:1", "0:360:1e-9", "0:1,2"],
)
def test_nonsense_headings_are_refused(text):
    with pytest.raises(InputError, match="headings"):
        parse_headings(text)


def test_the_program_runs_every_heading_through_the_pivot():
    headings = parse_headings("-15:105:15")
    text = star_program(6000.0, headings, (12.5, -30.0), 200.0)
    assert "(heading -15 deg)" in text
    assert text.endswith("M2\n")
    lines = [element for element in toolpath_of(text) if not element.traverse]
    assert [heading_deg(each) for each in lines] == pytest.approx(headings, abs=1e-6)
    for each in lines:
        assert each.evaluated
        assert each.feed == pytest.approx(0.1, rel=1e-15)
        assert each.length == pytest.approx(0.2, abs=2e-9)
        middle = each.position(0.5 * each.length)
        assert middle == pytest.approx((0.0125, -0.03, 0.0), abs=1e-9)


def test_rapids_between_the_lines_are_not_evaluated():
    elements = list(toolpath_of(star_program(6000.0, [0.0, 90.0], (0.0, 0.0), 200.0)))
    assert [(each.traverse, each.evaluated) for each in elements] == [(True, False), (False, True)] * 2


def test_no_negative_zeros_and_no_powers_of_ten():
    text = star_program(1e-3, [0.0, 90.0, 180.0, 270.0], (0.0, 0.0), 1e7)
    assert "-0.000000" not in text
    assert "e" not in "".join(line for line in text.splitlines() if not line.startswith("("))


@pytest.mark.parametrize(("feed", "length"), [(0.0, 200.0), (-1.0, 200.0), (6000.0, 0.0), (math.nan, 1.0), (1e-9, 1.0)])
def test_a_star_needs_feed_and_length(feed, length):
    with pytest.raises(InputError, match="feed_mm_min" if feed != 6000.0 else "length_mm"):
        star_program(feed, [0.0], (0.0, 0.0), length)


def test_a_star_needs_headings():
    with pytest.raises(InputError, match="none given"):
        star_program(6000.0, [], (0.0, 0.0), 200.0)


@pytest.mark.parametrize(
    ("end", "heading"),
    [((-0.1, 0.0, 0.0), 180.0), ((-0.1, -1e-17, 0.0), 180.0), ((0.0, -0.1, 0.05), -90.0), ((0.0, 0.0, 0.1), None)],
)
def test_headings_of_lines(end, heading):
    assert heading_deg(Line(1, (0.0, 0.0, 0.0), end, 0.1, False, True)) == heading


def test_the_report_of_a_line_has_the_agreed_keys_and_units():
    line = Line(5, (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.1, False, True)
    statistics = SegmentStatistics(0, line, 0.0)
    for left in (-2e-6, -4e-6):
        statistics.add(ContourError(0.0, left, 1e-6, left, 1e-6, 3e-6, 0.1, 0), 0.05, 5e-3)
    report = line_report(line, statistics.summary())
    assert {key: report[key] for key in list(report)[:5]} == {
        "kind": "line",
        "line": 5,
        "heading_deg": 0.0,
        "feed_mm_min": 6000.0,
        "length_mm": 200.0,
    }
    figures = {"mean": -3.0, "std": 1.0, "rms": math.sqrt(10.0), "max_abs": 4.0}
    assert report["contour_error_um"] == pytest.approx(figures)
    assert report["contour_error_z_um"] == pytest.approx({"mean": 1.0, "std": 0.0, "rms": 1.0, "max_abs": 1.0})
    assert report["contour_error_3d_um"] == pytest.approx({"mean": 3.0, "rms": 3.0, "max": 3.0})
    assert report["tracking_error_mm"] == pytest.approx({"mean": 5.0})
    assert report["below_feed"] == 2


def test_a_line_run_back_at_once_has_its_own_figures():
    """Headings 45 and 225: no rapid between them. A tool lagging 5 mm, 8 um to the lower right of both."""
    toolpath = toolpath_of(star_program(6000.0, [45.0, 225.0], (0.0, 0.0), 200.0))
    monitor = ContourMonitor()
    for index, element in enumerate(toolpath):
        monitor.add_segment(index, element, toolpath.starts[index])
    index_of = {1: toolpath.elements[1], 2: toolpath.elements[2]}
    assert len(toolpath.elements) == 3
    for k in range(4000):
        path = 1e-4 * k
        segment = 1 if path < 0.2 else 2
        x, y, z = index_of[segment].position(path - (0.2 if segment == 2 else 0.0))
        lagging = max(path - 5e-3, 0.0)
        along = min(lagging, 0.4 - lagging) - 0.1
        side = 8e-6 / math.sqrt(2.0)
        tool = (along / math.sqrt(2.0) + side, along / math.sqrt(2.0) - side, 0.0)
        monitor.step(TcpSetpoint(x, y, z, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, path, 0.1, segment, 0), tool, tool)
    there, back = monitor.finish()
    assert (there.segment, back.segment) == (1, 2)
    assert abs(there.cycles - 1000) <= 1
    assert abs(back.cycles - 1000) <= 1
    assert there.left_mean == pytest.approx(-8e-6, abs=1e-8)
    assert back.left_mean == pytest.approx(8e-6, abs=1e-8)
