"""The axis loop over whole arrays of setpoints, where it is linear: many lines at once, no step per cycle.

Position controller and velocity loop of one axis are one discrete linear system

    x[k+1] = A x[k] + B w[k],   y[k] = C x[k]

with the position error among the states and the increment of the setpoint as input: nothing in it grows with the
distance travelled, and rounding stays that of the tracking error. It is the same system that `simulation` steps (the
velocity loop discretised exactly), and is equal to it within 1e-12 m over a minute; not to the bit, because it adds in
another order. Commands that wait for a dead time to pass are states, too.

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
from pkm_cnc.plant import DEAD_TIME
from pkm_cnc.plant.velocity_loop import exact_discretisation
from pkm_cnc.servo import CASCADE_STATES, DriveParameters, cascade_state_space, filter_step

__all__ = ["AxisResponse", "axis_loop", "linear", "respond"]

Array = NDArray[np.float64]

BLOCK = 32
"""Cycles advanced together: the work per cycle grows with it, the python steps per cycle fall."""
GROUP = 64
"""Series advanced together. With BLOCK it keeps the products below the size from which BLAS starts threads, which wait
for each other wherever other processes are at work, and makes the path ten times slower there."""


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
    if setup.tcp_control.active:
        raise InputError(
            "tcp_control: a controller at the TCP couples the axes, and the array path takes each on its own: switch "
            "it off, or run the step loop"
        )
    for axis, parts in setup.axes.items():
        if (by := setup.imperfect(axis)) not in ("", DEAD_TIME):
            raise InputError(
                f"{axis}: {by} makes the axis imperfect, and the array path takes ideal ones alone, but for their dead "
                "time: run the step loop"
            )
        if parts.scale.noise != 0.0:
            raise InputError(
                f"{axis}.scale.noise: {parts.scale.noise} m, and the array path takes exact scales alone: set it to 0, "
                "or run the step loop"
            )
        if parts.scale.resolution != 0.0:
            raise InputError(
                f"{axis}.scale.resolution: {parts.scale.resolution} m makes the axis loop nonlinear, and the array "
                "path takes linear loops alone: set it to 0, or run the step loop"
            )
        if parts.drive.velocity_limit != 0.0:
            raise InputError(
                f"{axis}.drive.velocity_limit: {parts.drive.velocity_limit} m/s makes the axis loop nonlinear where it "
                "is reached, and the array path takes linear loops alone: set it to 0, or run the step loop"
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
    drive, period = setup.axes[axis].drive, setup.servo_period
    commanded, speed, change_of_speed = setpoint
    delayed = _delayed(drive, period, commanded, speed)
    increment = np.diff(delayed, axis=-1, append=delayed[..., -1:])
    feed_forward = drive.velocity_feed_forward * speed + drive.acceleration_feed_forward * change_of_speed
    system = axis_loop(drive, setup.axes[axis].screw.pitch, period)
    behind, slider_velocity = _run(system, np.stack([increment, feed_forward], axis=-1))
    tracking_error = (commanded - delayed) + behind
    _supervise(axis, drive, tracking_error)
    return AxisResponse(delayed - behind, slider_velocity, tracking_error)


def _delayed(drive: DriveParameters, period: float, position: Array, velocity: Array) -> Array:
    """The setpoints after the delay of the balancing filter, before its lag; (..., n) like them."""
    balancing = filter_step(drive, period)
    if balancing is None or drive.setpoint_delay == 0.0:
        return position
    cycles = position.shape[-1]
    at_rest = np.repeat(position[..., :1], balancing.whole + 2, axis=-1)  # the first setpoint among them
    position = np.concatenate([at_rest, position[..., 1:]], axis=-1)
    velocity = np.concatenate([0.0 * at_rest, velocity[..., 1:]], axis=-1)
    earlier, later = slice(0, cycles), slice(1, cycles + 1)
    delayed: Array = balancing.between(
        position[..., earlier], velocity[..., earlier], position[..., later], velocity[..., later]
    )
    return delayed


def _check(axis: str, setpoint: list[Array]) -> None:
    shapes = [part.shape for part in setpoint]
    if len(set(shapes)) != 1 or len(shapes[0]) < 1:
        raise InputError(f"{axis}: setpoints of shapes {shapes} given; position, velocity and acceleration have one")
    for name, part in zip(("position", "velocity", "acceleration"), setpoint, strict=True):
        if not np.isfinite(part).all():
            raise InputError(f"{axis}: {name} setpoint {part[~np.isfinite(part)][0]} is not a finite number")


def _supervise(axis: str, drive: DriveParameters, error: Array) -> None:
    over = ~(np.abs(error) <= drive.following_error_limit)
    if over.any():
        place = np.unravel_index(int(np.argmax(over)), error.shape)
        *series, cycle = map(int, place)
        raise MachineFault(
            f"cycle {cycle}{f' of series {series}' if series else ''}: {axis}: following error "
            f"{error[place] * 1e3:.6g} mm is over its limit of {drive.following_error_limit * 1e3:.6g} mm "
            "(drive.following_error_limit)"
        )


class _System(NamedTuple):
    """x[k+1] = A x[k] + B w[k], y[k] = C x[k], at rest at first: shapes (n, n), (n, m), (p, n)."""

    A: Array
    B: Array
    C: Array


def axis_loop(drive: DriveParameters, pitch: float, period: float) -> _System:
    """Inputs: increment of the delayed setpoint to the next cycle, m, and feed-forward to the velocity command, m/s.

    Outputs: delayed setpoint less slider, m, and slider velocity, m/s. Each signal is a row: its coefficients over
    states and inputs, so the lines below are the equations.
    """
    loop = _velocity_loop(drive, pitch, period)
    pid = drive.position_controller.gains.sampled(period)
    balancing = filter_step(drive, period)
    decay, gain = (balancing.decay, balancing.gain) if balancing is not None else (0.0, 0.0)
    states = len(loop.B) + 5
    signals = np.eye(states + 2)
    inner = signals[: len(loop.B)]
    error, lag, integral, derivative_before, error_before, increment, feed_forward = signals[len(loop.B) :]

    derivative = pid.decay * derivative_before + pid.derivative * (error - error_before)
    command = pid.proportional * error + integral + derivative + feed_forward
    displacement = loop.displacement @ inner + loop.gain * command
    lag_after = decay * lag + gain * increment
    error_after = error + (increment - (lag_after - lag)) - displacement
    inner_after = loop.A @ inner + np.outer(loop.B, command)
    after = np.vstack([inner_after, error_after, lag_after, integral + pid.integral * error, derivative, error])
    outputs = np.vstack([error + lag, loop.velocity @ inner])
    return _System(after[:, :states], after[:, states:], outputs[:, :states])


class _VelocityLoop(NamedTuple):
    """x[k+1] = A x[k] + B c[k]; the slider moves by displacement . x[k] + gain * c[k]; its velocity is velocity . x."""

    A: Array
    B: Array
    displacement: Array
    gain: float
    velocity: Array


def _velocity_loop(drive: DriveParameters, pitch: float, period: float) -> _VelocityLoop:
    if drive.dead_time != 0.0:
        return _late_velocity_loop(drive, pitch, period)
    a, b = _over(drive, pitch, period)
    return _VelocityLoop(a[:-1, :-1], b[:-1], a[-1, :-1], float(b[-1]), _velocity(drive, pitch))


def _late_velocity_loop(drive: DriveParameters, pitch: float, period: float) -> _VelocityLoop:
    """States: those of the loop without dead time, then the commands that have not acted to their end, newest first.

    The dead time is `whole` periods and a rest `late`: until `late` in a period the command acts that is whole + 1
    periods old, then the next. Both parts are exact for a `late` below 0, too, where the first runs backwards: so the
    response has a derivative by the dead time at 0, of which an identification makes use.
    """
    whole = max(0, math.floor(drive.dead_time / period * (1.0 + 1e-12)))
    late = drive.dead_time - whole * period
    (a1, b1), (a2, b2) = _over(drive, pitch, late), _over(drive, pitch, period - late)
    own = len(b1) - 1
    states = own + whole + 1
    signals = np.eye(states + 2)
    slider, command = signals[states:]
    commands = np.vstack([command, signals[own:states]])  # by age
    inner = np.vstack([signals[:own], slider])
    inner_after = a2 @ (a1 @ inner + np.outer(b1, commands[whole + 1])) + np.outer(b2, commands[whole])
    after, displacement = np.vstack([inner_after[:-1], commands[:-1]]), inner_after[-1]
    velocity = np.concatenate([_velocity(drive, pitch), np.zeros(whole + 1)])
    return _VelocityLoop(after[:, :states], after[:, -1], displacement[:states], float(displacement[-1]), velocity)


def _over(drive: DriveParameters, pitch: float, time: float) -> tuple[Array, Array]:
    """(A, B) of x after `time` (s) = A x + B c for a held command c, the slider's position last."""
    if drive.kind == "first_order":  # the other state is the command that was held last
        return np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([1.0, time])
    return exact_discretisation(cascade_state_space(drive, pitch), time)


