"""The planner: limits of TCP and drives at every servo period, judged by differences; times by closed forms."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion import PERIOD, arc, line, moved, polyline, used

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.errors import MachineFault
from pkm_cnc.motion import Interpolator, MotionParameters, pieces
from pkm_cnc.motion.limits import ANY_DRIVES, DriveLimits, LimitParameters
from pkm_cnc.motion.planner import Demand, Planner
from pkm_cnc.program import Line, PathMode, Toolpath

KEPT = 1.001
"""1. What may be used of a limit."""
PLAIN = MotionParameters(acceleration=5.0, centripetal_acceleration=4.0)
SMOOTH = MotionParameters(acceleration=5.0, centripetal_acceleration=4.0, jerk=100.0)
TIGHT = "limits.velocity=0.4", "limits.acceleration=3.0"
TIGHT_SMOOTH = (*TIGHT, "limits.jerk=60.0")

CARTESIAN = load_setup("cartesian")
TRIPOD, TRIPOD_SMOOTH = load_setup("tripod", TIGHT), load_setup("tripod", TIGHT_SMOOTH)
ACROSS = line((-0.15, -0.1, 0.0), (0.2, 0.12, 0.05), feed=1.0)
LOOP = arc((0.05, 0.1, 0.0), (0.05, 0.11, 0.0), 1.5 * math.pi, feed=1.0)


def cycles(setup: Setup, element: Line, motion: MotionParameters) -> int:
    return len(moved(setup, [element], motion)) - 4


@pytest.mark.parametrize("element", [ACROSS, LOOP], ids=["line", "arc"])
@pytest.mark.parametrize(
    ("setup", "motion", "binding"),
    [
        (TRIPOD, PLAIN, {"drive velocity", "drive acceleration"}),
        (TRIPOD_SMOOTH, SMOOTH, {"drive jerk"}),
        (CARTESIAN, SMOOTH, {"jerk"}),
    ],
    ids=["tripod", "tripod jerk", "cartesian jerk"],
)
def test_no_limit_is_exceeded_in_any_cycle_and_one_is_reached(
    setup: Setup, motion: MotionParameters, binding: set[str], element: Line
) -> None:
    parts = used(setup, moved(setup, [element], motion), motion)
    assert max(parts.values()) < KEPT, parts
    assert max(parts[name] for name in binding) > 0.97, parts


def test_near_the_edge_of_the_workspace_the_drive_sets_the_speed() -> None:
    """The Monopod's slider: u = sqrt(L^2 - x^2), |du/dx| = x / u; at its speed limit the TCP goes at vmax u / x."""
    setup = load_setup("monopod", ["limits.velocity=0.12"])
    points = moved(setup, [line((0.1, 0.0, 0.0), (0.55, 0.0, 0.0), feed=0.1)], PLAIN)
    x, v = np.array([(setpoint.x, setpoint.vx) for setpoint in points]).T
    allowed = np.minimum(0.1, 0.12 * np.sqrt(0.36 - x**2) / x)
    middle = (x > 0.11) & (x < 0.545)
    np.testing.assert_allclose(v[middle], allowed[middle], rtol=2e-3)
    assert allowed[middle].min() < 0.06


def test_the_tripod_slows_down_along_its_edge_just_enough() -> None:
    """Where a strut lies flat its drive is faster than the TCP: there it is at its limit, elsewhere the TCP at feed."""
    setup = load_setup("tripod", ["limits.velocity=0.15"])
    past = line((-0.15, 0.17, 0.0), (0.15, 0.17, 0.0), feed=0.15)
    setpoints = moved(setup, [past], PLAIN)
    assert 0.999 < used(setup, setpoints, PLAIN)["drive velocity"] < KEPT
    table = np.array([setpoint[:6] for setpoint in setpoints])
    speed = np.linalg.norm(table[:, 3:], axis=1)
    struts = np.abs(np.diff(setup.machine.inverse(table[:, :3]), axis=0)).max(axis=1) / PERIOD
    steady = slice(60, -60)
    busy = struts[steady] > 0.995 * 0.15
    assert 300 < busy.sum() < busy.size - 300
    np.testing.assert_allclose(speed[1:][steady][~busy], 0.15, rtol=6e-3)
    assert speed[1:][steady][busy].min() < 0.12


@pytest.mark.parametrize("feed", [0.05, 0.167])
@pytest.mark.parametrize("length", [0.05, 0.2])
def test_a_long_line_takes_the_time_of_an_s_curve(length: float, feed: float) -> None:
    """Where the feed is reached: length / feed + feed / a + a / j."""
    motion = MotionParameters(acceleration=2.0, jerk=50.0)
    ideal = length / feed + feed / 2.0 + 2.0 / 50.0
    found = cycles(CARTESIAN, line((0.0, 0.0, 0.0), (length, 0.0, 0.0), feed), motion) * PERIOD
    assert -0.002 <= found - ideal <= 0.003


