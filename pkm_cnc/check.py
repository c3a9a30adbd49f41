"""Checks a whole part program against the machine before anything moves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.kinematics import reached_rows
from pkm_cnc.motion import Curve, Interpolator, Planner, Shape, frames_of, pieces
from pkm_cnc.program import Element, Event, Program, ProgramSource, Toolpath, Totals
from pkm_cnc.records import NANOSECONDS, TcpSetpoint, Vector
from pkm_cnc.tolerances import LIMIT_EXCESS

__all__ = ["CheckedProgram", "prepare"]

SAMPLING = 0.25e-3
"""m. Distance of the points checked along a path. Between two of them a path on a machine of strut length 0.6 m can
bulge by at most SAMPLING^2 / 8 / 0.2 m = 0.04 um further out than either."""

PORTION = 10_000
"""Points checked at a time, so that memory does not grow with the length of an element."""


@dataclasses.dataclass(frozen=True)
class CheckedProgram:
    """A part program of which a machine can run all; it is read anew whenever it is run.

    `box` are the least and the greatest coordinates of the TCP, m, in base_link.
    """

    setup: Setup
    source: ProgramSource
    totals: Totals
    box: tuple[Vector, Vector]

    @property
    def length(self) -> float:
        """Path length, m."""
        return self.totals.length

    def items(self) -> Iterator[Element | Event]:
        """See `ProgramSource.items`."""
        return self.source.items()

    def toolpath(self) -> Toolpath:
        """All of it in memory."""
        return self.source.toolpath()

    def time(self) -> float:
        """Time of motion and dwells, s: of a run, or somewhat less where drives and jerk slow it down.

        What is not known before is not in it: how long a run waits for the TCP to be in position, or for the operator.
        """
        setup = self.setup
        planner = Planner(setup.motion, setup.drive_limits, setup.servo_period)
        path = pieces(self.items(), setup.motion, smooth=planner.taps > 1)
        time = self.totals.dwell_time
        while piece := next(path, None):
            time += planner.duration(piece, path)
        return round(time / setup.servo_period) * setup.servo_period_ns / NANOSECONDS

    def interpolator(self, attended: bool = False) -> Interpolator:
        """What runs it."""
        setup = self.setup
        return Interpolator(
            self,
            setup.motion,
            setup.servo_period,
            setup.drive_limits,
            attended=attended,
            optional_stop=setup.program.optional_stop,
            check=self._check_rapid,
        )

    def _check_rapid(self, rapid: Element) -> None:
        check = _Check(self.setup, self.source.program.name)
        check.add(rapid.line, rapid)
        check.finish()


def prepare(setup: Setup, program: Program, from_line: int = 0, toolpath: Toolpath | None = None) -> CheckedProgram:
    """Interpret a program for a machine and check all of it, a portion at a time.

    Every element is checked along its length against workspace, singularities and drive travel, and so is what rounds
    corners. Where the joints depend on what came before (`Machine.setpoint_motion`), so is every setpoint, as the run
    will have it, and there speed and acceleration of the drives, whose limits the planner keeps elsewhere by going
    slower; but not with motion.wait_in_position, because how long a run waits is not known before: it faults by itself.

    `from_line`: from that line on, see `ProgramSource`; `toolpath`: what that reads, where it is known. Raises
    ProgramError for what cannot be read, InputError for what the machine cannot reach, naming program, line, strut or
    axis, the place and by how much.
    """
    if from_line < 0:
        raise InputError(f"from_line {from_line}: lines of part programs are counted from 1; 0 = all of it")
    source = ProgramSource(program, setup.start_pose, setup.program_zero, setup.motion.rapid, setup.program, from_line)
    check, totals = _Check(setup, program.name), Totals()

    def checked() -> Iterator[Element | Event]:
        for item in source.items() if toolpath is None else toolpath.items():
            totals.add(item)
            if not isinstance(item, Event):
                check.add(item.line, item)
            yield item

    for piece in pieces(checked(), setup.motion, smooth=True):
        if isinstance(piece.shape, Curve):
            check.add(piece.line, piece.shape)
    result = CheckedProgram(setup, source, totals, check.finish())
    static = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period) == setup.machine.motion
    if not static and not setup.motion.wait_in_position:
        _check_setpoints(result)
    return result


class _Check:
    """Checks shapes along their length, in portions of many short ones or of a part of a long one."""

    def __init__(self, setup: Setup, name: str) -> None:
        self._setup = setup
        self._name = name
        self._shapes: list[tuple[int, Shape]] = []
        self._points = 0  # of these
        self._least, self._greatest = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, line: int, shape: Shape) -> None:
        """Check a shape of a line of the program, now or later."""
        steps = _steps(shape)
        if steps >= PORTION:
            self._flush()
            # The ends first: a coordinate with a zero too many is refused before a path of that length is looked at.
            self._check(line, np.array([shape.position(0.0), shape.position(shape.length)]))
            for first in range(0, steps + 1, PORTION):
                self._check(line, _points([shape], [range(first, min(first + PORTION, steps + 1))], [steps]))
            return
        self._shapes.append((line, shape))
        self._points += steps + 1
        if self._points >= PORTION:
            self._flush()

    def finish(self) -> tuple[Vector, Vector]:
        """Check what is left; return the least and greatest coordinates, m. Raises as `prepare`."""
        self._flush()
        (x0, y0, z0), (x1, y1, z1) = self._least.tolist(), self._greatest.tolist()
        return (x0, y0, z0), (x1, y1, z1)

    def _flush(self) -> None:
        shapes, self._shapes, self._points = self._shapes, [], 0
        if not shapes:
            return
        steps = [_steps(shape) for _, shape in shapes]
        points = _points([shape for _, shape in shapes], [range(count + 1) for count in steps], steps)
        try:
            self._check(shapes[0][0], points)
            return
        except InputError:
            pass
        ends = np.cumsum([count + 1 for count in steps])
        for (line, _), portion in zip(shapes, np.split(points, ends[:-1]), strict=True):  # for the message: the first
            self._check(line, portion[[0, -1]])  # shape that fails
            self._check(line, portion)

    def _check(self, line: int, points: NDArray[np.float64]) -> None:
        _check_points(self._setup, f"{self._name}:{line}", points)
        self._least = np.minimum(self._least, points.min(axis=0))
        self._greatest = np.maximum(self._greatest, points.max(axis=0))


def _steps(shape: Shape) -> int:
    return max(1, math.ceil(shape.length / SAMPLING))


def _points(shapes: Sequence[Shape], places: Sequence[range], steps: Sequence[int]) -> NDArray[np.float64]:
    """Points (k, 3) at these steps, of so many, along each shape."""
    which = np.repeat(np.arange(len(shapes)), [len(part) for part in places])
    lengths, counts = np.array([shape.length for shape in shapes]), np.array(steps)
    s = lengths[which] * np.concatenate([np.arange(part.start, part.stop) for part in places]) / counts[which]
    return np.asarray(frames_of(shapes, which, s)[0].T)


def _check_points(setup: Setup, where: str, points: NDArray[np.float64]) -> None:
    violations = setup.machine.violations(points)
    if violations:
        worst = max(violations, key=lambda violation: violation.excess)
        raise InputError(f"{where}: outside the workspace {_place(setup, points[worst.row or 0])}: {worst.reason}")
    _check_joints(setup, where, points, setup.machine.inverse(points))


def _check_setpoints(checked: CheckedProgram) -> None:
    setup = checked.setup
    motion = setup.machine.setpoint_motion(setup.start_pose, setup.servo_period)
    for line, setpoints in _portions(checked.interpolator()):
        where = f"{checked.source.program.name}:{line}"
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
    """The setpoints of a run that is in position at once wherever it waits, in portions, with their line."""
    line, portion = 0, list[TcpSetpoint]()
    while not interpolator.finished:
        setpoint = interpolator.step()
        segments, _ = interpolator.take_segments(), interpolator.take_events()
        if portion and (segments or len(portion) >= PORTION):
            yield line, portion
            portion = []
        if segments:
            line = segments[-1].element.line
        portion.append(setpoint)
    yield line, portion


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
