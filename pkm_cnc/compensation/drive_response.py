"""How drives follow: the response of each closed position loop to an impulse of its setpoint."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.array_path import respond
from pkm_cnc.compensation.nominal import nominal
from pkm_cnc.compensation.observation import SETTLED
from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.errors import InputError

__all__ = ["drive_responses"]

Array = NDArray[np.float64]

STEP = 1e-6
"""m. The step whose response is differenced."""
STILL = 3
"""Cycles of rest before the step: its velocity is a difference over three, its acceleration over five."""


def drive_responses(model: Setup) -> Array:
    """(axes, n): position of each drive of `model` n cycles after a unit impulse of its setpoint; each sums to 1.

    The drives are taken as linear: without limits, without what else is imperfect about the machine, without a
    controller at the TCP. Feed-forwards and dead times are in it. Raises InputError for drives that are unstable.
    """
    linear = _linear(model)
    longest = math.ceil(SETTLED / min(parts.drive.kv for parts in linear.axes.values()) / linear.servo_period)
    step = np.full(STILL + longest, STEP)
    step[:STILL] = 0.0
    speed = np.gradient(step) / linear.servo_period
    rate = np.gradient(speed) / linear.servo_period
    table = []
    for axis in linear.axes:
        answer = respond(linear, axis, step, speed, rate).position / STEP
        if not abs(answer[-1] - 1.0) < 1e-3:
            raise InputError(f"the model is unstable: {axis} does not come to rest after a step")
        table.append(np.diff(answer)[STILL - 1 :])
    return np.array([response / response.sum() for response in table])


def _linear(model: Setup) -> Setup:
    believed = nominal(model)
    kept = {key: value for key, (value, _) in believed.parameters.items() if not key.startswith("tcp_control.")}
    late = {f"{axis}.drive.dead_time": parts.drive.dead_time for axis, parts in model.axes.items()}
    setup = setup_from_parameters({**kept, **late})
    axes = {
        axis: dataclasses.replace(
            parts, drive=dataclasses.replace(parts.drive, velocity_limit=0.0, following_error_limit=math.inf)
        )
        for axis, parts in setup.axes.items()
    }
    return dataclasses.replace(setup, axes=axes)
