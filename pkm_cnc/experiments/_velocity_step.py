"""The TCP of the Monopod set off with a constant feed at once, by a part program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.experiments.experiment import Lab
from pkm_cnc.servo import response_figures

__all__ = ["VelocityStep", "velocity_step"]

Array = NDArray[np.float64]

_ACCELERATION = 1000.0  # m/s^2: the feed is there after a tenth of a servo period
_SECONDS = 0.25


@dataclass(frozen=True)
class VelocityStep:
    """Demanded and actual speed of the TCP, m/s, at `times`, s, from a period before it sets off; (n,)."""

    station_mm: float
    kv: float
    feed: float
    times: Array
    demanded: Array
    actual: Array

    def to_json(self) -> dict[str, Any]:
        """Figures of the response, its overshoot over the speed at the end. Raises InputError if it has not settled."""
        figures = response_figures(self.times, self.actual, self.feed)
        return {
            "station_mm": self.station_mm,
            "kv_per_s": self.kv,
            "feed_mm_min": 60e3 * self.feed,
            "overshoot_percent": 100.0 * figures.overshoot,
            "rise_time_ms": 1e3 * figures.rise_time,
            "settling_time_ms": 1e3 * figures.settling_time,
            "speed_at_end_mm_s": 1e3 * float(self.actual[-1]),
        }


def velocity_step(lab: Lab, station_mm: float, feed_mm_min: float, kv: float) -> VelocityStep:
    """Set off in +x from rest at a station, with a drive of gain `kv`, 1/s. Raises InputError, MachineFault."""
    x = 1e-3 * station_mm
    setup = lab.setup([f"drive.kv={kv!r}", f"motion.acceleration={_ACCELERATION!r}", f"start_pose=[{x!r}, 0.0, 0.0]"])
    end = station_mm + feed_mm_min / 60.0 * _SECONDS
    trial = lab.run(setup, f"G21 G90\nG1 X{end:.6f} F{feed_mm_min:.6f}\nM2\n", "velocity step")
    count = round(_SECONDS / setup.servo_period)
    speed = np.gradient(trial.evaluation.true[:, 0], trial.times)
    return VelocityStep(
        station_mm, kv, feed_mm_min / 60e3, trial.times[:count], trial.tcp_setpoint[:count, 1, 0], speed[:count]
    )
