"""Commands at any cycle: the path stays the same, the limits are kept, the same commands give the same bits."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from motion import PERIOD, arc, line, polyline, used

from pkm_cnc.check import prepare
from pkm_cnc.config import Setup, load_setup
from pkm_cnc.motion import Interpolator, MotionParameters
from pkm_cnc.program import Arc, Line, PathMode, Program, Toolpath
from pkm_cnc.records import (
    CMD_FEED_OVERRIDE,
    CMD_HOLD,
    CMD_RAPID_OVERRIDE,
    CMD_RESUME,
    CMD_SINGLE_BLOCK,
    PHASE_END,
    PHASE_MOVE,
    STATE_HELD,
    Command,
    TcpSetpoint,
)
from pkm_cnc.simulation import simulated_cycles

KEPT = 1.001
PLAIN = MotionParameters()
SMOOTH = dataclasses.replace(PLAIN, jerk=100.0)
TRIPOD = load_setup("tripod")
NARROW = load_setup("tripod", ["limits.velocity=0.12", "limits.acceleration=1.5"])
MACHINES = [(TRIPOD, PLAIN), (TRIPOD, SMOOTH), (load_setup("tripod", ["limits.jerk=400"]), SMOOTH), (NARROW, PLAIN)]

Script = Sequence[tuple[int, Command]]


def commanded(
    setup: Setup, elements: Sequence[Line | Arc], motion: MotionParameters, script: Script
) -> tuple[list[TcpSetpoint], list[tuple[int, Command]]]:
    """All setpoints, and the commands with the cycles in which they took effect: a wait is ended at once."""
    interpolator = Interpolator(Toolpath(tuple(elements)), motion, PERIOD, setup.drive_limits)
    left, taken = list(script), []
    setpoints: list[TcpSetpoint] = []

    def give(command: Command) -> None:
        if not interpolator.command(command):
            taken.append((len(setpoints), command))

    while not interpolator.finished:
        while left and left[0][0] <= len(setpoints):
            give(left.pop(0)[1])
        while interpolator.waits_for_operator:
            give(Command(CMD_RESUME if interpolator.state == STATE_HELD else CMD_FEED_OVERRIDE, 1.0))
        setpoints.append(interpolator.step())
    return setpoints, taken


def moving(setpoints: Sequence[TcpSetpoint]) -> list[TcpSetpoint]:
    return [setpoints[0]] * 3 + [setpoint for setpoint in setpoints if setpoint.phase == PHASE_MOVE]


def kept(setup: Setup, setpoints: Sequence[TcpSetpoint], motion: MotionParameters) -> dict[str, float]:
    """Parts of the limits; feeds are judged elsewhere, because overrides change them."""
    parts = used(setup, moving(setpoints), motion)
    del parts["feed"]
    return parts


COMMANDS = st.one_of(
    st.just(Command(CMD_HOLD)),
    st.just(Command(CMD_RESUME)),
    st.builds(Command, st.just(CMD_FEED_OVERRIDE), st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0, 1.3, 2.0])),
    st.builds(Command, st.just(CMD_SINGLE_BLOCK), st.sampled_from([0.0, 1.0])),
)
SCRIPTS = st.lists(st.tuples(st.integers(0, 400), COMMANDS), max_size=5).map(lambda s: sorted(s, key=lambda c: c[0]))
TURNS = st.lists(st.floats(-0.7, 0.7), min_size=1, max_size=8)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    st.sampled_from(range(len(MACHINES))),
    TURNS,
    st.sampled_from([0.002, 0.006]),
    st.sampled_from([0.03, 0.15]),
    st.sampled_from([PathMode("G61"), PathMode("G64", 5e-5)]),
    SCRIPTS,
)
@example(0, [0.0], 0.002, 0.03, PathMode("G61"), [(68, Command(CMD_HOLD))])  # braking ends with the motion
@example(3, [0.0, 0.5, -0.25], 0.002, 0.15, PathMode("G61"), [(97, Command(CMD_FEED_OVERRIDE, 0.0))])  # too late for it
@example(
    3, [0.0], 0.006, 0.05, PathMode("G61"), [(0, Command(CMD_SINGLE_BLOCK, 1.0)), (9, Command(CMD_FEED_OVERRIDE, 0.1))]
)
def test_whatever_is_commanded_limits_path_and_end_are_kept(
    machine: int,
    turns: Sequence[float],
    step: float,
    feed: float,
    mode: PathMode,
    script: Script,
) -> None:
    setup, motion = MACHINES[machine]
    points, heading = [(0.0, 0.0, 0.0)], 0.0
    for turn in turns:
        heading += turn
        x, y, z = points[-1]
        points.append((x + step * math.cos(heading), y + step * math.sin(heading), z))
    path = polyline(points, feed, mode)
    setpoints, taken = commanded(setup, path.elements, motion, script)
    assert max(kept(setup, setpoints, motion).values()) < KEPT
    assert max(math.dist((0.0,) * 3, setpoint[3:6]) for setpoint in setpoints) <= 2.0 * feed * KEPT
    assert setpoints[-1][:3] == points[-1]
    assert setpoints[-1].path_length == pytest.approx(path.length, abs=1e-15)
    lengths = [setpoint.path_length for setpoint in setpoints]
    assert max(a - b for a, b in itertools.pairwise(lengths)) <= 1e-15
    for before, after in itertools.pairwise(setpoints):  # the setpoints are one motion: no jump
        for here, there, v0, v1 in zip(before[:3], after[:3], before[3:6], after[3:6], strict=True):
            assert abs(there - here - 0.5 * PERIOD * (v0 + v1)) <= 2.0 * motion.acceleration * PERIOD * PERIOD
    tolerance = 1e-12 if mode.code == "G61" else 5e-5
    for setpoint in setpoints:
        element = path.elements[setpoint.segment]
        place = element.position(element.nearest(setpoint[:3], 0.0))
        assert math.dist(place, setpoint[:3]) <= tolerance
    assert commanded(setup, path.elements, motion, taken)[0] == setpoints  # the same commands in the same cycles


HALF_CIRCLE = arc((0.02, 0.0, 0.0), (0.0, 0.0, 0.0), math.pi)
ROUND = [HALF_CIRCLE, line(HALF_CIRCLE.end, (-0.02, -0.03, 0.0))]


@pytest.mark.parametrize(("setup", "motion"), MACHINES)
def test_half_the_override_from_the_start_is_half_the_feed_bit_for_bit(setup: Setup, motion: MotionParameters) -> None:
    halved = [dataclasses.replace(element, feed=0.5 * element.feed) for element in ROUND]
    script = [(0, Command(CMD_FEED_OVERRIDE, 0.5))]
    ours, theirs = commanded(setup, ROUND, motion, script)[0], commanded(setup, halved, motion, [])[0]
    assert [s._replace(feed=0.0) for s in ours] == [s._replace(feed=0.0) for s in theirs]


def test_half_the_override_takes_twice_the_time_but_for_the_ramps() -> None:
    path = polyline([(-0.05, 0.0, 0.0), (0.05, 0.0, 0.0)], 0.02)
    whole = len(commanded(TRIPOD, path.elements, PLAIN, [])[0])
    half = len(commanded(TRIPOD, path.elements, PLAIN, [(0, Command(CMD_FEED_OVERRIDE, 0.5))])[0])
    # 0.1 m at 0.02 and 0.01 m/s, and v / a for the ramps: 5.010 s, 10.005 s
    assert (whole - 3) * PERIOD == pytest.approx(5.010, abs=2 * PERIOD)
    assert (half - 3) * PERIOD == pytest.approx(10.005, abs=2 * PERIOD)


@pytest.mark.parametrize(("setup", "motion"), MACHINES[:3])
@pytest.mark.parametrize("factor", [0.3, 2.0])
def test_a_new_override_is_reached_as_soon_as_the_limits_allow(
    setup: Setup, motion: MotionParameters, factor: float
) -> None:
    path = polyline([(-0.06, 0.0, 0.0), (0.06, 0.0, 0.0)], 0.05)
    setpoints, _ = commanded(setup, path.elements, motion, [(500, Command(CMD_FEED_OVERRIDE, factor))])
    ramp = abs(factor - 1.0) * 0.05 / motion.acceleration
    ramp += motion.acceleration / motion.jerk if motion.jerk else 0.0
    if setup is not TRIPOD:
        ramp += 0.1  # the drives' jerk is lower than the TCP's, by the angle of the struts
    reached = next(k for k in range(500, len(setpoints)) if abs(setpoints[k].vx - factor * 0.05) < 1e-9)
    assert (reached - 500) * PERIOD <= ramp + 3 * PERIOD
    assert max(kept(setup, setpoints, motion).values()) < KEPT


def test_above_100_percent_the_limits_still_hold() -> None:
    script = [(0, Command(CMD_FEED_OVERRIDE, 2.0))]
    fast = [dataclasses.replace(element, feed=0.3) for element in ROUND]
    assert max(kept(NARROW, commanded(NARROW, fast, PLAIN, script)[0], PLAIN).values()) < KEPT


def test_rapids_have_their_own_override() -> None:
    program = Program("rapid.ngc", "G0 X30\nG1 X0 F3000\nM2\n")
    checked = prepare(TRIPOD, program)

    def speeds(script: Script) -> tuple[float, float]:
        cycles = [c.setpoint for c in simulated_cycles(TRIPOD, checked, script)]
        return max(s.vx for s in cycles), -min(s.vx for s in cycles)

    assert speeds([]) == pytest.approx((1.0 / 6.0, 0.05))
    assert speeds([(0, Command(CMD_RAPID_OVERRIDE, 0.5))]) == pytest.approx((0.5 / 6.0, 0.05))
    assert speeds([(0, Command(CMD_FEED_OVERRIDE, 0.5))]) == pytest.approx((1.0 / 6.0, 0.025))


def test_the_simulation_repeats_a_run_from_its_commands() -> None:
    checked = prepare(load_setup("tripod", ["motion.jerk=100"]), Program("c.ngc", "F3000\nG1 X20\nG3 X0 I-10\nM2\n"))
    script = [
        (50, Command(CMD_FEED_OVERRIDE, 0.4)),
        (130, Command(CMD_HOLD)),
        (160, Command(CMD_RESUME)),
        (300, Command(CMD_FEED_OVERRIDE, 1.7)),
    ]
    first = list(simulated_cycles(checked.setup, checked, script))
    again = [(cycle.cycle, command) for cycle in first for command in cycle.operator]
    assert again == script
    assert list(simulated_cycles(checked.setup, checked, again)) == first
    assert first[-1].setpoint.phase == PHASE_END
