"""What a calibration is made from: drive scales and, at the same time, where the TCP is or how far from a centre.

A CSV file has a header line; every column says its unit: `u1_mm` and `x_mm`, also in um or m. Positions need a column
for every drive and every coordinate of the machine, a ball-bar circle a column for every drive on the circle, `u1_mm`,
with the ball bar's centre, `center_u1_mm`, and `radius_mm`. Positions on a machine of one coordinate may have the
target positions of a positioning test, `target_x_mm`, its rows in the order of measuring.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.bag import Run
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.evaluation import setup_of
from pkm_cnc.kinematics import NOT_AS_DRAWN, Machine, is_drawn

__all__ = ["UNKNOWNS", "Circle", "Forward", "Measurements", "Positions", "positions_of_run", "read_measurements"]

Array = NDArray[np.float64]

UNKNOWNS = NOT_AS_DRAWN
"""Parameters of a geometry that a calibration looks for."""
UNITS = {"mm": 1e-3, "um": 1e-6, "m": 1.0}
BAG_ROWS = 500
"""Cycles taken from a bag, evenly spread: neighbouring cycles say the same."""
LEAST_SPAN = 0.010
"""m. Least motion of the TCP along each coordinate along which the struts change their direction."""
CONSTANT = 1e-6
"""m. A drive that moves less stands still."""


class Forward(Protocol):
    """What tells where the TCP is: a machine, or one whose platform tilts."""

    def forward(self, joints: ArrayLike) -> Array:
        """TCP (..., coordinates), m, in `base_link` with the drives at `joints` (..., axes), m."""


class Measurements(Protocol):
    """What was observed, and what a machine of another geometry would have shown at the same drive positions."""

    @property
    def observed(self) -> Array:
        """(m,), m."""

    def predicted(self, machine: Forward) -> Array:
        """(m,), m: `observed` as `machine` has it. Raises UnreachableError."""

    def check(self, machine: Machine) -> None:
        """Raises InputError naming the motion that is missing."""


@dataclass(frozen=True)
class Positions:
    """Drive scales (n, axes), m, and measured TCP (n, coordinates), m, in `base_link`, row by row."""

    joints: Array
    tcp: Array
    targets: Array | None = None
    """(n,) m, of a positioning test of one coordinate."""

    @property
    def observed(self) -> Array:
        """The measured coordinates, row after row, (n * coordinates,), m."""
        return self.tcp.reshape(-1)

    def predicted(self, machine: Forward) -> Array:
        """TCP that `machine` has at these drive positions, as `observed`. Raises UnreachableError."""
        return machine.forward(self.joints).reshape(-1)

    def check(self, machine: Machine) -> None:
        """Raises InputError naming a drive or coordinate that does not move, or not far enough."""
        _check_drives(self.joints, machine.axes)
        _check_span(machine, self.tcp)


@dataclass(frozen=True)
class Circle:
    """A ball-bar test: drive scales on the circle (n, axes) and at its centre (n, axes), m; measured radius (n,), m."""

    joints: Array
    center: Array
    radius: Array

    @property
    def observed(self) -> Array:
        """The measured radius, (n,), m."""
        return self.radius

    def predicted(self, machine: Forward) -> Array:
        """Distance (n,), m, that `machine` has between both positions. Raises UnreachableError."""
        apart = machine.forward(self.joints) - machine.forward(self.center)
        return np.asarray(np.sqrt(np.square(apart).sum(axis=-1)))

    def check(self, machine: Machine) -> None:
        """Raises InputError naming a drive or coordinate that does not move, or not far enough."""
        _check_drives(self.joints, machine.axes)
        _check_span(machine, machine.forward(self.joints))


def _check_drives(joints: Array, axes: Sequence[str]) -> None:
    """A drive that stands while others move makes no motion of these machines."""
    spans = np.ptp(joints, axis=0)
    for axis, span, start in zip(axes, spans.tolist(), joints[0].tolist(), strict=True):
        if span <= CONSTANT < spans.max():
            raise InputError(f"{axis}: constant, {1e3 * start:.6g} mm in all {len(joints)} rows: was it recorded?")
    if not spans.max() > CONSTANT:
        raise InputError(f"too little motion: {', '.join(axes)} constant in all {len(joints)} rows")


def _check_span(machine: Machine, tcp: Array) -> None:
    """Along a coordinate along which the joints move in proportion, a motion tells nothing and may be missing."""
    for index, name in enumerate(machine.coordinates):
        along = np.eye(len(machine.coordinates))[index]
        span = float(np.ptp(tcp[:, index]))
        if span < LEAST_SPAN and np.any(np.abs(machine.second_derivative(tcp[:1], along[None])) > 0.0):
            raise InputError(
                f"too little motion: {name} moves by {1e3 * span:.4g} mm, at least {1e3 * LEAST_SPAN:g} mm are needed "
                f"to tell a geometry: measure over the working range of {name}"
            )


def read_measurements(path: str, machine: Machine) -> Positions | Circle:
    """Read a CSV file of measurements on `machine`. Raises InputError naming file, line, column and what is wrong."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            table = _table(path, csv.reader(file))
    except OSError as error:
        raise InputError(f"measurements {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"measurements {path}: not a CSV file: {error}") from None
    circle = [*machine.axes, *(f"center_{axis}" for axis in machine.axes), "radius"]
    positions = [*machine.axes, *machine.coordinates]
    targets = [f"target_{name}" for name in machine.coordinates if len(machine.coordinates) == 1]
    wanted = circle if "radius" in table else positions + [name for name in targets if name in table]
    if sorted(wanted) != sorted(table):
        raise InputError(
            f"measurements {path}:1: columns {_listed(table)}; wanted are, each with its unit, {_listed(positions)} "
            f"or, of a ball-bar circle, {_listed(circle)}"
        )
    joints = np.stack([table[axis] for axis in machine.axes], axis=1)
    if wanted is circle:
        return Circle(joints, np.stack([table[f"center_{axis}"] for axis in machine.axes], axis=1), table["radius"])
    tcp = np.stack([table[name] for name in machine.coordinates], axis=1)
    return Positions(joints, tcp, next((table[name] for name in targets if name in table), None))


def _listed(names: Sequence[str] | dict[str, Array]) -> str:
    return ", ".join(names) or "(none)"


def _table(path: str, reader: Any) -> dict[str, Array]:
    """Columns in m, by name without unit."""
    header = [name.strip() for name in next(reader, [])]
    scales = [_scale(path, name) for name in header]
    names = [name.rpartition("_")[0] for name in header]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"measurements {path}:1: column {name} is there twice")
    rows = []
    for row in reader:
        if row:
            rows.append(_row(f"measurements {path}:{reader.line_num}", row, header))
    if not rows:
        raise InputError(f"measurements {path}: no rows")
    values = np.array(rows)
    return {name: scale * column for name, scale, column in zip(names, scales, values.T, strict=True)}


