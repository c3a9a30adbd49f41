"""One run of a part program on a machine, everything of it as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.bag import Run
from pkm_cnc.check import prepare
from pkm_cnc.config import Setup
from pkm_cnc.contour import SegmentSummary
from pkm_cnc.evaluation import Evaluation, evaluate
from pkm_cnc.program import Program
from pkm_cnc.records import ContourError
from pkm_cnc.simulation import simulated_cycles

__all__ = ["Runner", "Trial", "simulated", "trial_of_bag"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """A run of n cycles on a machine of m axes, SI units; row k is cycle k."""

    setup: Setup
    evaluation: Evaluation
    """Contour errors, and their figures by segment; the true TCP is `evaluation.true` (n, 3)."""
    tcp_setpoint: Array
    """Commanded position, velocity, acceleration of the TCP, (n, 3, 3)."""
    axis_setpoint: Array
    """Commanded position, velocity, acceleration of the axes, (n, m, 3)."""
    axis_position: Array
    """Sliders as they truly are, (n, m), m."""
    axis_velocity: Array
    """Their velocity, (n, m), m/s."""
    tracking_error: Array
    """Setpoint less scale value of each axis, (n, m), m: the thesis' delta-U."""
    believed: Array
    """TCP by the controller's kinematics and the scales, (n, 3), m."""

    @property
    def times(self) -> Array:
        """t_k, (n,), s."""
        return np.asarray(np.arange(len(self.tcp_setpoint)) * self.setup.servo_period, dtype=np.float64)

    def cycles_of(self, segment: int) -> NDArray[np.intp]:
        """The cycles whose contour error is against this segment, in order."""
        return np.flatnonzero([error.segment == segment for error in self.evaluation.errors])


Runner = Callable[[Setup, Program], Trial]
"""Runs a program: by the simulation, or through the graph."""


def simulated(setup: Setup, program: Program) -> Trial:
    """Run a program by the simulation. Raises InputError for what the machine cannot do, MachineFault."""
    checked = prepare(setup, program)
    tcp_setpoint, tcp, axes = array("d"), array("d"), array("d")  # thin: a cycle's records take fifty times as much
    errors: list[ContourError] = []
    summaries: dict[int, SegmentSummary] = {}
    for cycle in simulated_cycles(setup, checked):
        tcp_setpoint.extend(cycle.setpoint[:9])
        tcp.extend(cycle.tcp[:6])
        for setpoint, state, command in zip(cycle.axis_setpoints, cycle.states, cycle.commands, strict=True):
            axes.extend((*setpoint, state.slider_position, state.slider_velocity, command.tracking_error))
        errors.append(cycle.error)
        summaries.update((summary.segment, summary) for summary in cycle.summaries)
    by_axis = np.array(axes).reshape(-1, len(setup.axes), 6)
    believed, true = np.array(tcp).reshape(-1, 2, 3).swapaxes(0, 1)
    toolpath = checked.toolpath().contour
    evaluation = Evaluation(
        machine=setup.machine_name,
        servo_period=setup.servo_period,
        program_name=program.name,
        end=None,
        elements=list(toolpath.elements),
        starts=list(toolpath.starts),
        summaries=summaries,
        errors=errors,
        true=true,
    )
    return Trial(
        setup=setup,
        evaluation=evaluation,
        tcp_setpoint=np.array(tcp_setpoint).reshape(-1, 3, 3),
        axis_setpoint=by_axis[..., :3],
        axis_position=by_axis[..., 3],
        axis_velocity=by_axis[..., 4],
        tracking_error=by_axis[..., 5],
        believed=believed,
    )


def trial_of_bag(setup: Setup, run: Run) -> Trial:
    """The same from a bag that was recorded on `setup`. Raises InputError as `evaluate`."""
    evaluation = evaluate(run)
    cycles = len(evaluation.errors)

    def columns(topic: str, *names: str) -> Array:
        rows = run.servo[topic][:cycles]
        return np.stack([rows[name] for name in names], axis=-1).astype(np.float64)

    def by_axis(suffix: str, *names: str) -> Array:
        return np.stack([columns(f"{axis}/{suffix}", *names) for axis in setup.axes], axis=1)

    setpoint = [f"{part}.{axis}" for part in ("position", "velocity", "acceleration") for axis in "xyz"]
    actual = by_axis("actual", "slider_position", "slider_velocity")
    return Trial(
        setup=setup,
        evaluation=evaluation,
        tcp_setpoint=columns("tcp/setpoint", *setpoint).reshape(-1, 3, 3),
        axis_setpoint=by_axis("setpoint", "position", "velocity", "acceleration"),
        axis_position=actual[..., 0],
        axis_velocity=actual[..., 1],
        tracking_error=by_axis("command", "tracking_error")[..., 0],
        believed=columns("tcp/state", "believed.x", "believed.y", "believed.z"),
    )
