"""A synthetic positioning bench: a machine that is not what its controller believes, with reversal error and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.identification.measurements import Positions
from pkm_cnc.kinematics import Machine

__all__ = ["Bench", "PositioningTest"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PositioningTest:
    """`targets` (m,) m, `joints` (m, 2, n) m, `measured` (m, 2, n) m: the position TCP x at the j-th target.

    The second axis is the direction: approached from below, from above; the third the run.
    """

    targets: Array
    joints: Array
    measured: Array

    @property
    def deviations(self) -> Array:
        """Actual less target position, (m, 2, n), m."""
        return np.asarray(self.measured - self.targets[:, None, None])

    @property
    def positions(self) -> Positions:
        """All of it as measurements for a calibration, (2 m n) rows."""
        return Positions(self.joints.reshape(-1, 1), self.measured.reshape(-1, 1))


@dataclass(frozen=True)
class Bench:
    """A machine of one axis and one coordinate as it truly is, with `reversal` between the directions, m, and normal
    noise of standard deviation `noise`, m, of each approach.
    """

    truth: Machine
    reversal: float
    noise: float

    def test(self, controller: Machine, targets: Array, runs: int, generator: np.random.Generator) -> PositioningTest:
        """Let `controller` approach `targets` (m,), m, `runs` times from each side. Raises UnreachableError."""
        joints = np.broadcast_to(controller.inverse(targets[:, None])[:, :, None], (len(targets), 2, runs))
        ideal = self.truth.forward(joints[..., None])[..., 0]
        side = 0.5 * self.reversal * np.array((-1.0, 1.0))[:, None]  # what lags stays below when it comes from below
        return PositioningTest(targets, joints, ideal + side + generator.normal(0.0, self.noise, joints.shape))
