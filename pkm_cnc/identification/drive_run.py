"""What a recorded run tells of its drives: setpoints, scale readings, contour and measured TCP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc import run_messages
from pkm_cnc.bag import Run
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.evaluation import setup_of
from pkm_cnc.kinematics import is_drawn
from pkm_cnc.program import Element

__all__ = ["DriveRun", "drive_run"]

Array = NDArray[np.float64]

STANDING = 1e-6
"""m. A setpoint or reading that varies less stands still."""
SAME = ("servo_period", "program_zero")
"""Parameters that must be equal for a run of the same machine, beside those of the geometry."""


@dataclass(frozen=True)
class DriveRun:
    """One run, n cycles, SI, `base_link`.

    `setpoints`: axis -> position, velocity, acceleration (3, n); `readings`: axis -> linear scale (n,); `tcp` (n, 3) as
    the measuring instrument sees it; `path` (n,) path length of the setpoint along the contour; `segment` (n,) index of
    the element that the tool is on; `elements` of the contour and where they begin on it, `starts`.
    """

    name: str
    setpoints: dict[str, Array]
    readings: dict[str, Array]
    tcp: Array
    path: Array
    segment: NDArray[np.int64]
    elements: tuple[Element, ...]
    starts: tuple[float, ...]


def drive_run(run: Run, setup: Setup) -> DriveRun:
    """What `run` tells of the drives of `setup`.

    Raises InputError for a run of another machine (other kinematics, dimensions or servo period; drives may differ,
    they are what is looked for, and so may what a calibration finds: the run may be of before it), one with a
    controller at the TCP, topics that are missing, numbers that are not finite and a scale that does not move although
    its setpoint does.
    """
    _check_same(run, setup)
    cycles = run.cycles()
    wanted = ["tcp/setpoint", "tcp/state", "contour_error"]
    wanted += [f"{axis}/{topic}" for axis in setup.axes for topic in ("setpoint", "actual")]
    missing = [topic for topic in wanted if topic not in run.servo]
    if missing or not cycles:
        raise InputError(f"bag {run.folder}: it holds no {', '.join(missing) or 'whole cycle'}")
    setpoints, readings = {}, {}
    for axis in setup.axes:
        commanded = _columns(run, f"{axis}/setpoint", cycles, "position", "velocity", "acceleration").T
        setpoints[axis] = np.ascontiguousarray(commanded)
        readings[axis] = _columns(run, f"{axis}/actual", cycles, "position")[:, 0]
        if np.ptp(readings[axis]) <= STANDING < np.ptp(commanded[0]):
            raise InputError(
                f"bag {run.folder}: {axis}/actual is constant, {1e3 * readings[axis][0]:.6g} mm, while its setpoint "
                f"moves by {1e3 * np.ptp(commanded[0]):.4g} mm: was it recorded?"
            )
    contents = sorted(run.slow.get("toolpath/segment", []), key=lambda content: content.index)
    return DriveRun(
        name=str(run.folder),
        setpoints=setpoints,
        readings=readings,
        tcp=_columns(run, "tcp/state", cycles, *(f"position.{axis}" for axis in "xyz")),
        path=_columns(run, "tcp/setpoint", cycles, "path_length")[:, 0],
        segment=run.servo["contour_error"]["segment"][:cycles].astype(np.int64),
        elements=tuple(run_messages.element_of(content) for content in contents),
        starts=tuple(content.path_start for content in contents),
    )


def _columns(run: Run, topic: str, cycles: int, *names: str) -> Array:
    rows: NDArray[Any] = run.servo[topic][:cycles]
    table = np.stack([rows[name] for name in names], axis=1)
    bad = ~np.isfinite(table)
    if bad.any():
        cycle, column = (int(place) for place in np.argwhere(bad)[0])
        raise InputError(f"bag {run.folder}: {topic}: {names[column]} of cycle {cycle} is {table[cycle, column]}")
    return table


def _check_same(run: Run, setup: Setup) -> None:
    recorded = setup_of(run)
    if recorded.machine_name != setup.machine_name:
        raise InputError(
            f"bag {run.folder}: recorded on a {recorded.machine_name}, the machine is a {setup.machine_name}"
        )
    for key, (value, _) in setup.parameters.items():
        there = recorded.parameters[key][0] if key in recorded.parameters else None
        if (key in SAME or is_drawn(key)) and there != value:
            raise InputError(f"bag {run.folder}: recorded on another machine: {key} is {there} there, {value} here")
    if recorded.tcp_control.active:
        raise InputError(
            f"bag {run.folder}: recorded with a controller at the TCP (tcp_control), which moves the drives besides "
            "their setpoints: record a run without it"
        )