def _velocity(drive: DriveParameters, pitch: float) -> Array:
    """Slider velocity over the states without the position."""
    if drive.kind == "first_order":
        return np.ones(1)
    screw = pitch / (2.0 * math.pi)
    return np.array([screw if name == "motor_speed" else 0.0 for name in CASCADE_STATES[:4]])


class _BlockStep(NamedTuple):
    """A block of BLOCK cycles at once: outputs = w @ from_inputs + x @ from_state, next x = w @ to_state + x @ over.

    w are its inputs, shape (BLOCK m,), in the order of the cycles, as its outputs, shape (BLOCK p,).
    """

    from_inputs: Array
    from_state: Array
    to_state: Array
    over: Array


def _block_step(system: _System) -> _BlockStep:
    states, width = system.B.shape
    powers = [np.eye(states)]
    for _ in range(BLOCK):
        powers.append(system.A @ powers[-1])
    # response of the outputs so many cycles after an input; none in the same cycle
    impulse = np.stack([0.0 * (system.C @ system.B), *(system.C @ power @ system.B for power in powers[: BLOCK - 1])])
    now, later = np.ogrid[:BLOCK, :BLOCK]
    by_cycles = impulse[np.maximum(later - now, 0)]  # (BLOCK now, BLOCK later, p, m)
    return _BlockStep(
        np.ascontiguousarray(by_cycles.transpose(0, 3, 1, 2)).reshape(BLOCK * width, -1),
        np.hstack([(system.C @ power).T for power in powers[:BLOCK]]),
        np.vstack([(power @ system.B).T for power in reversed(powers[:BLOCK])]),
        np.ascontiguousarray(powers[BLOCK].T),
    )


def _run(system: _System, inputs: Array) -> Array:
    """Outputs for `inputs`, shape (..., n, m), as shape (p, ..., n)."""
    *series, cycles, width = inputs.shape
    step = _block_step(system)
    blocks = -(-cycles // BLOCK)
    padded = np.zeros((math.prod(series), blocks * BLOCK, width))
    padded[:, :cycles] = inputs.reshape(len(padded), cycles, width)
    by_block = padded.reshape(len(padded), blocks, BLOCK * width)
    result = np.empty((len(padded), blocks, BLOCK * len(system.C)))
    for group in (slice(first, first + GROUP) for first in range(0, len(padded), GROUP)):
        state: Array = np.zeros((len(padded[group]), len(system.A)))
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable drive: its following error says so
            for block in range(blocks):
                held = by_block[group, block]
                result[group, block] = held @ step.from_inputs + state @ step.from_state
                state = held @ step.to_state + state @ step.over
    outputs = result.reshape(len(padded), blocks * BLOCK, len(system.C))[:, :cycles]
    return np.moveaxis(outputs, -1, 0).reshape(len(system.C), *series, cycles)
