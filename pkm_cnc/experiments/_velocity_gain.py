"""The relative velocity gain of the Monopod along its way: recorded, by closed form, and estimated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.contour import estimated_tracking_error
from pkm_cnc.errors import InputError
from pkm_cnc.experiments.trial import Trial
from pkm_cnc.kinematics.monopod import Monopod
from pkm_cnc.tolerances import FEED_REACHED

__all__ = ["SETTLED", "Pass", "closed_form", "passes", "passes_program", "require_root"]

Array = NDArray[np.float64]

SETTLED = 8.0
"""In 1/Kv, after the feed is reached: the drives' transient has fallen to 0.03 %."""


def closed_form(setpoint: ArrayLike, tracking_error: ArrayLike, length: float, gamma: float) -> Array:
    """K_V-rel (n,), 1, of sliders at setpoints U_s (n,), m, that lag by Delta-U (n,), m: 4-17-b, 4-17-a for gamma 0.

    `length` of the strut, m; `gamma`, rad. Slider above the x axis, TCP right of the dead point, as printed. It is
    (Delta-u / Delta-x) / (du/dx) with the gear ratio where the slider is, not where it should be.

    The difference of square roots in the printed denominator is written by their sum, and Delta-U cancelled: exact for
    small Delta-U, and 1 for none.
    """
    u_s, delta = np.asarray(setpoint, dtype=float), np.asarray(tracking_error, dtype=float)
    sine, square = math.sin(gamma), math.cos(gamma) ** 2
    u_a = u_s - delta
    root_s, root_a = (np.sqrt(length * length - u * u * square) for u in (u_s, u_a))
    slope = sine + (u_s + u_a) * square / (root_s + root_a)
    return np.asarray((u_a * square + root_a * sine) / (root_a * slope))


@dataclass(frozen=True)
class Pass:
    """One way along x at a constant feed, m/s, in `direction` +1 or -1; arrays (n,), SI, one row a settled cycle."""

    direction: int
    feed: float
    x: Array
    """Actual TCP."""
    lag: Array
    """Tracking error of the TCP, setpoint - actual."""
    tcp_velocity: Array
    """Actual, by differences of the TCP's positions."""
    drive_velocity: Array
    """Actual, by differences of the slider's positions."""
    demanded_drive_velocity: Array
    """Setpoint of the same instant."""
    demanded_drive_velocity_here: Array
    """Of a TCP that passes x with the feed."""
    simulated: Array
    """K_V-rel by its definition 4-16: (dx/dt / Delta-x) / (du/dt / Delta-u), all of it recorded."""
    closed: Array
    """K_V-rel by 4-17 from setpoint and recorded tracking error of the slider."""
    estimated_x: Array
    """TCP where 4-15 expects it."""
    estimated: Array
    """K_V-rel by 4-17 from setpoint and the tracking error that 4-15 expects."""
    estimated_lag: Array
    """Tracking error of the TCP that 4-15 expects of the slider."""

    @property
    def kv_tcp(self) -> Array:
        """K_V of the TCP, 1/s: its actual velocity by its tracking error."""
        return np.asarray(self.tcp_velocity / self.lag)

    def at(self, values: Array, x: Array) -> Array:
        """`values` where the actual TCP is at x, m; NaN outside the way."""
        order = np.argsort(self.x)
        return np.asarray(np.interp(x, self.x[order], values[order], left=np.nan, right=np.nan))


def passes_program(begin_mm: float, end_mm: float, feeds_mm_min: Sequence[float]) -> str:
    """A part program (mm): forth and back between two positions, once at each feed."""
    ways = [f"G1 X{x:.6f} F{feed:.6f}" for feed in feeds_mm_min for x in (end_mm, begin_mm)]
    return "\n".join(["G21 G90", f"G0 X{begin_mm:.6f}", *ways, "M2", ""])


def require_root(machine: Monopod) -> None:
    """Raises InputError for the roots for which 4-17 is not printed."""
    geometry = machine.geometry
    if (geometry.slider_side, geometry.tcp_side) != ("above", "right"):
        raise InputError(
            f"geometry.slider_side {geometry.slider_side}, geometry.tcp_side {geometry.tcp_side}: 4-17 holds for the "
            "slider above and the TCP right"
        )


def passes(trial: Trial, machine: Monopod) -> list[Pass]:
    """The passes of a run, in order; of each the cycles from SETTLED/Kv after the feed is reached till it is left.

    Raises InputError if a pass has none.
    """
    x_s, velocity = trial.tcp_setpoint[:, 0, 0], trial.tcp_setpoint[:, 1, 0]
    times, (axis,) = trial.times, trial.setup.axes.values()
    settling = math.ceil(SETTLED / axis.drive.kv / trial.setup.servo_period)
    rates = np.gradient(trial.evaluation.true[:, 0], times), np.gradient(trial.axis_position[:, 0], times)
    found: list[Pass] = []
    after = 0
    for element in trial.evaluation.elements:
        if element.traverse:
            continue
        direction = 1 if element.end[0] > element.start[0] else -1
        low, high = sorted((element.start[0], element.end[0]))
        at_feed = np.abs(direction * velocity - element.feed) <= FEED_REACHED * element.feed
        on_way = np.flatnonzero(at_feed & (low <= x_s) & (x_s <= high))
        on_way = on_way[on_way >= after]
        at_once = np.split(on_way, np.flatnonzero(np.diff(on_way) > 1) + 1)  # other passes only brush this feed
        cycles = next((run[settling:] for run in at_once if len(run) > settling), None)
        if cycles is None:
            raise InputError(
                f"a feed of {60e3 * element.feed:g} mm/min is too fast between {1e3 * low:g} and {1e3 * high:g} mm: "
                f"the slider needs {1e3 * settling * trial.setup.servo_period:g} ms to settle; take a longer way"
            )
        after = int(cycles[-1]) + 1
        found.append(_pass(trial, machine, cycles, direction, element.feed, rates))
    return found


def _pass(
    trial: Trial, machine: Monopod, cycles: NDArray[np.intp], direction: int, feed: float, rates: tuple[Array, Array]
) -> Pass:
    setpoint, demanded = trial.axis_setpoint[cycles, 0, 0], trial.axis_setpoint[cycles, 0, 1]
    x, tcp_velocity, drive_velocity = trial.evaluation.true[cycles, 0], rates[0][cycles], rates[1][cycles]
    lag, delta = trial.tcp_setpoint[cycles, 0, 0] - x, trial.tracking_error[cycles, 0]
    (axis,) = trial.setup.axes.values()
    estimate = estimated_tracking_error(demanded, axis.drive.kv)
    estimated_x = machine.forward((setpoint - estimate)[:, None])[:, 0]
    offset, length, gamma = machine.geometry.slider_offset, machine.strut_length, machine.geometry.inclination
    return Pass(
        direction=direction,
        feed=feed,
        x=x,
        lag=lag,
        tcp_velocity=tcp_velocity,
        drive_velocity=drive_velocity,
        demanded_drive_velocity=demanded,
        demanded_drive_velocity_here=direction * feed * machine.jacobian(x[:, None])[:, 0, 0],
        simulated=np.asarray((tcp_velocity / lag) / (drive_velocity / delta)),
        closed=closed_form(setpoint + offset, delta, length, gamma),
        estimated_x=estimated_x,
        estimated=closed_form(setpoint + offset, estimate, length, gamma),
        estimated_lag=np.asarray(trial.tcp_setpoint[cycles, 0, 0] - estimated_x),
    )
