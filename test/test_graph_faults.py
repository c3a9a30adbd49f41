"""What goes wrong while the machine runs: one line, the right exit status, the others stop, and the bag is readable."""

import contextlib
import itertools
import math
import os
import re
import resource
import signal
import subprocess
import sys
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import TOPICS, run_graph, simulated, visitor
from running import (
    AXES,
    LONG,
    SHORT,
    TIMEOUT,
    FillingDisk,
    children,
    command,
    environment,
    evaluation,
    fill_the_disk,
    one_line,
    started,
    wait_for,
    wait_until_it_moves,
)

from pkm_cnc.bag import read_run
from pkm_cnc.bringup.processes import _end_of
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup, machine_files
from pkm_cnc.errors import MachineFault
from pkm_cnc.program import read_program
from pkm_cnc.run_messages import End
from pkm_cnc.simulation import simulated_cycles
from pkm_cnc.topics import nodes
from pkm_cnc_msgs.msg import TcpSetpoint


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "long.ngc"
    path.write_text(LONG)
    return path


def assert_true_so_far(bag, program, *overrides):
    """What the bag holds are the first cycles of the simulation."""
    run, setup = read_run(bag), load_setup("tripod", overrides)
    cycles = itertools.islice(simulated_cycles(setup, prepare(setup, read_program(str(program)))), run.cycles())
    recorded = [run.servo[f"{axis}/actual"]["slider_position"].tolist() for axis in AXES]
    for done in cycles:
        assert [positions[done.cycle] for positions in recorded] == [state.slider_position for state in done.states]
    return run


# Faults that a node finds ---------------------------------------------------------------------------------------------


def test_a_following_error_over_its_limit_ends_the_command(ros_domain, program, tmp_path):
    limit = "drive.following_error_limit=0.002"
    done = command("run", program, "--machine", "tripod", "--bag", tmp_path / "bag", "--set", limit)
    assert done.returncode == 1
    assert done.stdout == ""
    line = one_line(done)
    assert re.match(r"pkm_cnc: u\d/servo_drive: cycle \d+: u\d: .*following error", line)
    run = assert_true_so_far(tmp_path / "bag", program, limit)
    assert run.complete
    (end,) = run.slow["run_end"]
    assert not end.completed
    assert line == f"pkm_cnc: {end.node}: {end.reason}"
    result, said = evaluation(tmp_path / "bag")
    assert result["cycles"] == run.cycles() > 10
    assert f"the run did not complete: {end.node}: {end.reason}" in said


def test_a_fault_is_that_of_the_simulation_and_stands_on_the_diagnostics(ros_domain, program, tmp_path):
    limit = "drive.following_error_limit=0.002"
    with pytest.raises(MachineFault) as fault:
        simulated(program, tmp_path / "simulated", limit)
    with visitor() as guest:
        diagnostics = guest.hear("/diagnostics", DiagnosticArray)
        end = run_graph(program, tmp_path / "bag", limit, tick=lambda cycle: guest.spin())

        def errors():
            guest.spin()
            statuses = [status for report in diagnostics for status in report.status]
            return {status.name for status in statuses if status.level == DiagnosticStatus.ERROR}

        wait_for(lambda: f"pkm_cnc: {end.node}" in errors(), "the fault on /diagnostics")
    assert end.reason == str(fault.value)
    assert end.node == f"{fault.value.args[0].split(': ')[1]}/servo_drive"


def test_a_pose_that_cannot_be_reached_is_the_fault_of_the_simulation(ros_domain, program, tmp_path):
    unstable = ("drive.kind=first_order", "drive.kv=2200", "drive.following_error_limit=1e9")
    with pytest.raises(MachineFault, match=r"^cycle \d+: slider u\d: wrong assembly branch") as fault:
        simulated(program, tmp_path / "simulated", *unstable)
    end = run_graph(program, tmp_path / "bag", *unstable)
    assert (end.node, end.reason) == ("contour_monitor", str(fault.value))


