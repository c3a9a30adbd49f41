"""Speed and memory of this machine, as ratios measured in one run: `make bench` (about twelve minutes).

Machine time is what the machine would take; "x real time" is machine time over wall time, start-up included.
"""

from __future__ import annotations

import gc
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pkm_cnc.array_path import respond
from pkm_cnc.bag import BagWriter
from pkm_cnc.bringup import prepare_environment, run_in_one_process, run_in_processes
from pkm_cnc.check import prepare
from pkm_cnc.compensation import CompensationOptions, compensate, observe
from pkm_cnc.config import Setup, load_setup
from pkm_cnc.contour import circle_program, parse_headings, star_program
from pkm_cnc.experiments import Lab, load_experiment
from pkm_cnc.experiments import simulated as trial
from pkm_cnc.motion import Interpolator
from pkm_cnc.program import Program, interpret, read_elements, read_program
from pkm_cnc.records import PHASE_MOVE, AxisSetpoint
from pkm_cnc.reproduction import reproduce
from pkm_cnc.servo import ServoDrive
from pkm_cnc.simulation import make_plant, simulate
from pkm_cnc.topics import recorded_topics

HOPS = 20_000
ROOT = Path(__file__).resolve().parents[1]
BLOCKS, SEGMENTS = 100_000, 20_000
MINUTE_1, MINUTE_10 = 60.0, 600.0


def star(folder: Path, seconds: float) -> Program:
    """A star test of at least that much machine time, as a file."""
    text = star_program(6000.0, parse_headings("-15:105:15"), (0.0, 0.0), 200.0)
    header, body = text.split("G21 G90 G17\n")
    body = body.replace("M2\n", "") * max(1, round(seconds / 29.0 + 0.5))
    path = folder / f"star-{seconds:.0f}.ngc"
    path.write_text(f"{header}G21 G90 G17\n{body}M2\n")
    return read_program(path)


def bare_hop() -> float:
    """Wall time (s) of one hop of 100 bytes between two nodes of one process that do nothing else."""
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.serialization import serialize_message
    from rclpy.task import Future
    from std_msgs.msg import String

    from pkm_cnc.nodes.runner import make_executor

    context = Context()
    rclpy.init(args=[], context=context)
    ping, pong, done = Node("ping", context=context), Node("pong", context=context), Future()
    data, left = serialize_message(String(data="x" * 92)), [HOPS]
    to_pong, to_ping = ping.create_publisher(String, "there", 10), pong.create_publisher(String, "back", 10)

    def back(received: bytes) -> None:
        left[0] -= 2
        if left[0] > 0:
            to_pong.publish(data)
        else:
            done.set_result(None)

    ping.create_subscription(String, "back", back, 10, raw=True)
    pong.create_subscription(String, "there", lambda received: to_ping.publish(data), 10, raw=True)
    executor = make_executor(context)
    executor.add_node(ping)
    executor.add_node(pong)
    while to_pong.get_subscription_count() == 0 or to_ping.get_subscription_count() == 0:
        executor.spin_until_future_complete(Future(), 0.01)
    started = time.perf_counter()
    to_pong.publish(data)
    executor.spin_until_future_complete(done, 60.0)
    wall = time.perf_counter() - started
    context.try_shutdown()
    return wall / HOPS


def resident_mb() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def simulated(setup: Setup, program: Program, bag: Path | None) -> tuple[float, float]:
    """Machine time and wall time of a simulation, s."""
    toolpath = prepare(setup, program)
    gc.freeze()  # as `pkm_cnc simulate` does
    started = time.perf_counter()
    if bag is None:
        cycles = simulate(setup, program, toolpath)
    else:
        with BagWriter(bag, recorded_topics(tuple(setup.axes))) as writer:
            cycles = simulate(setup, program, toolpath, writer)
    return cycles * setup.servo_period, time.perf_counter() - started


