"""Checks a whole toolpath against the machine before anything moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.kinematics import reached_rows
from pkm_cnc.motion import Curve, Interpolator, Planner, Shape, pieces
from pkm_cnc.program import Program, Toolpath, interpret
from pkm_cnc.records import NANOSECONDS, TcpSetpoint
from pkm_cnc.tolerances import LIMIT_EXCESS

__all__ = ["check_toolpath", "prepare", "program_time"]

SAMPLING = 0.25e-3
"""m. Distance of the points checked along a path. Between two of them a path on a machine of strut length 0.6 m can
bulge by at most SAMPLING^2 / 8 / 0.2 m = 0.04 um further out than either."""

PORTION = 10_000
"""Points checked at a time, so that memory does not grow with the length of an element."""


def prepare(setup: Setup, program: Program) -> Toolpath:
    """Interpret a program for a machine and check all of it.

    Raises ProgramError for what cannot be read, InputError for what the machine cannot reach.
    """
    toolpath = interpret(
        program,
        start=setup.start_pose,
        zero=setup.program_zero,
        rapid=setup.motion.rapid,
        parameters=setup.program,
    )
    check_toolpath(setup, program, toolpath)
    return toolpath


def program_time(setup: Setup, toolpath: Toolpath) -> float:
    """Time of the motion and of the dwells of a program, s: that of a run, or somewhat less with limits of jerk.

    What is not known before is not in it: how long a run waits for the TCP to be in position, or for the operator.
    """
    planner = Planner(setup.motion, setup.drive_limits, setup.servo_period)
    path = pieces(toolpath.elements, setup.motion, smooth=planner.taps > 1)
    time = math.fsum(event.value or 0.0 for event in toolpath.events if event.kind == "dwell")
    while piece := next(path, None):
        time += planner.duration(piece, path)
    return round(time / setup.servo_period) * setup.servo_period_ns / NANOSECONDS


def check_toolpath(setup: Setup, program: Program, toolpath: Toolpath) -> None:
    """Check every element along its length against workspace, singularities and drive travel, and what rounds corners.

    Where the joints depend on what came before (`Machine.setpoint_motion`), every setpoint too, as the run will have
    it, and there speed and acceleration of the drives, whose limits the planner keeps elsewhere by going slower; but
    not with motion.wait_in_position, because how long a run waits is not known before: it faults by itself.
    Raises InputError naming program, line, strut or axis, the place and by how much.
    """
    for element in toolpath.elements:
        _check_along(setup, f"{program.name}:{element.line}", element)
    for piece in pieces(toolpath.elements, setup.motion, smooth=True):
        if isinstance(piece.shape, Curve):
            _check_along(setup, f"{program.name}:{piece.line}", piece.shape)
    static = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period) == setup.machine.motion
    if not static and not setup.motion.wait_in_position:
        _check_setpoints(setup, program, toolpath)


def _check_along(setup: Setup, where: str, shape: Shape) -> None:
    length = shape.length
    # The ends first: a coordinate with a zero too many is refused before a path of that length is looked at.
    _check_points(setup, where, np.array([shape.position(0.0), shape.position(length)]))
    steps = max(1, math.ceil(length / SAMPLING))
    for first in range(0, steps + 1, PORTION):
        places = range(first, min(first + PORTION, steps + 1))
        _check_points(setup, where, np.array([shape.position(length * step / steps) for step in places]))


def _check_points(setup: Setup, where: str, points: NDArray[np.float64]) -> None:
    violations = setup.machine.violations(points)
    if violations:
        worst = max(violations, key=lambda violation: violation.excess)
        raise InputError(f"{where}: outside the workspace {_place(setup, points[worst.row or 0])}: {worst.reason}")
    _check_joints(setup, where, points, setup.machine.inverse(points))


def _check_setpoints(setup: Setup, program: Program, toolpath: Toolpath) -> None:
    motion = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period)
    for segment, setpoints in _portions(Interpolator(toolpath, setup.motion, setup.servo_period, setup.drive_limits)):
        where = f"{program.name}:{toolpath.elements[segment].line}"
        table = np.array([setpoint[:9] for setpoint in setpoints])
        points = table[:, 0:3]
        rows, refusal = reached_rows(
            lambda *vectors: np.stack(motion(*vectors), axis=-1), points, table[:, 3:6], table[:, 6:9]
        )
        if refusal is not None:
            raise InputError(f"{where}: outside the workspace {_place(setup, points[len(rows)])}: {refusal}")
        _check_joints(setup, where, points, rows[:, :, 0])
        _check_rates(setup, where, points, rows)


def _check_rates(setup: Setup, where: str, points: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """`rows` (k, n, 3): position, speed, acceleration of each drive."""
    for column, (axis, axis_setup) in enumerate(setup.axes.items()):
        limits = axis_setup.limits
        for kind, name, unit, limit in (
            (1, "velocity", "m/s", limits.velocity),
            (2, "acceleration", "m/s^2", limits.acceleration),
        ):
            values = np.abs(rows[:, column, kind])
            row = int(np.argmax(values))
            if values[row] > limit * (1.0 + LIMIT_EXCESS):
                raise InputError(
                    f"{where}: {axis} is over its limit {_place(setup, points[row])}: {values[row]:.6g} {unit} is more "
                    f"than {limit:g} {unit} ({axis}.limits.{name}); a lower feed or motion.acceleration helps"
                )


def _portions(interpolator: Interpolator) -> Iterator[tuple[int, list[TcpSetpoint]]]:
    """The setpoints of a run that is in position at once wherever it waits, in portions of one segment each."""

    def setpoints() -> Iterator[TcpSetpoint]:
        while not interpolator.finished:
            yield interpolator.step()

    for segment, group in itertools.groupby(setpoints(), key=lambda setpoint: setpoint.segment):
        while portion := list(itertools.islice(group, PORTION)):
            yield segment, portion


def _check_joints(setup: Setup, where: str, points: NDArray[np.float64], joints: NDArray[np.float64]) -> None:
    missed = setup.actual.joint_violations(joints) if setup.actual is not setup.machine else []
    if missed:
        place = _place(setup, points[missed[0].row or 0])
        raise InputError(f"{where}: the actual machine (actual.geometry) cannot follow {place}: {missed[0].reason}")
    for column, (axis, axis_setup) in enumerate(setup.axes.items()):
        travel = axis_setup.travel
        for row, bound, excess in (
            (int(np.argmin(joints[:, column])), travel.minimum, travel.minimum - joints[:, column].min()),
            (int(np.argmax(joints[:, column])), travel.maximum, joints[:, column].max() - travel.maximum),
        ):
            if excess > 0:
                raise InputError(
                    f"{where}: {axis} leaves its travel {_place(setup, points[row])}: "
                    f"{joints[row, column] * 1e3:.3f} mm is {excess * 1e3:.3f} mm beyond {bound * 1e3:.3f} mm"
                )


def _place(setup: Setup, point: NDArray[np.float64]) -> str:
    x, y, z = (point - setup.program_zero) * 1e3
    return f"at X{x:.3f} Y{y:.3f} Z{z:.3f}"
