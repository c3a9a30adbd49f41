"""What a program asks for besides motion happens at its place, in its cycle; a program as a stream, from any line."""

from __future__ import annotations

import itertools
import tracemalloc
from collections.abc import Sequence

import pytest

from pkm_cnc.check import CheckedProgram, prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import Program
from pkm_cnc.records import CMD_RESUME, CMD_START, PHASE_MOVE, STATE_PROGRAM_STOP, STATE_RUNNING, Command
from pkm_cnc.simulation import Cycle, simulated_cycles

TRIPOD = load_setup("tripod")


def checked(text: str, overrides: Sequence[str] = (), from_line: int = 0) -> CheckedProgram:
    return prepare(load_setup("tripod", overrides), Program("events.ngc", text), from_line)


def run(program: CheckedProgram) -> list[Cycle]:
    return list(simulated_cycles(program.setup, program))


def happened(cycles: Sequence[Cycle]) -> list[tuple[int, str, float | None]]:
    return [(cycle.cycle, event.kind, event.value) for cycle in cycles for event in cycle.events]


def moves(cycles: Sequence[Cycle]) -> list[tuple[float, ...]]:
    """The setpoints without those that rest where the one before does."""
    found = [cycle.setpoint[:9] for cycle in cycles]
    return [found[0]] + [here for before, here in itertools.pairwise(found) if here != before]


@pytest.mark.parametrize("overrides", [[], ["motion.jerk=100"]])
@pytest.mark.parametrize(("seconds", "cycles"), [(0.25, 250), (0.0, 0), (0.0004, 0), (0.0006, 1)])
def test_a_dwell_lasts_whole_cycles_and_changes_nothing_else(
    overrides: Sequence[str], seconds: float, cycles: int
) -> None:
    # the corner is a stop, with or without a dwell
    without = run(checked("F3000\nG1 X10\nY10\nM2\n", overrides))
    dwelling = run(checked(f"F3000\nG1 X10\nG4 P{seconds}\nY10\nM2\n", overrides))
    assert len(dwelling) == len(without) + cycles
    assert moves(dwelling) == moves(without)
    (begin, kind, value), *_ = happened(dwelling)
    assert (kind, value) == ("dwell", seconds)
    assert dwelling[begin].setpoint[:9] == (0.01, *(0.0,) * 8)
    assert {cycle.setpoint[:9] for cycle in dwelling[begin : begin + cycles + 1]} == {dwelling[begin].setpoint[:9]}


def test_events_happen_at_their_places_and_stop_the_motion_there() -> None:
    text = "S1000 M3\nG64 P0.1\nF3000\nG1 X10\nM8\nX20\nT4\nX30 Y1\n(MSG, half way)\nX40 Y2\nM5 M9\nM2\n"
    cycles = run(checked(text))
    found = {kind: cycle for cycle, kind, _ in happened(cycles)}
    order = ["spindle_speed", "spindle_clockwise", "flood_on", "tool_select", "message", "spindle_stop", "coolant_off"]
    assert list(found) == [*order, "program_end"]
    assert (found["spindle_speed"], found["spindle_clockwise"]) == (0, 0)
    at = {kind: cycles[cycle].setpoint for kind, cycle in found.items()}
    for kind, x in (("flood_on", 0.01), ("spindle_stop", 0.04), ("coolant_off", 0.04), ("program_end", 0.04)):
        assert (at[kind].x, at[kind].vx) == (x, 0.0)
    for kind, x in (("tool_select", 0.02), ("message", 0.03)):  # passed: in the first cycle behind their place
        assert at[kind].vx == pytest.approx(0.05, rel=1e-2)
        assert 0.0 <= at[kind].path_length - x * (1.0 if x == 0.02 else 1.0017) < 0.05e-3 + 1e-5
    events = [event for cycle in cycles for event in cycle.events]
    assert events[-2].path_length == pytest.approx(checked(text).length)
    assert next(event.text for event in events if event.kind == "message") == "half way"


PAUSE = "F3000\nG1 X10\nM{}\nS500\nX20\nM2\n"


