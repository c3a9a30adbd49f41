"""The operator of the graph: services and parameters on the real middleware, and the same run again from its bag."""

from __future__ import annotations

import contextlib
import re
import signal

import pytest
from command_line import done, refused
from graph import run_graph, visitor
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from running import LONG, TIMEOUT, messages, one_line, started, wait_for
from std_srvs.srv import SetBool, Trigger

from pkm_cnc.bag import read_run
from pkm_cnc.records import (
    CMD_ABORT,
    CMD_FEED_OVERRIDE,
    CMD_HOLD,
    CMD_RAPID_OVERRIDE,
    CMD_RESET,
    CMD_RESUME,
    CMD_SINGLE_BLOCK,
    CMD_START,
    STATE_ABORTED,
    STATE_FINISHED,
    STATE_HELD,
    STATE_PROGRAM_STOP,
    STATE_READY,
    STATE_RUNNING,
)
from pkm_cnc.run_messages import RunOptions
from pkm_cnc_msgs.msg import ControllerStatus, OperatorCommand, ProgramEvent

ATTENDED = RunOptions(attended=True)
PROGRAM = "%\nG21 G90\nM3 S8000\nG1 X60 Y20 F3000\nG1 X0 Y40\nM0\nG1 X20\nG1 Y0\nG1 X0 F6000\nM5\nM30\n%\n"
"""About five seconds of machine time, with a stop in line 6."""


