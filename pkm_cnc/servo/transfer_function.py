"""The closed position loop as a transfer function: thesis eq. 7-1..7-3, its responses, and the recursion 7-4..7-9.

All of this is the continuous loop. The sampled loop that the machine runs (position controller once per servo period)
is `ServoDrive` with an axis plant; at 1 ms it differs little. scipy.signal is imported where it is used,
because that takes a second and no node needs it.

Slow poles. The small integral gains put two poles almost onto the zeros -T_p/K_p and -T_pi/K_pi (-8.3e-4 and -2e-4 1/s
for the defaults): in a step they show with 3e-11 of its height, but they last for hours, and moments of the impulse
response weigh them by time squared. The ramp lag of the default drive is 0.04999997 s after a second and 1/Kv in the
end; half the variance of its impulse response is 0.0012089 s^2 over seconds and 1/(2 Kv^2) = 0.00125 s^2 in the end.
What a machine shows is the former.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.servo.drive_parameters import DriveParameters

__all__ = [
    "TransferFunction",
    "filter_setpoints",
    "impulse_response",
    "poles",
    "position_loop",
    "ramp_lag",
    "ramp_response",
    "recursion",
    "step_response",
]

FloatArray = NDArray[np.float64]


_BESIDE_THE_GAIN = (
    "velocity_feed_forward",
    "acceleration_feed_forward",
    "setpoint_delay",
    "equivalent_delay",
    "position_integral_time",
    "position_derivative_time",
    "velocity_limit",
)


class TransferFunction(NamedTuple):
    """G(s) = numerator / denominator, coefficients in descending powers of s; the denominator has the higher degree."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]


def position_loop(drive: DriveParameters) -> TransferFunction:
    """Actual over commanded position of the closed loop: eq. 7-1 with 7-2, 7-3; kv / (s + kv) when first_order.

    G(0) = 1. An integral gain of zero lowers the order: the root at s = 0 that it puts above and below is cancelled.
    Raises InputError for a drive whose position controller is more than a gain: eq. 7-1 has nothing else.
    """
    for name in _BESIDE_THE_GAIN:
        if getattr(drive, name) != 0.0:
            raise InputError(
                f"drive.{name}: {getattr(drive, name)}; eq. 7-1 knows a position controller of gain kv alone"
            )
    if drive.kind == "first_order":
        return TransferFunction((drive.kv,), (1.0, drive.kv))
    kv, k_p, t_p = drive.kv, drive.velocity_gain, drive.velocity_integral
    k_pi, t_pi, k_m = drive.current_gain, drive.current_integral, drive.torque_constant
    velocity_loop = (k_m * k_p * k_pi, k_m * (k_p * t_pi + k_pi * t_p), k_m * t_p * t_pi)
    n1, n2, n3 = (kv * c for c in velocity_loop)
    denominator = [
        drive.inductance * drive.inertia,
        (drive.resistance + k_pi) * drive.inertia,
        t_pi * drive.inertia + velocity_loop[0],
        velocity_loop[1] + n1,
        velocity_loop[2] + n2,
        n3,
    ]
    numerator = [n1, n2, n3]
    while numerator[-1] == denominator[-1] == 0.0:
        del numerator[-1], denominator[-1]
    return TransferFunction(tuple(numerator), tuple(denominator))


def poles(transfer_function: TransferFunction) -> NDArray[np.complex128]:
    """The roots of the denominator, 1/s, shape (n,), from the fastest to the slowest."""
    roots = np.roots(transfer_function.denominator).astype(np.complex128)
    return roots[np.argsort(-np.abs(roots), kind="stable")]


def impulse_response(transfer_function: TransferFunction, times: ArrayLike) -> FloatArray:
    """Response (1/s) to a unit impulse at t = 0, at `times` (s): shape (n,), from 0, equally spaced. Same shape."""
    from scipy import signal

    return np.asarray(signal.impulse(transfer_function, T=np.asarray(times, dtype=float))[1])


def step_response(transfer_function: TransferFunction, times: ArrayLike) -> FloatArray:
    """Response to a unit step at t = 0, at `times` (s): shape (n,), from 0, equally spaced. Same shape."""
    from scipy import signal

    return np.asarray(signal.step(transfer_function, T=np.asarray(times, dtype=float))[1])


