"""The axis loop over whole arrays of setpoints, where it is linear: many lines at once, no step per cycle.

Position controller and velocity loop of one axis are one discrete linear system

    x[k+1] = A x[k] + B w[k],   y[k] = C x[k]

with the tracking error among the states and the increment of the setpoint as input: nothing in it grows with the
distance travelled, and rounding stays that of the tracking error. It is the same system that `simulation` steps (the
velocity loop discretised exactly), and is equal to it within 1e-12 m over a minute; not to the bit, because it adds in
another order.

It advances a block of cycles at a time: the outputs of a block are (its inputs) * H + (the state before it) * O with
the impulse response in H. That needs no eigenvalues, which nearly coincide for some drives, and the product works on
all lines together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.plant.velocity_loop import exact_discretisation
from pkm_cnc.servo import CASCADE_STATES, DriveParameters, cascade_state_space

__all__ = ["AxisResponse", "linear", "respond"]

Array = NDArray[np.float64]

BLOCK = 64
"""Cycles advanced together: the work per cycle grows with it, the python steps per cycle fall."""


class AxisResponse(NamedTuple):
    """One axis in every cycle, each of the setpoints' shape (..., n)."""

    position: Array
    """Slider, m."""
    velocity: Array
    """Slider, m/s."""
    tracking_error: Array
    """Setpoint less slider, m."""


def linear(setup: Setup) -> None:
    """Do nothing if `respond` can take the place of the step loop. Raises InputError naming the parameter if not."""
    for axis, parts in setup.axes.items():
        if parts.scale.resolution != 0.0:
            raise InputError(
                f"{axis}.scale.resolution: {parts.scale.resolution} m makes the axis loop nonlinear, and the array "
                "path takes linear loops alone: set it to 0, or run the step loop"
            )