@pytest.mark.parametrize("code", [0, 1])
def test_a_program_stop_waits_for_the_operator_who_is_there(code: int) -> None:
    program = checked(PAUSE.format(code), ["program.optional_stop=true"])
    alone = run(program)
    interpolator = program.interpolator(attended=True)
    assert interpolator.command(Command(CMD_START)) == ""
    setpoints, events = [], []
    while not interpolator.waits_for_operator:
        setpoints.append(interpolator.step())
        events += [event.kind for event in interpolator.take_events()]
    assert interpolator.state == STATE_PROGRAM_STOP
    assert events == ["program_stop" if code == 0 else "optional_stop"]
    assert setpoints[-1][:4] == (0.01, 0.0, 0.0, 0.0)
    assert interpolator.command(Command(CMD_RESUME)) == ""
    assert interpolator.state == STATE_RUNNING
    while not interpolator.finished:
        setpoints.append(interpolator.step(True))
    expected = [cycle.setpoint[:9] for cycle in alone if cycle.setpoint.phase == PHASE_MOVE]
    stop = expected.index((0.01, *(0.0,) * 8))
    expected.insert(stop, expected[stop])  # what follows a stop at the same place happens in a cycle of its own
    assert [setpoint[:9] for setpoint in setpoints if setpoint.phase == PHASE_MOVE] == expected


def test_an_optional_stop_is_passed_unless_it_is_asked_for() -> None:
    interpolator = checked(PAUSE.format(1)).interpolator(attended=True)
    interpolator.command(Command(CMD_START))
    while not interpolator.finished:
        interpolator.step()
    assert interpolator.state != STATE_PROGRAM_STOP


LINES = "S800 M3\nT1 M6\nG0 X5\nF3000\nG1 X10 M8\nX20\nG4 P1\nM9\nM7\nG2 X30 I5\nM5\nG1 X40\nM2\n"


def test_a_run_from_a_line_sets_what_is_in_force_and_goes_there_with_a_rapid() -> None:
    program = checked(LINES, from_line=9)
    first, *others = program.toolpath().elements
    assert (first.traverse, first.start, first.end) == (True, TRIPOD.start_pose, (0.02, 0.0, 0.0))
    assert first.feed == TRIPOD.motion.rapid
    assert others == list(checked(LINES).toolpath().elements)[3:]
    assert program.length == pytest.approx(sum(element.length for element in (first, *others)))
    cycles = run(program)
    found = happened(cycles)
    assert [kind for cycle, kind, _ in found if cycle == 0] == [
        "spindle_speed",
        "spindle_clockwise",
        "tool_select",
        "tool_change",
        "coolant_off",
        "mist_on",
    ]
    assert "dwell" not in [kind for _, kind, _ in found]
    whole = run(checked(LINES))
    assert cycles[-1].setpoint[:9] == whole[-1].setpoint[:9]


def test_a_run_from_a_line_in_force_in_other_order() -> None:
    """M9 after M7: no coolant; M5 after M3: the spindle rests."""
    cycles = run(checked("S1 M3\nM7\nF3000\nG1 X5\nM5\nM9\nX10\nM2\n", from_line=7))
    assert [kind for cycle, kind, _ in happened(cycles) if cycle == 0] == [
        "spindle_speed",
        "spindle_stop",
        "coolant_off",
    ]


@pytest.mark.parametrize(
    ("line", "reason"), [(13, r"contains no motion at or after line 13 \(from_line\)$"), (-1, "counted from 1")]
)
def test_a_line_without_motion_behind_it_is_refused(line: int, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        checked(LINES, from_line=line)


def test_the_way_to_a_line_is_checked() -> None:
    """X0 to X60 along Y0 leads through a place that the travel does not allow; the program goes around it."""
    around = "F3000\nG1 Z-20\nX60\nM2\n"
    narrow = ["start_pose=[0.0, 0.0, 0.02]"]
    assert checked(around, narrow, from_line=3).length > 0.0
    with pytest.raises(InputError, match=r"events.ngc:3: "):
        checked("F3000\nG1 X5\nX900\nM2\n", from_line=3)


def peak(blocks: int) -> float:
    """Most memory that check and run need beyond the program's text, MB."""
    text = "G64 P0.02\nF6000\n" + "G1 X10\nX20 Y1\nX10 Y2\nX0 Y0\n" * (blocks // 4) + "M2\n"
    program = Program("many.ngc", text)
    list(program.text)
    tracemalloc.start()
    interpolator = prepare(TRIPOD, program).interpolator()
    for _ in range(200):
        interpolator.step()
        interpolator.take_segments()
    result = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return result


def test_memory_does_not_grow_with_the_program() -> None:
    assert peak(1600) < peak(800) + 0.5
