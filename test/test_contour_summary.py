"""Figures of a segment against numpy, and the monitor's bookkeeping over a run."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from pkm_cnc.contour import ContourMonitor, SegmentStatistics, SegmentSummary, contour_error_report, in_position
from pkm_cnc.program import Arc, Line
from pkm_cnc.records import ContourError, TcpSetpoint, TcpState

LINE = Line(7, (0.0, 0.0, 0.0), (0.2, 0.0, 0.0), 0.1, False, True)
CIRCLE = Arc(8, (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.05, False, True, (0.0, 0.0, 0.0), math.tau)


def error_at(path_length, left, up, segment=3):
    return ContourError(0.0, left, up, left, up, math.hypot(left, up), path_length, segment)


def test_the_summary_has_the_fields_of_its_message():
    text = Path(__file__).parents[1].joinpath("pkm_cnc_msgs", "msg", "SegmentSummary.msg").read_text(encoding="utf-8")
    assert re.findall(r"^(?:uint32|uint64|float64) (\w+)", text, re.MULTILINE) == list(SegmentSummary._fields)


def test_figures_of_a_line_are_those_of_its_middle_half():
    random = np.random.default_rng(1)
    s = np.linspace(0.0, 0.2, 2001)
    left, up = 1.0 + 1e-6 * random.normal(size=(2, 2001))  # a mean far above the deviation
    speed = np.where(random.random(2001) < 0.1, 0.0999, 0.1 * (1.0 - 1e-9))
    tracking = random.random(2001)
    statistics = SegmentStatistics(3, LINE, 5.0)
    for values in zip(s, left, up, speed, tracking, strict=True):
        path_length, y, z, v, lag = map(float, values)
        statistics.add(error_at(5.0 + path_length, y, z), v, lag)
    summary = statistics.summary()
    middle = (s > 0.05 - 1e-9) & (s < 0.15 + 1e-9)
    inner = slice(501, 1500)  # rounding decides about the two cycles on the border
    assert summary.cycles in (middle.sum() - 2, middle.sum() - 1, middle.sum())
    assert abs(summary.below_feed - np.sum(speed[inner] < 0.09999)) <= 2
    assert summary.segment == 3
    for part, values in (("left", left), ("up", up)):
        values = values[inner]
        assert getattr(summary, f"{part}_mean") == pytest.approx(values.mean(), rel=1e-8)
        assert getattr(summary, f"{part}_std") == pytest.approx(values.std(), rel=1e-2)
        assert getattr(summary, f"{part}_rms") == pytest.approx(math.sqrt(np.mean(values**2)), rel=1e-8)
        assert getattr(summary, f"{part}_max_abs") == pytest.approx(np.abs(values).max(), rel=1e-5)
    magnitude = np.hypot(left, up)[inner]
    assert summary.magnitude_mean == pytest.approx(magnitude.mean(), rel=1e-8)
    assert summary.magnitude_rms == pytest.approx(math.sqrt(np.mean(magnitude**2)), rel=1e-8)
    assert summary.magnitude_max == pytest.approx(magnitude.max(), rel=1e-5)
    assert summary.tracking_error_mean == pytest.approx(tracking[inner].mean(), rel=5e-3)


def test_an_arc_counts_over_all_its_cycles_exactly_as_numpy_has_it():
    random = np.random.default_rng(2)
    left = 25e-6 + 1e-9 * random.normal(size=500)
    statistics = SegmentStatistics(0, CIRCLE, 0.0)
    for k, value in enumerate(left):
        statistics.add(error_at(k / 499 * CIRCLE.length, float(value), -2 * float(value)), 0.05, 1e-3)
    summary = statistics.summary()
    assert (summary.cycles, summary.below_feed) == (500, 0)
    assert summary.left_std == pytest.approx(left.std(), rel=1e-9)
    assert summary.left_mean == pytest.approx(left.mean(), rel=1e-14)
    assert summary.up_max_abs == 2 * np.abs(left).max()
    assert summary.up_rms == pytest.approx(2 * math.sqrt(np.mean(left**2)), rel=1e-14)
    assert summary.tracking_error_mean == 1e-3


def test_parts_that_do_not_exist_leave_the_magnitude_alone():
    statistics = SegmentStatistics(0, CIRCLE, 0.0)
    for k in range(3):
        statistics.add(ContourError(3e-6, 4e-6, 0.0, math.nan, math.nan, 5e-6, k * 0.1, 0), 0.05, 0.0)
    summary = statistics.summary()
    assert all(math.isnan(value) for value in summary[3:11])
    assert summary[11:14] == (5e-6, 5e-6, 5e-6)
    report = contour_error_report(summary)
    assert report["contour_error_um"] == {"mean": None, "std": None, "rms": None, "max_abs": None}
    assert report["contour_error_3d_um"] == pytest.approx({"mean": 5.0, "rms": 5.0, "max": 5.0})


def test_no_cycles_make_no_figures():
    summary = SegmentStatistics(4, LINE, 0.0).summary()
    assert summary[:3] == (4, 0, 0)
    assert all(math.isnan(value) for value in summary[3:])


def setpoint_at(x, segment, speed=0.1):
    return TcpSetpoint(x, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, 0.0, x, 0.1, segment, 0)


def run_over_three_lines(evaluated):
    """Lines of 0.1 m along x, feed 0.1 m/s at 1 ms, the tool 5 mm behind and 10 um to the left."""
    monitor = ContourMonitor()
    for index in range(3):
        start, end = (0.1 * index, 0.0, 0.0), (0.1 * (index + 1), 0.0, 0.0)
        monitor.add_segment(index, Line(index + 1, start, end, 0.1, False, evaluated[index]), 0.1 * index)
    for k in range(2999):
        x = 1e-4 * k
        tool = (x - 5e-3, 10e-6, 0.0)
        state, error = monitor.step(setpoint_at(x, int(x / 0.1)), (x - 4e-3, 0.0, 0.0), tool)
        yield monitor, k, state, error, tool


def test_summaries_come_in_order_as_soon_as_the_tool_leaves_a_segment():
    taken = []
    for monitor, _k, _, error, _ in run_over_three_lines([True, False, True]):
        taken += [(summary.segment, error.segment) for summary in monitor.take_summaries()]
    assert taken == [(0, 1)]
    rest = monitor.finish()
    assert [summary.segment for summary in rest] == [2]
    assert monitor.finish() == []
    assert abs(rest[0].cycles - 500) <= 1
    assert rest[0].left_mean == pytest.approx(10e-6, abs=1e-18)
    assert rest[0].tracking_error_mean == pytest.approx(math.hypot(5e-3, 10e-6), rel=1e-12)
    assert rest[0].below_feed == 0


def test_the_state_holds_both_positions_and_the_tracking_error():
    for _monitor, k, state, error, tool in run_over_three_lines([True] * 3):
        x = 1e-4 * k
        assert state == TcpState(x - 4e-3, 0.0, 0.0, *tool, x - tool[0], -10e-6, 0.0)
        assert error.left == 10e-6


def test_a_segment_passed_between_two_cycles_has_a_summary_of_no_cycles():
    monitor = ContourMonitor()
    for index in range(4):
        start, end = (1e-5 * index, 0.0, 0.0), (1e-5 * (index + 1), 0.0, 0.0)
        monitor.add_segment(index, Line(1, start, end, 0.1, False, True), 1e-5 * index)
    monitor.step(setpoint_at(0.5e-5, 0), (0.0, 0.0, 0.0), (0.5e-5, 0.0, 0.0))
    monitor.step(setpoint_at(2.5e-5, 2), (0.0, 0.0, 0.0), (2.5e-5, 0.0, 0.0))
    assert [(summary.segment, summary.cycles) for summary in monitor.take_summaries()] == [(0, 1), (1, 0)]
    assert [(summary.segment, summary.cycles) for summary in monitor.finish()] == [(2, 1)]


def test_in_position_is_a_distance_in_space():
    setpoint = setpoint_at(1.0, 0)
    assert in_position(setpoint, (1.0, 3e-6, 4e-6), 5.1e-6)
    assert not in_position(setpoint, (1.0, 3e-6, 4e-6), 4.9e-6)
    assert not in_position(setpoint, (math.nan, 0.0, 0.0), 1.0)
