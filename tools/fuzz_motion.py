"""Plans random part programs: `.venv/bin/python tools/fuzz_motion.py [--count 2000] [--seed 1]`.

Each runs on a Cartesian machine, the Tripod or the Bipod, with or without limits of jerk, some near the edge of the
workspace with drives that are much too slow for the feed. What is sent is judged by the setpoints' positions alone:
those of the drives by the inverse kinematics, speeds, accelerations and jerks as differences. The first that fails is
written out.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.check import prepare
from pkm_cnc.config import Setup, load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.motion import Interpolator
from pkm_cnc.program import Element, Program, Toolpath
from pkm_cnc.records import PHASE_MOVE, TcpSetpoint, Vector

Array = NDArray[np.float64]

KEPT = 1.001
"""1. What may be used of a limit."""
NOISE = 1e-12
"""m. What a third difference of positions of less than a metre has of rounding, and more."""
MOTION = "motion.acceleration=5.0", "motion.centripetal_acceleration=4.0"
SLOW_DRIVES = "limits.velocity=0.25", "limits.acceleration=3.0"
JERK = "motion.jerk=100.0", "limits.jerk=120.0"
MODES = ["", "G61", "G61.1", "G64", "G64 P0.02 Q0", "G64 P0.1 Q0.05", "G64 P1 Q0.2", "G64 P0.003 Q0.001", "G64 P0"]


class Place(NamedTuple):
    """Where programs of a setup run: within `reach` of `middle`, mm, in the x-y plane alone if `flat`."""

    setup: Setup
    middle: tuple[float, float]
    reach: float
    flat: bool


def places() -> list[Place]:
    """Every machine with and without limits of jerk, with drives that hardly limit and such that do."""
    result = []
    for jerk in ((), JERK):
        for drives in (("limits.acceleration=40.0",), SLOW_DRIVES):
            overrides = (*MOTION, *drives, *jerk)
            result += [
                Place(load_setup("cartesian", overrides), (0.0, 0.0), 80.0, False),
                Place(load_setup("tripod", overrides), (0.0, 0.0), 80.0, False),
                Place(load_setup("tripod", overrides), (0.0, 195.0), 40.0, False),
                Place(load_setup("bipod", overrides), (330.0, 0.0), 60.0, True),
            ]
    return result


def program(rng: random.Random, place: Place) -> str:
    """A program of lines, arcs, helices and rows of tiny segments, in any mode, from where the machine starts."""
    blocks = [f"G0 X{place.middle[0]:g} Y{place.middle[1]:g}", f"G1 F{_feed(rng)}"]
    end = place.middle
    for _ in range(rng.randrange(1, 6)):
        kind = rng.randrange(10)
        if kind < 2:
            blocks.append(f"{rng.choice(MODES)} F{_feed(rng)}".strip())
        point = tuple(
            round(middle + rng.uniform(-0.7, 0.7) * place.reach * rng.choice((1.0, 0.1, 0.01)), 3)
            for middle in place.middle
        )
        height = "" if place.flat else f" Z{rng.uniform(-20.0, 20.0):.3f}"
        if kind == 2:
            blocks.append(f"G0 X{point[0]} Y{point[1]}{height}")
        elif kind < 5:
            blocks += _row(rng, end, point)
        elif kind < 7:
            i, j = (round(rng.uniform(-0.15, 0.15) * place.reach, 3) for _ in range(2))
            if math.hypot(i, j) < 0.01:
                continue
            turn = rng.uniform(0.1, math.tau)
            sign = rng.choice((-1, 1))
            point = (
                end[0] + i - i * math.cos(turn) + sign * j * math.sin(turn),
                end[1] + j - j * math.cos(turn) - sign * i * math.sin(turn),
            )
            point = (round(point[0], 6), round(point[1], 6))
            height = height if rng.random() < 0.3 else ""
            blocks.append(f"G{2 if sign < 0 else 3} X{point[0]} Y{point[1]} I{i} J{j}{height}")
        else:
            blocks.append(f"G1 X{point[0]} Y{point[1]}{height if rng.random() < 0.5 else ''}")
        end = point
    return "\n".join([*blocks, "M2", ""])


def _feed(rng: random.Random) -> float:
    return round(10.0 ** rng.uniform(2.0, 4.7), 1)


def _row(rng: random.Random, start: Sequence[float], end: Sequence[float]) -> list[str]:
    """Short lines along a wave from start to end."""
    length = math.dist(start, end)
    count = min(rng.randrange(2, 60), max(2, round(length / 0.02)))
    height, waves = 0.05 * length * rng.random() ** 3, rng.uniform(0.2, 3.0)
    across = (-(end[1] - start[1]), end[0] - start[0])
    blocks = []
    for k in range(1, count + 1):
        part = k / count
        out = height * math.sin(math.pi * waves * part) * (1.0 - part) / max(length, 1e-3)
        x, y = (a + part * (b - a) + out * c for a, b, c in zip(start, end, across, strict=True))
        blocks.append(f"G1 X{x:.4f} Y{y:.4f}")
    return blocks


def sent(setup: Setup, text: str) -> tuple[Toolpath, list[TcpSetpoint]]:
    """The toolpath of a program and its setpoints, with some of the rest before and behind. Raises InputError."""
    toolpath = prepare(setup, Program("fuzz.ngc", text)).toolpath()
    interpolator = Interpolator(toolpath, setup.motion, setup.servo_period, setup.drive_limits)
    setpoints = []
    while not interpolator.finished:
        setpoints.append(interpolator.step())
    moves = [setpoint for setpoint in setpoints if setpoint.phase == PHASE_MOVE]
    return toolpath, [moves[0]] * 3 + moves + [moves[-1]] * 3


def faults(setup: Setup, toolpath: Toolpath, setpoints: Sequence[TcpSetpoint]) -> list[str]:
    """What is wrong with the motion along a toolpath."""
    table = np.array([setpoint[:6] for setpoint in setpoints])
    position, velocity = table[:, :3], table[:, 3:]
    feeds = np.array([setpoint.feed for setpoint in setpoints])
    found = [
        f"{name} uses {used:.5f} of its limit in cycle {cycle}"
        for name, used, cycle in _uses(setup, position, feeds)
        if not used <= KEPT
    ]
    found += _wrong_ends(toolpath, setpoints)
    sag = math.hypot(setup.motion.acceleration, setup.motion.centripetal_acceleration) * setup.servo_period**2
    steps = np.diff(position, axis=0) - 0.5 * setup.servo_period * (velocity[1:] + velocity[:-1])
    if (jump := float(np.abs(steps).max())) > sag:
        found.append(f"a step differs by {jump:.3g} m from what the velocities say")
    return found + list(_deviations(toolpath, setup, position, sag))


def _uses(setup: Setup, position: Array, feeds: Array) -> Iterator[tuple[str, float, int]]:
    """Name of each limit, the largest part of it that is used, and in which cycle."""
    period, motion = setup.servo_period, setup.motion
    limits = [axis.limits for axis in setup.axes.values()]
    drives = setup.machine.inverse(position)
    drives = drives - drives[0]
    tcp = position - position[0]

    def most(name: str, parts: Array) -> tuple[str, float, int]:
        return name, float(parts.max()), int(parts.argmax())

    def difference(values: Array, order: int) -> Array:
        differences = np.abs(np.diff(values, n=order, axis=0))
        return np.asarray(np.maximum(differences - NOISE, 0.0) / period**order)

    def norm(values: Array) -> Array:
        return np.asarray(np.sqrt((values**2).sum(axis=1)))

    yield most("feed", norm(difference(tcp, 1)) / np.maximum(feeds[1:], feeds[:-1]))
    both = math.hypot(motion.acceleration, motion.centripetal_acceleration)
    yield most("acceleration", norm(difference(tcp, 2)) / both)
    yield most("drive velocity", (difference(drives, 1) / [limit.velocity for limit in limits]).max(axis=1))
    yield most("drive acceleration", (difference(drives, 2) / [limit.acceleration for limit in limits]).max(axis=1))
    if motion.jerk:
        yield most("jerk", norm(difference(tcp, 3)) / motion.jerk)
        yield most("drive jerk", (difference(drives, 3) / [limit.jerk for limit in limits]).max(axis=1))


def _wrong_ends(toolpath: Toolpath, setpoints: Sequence[TcpSetpoint]) -> Iterator[str]:
    """Where the TCP does not rest although it must: at the end, at both ends of a rapid, everywhere under G61.1."""
    end = toolpath.elements[-1].end
    if setpoints[-1][:9] != (*end, *(0.0,) * 6):
        yield f"ends at {setpoints[-1][:9]}, not at rest at {end}"
    if any(after.path_length < before.path_length - 1e-12 for before, after in pairwise(setpoints)):
        yield "goes back along the path"
    rests = {setpoint[:3] for setpoint in setpoints if setpoint[3:9] == (0.0,) * 6}
    for before, after in pairwise(toolpath.elements):
        stops = before.traverse or after.traverse or before.path_mode.code == "G61.1"
        if stops and before.end not in rests:
            yield f"does not rest at the end of line {before.line}"


def _deviations(toolpath: Toolpath, setup: Setup, position: Array, sag: float) -> Iterator[str]:
    """Where setpoints are further from the path than P, or a point of the path from the polyline of the setpoints."""
    allowed = max(_tolerance(element, setup) for element in toolpath.elements) + sag
    for point in position[:: max(1, len(position) // 150)].tolist():
        off = min(_apart(element, (point[0], point[1], point[2])) for element in toolpath.elements)
        if off > allowed:
            yield f"{point} is {off:.4g} m off the path"
    start, step = position[:-1], np.diff(position, axis=0)
    square = np.maximum((step**2).sum(axis=1), 1e-30)
    for element in toolpath.elements:
        for part in (0.5, 1.0):
            point = np.array(element.position(part * element.length))
            along = np.clip(((point - start) * step).sum(axis=1) / square, 0.0, 1.0)
            off = float(np.sqrt(((start + along[:, None] * step - point) ** 2).sum(axis=1)).min())
            if off > allowed:
                yield f"line {element.line} is left by {off:.4g} m"


def _tolerance(element: Element, setup: Setup) -> float:
    mode = element.path_mode
    if mode.code != "G64":
        return 0.0
    return setup.motion.blend_tolerance if mode.tolerance is None else mode.tolerance


def _apart(element: Element, point: Vector) -> float:
    return math.dist(element.position(element.nearest(point, 0.5 * element.length)), point)


def main() -> int:
    """Plan many programs; 1 if one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="how many programs (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers (%(default)s)")
    parser.add_argument("--all", action="store_true", help="go on after a program that failed")
    arguments = parser.parse_args()
    everywhere, failed, refused, begin = places(), 0, 0, time.perf_counter()
    for number in range(arguments.count):
        rng = random.Random(f"{arguments.seed} {number}")
        place = everywhere[number % len(everywhere)]
        text = program(rng, place)
        try:
            found = faults(place.setup, *sent(place.setup, text))
        except InputError:
            refused += 1
            continue
        except Exception as error:
            found = [f"{type(error).__name__}: {error}"]
        if found:
            failed += 1
            print(f"program {number} of seed {arguments.seed} ({place.setup.machine_name}): {found[:3]}", flush=True)
            if not arguments.all:
                print(text)
                return 1
    wall = time.perf_counter() - begin
    print(f"{arguments.count} programs: {failed} failed, {refused} refused; {wall:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