def array_path_times(setup: Setup) -> tuple[float, float]:
    """Wall time (s) of the same axis motions, 200 lines of 2000 cycles, by the array path and by the step loop."""
    axis, parts = next(iter(setup.axes.items()))
    time_of = np.arange(2000) * setup.servo_period
    speeds = np.linspace(0.01, 0.15, 200)[:, np.newaxis]
    position, velocity = make_plant(setup, axis).state.position + speeds * time_of, np.broadcast_to(speeds, (200, 2000))
    acceleration = np.zeros((200, 2000))
    started = time.perf_counter()
    respond(setup, axis, position, velocity, acceleration)
    by_arrays = time.perf_counter() - started
    started = time.perf_counter()
    for line in zip(position.tolist(), velocity.tolist(), acceleration.tolist(), strict=True):
        drive, plant = ServoDrive(parts.drive, setup.servo_period), make_plant(setup, axis)
        for setpoint in zip(*line, strict=True):
            plant.step(drive.step(AxisSetpoint(*setpoint), plant.state))
    return by_arrays, time.perf_counter() - started


def wave(blocks: int) -> Program:
    """Lines of 0.1 mm along a curve in space, as a CAM system writes them."""
    places = (
        (50.0 * math.cos(2e-3 * k) - 50.0, 50.0 * math.sin(2e-3 * k), 2.0 * math.sin(1e-3 * k))
        for k in range(1, blocks + 1)
    )
    lines = "".join(f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f}\n" for x, y, z in places)
    return Program("wave.ngc", f"G21 G90 G64 P0.02 F6000\n{lines}M2\n")


def reading(program: Program) -> float:
    """Wall time (s) of interpreting a program."""
    started = time.perf_counter()
    origin = (0.0, 0.0, 0.0)
    for _ in read_elements(program, start=origin, zero=origin, rapid=0.1):
        pass
    return time.perf_counter() - started


