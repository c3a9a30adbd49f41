"""The Monopod at constant speed there and back, for the claims of section 4.4."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pkm_cnc.reproduction.evidence import Evidence
from pkm_cnc.reproduction.reading import Array

__all__ = ["KV", "LENGTH", "POSITIONS", "Travel", "gain_ratio", "strut_angle", "travel"]

LENGTH = 0.600
"""Of the strut, m: ours, the thesis gives none."""
KV = 50.0
"""1/s: the 3 [1000/min] of section 4.2.3."""
POSITIONS = np.linspace(0.370, 0.460, 10)
"""TCP positions at which claims look, m; beta 38 to 50 deg of the thesis' 35 to 60."""
SETTLED = 0.12
"""s at constant speed until the start is forgotten: 6/Kv."""


@dataclass(frozen=True)
class Travel:
    """Signals at POSITIONS of the TCP's setpoint, (10,) each, m and m/s."""

    tcp_lag: Array
    """Setpoint less actual x."""
    drive_lag: Array
    """Setpoint less actual u."""
    demanded: Array
    """Setpoint velocity of the drive."""
    actual: Array
    """Its actual velocity in the same cycle."""
    actual_there: Array
    """Its actual velocity when the actual TCP is at these positions."""


def travel(evidence: Evidence, feed: float, direction: int, *overrides: str) -> Travel:
    """At `feed` mm/min in +x (1) or -x (-1), once the drive has settled."""
    program = f"G21 G90\nG0 X280\nG1 X560 F{feed:g}\nG1 X280\nM2\n"
    trial = evidence.trial("monopod", program, f"drive.kv={KV}", "motion.acceleration=20.0", *overrides)
    speed = trial.tcp_setpoint[:, 1, 0]
    constant = np.flatnonzero(np.abs(speed - direction * feed / 60e3) < 1e-9)
    stretches = np.split(constant, np.flatnonzero(np.diff(constant) > 1) + 1)
    rows = max(stretches, key=len)[round(SETTLED / trial.setup.servo_period) :]
    setpoint, actual = direction * trial.tcp_setpoint[rows, 0, 0], direction * trial.evaluation.true[rows, 0]

    def at(values: Array, positions: Array) -> Array:
        return np.asarray(np.interp(direction * POSITIONS, positions, values))

    return Travel(
        tcp_lag=at(direction * (setpoint - actual), setpoint),
        drive_lag=at(trial.tracking_error[rows, 0], setpoint),
        demanded=at(trial.axis_setpoint[rows, 0, 1], setpoint),
        actual=at(trial.axis_velocity[rows, 0], setpoint),
        actual_there=at(trial.axis_velocity[rows, 0], actual),
    )


def gain_ratio(lag: Array, positions: Array = POSITIONS) -> Array:
    """K_V-rel by 4-17-a of the drive's tracking error (m) at positions of the TCP's setpoint (m)."""
    u_s = np.sqrt(LENGTH**2 - positions**2)
    u_a = u_s - lag
    x_a = np.sqrt(LENGTH**2 - u_a**2)
    return np.asarray(lag * u_a / (x_a * (x_a - np.sqrt(LENGTH**2 - u_s**2))))


def strut_angle(position: float) -> float:
    """beta, between strut and drive axis, deg, at a position of the TCP, m."""
    return math.degrees(math.asin(position / LENGTH))
