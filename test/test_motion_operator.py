"""The operator: which command is taken when, and what a run does for it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from pkm_cnc.check import CheckedProgram, prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.motion import Interpolator, Operator
from pkm_cnc.motion.operator import Refusal
from pkm_cnc.program import Program
from pkm_cnc.records import (
    CMD_ABORT,
    CMD_FEED_OVERRIDE,
    CMD_HOLD,
    CMD_RAPID_OVERRIDE,
    CMD_RESET,
    CMD_RESUME,
    CMD_SINGLE_BLOCK,
    CMD_START,
    PHASE_END,
    STATE_ABORTED,
    STATE_ABORTING,
    STATE_FINISHED,
    STATE_HELD,
    STATE_HOLDING,
    STATE_PROGRAM_STOP,
    STATE_READY,
    STATE_RUNNING,
    Command,
    TcpSetpoint,
)
from pkm_cnc.simulation import Cycle, simulated_cycles

TRIPOD = load_setup("tripod")
SQUARE = Program("square.ngc", "F3000\nG1 X10\nY10\nX0\nY0\nM2\n")
ALLOWED = {
    CMD_START: {STATE_READY: STATE_RUNNING},
    CMD_HOLD: {STATE_RUNNING: STATE_HOLDING},
    CMD_RESUME: {STATE_HOLDING: STATE_RUNNING, STATE_HELD: STATE_RUNNING, STATE_PROGRAM_STOP: STATE_RUNNING},
    CMD_ABORT: dict.fromkeys((STATE_RUNNING, STATE_HOLDING, STATE_HELD, STATE_PROGRAM_STOP), STATE_ABORTING),
    CMD_RESET: {STATE_ABORTED: STATE_READY},
}


@pytest.mark.parametrize("state", range(8))
@pytest.mark.parametrize("kind", sorted(ALLOWED))
def test_a_command_is_taken_in_its_states_only_and_a_refusal_is_one_line(kind: int, state: int) -> None:
    if state in ALLOWED[kind]:
        assert Operator(state).commanded(Command(kind)) == Operator(ALLOWED[kind][state])
    else:
        with pytest.raises(Refusal, match=r"^\w+ is not possible in state [a-z ]+: it needs [a-z ]+$"):
            Operator(state).commanded(Command(kind))


@pytest.mark.parametrize("kind", [CMD_FEED_OVERRIDE, CMD_RAPID_OVERRIDE])
def test_overrides_are_from_0_to_2(kind: int) -> None:
    ready = Operator(STATE_READY)
    for value in (0.0, 0.37, 2.0):
        assert ready.commanded(Command(kind, value)).override(kind == CMD_RAPID_OVERRIDE) == value
    for value in (-1e-9, 2.01, math.nan, math.inf):
        with pytest.raises(Refusal, match=r"override .* is not from 0 to 2"):
            ready.commanded(Command(kind, value))
    with pytest.raises(Refusal, match="finished"):
        Operator(STATE_FINISHED).commanded(Command(kind, 1.0))


def test_single_block_is_on_or_off_and_other_kinds_are_none() -> None:
    assert Operator(STATE_HELD).commanded(Command(CMD_SINGLE_BLOCK, 1.0)).single_block
    for command, reason in ((Command(CMD_SINGLE_BLOCK, 0.5), "neither 0 nor 1"), (Command(8), "no command of kind 8")):
        with pytest.raises(Refusal, match=reason):
            Operator(STATE_HELD).commanded(command)


def test_an_abort_outlasts_the_stops_of_the_program() -> None:
    assert Operator(STATE_ABORTING).waiting(STATE_PROGRAM_STOP).state == STATE_ABORTED
    assert Operator(STATE_RUNNING).waiting(STATE_PROGRAM_STOP).waits
    assert not Operator(STATE_RUNNING).rested().waits


def attended(program: CheckedProgram) -> Interpolator:
    return program.interpolator(attended=True)


def run_on(interpolator: Interpolator, cycles: int | None = None) -> list[TcpSetpoint]:
    """The setpoints up to the next wait, or so many."""
    setpoints: list[TcpSetpoint] = []
    while not (interpolator.waits_for_operator or interpolator.finished or len(setpoints) == cycles):
        setpoints.append(interpolator.step())
    return setpoints


def test_an_attended_run_waits_for_start_and_is_then_the_same_run() -> None:
    checked = prepare(TRIPOD, SQUARE)
    interpolator = attended(checked)
    assert interpolator.state == STATE_READY
    with pytest.raises(RuntimeError, match="waits for the operator"):
        interpolator.step()
    assert interpolator.command(Command(CMD_START)) == ""
    assert run_on(interpolator) == run_on(checked.interpolator())
    assert interpolator.state == STATE_FINISHED


@pytest.mark.parametrize("overrides", [[], ["motion.jerk=100"]])
def test_hold_stops_on_the_path_and_resume_goes_on_to_the_same_end(overrides: Sequence[str]) -> None:
    setup = load_setup("tripod", overrides)
    checked = prepare(setup, SQUARE)
    through = run_on(checked.interpolator())
    interpolator = checked.interpolator()
    run_on(interpolator, 100)
    assert interpolator.command(Command(CMD_HOLD)) == ""
    assert interpolator.state == STATE_HOLDING
    held = run_on(interpolator)
    assert interpolator.state == STATE_HELD
    assert held[-1][3:9] == (0.0,) * 6
    speed, a = math.dist((0.0,) * 3, through[99][3:6]), setup.motion.acceleration
    ramp = a / setup.motion.jerk if setup.motion.jerk else 0.0
    assert len(held) <= (speed / a + 2.0 * ramp) / setup.servo_period + 3
    assert "not possible" in interpolator.command(Command(CMD_HOLD))
    assert interpolator.command(Command(CMD_RESUME)) == ""
    assert run_on(interpolator)[-1] == through[-1]


def test_a_single_block_ends_at_the_end_of_its_line() -> None:
    interpolator = attended(prepare(TRIPOD, Program("lines.ngc", "G64 P0.05\nF3000\nG1 X10\nX20 Y1\nX30 Y3\nM2\n")))
    interpolator.command(Command(CMD_SINGLE_BLOCK, 1.0))
    interpolator.command(Command(CMD_START))
    places = []
    while not interpolator.finished:
        last = run_on(interpolator)[-1]
        if last.phase != PHASE_END:
            assert interpolator.state == STATE_HELD
            places.append((1e3 * last.x, 1e3 * last.y))
            assert interpolator.command(Command(CMD_RESUME)) == ""
    assert len(places) == 2
    for place, corner in zip(places, ((10.0, 0.0), (20.0, 1.0)), strict=True):
        assert math.dist(place, corner) <= 0.05 + 1e-9


def test_after_abort_and_reset_the_program_is_run_anew_from_where_the_tcp_stands() -> None:
    checked = prepare(TRIPOD, SQUARE)
    interpolator = attended(checked)
    interpolator.command(Command(CMD_START))
    run_on(interpolator, 150)
    known = interpolator.take_segments()
    interpolator.command(Command(CMD_ABORT))
    stands = run_on(interpolator)[-1]
    assert interpolator.state == STATE_ABORTED
    assert "not possible" in interpolator.command(Command(CMD_START))
    assert interpolator.command(Command(CMD_RESET)) == ""
    assert interpolator.state == STATE_READY
    assert interpolator.command(Command(CMD_START)) == ""
    again = run_on(interpolator)
    segments = interpolator.take_segments()
    assert [segment.number for segment in segments] == list(range(known[-1].number + 1, known[-1].number + 6))
    rapid = segments[0].element
    assert (rapid.traverse, rapid.start, rapid.end) == (True, stands[:3], TRIPOD.start_pose)
    assert again[-1][:3] == run_on(checked.interpolator())[-1][:3]
    assert again[-1].path_length == pytest.approx(segments[-1].path_start + segments[-1].element.length)


def test_the_way_back_to_the_beginning_is_checked() -> None:
    checked = prepare(TRIPOD, SQUARE)

    def refuse(rapid: object) -> None:
        raise InputError("outside the workspace")

    interpolator = Interpolator(checked, TRIPOD.motion, TRIPOD.servo_period, attended=True, check=refuse)
    interpolator.command(Command(CMD_START))
    run_on(interpolator, 50)
    interpolator.command(Command(CMD_ABORT))
    run_on(interpolator)
    interpolator.command(Command(CMD_RESET))
    assert interpolator.command(Command(CMD_START)) == "outside the workspace"
    assert interpolator.state == STATE_READY


@pytest.mark.parametrize("commands", [[(120, CMD_ABORT)], [(80, CMD_HOLD), (90, CMD_ABORT)], [(80, CMD_HOLD)]])
def test_an_abort_ends_an_unattended_run(commands: Sequence[tuple[int, int]]) -> None:
    """Moving, braking for a hold, or held (the last of which is in cycle 104)."""
    cycles: list[Cycle] = []
    given = [(cycle, Command(kind)) for cycle, kind in commands]
    if len(given) == 1 and given[0][1].kind == CMD_HOLD:
        given.append((105, Command(CMD_ABORT)))
    with pytest.raises(MachineFault, match=r"aborted by the operator in line 2$"):
        cycles.extend(simulated_cycles(TRIPOD, prepare(TRIPOD, SQUARE), given))
    assert cycles[-1].setpoint[3:9] == (0.0,) * 6
    assert cycles[-1].state in (STATE_ABORTED, STATE_HELD)


def test_override_0_is_a_stop_from_which_a_higher_one_goes_on() -> None:
    checked = prepare(TRIPOD, SQUARE)
    interpolator = checked.interpolator()
    run_on(interpolator, 100)
    interpolator.command(Command(CMD_FEED_OVERRIDE, 0.0))
    stopped = run_on(interpolator)
    assert interpolator.state == STATE_RUNNING
    assert interpolator.waits_for_operator
    assert stopped[-1][3:9] == (0.0,) * 6
    interpolator.command(Command(CMD_FEED_OVERRIDE, 1.0))
    assert run_on(interpolator)[-1] == run_on(checked.interpolator())[-1]


def test_a_simulated_operator_who_leaves_a_run_waiting_is_a_fault_and_a_refused_command_an_error() -> None:
    checked = prepare(TRIPOD, SQUARE)
    with pytest.raises(MachineFault, match="line 2: the run waits for the operator"):
        list(simulated_cycles(TRIPOD, checked, [(100, Command(CMD_HOLD))]))
    with pytest.raises(InputError, match="operator's command in cycle 7: reset is not possible"):
        list(simulated_cycles(TRIPOD, checked, [(7, Command(CMD_RESET))]))


def test_progress_counts_down_in_nominal_times() -> None:
    checked = prepare(TRIPOD, SQUARE)
    interpolator = checked.interpolator()
    assert interpolator.progress()[1:] == pytest.approx((0.0, 0.04, 0.04 / 0.05))
    run_on(interpolator, 300)
    line, position, length, remaining = interpolator.progress()
    assert (line, length) == (3, pytest.approx(0.04))
    assert remaining == pytest.approx((length - position) / 0.05)
    interpolator.command(Command(CMD_FEED_OVERRIDE, 0.5))
    assert interpolator.progress().time_remaining == pytest.approx(2.0 * remaining)
    interpolator.command(Command(CMD_FEED_OVERRIDE, 0.0))
    assert math.isnan(interpolator.progress().time_remaining)