class Operator:
    """Somebody at the machine, as steps of generators that are taken some ten times a second."""

    def __init__(self, guest):
        self.guest = guest
        self.node = guest.node
        self.states = []
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ControllerStatus, "/status", self._hear, latched)

    def _hear(self, status):
        if not self.states or self.states[-1] != status.state:
            self.states.append(status.state)

    def until(self, state):
        while not self.states or self.states[-1] != state:
            yield

    def until_it_moves(self, cycles):
        """Until the machine has gone some way: so many ticks of the test."""
        yield from (None for _ in range(cycles))

    def ask(self, kind, name, request):
        client = self.node.create_client(kind, f"/interpolator/{name}")
        while not client.service_is_ready():
            yield
        future = client.call_async(request)
        while not future.done():
            yield
        self.node.destroy_client(client)
        return future.result()

    def try_to(self, name):
        """Call a service until the machine is up; return its last answer."""
        while True:
            answer = yield from self.ask(Trigger, name, Trigger.Request())
            if "not all nodes are there yet" not in answer.message:
                return answer

    def do(self, *names):
        for name in names:
            answer = yield from self.try_to(name)
            assert (answer.success, answer.message) == (True, ""), name

    def single_block(self, on):
        answer = yield from self.ask(SetBool, "single_block", SetBool.Request(data=on))
        assert answer.success, answer.message

    def set(self, name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = (yield from self.ask(SetParameters, "set_parameters", request)).results
        return result


@contextlib.contextmanager
def operated(script):
    """A `tick` that takes one step of `script(operator)`; in the end the script must have come to its end."""
    with visitor() as guest:
        steps, over = script(Operator(guest)), []

        def tick(cycle=0):
            guest.spin()
            if not over and next(steps, steps) is steps:
                over.append(True)

        yield tick
        assert over


def commanded(bag):
    return [(content.kind, content.value) for content in read_run(bag).slow["operator/command"]]


def assert_replayed(bag):
    cycles = read_run(bag).cycles()
    assert re.match(rf"equal bit for bit: {cycles} cycles, \d+ messages", done("replay", bag))


def test_an_attended_run_obeys_and_its_bag_gives_the_same_run_again(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text(PROGRAM)

    def script(operator):
        yield from operator.until(STATE_READY)
        assert (yield from operator.set("feed_override", 0.5)).successful
        yield from operator.do("start", "hold")
        yield from operator.until(STATE_HELD)
        assert (yield from operator.set("feed_override", 2.0)).successful
        assert (yield from operator.set("rapid_override", 0.25)).successful
        yield from operator.do("resume")
        yield from operator.until(STATE_PROGRAM_STOP)
        yield from operator.single_block(True)
        yield from operator.do("resume")
        yield from operator.until(STATE_HELD)
        yield from operator.single_block(False)
        yield from operator.do("resume")

    bag = tmp_path / "bag"
    with operated(script) as tick:
        end = run_graph(tmp_path / "part.ngc", bag, options=ATTENDED, tick=tick)
    assert end.completed, end
    assert commanded(bag) == [
        (CMD_FEED_OVERRIDE, 0.5),
        (CMD_START, 0.0),
        (CMD_HOLD, 0.0),
        (CMD_FEED_OVERRIDE, 2.0),
        (CMD_RAPID_OVERRIDE, 0.25),
        (CMD_RESUME, 0.0),
        (CMD_SINGLE_BLOCK, 1.0),
        (CMD_RESUME, 0.0),
        (CMD_SINGLE_BLOCK, 0.0),
        (CMD_RESUME, 0.0),
    ]
    run = read_run(bag)
    states = [status.state for status in run.slow["status"]]
    assert (states[0], states[-1]) == (STATE_READY, STATE_FINISHED)
    assert {STATE_RUNNING, STATE_HELD, STATE_PROGRAM_STOP} < set(states)
    kinds = [event.kind for event in run.slow["program/event"]]
    names = "SPINDLE_SPEED SPINDLE_CLOCKWISE PROGRAM_STOP SPINDLE_STOP PROGRAM_END"
    assert kinds == [getattr(ProgramEvent, f"KIND_{name}") for name in names.split()]
    assert run.slow["status"][-1].commands == 10
    assert run.slow["status"][-1].events == len(kinds)
    assert_replayed(bag)


def test_an_aborted_attended_run_is_reset_and_begins_anew(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text("G21 G90\nG1 X40 Y15 F6000\nG1 X0 Y0\nM2\n")

    def script(operator):
        yield from operator.until(STATE_READY)
        yield from operator.do("start", "abort")
        yield from operator.until(STATE_ABORTED)
        refused = yield from operator.try_to("start")
        assert not refused.success
        assert refused.message
        yield from operator.do("reset", "start")

    bag = tmp_path / "bag"
    with operated(script) as tick:
        end = run_graph(tmp_path / "part.ngc", bag, options=ATTENDED, tick=tick)
    assert end.completed, end
    assert [kind for kind, _ in commanded(bag)] == [CMD_START, CMD_ABORT, CMD_RESET, CMD_START]
    assert_replayed(bag)


def test_a_refused_command_says_why_and_changes_nothing(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text("G21 G90\nG1 X4 Y1 F6000\nM2\n")
    answers = {}

    def script(operator):
        yield from operator.until(STATE_READY)
        for name in ("resume", "reset", "hold"):
            answers[name] = yield from operator.try_to(name)
        for name, value in (("feed_override", 2.5), ("feed_override", -0.1), ("feed_override", 1), ("drive.kv", 30.0)):
            answers[name, value] = yield from operator.set(name, value)
        yield from operator.do("start")

    with operated(script) as tick:
        end = run_graph(tmp_path / "part.ngc", tmp_path / "bag", options=ATTENDED, tick=tick)
    assert end.completed, end
    for name in ("resume", "reset", "hold"):
        assert not answers.pop(name).success
    for what, result in answers.items():
        assert not result.successful, what
        assert result.reason
    assert [kind for kind, _ in commanded(tmp_path / "bag")] == [CMD_START]


def test_an_abort_ends_an_unattended_run_with_one_line_and_a_readable_bag(ros_domain, tmp_path):
    (tmp_path / "long.ngc").write_text(LONG)
    bag = tmp_path / "bag"

    def script(operator):
        yield from operator.until(STATE_RUNNING)
        yield from operator.until_it_moves(3)
        yield from operator.do("abort")

    arguments = ("run", tmp_path / "long.ngc", "--machine", "tripod", "--bag", bag)
    with operated(script) as tick, started(*arguments) as process:
        wait_for(lambda: (tick(), process.poll() is not None)[1], "the end of the run")
        assert process.returncode == 1
        assert re.fullmatch(r"pkm_cnc: interpolator: .*aborted by the operator in line \d+", one_line(process))
    run = read_run(bag)
    assert run.complete
    assert "aborted by the operator" in run.slow["run_end"][0].reason
    assert commanded(bag) == [(CMD_ABORT, 0.0)]
    assert_replayed(bag)


def test_one_process_per_node_obeys_and_waits_without_missing_anybody(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text("G21 G90\nG1 X4 Y1 F6000\nM0\nG1 X0\nM2\n")
    bag = tmp_path / "bag"

    def script(operator):
        yield from operator.until(STATE_READY)
        yield from operator.do("start")
        yield from operator.until(STATE_PROGRAM_STOP)
        yield from operator.until_it_moves(150)  # longer than the watchdog waits: a tick comes every 10 ms
        yield from operator.do("resume")

    arguments = ("run", tmp_path / "part.ngc", "--machine", "tripod", "--bag", bag, "--processes", "each")
    with operated(script) as tick, started(*arguments, "--attended", "--set", "graph.watchdog=1") as process:
        wait_for(lambda: (tick(), process.poll() is not None)[1], "the end of the run")
        assert process.communicate(timeout=TIMEOUT)[1] == ""
        assert process.returncode == 0
    assert [kind for kind, _ in commanded(bag)] == [CMD_START, CMD_RESUME]
    assert_replayed(bag)


def test_ctrl_c_while_the_operator_is_waited_for_closes_the_bag(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text("G21 G90\nG1 X4 Y1 F6000\nM2\n")
    bag = tmp_path / "bag"
    ready = []

    def script(operator):
        yield from operator.until(STATE_READY)
        ready.append(True)

    arguments = ("run", tmp_path / "part.ngc", "--machine", "tripod", "--bag", bag, "--attended")
    with operated(script) as tick, started(*arguments) as process:
        wait_for(lambda: tick() or ready, "the machine is ready", process)
        process.send_signal(signal.SIGINT)
        process.wait(TIMEOUT)
        assert re.fullmatch(r"pkm_cnc: [\w/]+: stopped by SIGINT", one_line(process))
        assert process.returncode == 1
    run = read_run(bag)
    assert run.complete
    assert [status.state for status in run.slow["status"]] == [STATE_READY]


@pytest.mark.parametrize("subcommand", ["run", "simulate"])
@pytest.mark.parametrize("line", ["12", "-1", "2.5"])
def test_a_line_without_motion_behind_it_is_refused(tmp_path, subcommand, line):
    (tmp_path / "part.ngc").write_text("G21 G90\nG1 X4 Y1 F6000\nM2\n")
    arguments = (subcommand, tmp_path / "part.ngc", "--machine", "tripod", "--bag", tmp_path / "bag")
    assert line in refused(*arguments, f"--from-line={line}")
    assert not (tmp_path / "bag").exists()


def test_a_run_from_a_line_is_that_of_the_simulation(ros_domain, tmp_path):
    (tmp_path / "part.ngc").write_text("G21 G90\nM3 S500\nG1 X9 Y1 F6000\nG1 X4 Y4\nG1 X0 Y0\nM2\n")
    machine = ("--machine", "tripod", "--from-line", "5")
    done("simulate", tmp_path / "part.ngc", *machine, "--bag", tmp_path / "simulated")
    end = run_graph(tmp_path / "part.ngc", tmp_path / "graph", options=RunOptions(from_line=5))
    assert end.completed, end
    ours, theirs = messages(tmp_path / "graph"), messages(tmp_path / "simulated")
    assert set(ours) == set(theirs)
    assert {topic for topic in ours if ours[topic] != theirs[topic]} == {"/run_end"}
    assert read_run(tmp_path / "graph").slow["run_info"][0].from_line == 5
    assert_replayed(tmp_path / "graph")


def test_the_constants_of_the_messages_are_those_of_the_records():
    for name in ("START", "HOLD", "RESUME", "ABORT", "RESET", "SINGLE_BLOCK", "FEED_OVERRIDE", "RAPID_OVERRIDE"):
        assert getattr(OperatorCommand, f"KIND_{name}") == globals()[f"CMD_{name}"], name
