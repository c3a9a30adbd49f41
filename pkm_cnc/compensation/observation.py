"""What a run of a program shows of its contour error, simulated or recorded."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.array_path import linear, respond
from pkm_cnc.bag import Run
from pkm_cnc.check import prepare
from pkm_cnc.config import Setup
from pkm_cnc.contour import ContourTracker, in_position, judged_range
from pkm_cnc.errors import InputError, MachineFault, UnreachableError
from pkm_cnc.evaluation import evaluate, setup_of
from pkm_cnc.motion import Interpolator
from pkm_cnc.program import Program, ProgramSource, Toolpath, carried_original, frames
from pkm_cnc.records import ContourError, TcpSetpoint, Vector
from pkm_cnc.simulation import simulated_cycles

__all__ = [
    "SETTLED",
    "ErrorFigures",
    "Observation",
    "check_machine",
    "decides_setpoints",
    "judged",
    "observe",
    "recorded",
    "setpoints_of",
    "tangents_at",
    "toolpath_of",
    "tracker_of",
]

Array = NDArray[np.float64]

SETTLED = 40.0
"""1/Kv: after that nothing is left of a lag, and every drive that is stable is in position."""


@dataclass(frozen=True)
class ErrorFigures:
    """Largest and root mean square contour error in three dimensions, and their parts in the plane, m."""

    largest: float
    rms: float
    largest_in_plane: float
    rms_in_plane: float
    cycles: int


@dataclass(frozen=True)
class Observation:
    """A run cycle by cycle (n cycles, m axes), SI, `base_link`.

    `s` is the setpoint's path length on the contour, `segment` the contour's element that it is on, `setpoint` (n, 3)
    the TCP it asks for, `joints` and `actual` (n, m) the drives' setpoints and their positions as measured; `errors`
    are the contour errors of the true TCP.
    """

    s: Array
    segment: NDArray[np.int64]
    setpoint: Array
    joints: Array
    actual: Array
    errors: list[ContourError]

    def error_vectors(self) -> tuple[Array, Array]:
        """Path lengths (n,) of the tool's places on the contour and the vectors (n, 3) from there to it, m."""
        table = np.array([(error.path_length, error.x, error.y, error.z) for error in self.errors])
        return table[:, 0], table[:, 1:]


def judged(errors: Iterable[ContourError], contour: Toolpath) -> ErrorFigures:
    """The figures over what is judged: the middle half of every evaluated line, all of every evaluated arc."""
    ranges = [
        judged_range(element, start) if element.evaluated else (math.inf, -math.inf)
        for element, start in zip(contour.elements, contour.starts, strict=True)
    ]
    chosen = [
        (error.magnitude, error.left)
        for error in errors
        if ranges[error.segment][0] <= error.path_length <= ranges[error.segment][1]
    ]
    if not chosen:
        nothing = math.nan
        return ErrorFigures(nothing, nothing, nothing, nothing, 0)
    size, left = np.abs(np.array(chosen)).T
    left = left[np.isfinite(left)]
    plane = (float(left.max()), float(np.sqrt((left**2).mean()))) if len(left) else (math.nan, math.nan)
    return ErrorFigures(float(size.max()), float(np.sqrt((size**2).mean())), *plane, len(chosen))


def setpoints_of(setup: Setup, toolpath: Toolpath) -> list[TcpSetpoint]:
    """The setpoints of a run that never waits, with segment and path length of the contour that counts."""
    interpolator = Interpolator(toolpath, setup.motion, setup.servo_period, setup.drive_limits)
    setpoints = []
    while not interpolator.finished:
        setpoints.append(interpolator.step())
    return setpoints


def observe(setup: Setup, program: Program, toolpath: Toolpath | None = None) -> Observation:
    """Run a program: as arrays where the machine is linear and does not wait on its way, else step by step.

    `toolpath` is what `toolpath_of` reads of it, where that is known. The array path does not check
    it. Raises MachineFault, and InputError as `check.prepare`.
    """
    try:
        linear(setup)
    except InputError:
        return _by_steps(setup, program)
    if setup.motion.wait_in_position:
        return _by_steps(setup, program)
    return _by_arrays(setup, toolpath or toolpath_of(setup, program))


def toolpath_of(setup: Setup, program: Program) -> Toolpath:
    """All motions of a program, each with its place on the contour that counts. Raises as `check.prepare`."""
    return ProgramSource(program, setup.start_pose, setup.program_zero, setup.motion.rapid, setup.program).toolpath()