@contextlib.contextmanager
def scene(script):
    """A visitor and a `tick` that takes one step of `script(visitor)` ten times a second once the machine moves."""
    with visitor() as guest:
        steps = script(guest)

        def tick(cycle):
            guest.spin()
            if cycle:
                next(steps)

        yield tick


def speak(guest, name):
    """Steps: make a publisher on a topic of the graph and wait until its subscribers, without the recorder, hear it."""
    speaker = guest.speaker(name)
    while speaker.get_subscription_count() < len(TOPICS[name].subscribers) - 1:
        yield
    return speaker


def forever():
    while True:
        yield


def test_late_messages_are_ignored_and_counted_and_a_skipped_cycle_is_a_fault(ros_domain, program, tmp_path):
    topic = TOPICS["u2/actual"]
    late = topic.codec.pack(0, 0, (1.0, 1.0, 1.0, math.nan, math.nan, math.nan, 0))
    skipping = topic.codec.pack(10**9, 0, (1.0, 1.0, 1.0, math.nan, math.nan, math.nan, 0))
    ignored = {}

    def script(guest):
        diagnostics = guest.hear("/diagnostics", DiagnosticArray)
        speaker = yield from speak(guest, topic.name)
        for _ in range(3):
            speaker.publish(late)
        while [ignored.get(name) for name in ("u2/servo_drive", "contour_monitor", "u1/servo_drive")] != [
            "3",
            "3",
            "0",
        ]:
            yield
            for status in (status for report in diagnostics for status in report.status):
                figures = {value.key: value.value for value in status.values}
                ignored[status.name.removeprefix("pkm_cnc: ")] = figures.get("ignored messages")
        speaker.publish(skipping)
        yield from forever()

    with scene(script) as tick:
        end = run_graph(program, tmp_path / "bag", "graph.watchdog=4", tick=tick)
    assert end.node in ("u2/servo_drive", "contour_monitor")
    assert re.fullmatch(r"u2/actual: cycle 1000000000 received, cycle \d+ expected", end.reason)
    assert assert_true_so_far(tmp_path / "bag", program).cycles() > 100


def test_what_is_not_a_number_is_a_fault(ros_domain, tmp_path):
    """On a slow clock, so that the visitor's next setpoint comes before the true one."""
    (tmp_path / "slow.ngc").write_text("G21 G90\nG1 X50 F60\nM2\n")
    topic = TOPICS["tcp/setpoint"]

    def script(guest):
        heard = guest.hear("/tcp/setpoint", TcpSetpoint)
        speaker = yield from speak(guest, topic.name)
        while True:
            if heard:
                values = [0.0] * 11 + [0, 0]
                values[1] = math.nan
                speaker.publish(topic.codec.pack(heard[-1].cycle + 1, 0, values))
            yield

    overrides = ("servo_period=0.1", "drive.kv=1.0", "graph.window=1")
    with scene(script) as tick:
        end = run_graph(tmp_path / "slow.ngc", tmp_path / "bag", *overrides, pacing="realtime", tick=tick)
    assert end.node in ("inverse_kinematics", "contour_monitor")
    assert re.fullmatch(r"tcp/setpoint: position\.y is nan in cycle \d+, a finite number expected", end.reason)
    assert read_run(tmp_path / "bag").complete


def test_a_message_of_another_length_is_a_fault_naming_the_topic(ros_domain, program, tmp_path):
    topic = TOPICS["u3/command"]

    def script(guest):
        speaker = yield from speak(guest, topic.name)
        speaker.publish(topic.codec.pack(0, 0, (0.0, 0.0))[:-8])
        yield from forever()

    with scene(script) as tick:
        end = run_graph(program, tmp_path / "bag", tick=tick)
    assert end.node == "u3/plant"
    size = topic.codec.size
    assert end.reason == f"u3/command: pkm_cnc_msgs/msg/AxisCommand: {size - 8} bytes received, {size} expected"