def peer_reading(program: Program, folder: Path) -> float | None:
    """Wall time (s) of LinuxCNC's interpreter for the same program, start-up included; None where it is not there."""
    peer = shutil.which("rs274")
    if peer is None:
        return None
    path = folder / program.name
    path.write_text(program.text)
    started = time.perf_counter()
    subprocess.run([peer, "-g", str(path)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - started


def planning(setup: Setup, program: Program) -> tuple[float, float, float]:
    """Of a planned program: the motion's time (s), wall time (s), and the time at feed all along (s)."""
    toolpath = interpret(program, start=setup.start_pose, zero=setup.program_zero, rapid=setup.motion.rapid)
    interpolator = Interpolator(toolpath, setup.motion, setup.servo_period, setup.drive_limits)
    started, cycles = time.perf_counter(), 0
    while not interpolator.finished:
        cycles += interpolator.step().phase == PHASE_MOVE
    at_feed = sum(element.length / element.feed for element in toolpath.elements)
    return (cycles - 1) * setup.servo_period, time.perf_counter() - started, at_feed


def print_motion(folder: Path) -> None:
    """Interpreter and look-ahead."""
    program = wave(BLOCKS)
    print(f"interpreter:              {BLOCKS / reading(program):6.0f} blocks/s   (required 33000)", flush=True)
    peer = peer_reading(program, folder)
    if peer is not None:
        print(f"  LinuxCNC's rs274        {BLOCKS / peer:6.0f} blocks/s", flush=True)
    for name, overrides in (("", ()), (", limits of jerk", ("motion.jerk=100.0", "limits.jerk=200.0"))):
        machine, wall, at_feed = planning(load_setup("tripod", overrides), wave(SEGMENTS))
        print(
            f"look-ahead:               {SEGMENTS / wall:6.0f} segments/s of 0.1 mm, in {machine / at_feed:.3f} x the "
            f"time at 6000 mm/min{name}",
            flush=True,
        )


def print_optimum() -> None:
    """The time of a motion near the edge of the workspace, and in time-optimal motion under the same limits."""
    sys.path.append(str(ROOT / "test"))
    from time_optimum import optimum  # what the tests compare with as well

    setup = load_setup("tripod", ["limits.velocity=0.4", "limits.acceleration=3.0"])
    program = Program("edge.ngc", "G1 X-120 Y200 F60000\nX140 Y215\nM2\n")
    toolpath = interpret(program, start=setup.start_pose, zero=setup.program_zero, rapid=setup.motion.rapid)
    machine, _, _ = planning(setup, program)
    ideal = sum(optimum(setup, [element], setup.motion) for element in toolpath.elements)
    print(
        f"cycle time:               {machine / ideal:6.3f} x the time optimum of toppra   (required 1.02)", flush=True
    )
    jerk = ["motion.jerk=100.0", "limits.jerk=200.0"]
    limited, _, _ = planning(load_setup("tripod", ["limits.velocity=0.4", "limits.acceleration=3.0", *jerk]), program)
    print(f"  with limits of jerk     {limited / ideal:6.3f} x", flush=True)


def compensated(setup: Setup, program: Program) -> float:
    """Machine time, s, of a program that mirror compensates in one pass in a processor second."""
    cycles = len(observe(setup, program).s)
    gc.freeze()  # as `pkm_cnc compensate` does
    started = time.process_time()
    compensate(setup, program, options=CompensationOptions(iterations=1))
    return cycles * setup.servo_period / (time.process_time() - started)


def print_compensation(setup: Setup, star_6000: Program) -> None:
    """One pass, the best of three: long lines, an arc, and the short pieces of a fast arc."""
    circles = [
        Program(
            f"circle R 100 at {feed:.0f}",
            circle_program(
                feed_mm_min=feed,
                radius_mm=100.0,
                center_mm=(0.0, 0.0),
                direction="ccw",
                overshoot_deg=180.0,
                acceleration_mm_s2=2000.0,
            ),
        )
        for feed in (3000.0, 9000.0)
    ]
    for program in (star_6000, *circles):
        best = max(compensated(setup, program) for _ in range(3))
        print(
            f"compensate in one pass:   {best:6.2f} s of machine time a processor second, {program.name}   (aim 30)",
            flush=True,
        )


def wall_of(name: str) -> float:
    """Wall time (s) of an experiment with its defaults."""
    experiment = load_experiment(name)
    started = time.perf_counter()
    experiment.run(Lab(experiment.machine, (), trial), experiment.options())
    return time.perf_counter() - started


def main() -> None:
    """Measure and print."""
    prepare_environment()
    setup = load_setup("tripod")
    with tempfile.TemporaryDirectory(prefix="pkm_cnc_bench_") as name:
        folder = Path(name)
        minute, ten_minutes = star(folder, MINUTE_1), star(folder, MINUTE_10)

        print_motion(folder)
        print_optimum()
        machine, wall = simulated(setup, minute, None)
        print(f"simulate without a bag:   {machine / wall:6.2f} x real time   (required 30)", flush=True)
        machine, wall = simulated(setup, minute, folder / "simulated")
        print(f"simulate with a bag:      {machine / wall:6.2f} x real time   (required 8)", flush=True)

        by_arrays, by_steps = array_path_times(setup)
        print(
            f"array path:               {by_steps / by_arrays:6.1f} x as fast as the step loop, 200 lines", flush=True
        )
        print_compensation(setup, minute)
        wall = wall_of("workspace-map")
        print(f"map of the workspace:     {wall:6.1f} s for 41 x 41 pivots, 24 headings   (aim 60)", flush=True)
        started = time.perf_counter()
        reproduce()
        print(f"reproduction:             {time.perf_counter() - started:6.1f} s   (aim 180)", flush=True)

        hop = bare_hop()
        print(
            f"bare hop:                 {hop * 1e6:6.2f} us in one process; a cycle has 14 and 12 publish calls",
            flush=True,
        )

        memory: dict[float, float] = {}

        def watch(cycle: int) -> None:
            now = cycle * setup.servo_period
            for mark in (MINUTE_1, MINUTE_10):
                if now >= mark and mark not in memory:
                    memory[mark] = resident_mb()

        started = time.perf_counter()
        end = run_in_one_process(setup, ten_minutes.name, str(folder / "one"), "fast", watch)
        wall, machine = time.perf_counter() - started, (end.cycle + 1) * setup.servo_period
        assert end.completed, end
        per_cycle = wall / (end.cycle + 1)
        print(f"run, one process:         {machine / wall:6.2f} x real time   (required 1.5, aim 2.5)", flush=True)
        print(f"  a cycle costs           {per_cycle / hop:6.1f} bare hops")
        growth = memory[MINUTE_10] - memory[MINUTE_1]
        print(
            f"  resident memory growth  {growth:6.1f} MB from minute 1 to minute 10   (required below 20)", flush=True
        )

        started = time.perf_counter()
        end = run_in_processes(setup, minute.name, str(folder / "each"), "fast")
        wall, machine = time.perf_counter() - started, (end.cycle + 1) * setup.servo_period
        assert end.completed, end
        print(f"run, one process a node:  {machine / wall:6.2f} x real time   (required 0.6, aim 1)", flush=True)


if __name__ == "__main__":
    main()