def ramp_response(transfer_function: TransferFunction, times: ArrayLike) -> FloatArray:
    """Response (s) to the ramp x = t, at `times` (s): shape (n,), from 0, equally spaced. Same shape."""
    from scipy import signal

    ramp = np.asarray(times, dtype=float)
    return np.asarray(signal.lsim(transfer_function, ramp, ramp)[1])


def ramp_lag(transfer_function: TransferFunction) -> float:
    """Final lag (s) behind a ramp, the mean of the impulse response: 1/Kv for a position loop."""
    numerator, denominator = transfer_function
    first_order_term = numerator[-2] / numerator[-1] if len(numerator) > 1 else 0.0
    return denominator[-2] / denominator[-1] - first_order_term


def recursion(transfer_function: TransferFunction, period: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The coefficients (A_0.., B_0..) of eq. 7-7 and 7-9 for samples `period` seconds apart.

    sum_j A_j xs[i-j] = sum_j B_j xa[i-j], where each power s^m became the m-th backward difference (eq. 7-5). Signs and
    the missing B_5 of the printed 7-9 follow from 7-5.

    The B_j are huge and cancel: for the default drive at 1 ms they are near 4e11 and their sum, which carries the gain
    at rest, is D_6 = 6e-4, a single rounding error; at 0.1 ms nothing of it is left. Solved as eq. 7-8 in double
    precision, a step is held to 4e-9 of its height after 0.5 s, 1e-4 after 60 s and 2e-3 after 300 s at 1 ms, and it
    diverges within 0.5 s at 0.01 ms. `filter_setpoints` is the same recursion without that loss.
    """
    return (
        _backward_coefficients(transfer_function.numerator, period),
        _backward_coefficients(transfer_function.denominator, period),
    )


def _backward_coefficients(polynomial: tuple[float, ...], period: float) -> tuple[float, ...]:
    by_power = [(power, c / period**power) for power, c in enumerate(reversed(polynomial))]
    return tuple(
        sum((-1.0) ** j * math.comb(power, j) * c for power, c in by_power if power >= j)
        for j in range(len(polynomial))
    )


def filter_setpoints(transfer_function: TransferFunction, period: float, setpoints: ArrayLike) -> FloatArray:
    """Actual positions for `setpoints`, shape (n,), any unit, `period` seconds apart, by the recursion 7-4..7-8.

    The loop rests on the first setpoint before the series, as a position loop (G(0) = 1) does. Backward differences
    make it a first-order method: a unit step of the default drive is followed within 4e-3 at 1 ms, 6e-4 at 0.1 ms.

    Eq. 7-8 is solved with the differences S^m xa of eq. 7-5 as memory instead of xa[i-1..i-5]. That is the same
    recursion in exact arithmetic, and keeps the nine or so digits that 7-8 loses (see `recursion`).
    """
    series = np.asarray(setpoints, dtype=float)
    n = transfer_function.numerator[::-1]
    d = transfer_function.denominator[::-1]
    order = len(d) - 1
    highest_weight = sum(d[m] * period ** (order - m) for m in range(order + 1))
    setpoint_differences = [0.0] * len(n)  # S^m xs of the sample before, m = 0..
    actual_differences = [0.0] * order
    actual = np.empty_like(series)
    for i, displacement in enumerate((series - series[:1]).tolist()):
        difference, excitation = displacement, 0.0
        for m, coefficient in enumerate(n):
            excitation += coefficient * difference
            previous, setpoint_differences[m] = setpoint_differences[m], difference
            difference = (difference - previous) / period
        # S^m xa[i] = S^m xa[i-1] + period * S^(m+1) xa[i]: first with the highest difference zero, then with its share
        predicted, remaining = 0.0, excitation
        for m in reversed(range(order)):
            predicted = actual_differences[m] + period * predicted
            remaining -= d[m] * predicted
        difference = remaining / highest_weight
        for m in reversed(range(order)):
            difference = actual_differences[m] + period * difference
            actual_differences[m] = difference
        actual[i] = series[0] + difference
    return actual