def _scale(path: str, name: str) -> float:
    unit = name.rpartition("_")[2]
    if unit == name or unit not in UNITS:
        raise InputError(
            f"measurements {path}:1: column {name!r} has no unit; call it {name}_mm, {name}_um or {name}_m"
        )
    return UNITS[unit]


def _row(where: str, row: Sequence[str], header: Sequence[str]) -> list[float]:
    if len(row) != len(header):
        raise InputError(f"{where}: {len(row)} values, {len(header)} expected")
    values = []
    for name, cell in zip(header, row, strict=True):
        try:
            value = float(cell)
        except ValueError:
            raise InputError(f"{where}: {name}: {cell!r} is not a number") from None
        if not np.isfinite(value):
            raise InputError(f"{where}: {name}: {cell.strip()} is not a finite number")
        values.append(value)
    return values


def positions_of_run(run: Run, setup: Setup) -> Positions:
    """Drive scales and true TCP of a recorded run of the machine `setup`, at most `BAG_ROWS` of its cycles.

    Raises InputError for a run of another machine: other kinematics, or a drawing with other dimensions.
    """
    _check_same(run, setup)
    machine, cycles = setup.kinematics, run.cycles()
    if not cycles:
        raise InputError(f"bag {run.folder}: it holds no cycle")
    missing = {"tcp/state", *(f"{axis}/actual" for axis in machine.axes)} - set(run.servo)
    if missing:
        raise InputError(f"bag {run.folder}: it holds no {', '.join(sorted(missing))}")
    rows = np.unique(np.linspace(0, cycles - 1, BAG_ROWS).astype(int))
    joints = np.stack([run.servo[f"{axis}/actual"]["position"][rows] for axis in machine.axes], axis=1)
    tcp = np.stack([run.servo["tcp/state"][f"position.{name}"][rows] for name in machine.coordinates], axis=1)
    if not (np.isfinite(joints).all() and np.isfinite(tcp).all()):
        raise InputError(f"bag {run.folder}: a position is no finite number")
    return Positions(joints, tcp)


def _check_same(run: Run, setup: Setup) -> None:
    """What a calibration looks for may differ: a bag from before the last calibration is as good as any."""
    recorded = setup_of(run)
    if recorded.machine_name != setup.machine_name:
        raise InputError(
            f"bag {run.folder}: recorded on a {recorded.machine_name}, the machine is a {setup.machine_name}"
        )
    for key, (value, _) in setup.parameters.items():
        there = recorded.parameters[key][0] if key in recorded.parameters else None
        if is_drawn(key) and there != value:
            raise InputError(f"bag {run.folder}: recorded on another machine: {key} is {there} there, {value} here")