@pytest.mark.parametrize("length", [1e-5, 1e-3, 5e-3])
def test_a_short_line_loses_at_most_a_quarter_to_an_s_curve(length: float) -> None:
    """Four phases of jerk, t = 4 (L / 2 j)^(1/3), or, where the acceleration matters, v (v/a + a/j) = L."""
    a, j = 2.0, 50.0
    ideal = 4.0 * (length / (2.0 * j)) ** (1.0 / 3.0)
    if ideal > 4.0 * a / j:
        v = 0.5 * (-a * a / j + math.sqrt((a * a / j) ** 2 + 4.0 * a * length))
        ideal = 2.0 * (v / a + a / j)
    found = cycles(CARTESIAN, line((0.0, 0.0, 0.0), (length, 0.0, 0.0), 1.0), MotionParameters(acceleration=a, jerk=j))
    assert ideal - PERIOD <= found * PERIOD
    if length > 1e-4:
        assert found * PERIOD <= 1.25 * ideal


def test_a_curved_row_of_short_lines_is_run_at_the_feed() -> None:
    """2000 lines of 0.03 mm on a circle of 10 mm under G64: at 0.1 m/s every period passes three of them."""
    count, radius, feed = 2_000, 0.01, 0.1
    angles = 2.0 * math.pi * np.arange(count + 1) / count
    points = [(round(radius * math.cos(t), 6), round(radius * math.sin(t), 6), 0.0) for t in angles]
    path = polyline(points, feed, PathMode("G64", 20e-6, 20e-6))
    setpoints = moved(TRIPOD, path.elements, PLAIN)
    assert (len(setpoints) - 4) * PERIOD < 1.01 * (path.length / feed + feed / PLAIN.acceleration)
    assert max(used(TRIPOD, setpoints, PLAIN).values()) < KEPT


@pytest.mark.parametrize(("motion", "drives"), [(PLAIN, ANY_DRIVES), (SMOOTH, TRIPOD_SMOOTH.drive_limits)])
def test_the_path_is_taken_as_it_is_needed(motion: MotionParameters, drives: DriveLimits) -> None:
    """An endless program: how far its reading is ahead of the setpoints does not grow."""
    taken = 0

    def endless() -> Iterator[Line]:
        nonlocal taken
        while True:
            for begin, end in ((0.0, 1.0), (1.0, 2.0), (2.0, 1.0), (1.0, 0.0)):
                taken += 1
                ends = [(1e-3 * x, 1e-3 * math.sin(3.0 * x), 0.0) for x in (begin, end)]
                yield line(ends[0], ends[1], feed=0.05, mode=PathMode("G64", 1e-5))

    ahead = pieces(endless(), motion, smooth=motion.jerk > 0.0)
    planner = Planner(motion, drives, PERIOD)
    found: list[int] = []
    while len(found) < 3000:
        move, sent, ends = planner.move(next(ahead), ahead), 0, False
        while not ends:
            setpoints, _, ends, *_ = move.portion(sent, Demand(1.0, False))
            sent = len(setpoints)
            found += [taken - setpoint.segment for setpoint in setpoints]
    assert max(found) < 400