def respond(setup: Setup, axis: str, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> AxisResponse:
    """The response of `axis` to its setpoint in cycles 0 to n-1: position m, velocity m/s, acceleration m/s^2.

    The setpoints have shape (..., n), one series along the last dimension, any number of series before it, each on its
    own: the axis rests on the first position of the series before the series begins. All three are of one shape. An
    end of travel is not looked at.

    Raises InputError for an axis that the machine does not have, shapes that differ, a setpoint that is not finite
    and a setup that `linear` refuses; MachineFault when a tracking error is over drive.following_error_limit.
    """
    linear(setup)
    if axis not in setup.axes:
        raise InputError(f"axis {axis!r} is unknown; {setup.machine_name} has {', '.join(setup.axes)}")
    setpoint = [np.asarray(part, dtype=float) for part in (position, velocity, acceleration)]
    _check(axis, setpoint)
    drive = setup.axes[axis].drive
    commanded = setpoint[0]
    system = _axis_loop(drive, setup.axes[axis].screw.pitch, setup.servo_period)
    increment = np.diff(commanded, axis=-1, append=commanded[..., -1:])
    error, speed = _run(system, increment[..., np.newaxis, :])
    _supervise(axis, drive, error)
    return AxisResponse(commanded - error, speed, error)


def _check(axis: str, setpoint: list[Array]) -> None:
    shapes = [part.shape for part in setpoint]
    if len(set(shapes)) != 1 or len(shapes[0]) < 1:
        raise InputError(f"{axis}: setpoints of shapes {shapes} given; position, velocity and acceleration have one")
    for name, part in zip(("position", "velocity", "acceleration"), setpoint, strict=True):
        if not np.isfinite(part).all():
            raise InputError(f"{axis}: {name} setpoint {part[~np.isfinite(part)][0]} is not a finite number")


def _supervise(axis: str, drive: DriveParameters, error: Array) -> None:
    largest = float(np.max(np.abs(error), initial=0.0))
    if not largest <= drive.following_error_limit:
        raise MachineFault(
            f"{axis}: following error {largest * 1e3:.6g} mm is over its limit of "
            f"{drive.following_error_limit * 1e3:.6g} mm (drive.following_error_limit)"
        )


class _System(NamedTuple):
    """x[k+1] = A x[k] + B w[k], y[k] = C x[k], at rest at first: shapes (n, n), (n, m), (p, n)."""

    A: Array
    B: Array
    C: Array


def _axis_loop(drive: DriveParameters, pitch: float, period: float) -> _System:
    """Input: increment of the setpoint to the next cycle, m. Outputs: tracking error, m, and slider velocity, m/s.

    Each signal is a row: its coefficients over the states and the input, so the lines below are the equations.
    """
    loop = _velocity_loop(drive, pitch, period)
    order = len(loop.B)
    *_, tracking_error, increment = np.eye(order + 2)
    inner = np.eye(order, order + 2)
    command = drive.kv * tracking_error
    displacement = loop.displacement @ inner + loop.gain * command
    following = np.vstack([loop.A @ inner + np.outer(loop.B, command), tracking_error + increment - displacement])
    states = order + 1
    outputs = np.vstack([tracking_error[:states], loop.velocity @ inner[:, :states]])
    return _System(following[:, :states], following[:, states:], outputs)


class _VelocityLoop(NamedTuple):
    """x[k+1] = A x[k] + B c[k]; the slider moves by displacement . x[k] + gain * c[k]; its velocity is velocity . x."""

    A: Array
    B: Array
    displacement: Array
    gain: float
    velocity: Array


def _velocity_loop(drive: DriveParameters, pitch: float, period: float) -> _VelocityLoop:
    if drive.kind == "first_order":  # the one state is the command that was held last
        return _VelocityLoop(np.zeros((1, 1)), np.ones(1), np.zeros(1), period, np.ones(1))
    a, b = exact_discretisation(cascade_state_space(drive, pitch), period)
    screw = pitch / (2.0 * math.pi)
    velocity = np.array([screw if name == "motor_speed" else 0.0 for name in CASCADE_STATES[:4]])
    return _VelocityLoop(a[:4, :4], b[:4], a[4, :4], float(b[4]), velocity)


def _run(system: _System, inputs: Array) -> Array:
    """Outputs for `inputs`, shape (..., m, n), as shape (p, ..., n)."""
    *series, width, cycles = inputs.shape
    states, outputs = len(system.A), len(system.C)
    powers = [np.eye(states)]
    for _ in range(BLOCK):
        powers.append(system.A @ powers[-1])
    from_state = np.hstack([(system.C @ power).T for power in powers[:BLOCK]])  # (n, BLOCK p)
    impulse = np.stack(
        [np.zeros((width, outputs)), *[(system.C @ power @ system.B).T for power in powers[: BLOCK - 1]]]
    )
    now, later = np.ogrid[:BLOCK, :BLOCK]
    from_inputs = np.moveaxis(impulse[np.maximum(later - now, 0)], 2, 0)  # (m, BLOCK now, BLOCK later, p)
    to_state = np.stack([(power @ system.B).T for power in reversed(powers[:BLOCK])], axis=1)  # (m, BLOCK, n)

    blocks = -(-cycles // BLOCK)
    padded = np.zeros((math.prod(series), width, blocks * BLOCK))
    padded[..., :cycles] = inputs.reshape(len(padded), width, cycles)
    result = np.empty((len(padded), blocks * BLOCK, outputs))
    state: Array = np.zeros((len(padded), states))
    for first in range(0, blocks * BLOCK, BLOCK):
        block = padded[..., first : first + BLOCK].reshape(len(padded), -1)
        here = block @ from_inputs.reshape(width * BLOCK, -1) + state @ from_state
        result[:, first : first + BLOCK] = here.reshape(len(padded), BLOCK, outputs)
        state = state @ powers[BLOCK].T + block @ to_state.reshape(width * BLOCK, states)
    return np.moveaxis(result[:, :cycles], -1, 0).reshape(outputs, *series, cycles)