def _by_arrays(setup: Setup, toolpath: Toolpath) -> Observation:
    setpoints = setpoints_of(setup, toolpath)
    moving = len(setpoints)
    slowest = min(parts.drive.kv for parts in setup.axes.values())
    setpoints += [setpoints[-1]] * math.ceil(SETTLED / slowest / setup.servo_period)
    table = _table(setpoints)
    joints, speeds, rates = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period)(
        table[:, 0:3], table[:, 3:6], table[:, 6:9]
    )
    actual = np.stack(
        [
            respond(setup, axis, joints[:, column], speeds[:, column], rates[:, column]).position
            for column, axis in enumerate(setup.axes)
        ],
        axis=1,
    )
    try:
        believed, true = setup.machine.forward(actual), setup.true_tcp(actual)
    except UnreachableError as error:
        raise MachineFault(str(error)) from None
    count = moving
    tolerance = setup.motion.in_position_tolerance
    while count < len(setpoints) and not in_position(setpoints[count - 1], _vector(believed[count - 2]), tolerance):
        count += 1
    segments = [setpoint.segment for setpoint in setpoints[:count]]
    errors = tracker_of(toolpath.contour).follow(true[:count], segments)
    return _observation(table[:count], segments, joints[:count], actual[:count], errors)


def _by_steps(setup: Setup, program: Program) -> Observation:
    setpoints, joints, actual, errors = [], [], [], []
    for cycle in simulated_cycles(setup, prepare(setup, program)):
        setpoints.append(cycle.setpoint)
        joints.append([setpoint.position for setpoint in cycle.axis_setpoints])
        actual.append([state.position for state in cycle.states])
        errors.append(cycle.error)
    segments = [setpoint.segment for setpoint in setpoints]
    return _observation(_table(setpoints), segments, np.array(joints), np.array(actual), errors)


def _table(setpoints: list[TcpSetpoint]) -> Array:
    """The setpoints' numbers but segment and phase, one row each."""
    return np.array([*zip(*setpoints, strict=True)][:11]).T


def _observation(
    table: Array, segments: list[int], joints: Array, actual: Array, errors: list[ContourError]
) -> Observation:
    return Observation(table[:, 9], np.array(segments), table[:, 0:3], joints, actual, errors)


def tangents_at(contour: Toolpath, s: Array, segments: Sequence[int] | None = None) -> Array:
    """Unit tangents (n, 3) at path lengths `s` (n,) of the contour, m; `segments` (n,) where an element is meant."""
    starts = np.array(contour.starts)
    which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None) if segments is None else np.array(segments)
    return np.asarray(frames(contour.elements, which, s - starts[which])[1].T)


def tracker_of(contour: Toolpath) -> ContourTracker:
    """One that knows all of a contour."""
    tracker = ContourTracker()
    for index, (element, start) in enumerate(zip(contour.elements, contour.starts, strict=True)):
        tracker.add(index, element, start)
    return tracker


def _vector(row: list[float] | Array) -> Vector:
    x, y, z = row
    return float(x), float(y), float(z)


SAME_SETPOINTS = ("machine", "servo_period", "start_pose", "program_zero", "geometry", "motion", "program", "limits")
"""Parameters that decide the setpoints: a bag counts if it agrees with the machine in these."""


def recorded(run: Run, setup: Setup, program_text: str) -> Observation:
    """The run that a bag holds. Raises InputError for one of another machine or program, or that did not complete."""
    name = f"bag {run.folder}"
    evaluation = evaluate(run)
    info = run.slow["run_info"][0]
    if not run.complete or evaluation.end is None or not evaluation.end.completed:
        reason = evaluation.end.reason if evaluation.end is not None and evaluation.end.reason else "it ends early"
        raise InputError(f"{name}: the run did not complete ({reason}): its errors are not those of the whole contour")
    if info.program != program_text:
        carried = carried_original(Program("", program_text))
        if carried is not None and carried.text.strip() == info.program.strip():
            raise InputError(f"{name}: it is of the original that this program carries: compensate that by it")
        raise InputError(f"{name}: it is of another part program ({info.program_name}): record a run of this one")
    check_machine(name, setup_of(run), setup)
    cycles = run.cycles()
    rows = run.servo["tcp/setpoint"][:cycles]
    axes = [*setup.axes]
    return Observation(
        np.array(rows["path_length"]),
        np.array(rows["segment"], dtype=np.int64),
        np.stack([rows[f"position.{axis}"] for axis in "xyz"], axis=1),
        np.stack([run.servo[f"{axis}/setpoint"][:cycles]["position"] for axis in axes], axis=1),
        np.stack([run.servo[f"{axis}/actual"][:cycles]["position"] for axis in axes], axis=1),
        evaluation.errors,
    )


def decides_setpoints(key: str) -> bool:
    """Whether the parameter `key` is one of those, for all axes or for one."""
    sections = key.split(".")
    own = len(sections) > 2 and sections[0] != "actual" and sections[1] in SAME_SETPOINTS
    return sections[0] in SAME_SETPOINTS or own


def check_machine(name: str, other: Setup, setup: Setup, counts: Callable[[str], bool] = decides_setpoints) -> None:
    """Raise InputError, calling `other` `name`, if it differs from `setup` in a parameter that `counts`."""
    ours, theirs = ({key: value for key, (value, _) in one.parameters.items()} for one in (setup, other))
    for key in sorted({*ours, *theirs}, key=lambda key: (key != "machine", key)):
        if counts(key) and ours.get(key) != theirs.get(key):
            raise InputError(
                f"{name}: it is of another machine: {key} is {theirs.get(key)} there and {ours.get(key)} here"
            )