def test_a_disk_that_fills_up_stops_the_machine(ros_domain, program, tmp_path, monkeypatch):
    fill_the_disk(monkeypatch)
    end = run_graph(program, tmp_path / "bag")
    assert end.node == "recorder"
    assert end.exit_code == 1
    assert re.fullmatch(r"bag .*bag: No space left on device; what was written before stays readable", end.reason)
    assert (tmp_path / "bag/bag_0.mcap").stat().st_size == FillingDisk.room
    assert assert_true_so_far(tmp_path / "bag", program).cycles() > 100


# Faults that nobody tells ---------------------------------------------------------------------------------------------


def run_each(program, bag):
    return started(
        *("run", program, "--machine", "tripod", "--bag", bag, "--processes", "each", "--set", "graph.watchdog=1")
    )


def kill(process, name):
    """SIGKILL a node of a running graph; return the command's line, and how long it took to say it, s."""
    found = wait_for(lambda: (kids := children(process.pid)) and len(kids) == len(nodes(AXES)) and kids, "all nodes")
    os.kill(found[name], signal.SIGKILL)
    killed = time.monotonic()
    process.wait(TIMEOUT)
    assert process.returncode == 1
    assert not [pid for pid in found.values() if os.path.exists(f"/proc/{pid}")]
    return one_line(process), time.monotonic() - killed


def test_a_killed_plant_is_named_and_everyone_else_stops(ros_domain, program, tmp_path):
    with run_each(program, tmp_path / "bag") as process:
        wait_until_it_moves(process, tmp_path / "bag")
        line, wall = kill(process, "u2/plant")
    assert re.fullmatch(r"pkm_cnc: [\w/]+: u2/plant has not answered cycle \d+ on u2/actual for 1 s", line)
    assert 1.0 < wall < 10.0
    run = assert_true_so_far(tmp_path / "bag", program)
    assert run.complete
    result, said = evaluation(tmp_path / "bag")
    assert result["cycles"] == run.cycles()
    assert "u2/plant has not answered" in said


@pytest.mark.parametrize(("said", "completed"), [("run completed in cycle 7\n", True), ("", False)])
def test_a_process_killed_after_it_has_completed_is_no_fault(tmp_path, said, completed):
    """What crashes while it leaves, when all is recorded, has done its work."""
    for name, text in (("plant", said), ("recorder", "run completed in cycle 7\n")):
        (tmp_path / f"{name}.out").write_text(text)
        (tmp_path / f"{name}.err").touch()
    killed = {name: subprocess.CompletedProcess((), code) for name, code in (("plant", -11), ("recorder", 0))}
    end = _end_of(killed, tmp_path)
    assert end == (End(7, "recorder", "") if completed else End(0, "plant", "killed by SIGSEGV"))


def test_a_killed_recorder_is_named_and_loses_less_than_a_second(ros_domain, program, tmp_path):
    with run_each(program, tmp_path / "bag") as process:
        wait_until_it_moves(process, tmp_path / "bag")
        line, _ = kill(process, "recorder")
    reason = re.fullmatch(r"pkm_cnc: [\w/]+: recorder has not answered cycle (\d+) on recorder/progress for 1 s", line)
    assert reason
    run = assert_true_so_far(tmp_path / "bag", program)
    assert not run.complete
    assert int(reason[1]) - run.cycles() < 1000
    result, said = evaluation(tmp_path / "bag")
    assert result["cycles"] == run.cycles() > 100
    assert re.search(rf"never closed: evaluated up to its last whole chunk, {run.cycles()} cycles", said)


