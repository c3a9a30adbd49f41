"""Interpolator: what comes out cycle by cycle, judged by the geometry and by closed forms of the motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.motion import Interpolator, MotionParameters
from pkm_cnc.parameters import parameters_of, read_section
from pkm_cnc.program import Arc, Line, Toolpath
from pkm_cnc.records import (
    CMD_ABORT,
    CMD_FEED_OVERRIDE,
    CMD_RESET,
    CMD_START,
    PHASE_END,
    PHASE_HOLD,
    PHASE_MOVE,
    Command,
    TcpSetpoint,
    Vector,
)

PERIOD = 0.001
PARAMETERS = MotionParameters()
ACCELERATION = PARAMETERS.acceleration


def line(start: Vector, end: Vector, feed: float = 0.1, number: int = 1, traverse: bool = False) -> Line:
    return Line(line=number, start=start, end=end, feed=feed, traverse=traverse, evaluated=not traverse)


def toolpath(*elements: Line | Arc) -> Toolpath:
    return Toolpath(elements)


def polyline(points: Sequence[Vector], feed: float = 0.1) -> Toolpath:
    return toolpath(*(line(*ends, feed, number) for number, ends in enumerate(itertools.pairwise(points), 1)))


def run(
    path: Toolpath,
    parameters: MotionParameters = PARAMETERS,
    in_position: Callable[[int], bool] = lambda cycle: True,
) -> list[TcpSetpoint]:
    """All setpoints; `in_position` answers for a cycle."""
    interpolator = Interpolator(path, parameters, PERIOD)
    setpoints: list[TcpSetpoint] = []
    while not interpolator.finished:
        setpoints.append(interpolator.step(in_position(len(setpoints) - 1)))
    return setpoints


def positions(setpoints: Sequence[TcpSetpoint]) -> np.ndarray:
    return np.array([setpoint[0:3] for setpoint in setpoints])


def velocities(setpoints: Sequence[TcpSetpoint]) -> np.ndarray:
    return np.array([setpoint[3:6] for setpoint in setpoints])


def accelerations(setpoints: Sequence[TcpSetpoint]) -> np.ndarray:
    return np.array([setpoint[6:9] for setpoint in setpoints])


def duration(length: float, feed: float) -> float:
    """From rest to rest along one element."""
    if length < feed**2 / ACCELERATION:
        return 2.0 * math.sqrt(length / ACCELERATION)
    return length / feed + feed / ACCELERATION


def cycles(length: float, feed: float = 0.1) -> int:
    """Cycles from stop to stop; a time within rounding of a multiple of the period must be kept out of the tests."""
    assert 1e-6 < (duration(length, feed) / PERIOD) % 1.0 < 1.0 - 1e-6
    return math.ceil(duration(length, feed) / PERIOD)


def test_a_line_is_a_trapezoid_of_speed_along_it() -> None:
    start, end = (0.01, -0.02, 0.3), (0.0714, 0.0111, 0.3123)
    setpoints = run(polyline([start, end]))
    length = math.dist(start, end)
    tangent = (np.array(end) - start) / length
    t = PERIOD * np.arange(cycles(length))
    ramp, total = 0.1 / ACCELERATION, duration(length, 0.1)
    v = np.minimum(np.minimum(ACCELERATION * t, 0.1), ACCELERATION * (total - t))
    begun, left = np.minimum(t, ramp), np.maximum(t - (total - ramp), 0.0)
    s = 0.1 * t - 0.1 * begun + 0.5 * ACCELERATION * begun**2 - 0.5 * ACCELERATION * left**2
    moving = setpoints[: len(t)]
    np.testing.assert_allclose([setpoint.path_length for setpoint in moving], s, atol=1e-15)
    np.testing.assert_allclose(positions(moving), np.array(start) + np.outer(s, tangent), atol=2e-16)
    np.testing.assert_allclose(velocities(moving), np.outer(v, tangent), atol=1e-15)
    a = np.select([t < ramp, t < total - ramp], [ACCELERATION, 0.0], -ACCELERATION)
    np.testing.assert_allclose(accelerations(moving)[1:], np.outer(a, tangent)[1:], atol=1e-15)
    assert {setpoint.phase for setpoint in moving} == {PHASE_MOVE}


def test_it_starts_at_rest_and_ends_at_rest_exactly_on_the_end_points() -> None:
    start, end = (0.1, 0.2, 0.3), (0.1 / 3.0, 0.7, -0.9)
    setpoints = run(polyline([start, end]))
    length = math.dist(start, end)
    rest = (0.0,) * 6
    assert setpoints[0] == (*start, *rest, 0.0, 0.1, 0, PHASE_MOVE)
    assert setpoints[cycles(length)] == (*end, *rest, length, 0.1, 0, PHASE_MOVE)
    assert setpoints[cycles(length) + 1 :] == [
        (*end, *rest, length, 0.1, 0, PHASE_HOLD),
        (*end, *rest, length, 0.1, 0, PHASE_END),
    ]


def test_a_corner_is_a_stop_exactly_on_it_and_costs_less_than_a_period() -> None:
    points = [(0.0, 0.0, 0.1), (0.05037, 0.0, 0.1), (0.05037, 0.03045, 0.1)]
    setpoints = run(polyline(points))
    first, second = cycles(0.05037), cycles(0.03045)
    assert setpoints[first] == (*points[1], *(0.0,) * 6, 0.05037, 0.1, 0, PHASE_MOVE)
    begun = setpoints[first + 1]
    assert begun.path_length == pytest.approx(0.05037 + 0.5 * ACCELERATION * PERIOD**2, abs=1e-15)
    assert (begun.segment, begun.vx, begun.vy) == (1, 0.0, pytest.approx(ACCELERATION * PERIOD))
    assert setpoints[first + second][:6] == (*points[2], 0.0, 0.0, 0.0)
    assert len(setpoints) == 1 + first + second + 2


@pytest.mark.parametrize(
    ("angle", "stops"), [(0.01, False), (0.0499, False), (0.0501, True), (math.pi / 2, True), (math.pi, True)]
)
@pytest.mark.parametrize("upwards", [False, True])
def test_only_a_junction_above_the_tangent_angle_stops(angle: float, stops: bool, upwards: bool) -> None:
    across = 0.02 * math.sin(angle)
    corner = (0.02, 0.0, 0.0)
    end = (0.02 + 0.02 * math.cos(angle), *((0.0, across) if upwards else (across, 0.0)))
    setpoints = run(polyline([(0.0, 0.0, 0.0), corner, end]))
    middle = [setpoint for setpoint in setpoints if abs(setpoint.path_length - 0.02) < 0.01]
    slowest = min(math.hypot(*setpoint[3:6]) for setpoint in middle)
    passed = min(0.1, MotionParameters().centripetal_acceleration * PERIOD / angle)
    assert slowest == (0.0 if stops else pytest.approx(passed, rel=0.05))
    assert stops or slowest >= passed * (1.0 - 1e-12)


def test_the_feed_is_kept_through_a_tangent_line_arc_line() -> None:
    radius, feed = 0.02, 0.05
    begin, end, center = (0.03, 0.0, 0.0), (0.03, 2.0 * radius, 0.0), (0.03, radius, 0.0)
    arc = Arc(2, begin, end, feed, traverse=False, evaluated=True, center=center, sweep=math.pi)
    path = toolpath(line((0.0, 0.0, 0.0), arc.start, feed, 1), arc, line(arc.end, (0.0, 0.04, 0.0), feed, 3))
    setpoints = run(path)
    length = 0.06 + math.pi * radius
    assert len(setpoints) == 1 + cycles(length, feed) + 2
    ramp = math.ceil(feed / ACCELERATION / PERIOD)
    cruising = setpoints[ramp : cycles(length, feed) - ramp]
    np.testing.assert_allclose(np.linalg.norm(velocities(cruising), axis=1), feed, rtol=1e-12)
    on_arc = [setpoint for setpoint in cruising if setpoint.segment == 1]
    inward = np.array(arc.center) - positions(on_arc)
    np.testing.assert_allclose(np.linalg.norm(inward, axis=1), radius, rtol=1e-12)
    np.testing.assert_allclose(accelerations(on_arc), feed**2 / radius**2 * inward, atol=1e-12)
    steps = np.diff(positions(cruising), axis=0) / PERIOD
    mean = 0.5 * (velocities(cruising)[1:] + velocities(cruising)[:-1])
    # a step across a junction sees the jump of the acceleration, v^2/r
    np.testing.assert_allclose(steps, mean, atol=0.25 * feed**2 / radius * PERIOD)


def test_ten_elements_a_period_keep_the_feed_and_lose_no_time() -> None:
    count = 3004
    short = run(polyline([(1e-5 * k, 0.0, 0.0) for k in range(count + 1)]))
    whole = run(polyline([(0.0, 0.0, 0.0), (1e-5 * count, 0.0, 0.0)]))
    assert len(short) == len(whole)
    np.testing.assert_allclose(positions(short), positions(whole), atol=1e-13)
    np.testing.assert_allclose(velocities(short), velocities(whole), atol=1e-12)
    switches = np.abs(np.diff(accelerations(whole)[:, 0])) > 0.0  # a cycle right on a switch may see either side of it
    steady = ~(np.append(switches, False) | np.append(False, switches))
    np.testing.assert_allclose(accelerations(short)[steady], accelerations(whole)[steady], atol=1e-9)
    passed = {setpoint.segment for setpoint in short}
    assert len(passed) < count / 5
    for setpoint in short:
        assert 1e-5 * setpoint.segment - 1e-12 <= setpoint.path_length <= 1e-5 * (setpoint.segment + 1) + 1e-12


@pytest.mark.parametrize("traverses", [(True, False), (False, True), (True, True), (False, False)])
def test_a_rapid_never_joins_its_neighbours(traverses: tuple[bool, bool]) -> None:
    points = [(0.0, 0.0, 0.0), (0.05037, 0.0, 0.0), (0.10074, 0.0, 0.0)]
    pairs = zip(itertools.pairwise(points), traverses, strict=True)
    setpoints = run(toolpath(*(line(*ends, 0.1, traverse=traverse) for ends, traverse in pairs)))
    if any(traverses):
        assert setpoints[cycles(0.05037)][:6] == (*points[1], 0.0, 0.0, 0.0)
        assert len(setpoints) == 1 + 2 * cycles(0.05037) + 2
    else:
        assert len(setpoints) == 1 + cycles(0.10074) + 2


def test_each_setpoint_names_its_element_and_that_elements_feed() -> None:
    path = toolpath(
        line((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), 0.02),
        line((0.02, 0.0, 0.0), (0.05, 0.0, 0.0), 0.1),
        line((0.05, 0.0, 0.0), (0.06, 0.0, 0.0), 0.01),
    )
    for setpoint in run(path):
        assert path.starts[setpoint.segment] <= setpoint.path_length
        assert setpoint.path_length <= path.starts[setpoint.segment] + path.elements[setpoint.segment].length
        assert setpoint.feed == path.elements[setpoint.segment].feed
        assert setpoint.vx <= setpoint.feed * (1.0 + 1e-14)
        assert setpoint.x == pytest.approx(setpoint.path_length, abs=1e-15)


coordinates = st.integers(-50_000, 50_000).map(lambda micrometres: micrometres * 1e-6)
moves = st.lists(
    st.tuples(st.tuples(coordinates, coordinates, coordinates), st.floats(1e-3, 0.3), st.booleans()),
    min_size=2,
    max_size=6,
    unique_by=lambda move: move[0],
)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(moves)
def test_any_polyline_is_followed_within_its_limits(program: list[tuple[Vector, float, bool]]) -> None:
    elements = [
        line(before[0], after[0], after[1], number, after[2])
        for number, (before, after) in enumerate(itertools.pairwise(program), 2)
    ]
    for before, after in itertools.pairwise(elements):  # a straight junction is no stop
        assume(math.dist(before.tangent(0.0), after.tangent(0.0)) > 1e-9)
    setpoints = run(toolpath(*elements), MotionParameters(tangent_angle=0.0))
    xyz, v, a = positions(setpoints), velocities(setpoints), accelerations(setpoints)
    feeds = np.array([setpoint.feed for setpoint in setpoints])
    assert np.all(np.linalg.norm(v, axis=1) <= feeds * (1.0 + 1e-12))
    assert np.all(np.linalg.norm(a, axis=1) <= ACCELERATION * (1.0 + 1e-12))
    assert np.all(np.linalg.norm(np.diff(v, axis=0), axis=1) <= ACCELERATION * PERIOD * (1.0 + 1e-9))
    assert np.all(np.diff([setpoint.path_length for setpoint in setpoints]) >= -1e-15)
    steps = np.diff(xyz, axis=0) - 0.5 * PERIOD * (v[1:] + v[:-1])
    assert np.linalg.norm(steps, axis=1).max() <= 0.25 * ACCELERATION * PERIOD**2 * (1.0 + 1e-6)
    stops = [setpoint for setpoint in setpoints if setpoint[3:9] == (0.0,) * 6]
    corners = [stop[:3] for stop in stops if stop.phase == PHASE_MOVE]
    assert corners == [point for point, _, _ in program]


def hold_phases(setpoints: list[TcpSetpoint]) -> str:
    return "".join("MHE"[setpoint.phase] for setpoint in setpoints)


def test_the_program_ends_once_the_tcp_is_in_position() -> None:
    path = polyline([(0.0, 0.0, 0.0), (0.05037, 0.0, 0.0)])
    stop = cycles(0.05037)
    assert hold_phases(run(path)) == "M" * (stop + 1) + "HE"
    assert hold_phases(run(path, in_position=lambda cycle: cycle >= stop + 25)) == "M" * (stop + 1) + "H" * 25 + "E"


def test_feedback_is_wanted_after_a_hold_and_looked_at_then_only() -> None:
    interpolator = Interpolator(polyline([(0.0, 0.0, 0.0), (0.05037, 0.0, 0.0)]), PARAMETERS, PERIOD)
    for _ in range(cycles(0.05037) + 1):
        assert not interpolator.needs_feedback
        assert interpolator.step(in_position=False).phase == PHASE_MOVE
    assert not interpolator.needs_feedback
    assert interpolator.step(in_position=True).phase == PHASE_HOLD
    assert interpolator.needs_feedback
    assert interpolator.step(in_position=False).phase == PHASE_HOLD
    assert interpolator.needs_feedback
    assert not interpolator.finished
    assert interpolator.step(in_position=True).phase == PHASE_END
    assert interpolator.finished
    assert not interpolator.needs_feedback
    with pytest.raises(RuntimeError, match="after its last one"):
        interpolator.step()


def test_waiting_at_a_corner_only_shifts_what_follows() -> None:
    path = polyline([(0.0, 0.0, 0.0), (0.05037, 0.0, 0.0), (0.05037, 0.03045, 0.0)])
    stop = cycles(0.05037)
    plain = run(path)
    waited = run(path, MotionParameters(wait_in_position=True), lambda cycle: cycle >= stop + 7)
    assert waited[: stop + 1] == plain[: stop + 1]
    assert waited[stop + 1 : stop + 8] == [plain[stop]._replace(phase=PHASE_HOLD)] * 7
    assert waited[stop + 8 :] == plain[stop + 1 :]


def test_waiting_does_not_stop_at_a_tangent_junction() -> None:
    path = polyline([(0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.05037, 0.0, 0.0)])
    waiting = MotionParameters(wait_in_position=True)
    assert hold_phases(run(path, waiting)) == "M" * (cycles(0.05037) + 1) + "HE"


def test_never_in_position_is_a_fault_naming_line_tolerance_and_time() -> None:
    parameters = MotionParameters(in_position_timeout=0.02, in_position_tolerance=2e-6)
    path = toolpath(line((0.0, 0.0, 0.0), (0.05037, 0.0, 0.0), number=41))
    interpolator = Interpolator(path, parameters, PERIOD)
    for _ in range(cycles(0.05037) + 1 + 20):
        interpolator.step(in_position=False)
    with pytest.raises(MachineFault, match=r"line 41: .*within 2 um.*in 0\.02 s") as caught:
        interpolator.step(in_position=False)
    assert "\n" not in str(caught.value)
    with pytest.raises(RuntimeError, match="after a fault"):
        interpolator.step()


def begin_anew(interpolator: Interpolator) -> None:
    """Where the TCP rests."""
    for kind in (CMD_ABORT, CMD_RESET, CMD_START):
        assert interpolator.command(Command(kind, 0.0)) == ""


def test_a_run_aborted_while_it_waits_to_be_in_position_begins_anew() -> None:
    interpolator = Interpolator(toolpath(line((0.0, 0.0, 0.0), (0.01, 0.0, 0.0))), PARAMETERS, PERIOD, attended=True)
    interpolator.command(Command(CMD_START, 0.0))
    while not interpolator.needs_feedback:
        interpolator.step()
    interpolator.step(False)
    begin_anew(interpolator)
    while not interpolator.finished:
        last = interpolator.step()
    assert last[:3] == (0.01, 0.0, 0.0)


def test_an_override_of_zero_does_not_outlive_the_run_it_stopped() -> None:
    """What leads back to the beginning is a rapid: the feed override that the aborted motion waited for is not its."""
    path = toolpath(line((0.0, 0.0, 0.0), (0.01, 0.0, 0.0)))
    interpolator = Interpolator(path, PARAMETERS, PERIOD, attended=True)
    interpolator.command(Command(CMD_START, 0.0))
    for _ in range(50):
        interpolator.step()
    interpolator.command(Command(CMD_FEED_OVERRIDE, 0.0))
    while not interpolator.waits_for_operator:
        interpolator.step()
    begin_anew(interpolator)
    while not interpolator.waits_for_operator:
        last = interpolator.step()
    assert last[:3] == (0.0, 0.0, 0.0)
    interpolator.command(Command(CMD_FEED_OVERRIDE, 1.0))
    while not interpolator.finished:
        last = interpolator.step()
    assert last[:3] == (0.01, 0.0, 0.0)


def test_the_section_motion_reads_and_refuses() -> None:
    assert read_section(MotionParameters, {}, "motion.") == PARAMETERS
    assert read_section(MotionParameters, {"rapid": 1}, "motion.").rapid == 1.0
    with pytest.raises(InputError, match=r"motion\.acceleration: 0\.0 m/s\^2 is not above 0\.0"):
        read_section(MotionParameters, {"acceleration": 0.0}, "motion.")
    for spec in parameters_of(MotionParameters):
        assert "default" in spec.doc
        assert bool(spec.unit) == isinstance(spec.default, float)