@pytest.mark.parametrize(("motion", "setup"), [(PLAIN, CARTESIAN), (SMOOTH, TRIPOD_SMOOTH)])
def test_a_long_slow_line_is_planned_as_it_is_needed(motion: MotionParameters, setup: Setup) -> None:
    """0.1 m at 10 mm/min are 600,000 cycles, of which some ten thousand are planned at once."""
    element = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), feed=0.01 / 60.0)
    interpolator = Interpolator(Toolpath((element,)), motion, PERIOD, setup.drive_limits)
    tracemalloc.start()
    for _ in range(100):
        interpolator.step()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_a_block_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same motion, and with a jerk limit almost, whether it is planned at once or in many blocks."""
    ends = [(-0.05 + 1e-3 * k, 0.02 * math.sin(0.05 * k), 0.0) for k in range(60)]
    path = polyline(ends, 0.3, PathMode("G64", 2e-5, 0.0))
    plain, smooth = moved(TRIPOD, path.elements, PLAIN), moved(TRIPOD_SMOOTH, path.elements, SMOOTH)
    monkeypatch.setattr("pkm_cnc.motion.planner.BLOCK", 100)
    np.testing.assert_allclose(moved(TRIPOD, path.elements, PLAIN)[-1][:9], plain[-1][:9], atol=0.0)
    assert len(moved(TRIPOD, path.elements, PLAIN)) == pytest.approx(len(plain), rel=2e-3)
    blocks = moved(TRIPOD_SMOOTH, path.elements, SMOOTH)
    assert len(blocks) == pytest.approx(len(smooth), rel=5e-2)
    assert max(used(TRIPOD_SMOOTH, blocks, SMOOTH).values()) < KEPT


@pytest.mark.parametrize("motion", [PLAIN, SMOOTH])
@pytest.mark.parametrize("angle", [1e-4, 5e-3, 9.9e-3])
def test_the_velocity_never_jumps_at_a_tangent_junction(angle: float, motion: MotionParameters) -> None:
    """G61: by no more than the centripetal acceleration in a period; and with a jerk limit, by no more than that."""
    corner = (0.03, 0.0, 0.0)
    end = (0.03 + 0.03 * math.cos(angle), 0.03 * math.sin(angle), 0.0)
    setpoints = moved(CARTESIAN, [line((0.0, 0.0, 0.0), corner, 0.4), line(corner, end, 0.4)], motion)
    across = np.array([setpoint.vy for setpoint in setpoints])
    turned = np.flatnonzero(across)[0]
    assert across[turned] <= motion.centripetal_acceleration * PERIOD * 1.001
    assert max(used(CARTESIAN, setpoints, motion).values()) < KEPT


def test_an_arc_is_run_at_what_its_radius_allows() -> None:
    element = arc((0.0, 0.0, 0.0), (0.0, 0.002, 0.0), 1.9 * math.pi, feed=1.0)
    speeds = [math.hypot(setpoint.vx, setpoint.vy) for setpoint in moved(CARTESIAN, [element], PLAIN)]
    assert max(speeds) == pytest.approx(math.sqrt(PLAIN.centripetal_acceleration * 0.002), rel=1e-9)


@pytest.mark.parametrize(("setup", "motion"), [(TRIPOD, PLAIN), (TRIPOD_SMOOTH, SMOOTH)], ids=["", "smooth"])
def test_how_many_pieces_are_cut_together_changes_no_bit(
    setup: Setup, motion: MotionParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines and arcs that meet at small angles, slow and fast ones, short and long, and a corner that is rounded."""
    bend = [*polyline([(k * 2e-3, 1e-5 * k * k, 0.0) for k in range(21)], feed=0.2)]
    ring = arc(bend[-1].end, (bend[-1].end[0], bend[-1].end[1] + 0.02, 0.0), 2.0, feed=0.3)
    rest = [line(ring.end, (0.0, 0.1, 0.0), 0.1, PathMode("G64", 1e-4)), line((0.0, 0.1, 0.0), (0.1, 0.12, 0.01), 0.3)]
    together = moved(setup, [*bend, ring, *rest], motion)
    monkeypatch.setattr("pkm_cnc.motion.planner.GROUP", 1)
    assert moved(setup, [*bend, ring, *rest], motion) == together


def test_a_limit_that_cannot_be_kept_is_a_fault_naming_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pkm_cnc.motion.block.ROUNDS", 1)
    with pytest.raises(MachineFault, match=r"line 1: .*limits cannot be kept .*% too fast") as caught:
        moved(TRIPOD_SMOOTH, [ACROSS], SMOOTH)
    assert "\n" not in str(caught.value)


places = st.tuples(*(st.integers(-80, 80) for _ in range(3))).map(
    lambda millimetres: tuple(1e-3 * number * scale for number, scale in zip(millimetres, (1.0, 1.0, 0.3), strict=True))
)
programs = st.tuples(
    st.lists(places, min_size=3, max_size=5, unique=True),
    st.sampled_from([PathMode("G61"), PathMode("G61.1"), PathMode("G64"), PathMode("G64", 1e-4, 1e-4)]),
    st.floats(0.01, 1.0),
    st.sampled_from([(TRIPOD, PLAIN), (TRIPOD_SMOOTH, SMOOTH)]),
)


@settings(derandomize=True, deadline=None, max_examples=10)
@given(programs)
def test_any_program_ends_exactly_and_keeps_its_limits(program: tuple) -> None:
    points, mode, feed, (setup, motion) = program
    setpoints = moved(setup, polyline(points, feed, mode).elements, motion)
    parts = used(setup, setpoints, motion)
    assert max(parts.values()) < KEPT, parts
    assert setpoints[-1][:9] == (*points[-1], *(0.0,) * 6)
    assert np.all(np.diff([setpoint.path_length for setpoint in setpoints]) >= -1e-12)
    if mode.code == "G61.1":
        rests = {setpoint[:3] for setpoint in setpoints if setpoint[3:9] == (0.0,) * 6}
        assert rests >= set(points)


def test_drive_limits_come_from_the_sections() -> None:
    limits = DriveLimits.of(TRIPOD.machine.motion, [LimitParameters(0.3, 4.0, 0.0), LimitParameters(0.2, 3.0, 50.0)])
    assert limits.velocity.tolist() == [0.3, 0.2]
    assert limits.acceleration.tolist() == [4.0, 3.0]
    assert limits.jerk.tolist() == [math.inf, 50.0]