# Signals --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("processes", ["one", "each"])
def test_a_signal_stops_cleanly(ros_domain, program, tmp_path, processes, number):
    bag = tmp_path / "bag"
    with started("run", program, "--machine", "tripod", "--bag", bag, "--processes", processes) as process:
        wait_until_it_moves(process, bag)
        process.send_signal(number)
        process.wait(TIMEOUT)
        line = one_line(process)
    assert process.returncode == 1
    assert re.fullmatch(rf"pkm_cnc: [\w/]+: stopped by {number.name}", line)
    run = read_run(bag)
    assert run.complete
    assert run.slow["run_end"][0].reason == f"stopped by {number.name}"
    assert evaluation(bag)[0]["cycles"] == run.cycles() > 100


@pytest.mark.parametrize("processes", ["one", "each"])
def test_a_signal_while_the_nodes_are_starting_stops_them_too(ros_domain, program, tmp_path, processes):
    bag = tmp_path / "bag"
    with started("run", program, "--machine", "tripod", "--bag", bag, "--processes", processes) as process:
        if processes == "each":
            wait_for(lambda: len(children(process.pid)) == len(nodes(AXES)), "all processes", process)
        else:
            wait_for(lambda: bag.exists(), "the recorder is configured", process)
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        process.wait(TIMEOUT)
        line = one_line(process)
    assert process.returncode == 1
    assert "SIGINT" in line
    assert time.monotonic() - sent < 15.0


# Refused before it begins ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("processes", ["one", "each"])
def test_a_bag_that_exists_is_refused(ros_domain, program, tmp_path, processes):
    (tmp_path / "bag").mkdir()
    done = command("run", program, "--machine", "tripod", "--bag", tmp_path / "bag", "--processes", processes)
    assert done.returncode == 2
    assert re.fullmatch(r"pkm_cnc: bag .*bag exists already: .*", one_line(done))


def node(name, *arguments):
    """Run one node as `ros2 run pkm_cnc NAME` does."""
    code = f"from pkm_cnc.nodes.{name} import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, "--ros-args", *map(str, arguments)],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
    )


def test_a_node_refuses_what_it_cannot_use_in_one_line(ros_domain, tmp_path):
    tripod = machine_files()["tripod"]
    (tmp_path / "typo.yaml").write_text(tripod.read_text().replace("kv: 20.0", "kw: 20.0"))
    (tmp_path / "short.ngc").write_text(SHORT)
    short = f"program:={tmp_path / 'short.ngc'}"
    for arguments, reason in (
        (["--params-file", tripod], "interpolator: parameter program is missing; give -p program:=FILE"),
        (["--params-file", tripod, "-p", "program:=none.ngc"], "none.ngc"),
        (["--params-file", tmp_path / "typo.yaml", "-p", short], "interpolator: drive.kw: unknown parameter; "),
        (["--params-file", tripod, "-p", short, "-p", "pacing:=slow"], "'slow' is not one of fast, realtime"),
        (["-p", short], "interpolator: machine: "),
    ):
        done = node("interpolator", *arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert one_line(done).startswith("pkm_cnc: interpolator: ")
        assert reason in done.stderr


def test_a_second_machine_in_the_same_domain_is_refused_and_does_not_disturb_the_first(ros_domain, program, tmp_path):
    with started("run", program, "--machine", "tripod", "--bag", tmp_path / "first") as process:
        wait_until_it_moves(process, tmp_path / "first")
        second = command("run", program, "--machine", "tripod", "--bag", tmp_path / "second")
        assert second.returncode == 1
        assert "another machine runs in ROS domain" in one_line(second)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        process.wait(TIMEOUT)
        assert one_line(process) == "pkm_cnc: interpolator: stopped by SIGTERM"
    assert_true_so_far(tmp_path / "first", program)


def test_a_small_file_size_limit_stops_the_command_like_a_full_disk(ros_domain, program, tmp_path):
    """Everything the process writes is limited, the shared memory of the middleware too: it may only fail cleanly."""
    done = command(
        *("run", program, "--machine", "tripod", "--bag", tmp_path / "bag"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10_000_000, 10_000_000)),
    )
    assert done.returncode == 1
    assert "File too large; what was written before stays readable" in done.stderr
