"""The step loop without ROS: what it does must not depend on how it is cut into blocks, nor on who watches."""

from __future__ import annotations

import itertools

import pytest

from pkm_cnc import simulation
from pkm_cnc.check import prepare
from pkm_cnc.config import Setup, load_setup
from pkm_cnc.errors import MachineFault
from pkm_cnc.messages import deserialize
from pkm_cnc.program import Program
from pkm_cnc.records import PHASE_END, PHASE_HOLD, PHASE_MOVE
from pkm_cnc.simulation import Cycle, simulate, simulated_cycles
from pkm_cnc.topics import topics

CORNER = Program("corner.ngc", "G0 X10\nG1 Y10 F3000\nG1 X0\nM2\n")


class Memory:
    """A sink that keeps what it is given."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, int, bytes]] = []

    def write(self, topic: str, time: int, data: bytes) -> None:
        self.messages.append((topic, time, data))

    def of(self, topic: str) -> list[bytes]:
        return [data for name, _, data in self.messages if name == topic]


def run(setup: Setup, program: Program = CORNER) -> list[Cycle]:
    return list(simulated_cycles(setup, prepare(setup, program)))


@pytest.mark.parametrize("block", [1, 7, 100_000])
def test_the_result_does_not_depend_on_the_block_length(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    setup = load_setup("tripod")
    expected = run(setup)
    monkeypatch.setattr(simulation, "BLOCK", block)
    assert repr(run(setup)) == repr(expected)  # repr: NaN equals NaN, -0.0 differs from 0.0


def test_every_state_is_what_the_command_before_led_to() -> None:
    cycles = run(load_setup("tripod"))
    assert [cycle.cycle for cycle in cycles] == list(range(len(cycles)))
    for before, after in itertools.pairwise(cycles):
        assert before.next_states == after.states
    for cycle in cycles:
        for setpoint, state, command in zip(cycle.axis_setpoints, cycle.states, cycle.commands, strict=True):
            assert command.tracking_error == setpoint.position - state.position
            assert command.velocity == 20.0 * command.tracking_error


def test_it_holds_at_the_end_until_the_tool_is_in_position_and_ends_once() -> None:
    cycles = run(load_setup("tripod"))
    phases = [cycle.setpoint.phase for cycle in cycles]
    assert phases.count(PHASE_END) == 1
    assert phases[-1] == PHASE_END
    assert set(phases[phases.index(PHASE_HOLD) : -1]) == {PHASE_HOLD}
    last = cycles[-2]
    assert abs(last.tcp.tracking_error_x) < 40e-6
    assert (last.setpoint.x, last.setpoint.y) == (0.0, 0.010)


def test_waiting_in_position_at_a_corner_lets_the_tool_reach_it() -> None:
    def nearest(setup: Setup) -> float:
        points = [(cycle.tcp.x - 0.010, cycle.tcp.y - 0.010) for cycle in run(setup)]
        return min((x * x + y * y) ** 0.5 for x, y in points)

    assert nearest(load_setup("tripod")) > 1e-4
    waiting = load_setup("tripod", ["motion.wait_in_position=true", "motion.in_position_tolerance=1e-6"])
    assert nearest(waiting) < 1.1e-6
    assert PHASE_MOVE in [cycle.setpoint.phase for cycle in run(waiting)]


def test_a_fault_names_cycle_and_axis_and_keeps_the_cycles_before_it() -> None:
    setup = load_setup("tripod", ["u2.drive.following_error_limit=0.0001"])
    toolpath, sink = prepare(setup, CORNER), Memory()
    with pytest.raises(MachineFault, match=r"^cycle (\d+): u2: following error") as caught:
        simulate(setup, CORNER, toolpath, sink)
    cycle = int(str(caught.value).split()[1].rstrip(":"))
    table = topics(tuple(setup.axes))
    assert [table["tcp/state"].codec.unpack(data)[0] for data in sink.of("tcp/state")] == list(range(cycle))
    end = deserialize(sink.of("run_end")[0], "pkm_cnc_msgs/msg/RunEnd")
    assert (end.completed, end.cycle, end.reason) == (False, cycle, str(caught.value))


@pytest.mark.parametrize("longer", ["0.6", "0.9"])
def test_the_first_of_two_poses_that_cannot_be_reached_is_the_fault(longer: str) -> None:
    """Unstable drives: the controller's geometry refuses the joints first, the actual one some cycles later or not."""
    unstable = ("drive.kind=first_order", "drive.kv=2200", "drive.following_error_limit=1e9")
    setup = load_setup("tripod", [*unstable, f"actual.geometry.strut_length={longer}"])
    cycles = []
    with pytest.raises(MachineFault, match="wrong assembly branch") as caught:
        cycles.extend(simulated_cycles(setup, prepare(setup, CORNER)))
    assert str(caught.value).startswith(f"cycle {len(cycles)}: ")


def test_what_is_recorded_has_every_servo_topic_in_cycle_order() -> None:
    setup = load_setup("tripod")
    sink = Memory()
    count = simulate(setup, CORNER, prepare(setup, CORNER), sink)
    for topic in topics(tuple(setup.axes)).values():
        if topic.record is not None:
            cycles = [topic.codec.unpack(data)[0] for data in sink.of(topic.name)]
            assert cycles == list(range(count + topic.name.endswith("/actual"))), topic.name
    assert all(time == 0 for name, time, _ in sink.messages if name == "run_info")
    assert len(sink.of("toolpath/segment")) == 3
    assert len(sink.of("contour_monitor/segment_summary")) == 2


def test_a_believed_position_differs_from_the_true_one_by_the_scale() -> None:
    cycles = run(load_setup("tripod", ["scale.resolution=20.0e-6"]))
    gaps = [abs(cycle.tcp.believed_x - cycle.tcp.x) for cycle in cycles]
    assert 1e-7 < max(gaps) < 60e-6
    assert all(state.position == pytest.approx(state.slider_position, abs=10.1e-6) for state in cycles[50].states)
