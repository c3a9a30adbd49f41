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
from pkm_cnc.motion import Interpolator
from pkm_cnc.program import Arc, Line, Program, Toolpath, interpret
from pkm_cnc.records import TcpSetpoint

__all__ = ["check_toolpath", "prepare"]

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


def check_toolpath(setup: Setup, program: Program, toolpath: Toolpath) -> None:
    """Check every element along its length against workspace, singularities and drive travel.

    Where the joints depend on what came before (`Machine.setpoint_motion`), every setpoint too, as the run will have
    it; but not with motion.wait_in_position, because how long a run waits is not known before: it faults by itself.
    Raises InputError naming program, line, strut or axis, the place and by how much.
    """
    for element in toolpath.elements:
        _check_element(setup, f"{program.name}:{element.line}", element)
    static = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period) == setup.machine.motion
    if not static and not setup.motion.wait_in_position:
        _check_setpoints(setup, program, toolpath)


def _check_element(setup: Setup, where: str, element: Line | Arc) -> None:
    # The ends first: a coordinate with a zero too many is refused before a path of that length is looked at.
    _check_points(setup, where, np.array([element.start, element.end]))
    steps = max(1, math.ceil(element.length / SAMPLING))
    for first in range(0, steps + 1, PORTION):
        places = range(first, min(first + PORTION, steps + 1))
        _check_points(setup, where, np.array([element.position(element.length * step / steps) for step in places]))


def _check_points(setup: Setup, where: str, points: NDArray[np.float64]) -> None:
    violations = setup.machine.violations(points)
    if violations:
        worst = max(violations, key=lambda violation: violation.excess)
        raise InputError(f"{where}: outside the workspace {_place(setup, points[worst.row or 0])}: {worst.reason}")
    _check_joints(setup, where, points, setup.machine.inverse(points))


def _check_setpoints(setup: Setup, program: Program, toolpath: Toolpath) -> None:
    motion = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period)
    for segment, setpoints in _portions(Interpolator(toolpath, setup.motion, setup.servo_period)):
        where = f"{program.name}:{toolpath.elements[segment].line}"
        table = np.array([setpoint[:9] for setpoint in setpoints])
        points = table[:, 0:3]
        joints, refusal = reached_rows(lambda *vectors: motion(*vectors)[0], points, table[:, 3:6], table[:, 6:9])
        if refusal is not None:
            raise InputError(f"{where}: outside the workspace {_place(setup, points[len(joints)])}: {refusal}")
        _check_joints(setup, where, points, joints)


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
