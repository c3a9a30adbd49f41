"""What an identification of drives looks for: few physical parameters per drive, counted in steps of comparable size.

The thesis frees all nine coefficients of the transfer function 7-1. They are no free numbers: a position loop that
is closed on a scale has G(0) = 1, and motor and controllers leave fewer parameters than coefficients. These are they,
as the machine file has them: every value of them makes a loop with G(0) = 1.

- `kv`, velocity gain of the position loop.
- `velocity_gain` of the velocity controller: the bandwidth of the velocity loop. On a rigid axis without friction the
  motion depends on velocity_gain * torque_constant * current_gain / (inertia (resistance + current_gain)) alone, which
  is that bandwidth in rad/s, so one of them is estimated and the others are kept. Not for `first_order`, where the
  velocity loop is ideal.
- `dead_time`, by how much later than it is given a velocity command acts: transmission and computation in the drive.
- `velocity_feed_forward`, `acceleration_feed_forward`, which are settings of the controller.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.config import Setup
from pkm_cnc.parameters import parameters_of
from pkm_cnc.servo import DriveParameters, equivalent_delay

__all__ = ["SIZES", "DriveUnknown", "drive_setup", "drive_unknowns", "drive_values", "velocity_bandwidth"]

Array = NDArray[np.float64]

POSITIVE = ("kv", "velocity_gain")
"""Their steps are of the time constant, 1/value, in shares of it: the motion is nearly linear in those."""
SIZES = {
    "kv": 1.0,
    "velocity_gain": 1.0,
    "dead_time": 0.001,
    "velocity_feed_forward": 1.0,
    "acceleration_feed_forward": 0.001,
}
"""What one step is: a time constant doubled, the whole feed-forward, 1 ms (about a velocity loop's equivalent delay).
In the order in which they are wanted: a feed-forward is a setting of the controller, and mostly known."""


@dataclass(frozen=True)
class DriveUnknown:
    """One parameter of one drive: `axis`, `name` of the parameter."""

    axis: str
    name: str

    @property
    def key(self) -> str:
        """As the machine file has it."""
        return f"{self.axis}.drive.{self.name}"

    @property
    def unit(self) -> str:
        """SI."""
        return next(spec.unit for spec in parameters_of(DriveParameters) if spec.name == self.name)

    def stepped(self, value: float, step: float) -> float:
        """The value `step` (above -1) steps from `value`."""
        return value / (1.0 + step) if self.name in POSITIVE else value + step * SIZES[self.name]

    def size(self, value: float) -> float:
        """Magnitude of the value's derivative by the step, at step 0: what one step is there, in `unit`."""
        return value if self.name in POSITIVE else SIZES[self.name]


def drive_unknowns(setup: Setup, axes: Sequence[str] | None = None) -> tuple[DriveUnknown, ...]:
    """What is looked for in the drives of `axes`, of all without them, drive by drive."""
    return tuple(
        DriveUnknown(axis, name)
        for axis in (setup.axes if axes is None else axes)
        for name in SIZES
        if name != "velocity_gain" or setup.axes[axis].drive.kind == "cascade"
    )


def drive_values(setup: Setup, unknowns: Sequence[DriveUnknown]) -> Array:
    """The unknowns' values in `setup`, (p,), in their units."""
    return np.array([getattr(setup.axes[one.axis].drive, one.name) for one in unknowns], dtype=float)


def drive_setup(setup: Setup, unknowns: Sequence[DriveUnknown], values: Array) -> Setup:
    """`setup` with `values` (p,) of the unknowns as a model: ideal scales, no limit of the following error.

    For `array_path.respond`, which looks at the axes alone: `parameters` stay those of `setup`.
    """
    axes = {
        axis: dataclasses.replace(
            parts,
            scale=dataclasses.replace(parts.scale, resolution=0.0, noise=0.0),
            drive=dataclasses.replace(
                parts.drive,
                following_error_limit=math.inf,
                **{one.name: value for one, value in zip(unknowns, values.tolist(), strict=True) if one.axis == axis},
            ),
        )
        for axis, parts in setup.axes.items()
    }
    return dataclasses.replace(setup, axes=axes)


def velocity_bandwidth(drive: DriveParameters) -> float:
    """Bandwidth of the velocity loop, rad/s, as of the first-order lag that stands for it; infinite for first_order."""
    delay = equivalent_delay(drive)
    return 1.0 / delay if delay > 0.0 else math.inf
