"""Claims of section 2.2: responses, PID control, the cascade, and contour errors of serial machines."""

from __future__ import annotations

import math

import numpy as np

from pkm_cnc.reproduction.claim import Claim, Outcome, claim, judged, not_checkable
from pkm_cnc.reproduction.evidence import Evidence
from pkm_cnc.reproduction.reading import exponent, left_um, per_degree
from pkm_cnc.servo import (
    DriveParameters,
    TransferFunction,
    impulse_response,
    poles,
    position_loop,
    ramp_lag,
    step_response,
)

__all__ = ["CLAIMS"]

SECOND_ORDER = TransferFunction((1.0,), (1.0, 0.8, 1.0))
"""Natural frequency 1 rad/s, damping ratio 0.4."""
IDEAL = "drive.kind=first_order"
HEADINGS = (0.0, 15.0, 45.0, 100.0)
RADIUS_MM, FEED_MM_MIN, KV = 100.0, 3000.0, 20.0


@claim(
    "2.2.2 (fig. 2-3-a)",
    "A first-order system's impulse response decays to zero; t_d is its time constant.",
    "transfer function",
)
def first_order_impulse(evidence: Evidence) -> Outcome:
    t_d = 0.05
    response = impulse_response(TransferFunction((1.0,), (t_d, 1.0)), np.arange(21) * t_d)
    start, at_t_d, late = float(response[0]), float(response[1]), float(response[20])
    return judged(
        abs(at_t_d / start - math.exp(-1.0)) < 1e-9 and abs(late) < 1e-6 * start,
        f"{at_t_d / start:.6f} of its start at t_d, exp(-1) = {math.exp(-1.0):.6f}; {late / start:.1e} at 20 t_d",
    )


@claim(
    "2.2.2 (fig. 2-3-b)", "Second order: the area under the impulse response up to t_p is 1 + M_p.", "transfer function"
)
def area_to_peak(evidence: Evidence) -> Outcome:
    from scipy import integrate

    times = np.linspace(0.0, 20.0, 20001)
    step, impulse = step_response(SECOND_ORDER, times), impulse_response(SECOND_ORDER, times)
    peak = int(np.argmax(step))
    crossing = int(np.argmax((impulse[:-1] > 0.0) & (impulse[1:] <= 0.0)))
    area = float(integrate.trapezoid(impulse[: peak + 1], times[: peak + 1]))
    overshoot = math.exp(-math.pi * 0.4 / math.sqrt(1.0 - 0.16))
    return judged(
        abs(area - 1.0 - overshoot) < 1e-5 and abs(peak - crossing) <= 1,
        f"damping 0.4: area {area:.5f}, 1 + M_p = {1.0 + overshoot:.5f}; the step peaks at {times[peak]:.3f} s, the "
        f"impulse response is zero at {times[crossing]:.3f} s",
    )


@claim("2.2.3 (2-5)", "The serial PID algorithm as printed.", "formula as printed")
def serial_pid(evidence: Evidence) -> Outcome:
    """For the error a t and K_p = T_i = T_d = 1, at t = 1 s."""

    def printed(slope: float) -> float:
        return (slope + slope / 2.0) * (1.0 + slope)

    def operator(slope: float) -> float:
        return slope + slope / 2.0 + slope + slope

    return judged(
        math.isclose(printed(2.0), 2.0 * printed(1.0)),
        f"twice the error gives {printed(2.0) / printed(1.0):.2f} times the output as printed, "
        f"{operator(2.0) / operator(1.0):.2f} times with the operator",
        otherwise="1 + T_d d/dt is an operator on the first bracket, not a factor: as printed it is not linear",
    )


@claim(
    "2.2.3", "With P control alone a higher gain is faster and leaves less error, but never none.", "transfer function"
)
def proportional_control(evidence: Evidence) -> Outcome:
    """Around a first-order plant, 1/(s + 1)."""
    gains = (1.0, 4.0, 16.0)
    loops = [TransferFunction((gain,), (1.0, 1.0 + gain)) for gain in gains]
    left = [1.0 - float(step_response(loop, np.array([0.0, 40.0]))[-1]) for loop in loops]
    band = [abs(poles(loop)[0]) for loop in loops]
    return judged(
        left[0] > left[1] > left[2] > 1e-6 and band[0] < band[1] < band[2],
        f"gain 1, 4, 16 around 1/(s + 1): steady-state error {_listed(left)}, bandwidth {_listed(band)} rad/s",
    )


@claim("2.2.3", "With an integral term the steady-state error is minimal.", "transfer function")
def integral_control(evidence: Evidence) -> Outcome:
    loop = TransferFunction((4.0, 4.0), (1.0, 5.0, 4.0))  # 4 + 4/s around 1/(s + 1)
    left = 1.0 - float(step_response(loop, np.array([0.0, 40.0]))[-1])
    return judged(abs(left) < 1e-9, f"4 + 4/s around 1/(s + 1): {left:.1e} of a step is left")


@claim(
    "2.2.3, 4.2.4",
    "With a high proportional gain the loop overshoots, and in the end is unstable.",
    "transfer function",
)
def high_gain(evidence: Evidence) -> Outcome:
    gains = (20.0, 600.0, 1000.0)
    over = [float(step_response(position_loop(DriveParameters(kv=kv)), SHORT).max()) - 1.0 for kv in gains]
    stable, unstable = 20.0, 1e5
    while unstable - stable > 0.01:
        middle = (stable + unstable) / 2.0
        if poles(position_loop(DriveParameters(kv=middle))).real.max() < 0.0:
            stable = middle
        else:
            unstable = middle
    return judged(
        over[0] < 1e-6 < over[1] < over[2] and unstable < 1e5 - 1.0,
        f"default drive: overshoot {100 * max(over[0], 0.0):.1f}, {100 * over[1]:.1f}, {100 * over[2]:.1f} % of a step "
        f"at Kv 20, 600, 1000 1/s; unstable from Kv {unstable:.0f} 1/s",
    )


SHORT = np.linspace(0.0, 0.5, 5001)


@claim("2.2.4", "The bandwidth of the loops rises from the outer to the inner.", "transfer function")
def bandwidths(evidence: Evidence) -> Outcome:
    drive = DriveParameters()
    current = (drive.current_gain, drive.current_integral)
    motor = (drive.inductance, drive.resistance)
    current_loop = TransferFunction(current, (motor[0], motor[1] + current[0], current[1]))
    position = position_loop(drive)
    velocity = _velocity_loop(drive)
    bands = [_bandwidth(loop) for loop in (position, velocity, current_loop)]
    return judged(
        bands[0] < bands[1] < bands[2],
        f"-3 dB of the default drive: position {bands[0]:.1f} Hz, velocity {bands[1]:.0f} Hz, "
        f"current {bands[2]:.0f} Hz",
    )


def _velocity_loop(drive: DriveParameters) -> TransferFunction:
    """Of 7-1 with Kv tending to 0: numerator and denominator without their terms in Kv."""
    n1, n2, n3 = (value / drive.kv for value in position_loop(drive).numerator)
    d1, d2, d3, d4, d5, _ = position_loop(drive).denominator
    return TransferFunction((n1, n2, n3), (d1, d2, d3, d4 - drive.kv * n1, d5 - drive.kv * n2))


def _bandwidth(loop: TransferFunction) -> float:
    """Where the gain first falls below 1/sqrt 2, Hz."""
    frequency = np.geomspace(0.1, 1e4, 100_001)
    s = 2j * math.pi * frequency
    gain = np.abs(np.polyval(loop.numerator, s) / np.polyval(loop.denominator, s))
    return float(frequency[np.argmax(gain < math.sqrt(0.5))])


@claim("2.2.4", "The integrator of the position loop takes away the steady-state error of a step.", "transfer function")
def step_arrives(evidence: Evidence) -> Outcome:
    left = 1.0 - float(step_response(position_loop(DriveParameters()), np.array([0.0, 2.0]))[-1])
    return judged(abs(left) < 1e-9, f"default drive: {left:.1e} of a step is left after 2 s")


@claim("2.2.4 (2-6, 2-7)", "At constant speed the tracking error is v/Kv.", "Cartesian")
def lag_is_v_over_kv(evidence: Evidence) -> Outcome:
    lag = evidence.star("cartesian", 6000.0, HEADINGS)[0.0]["tracking_error_mm"]["mean"]
    final = ramp_lag(position_loop(DriveParameters()))
    return judged(
        abs(lag - 5.0) < 0.005,
        f"6000 mm/min, Kv 20 1/s: {lag:.5f} mm, v/Kv = 5 mm (lag of a ramp in the end {final:.5f} s)",
    )


@claim(
    "2.2.4 (2-11)",
    "On a parallel machine too the gain at the TCP equals that of the drives: K_V-U = K_V-X.",
    "star test",
)
def gain_at_the_tcp(evidence: Evidence) -> Outcome:
    lines = evidence.star("tripod", 6000.0, (15.0,), pivot=OFF_AXIS)
    line = lines[15.0]
    gain = 100.0 / line["tracking_error_mm"]["mean"]
    across = line["contour_error_3d_um"]["mean"]
    return judged(
        abs(gain / KV - 1.0) < 1e-4 and across < 0.1,
        f"Tripod at {OFF_AXIS} mm, 15 deg, 6000 mm/min, Kv 20 1/s: {gain:.3f} 1/s at the TCP, and a tracking error of "
        f"{across:.1f} um across the path",
        otherwise="2-10 takes the Jacobian as constant over the tracking error; second order in v is left out",
    )


OFF_AXIS = (80.0, -60.0)


@claim("2.2.4", "That equality is an estimate that holds for low speed only.", "star tests")
def gain_at_low_speed(evidence: Evidence) -> Outcome:
    feeds = (1500.0, 6000.0)
    lines = [evidence.star("tripod", feed, (15.0,), pivot=OFF_AXIS)[15.0] for feed in feeds]
    share = [1e-3 * line["contour_error_3d_um"]["mean"] / line["tracking_error_mm"]["mean"] for line in lines]
    power = exponent(feeds, share)
    return judged(
        abs(power - 1.0) < 0.05,
        f"across the path, of the tracking error: {100 * share[0]:.3f} % at 1500, {100 * share[1]:.3f} % at 6000 "
        f"mm/min, goes with v^{power:.3f}",
    )


@claim("2.2.5 (fig. 2-10), 6.4.1.2, 8", "Serial axes with equal gains: no contour error on a line.", "Cartesian")
def no_error_on_a_line(evidence: Evidence) -> Outcome:
    lines = evidence.star("cartesian", 1500.0, HEADINGS).values()
    largest = max(line["contour_error_3d_um"]["max"] for line in lines)
    return judged(
        largest < 1e-6,
        f"{1e-6 * largest:.1e} m at most on the middle half, 1500 mm/min, four headings",
        remark="what the rapid before it left across the line has died out there",
    )


@claim("2.2.5 (2-12)", "Serial axes: a circle is too small by (v/Kv)^2/(2 R).", "Cartesian")
def radial_error(evidence: Evidence) -> Outcome:
    expected = 1e3 * (FEED_MM_MIN / 60.0 / KV) ** 2 / (2.0 * RADIUS_MM)
    periods = (0.001, 0.0005)
    found = [
        evidence.circle("cartesian", FEED_MM_MIN, RADIUS_MM, IDEAL, f"servo_period={period}").report[
            "radial_deviation_um"
        ]["mean"]
        for period in periods
    ]
    limit = 2.0 * found[1] - found[0]
    return judged(
        abs(limit / expected - 1.0) < 0.01,
        f"R 100 mm, 3000 mm/min, Kv 20 1/s: 2-12 {expected:.2f} um; simulated {found[0]:.2f} um at 1 ms, "
        f"{found[1]:.2f} um at 0.5 ms, {limit:.2f} um in the continuous limit",
        remark="a position loop sampled with T is better by the factor 1 - Kv T",
    )


@claim("2.2.5", "The circle is perfect: its radial error is constant.", "Cartesian")
def perfect_circle(evidence: Evidence) -> Outcome:
    circularity = evidence.circle("cartesian", FEED_MM_MIN, RADIUS_MM, IDEAL).report["circularity_um"]
    return judged(circularity < 0.01, f"circularity {circularity:.1e} um")


@claim("2.2.5 (2-12)", "It goes with the square of the feed, and with 1/R.", "Cartesian")
def radial_error_over_feed_and_radius(evidence: Evidence) -> Outcome:
    def deviation(feed: float, radius: float) -> float:
        return float(evidence.circle("cartesian", feed, radius, IDEAL).report["radial_deviation_um"]["mean"])

    feeds, radii = (1500.0, 3000.0), (50.0, 100.0)
    by_feed = exponent(feeds, [deviation(feed, RADIUS_MM) for feed in feeds])
    by_radius = exponent(radii, [deviation(FEED_MM_MIN, radius) for radius in radii])
    return judged(
        abs(by_feed - 2.0) < 0.02 and abs(by_radius + 1.0) < 0.02, f"goes with v^{by_feed:.3f} and R^{by_radius:.3f}"
    )


@claim("2.2.5, 2.2.6 (2-12)", "It goes with 1/Kv^2.", "Cartesian")
def radial_error_over_gain(evidence: Evidence) -> Outcome:
    gains = (10.0, 20.0)
    deviation = [
        evidence.circle("cartesian", FEED_MM_MIN, RADIUS_MM, IDEAL, f"drive.kv={gain}").report["radial_deviation_um"][
            "mean"
        ]
        for gain in gains
    ]
    power = exponent(gains, deviation)
    return judged(abs(power + 2.0) < 0.05, f"goes with Kv^{power:.3f} at a servo period of 1 ms")


UNEQUAL = (IDEAL, "x.drive.kv=20.0", "y.drive.kv=24.0")


@claim("2.2.5 (fig. 2-12), 6.6", "Unequal gains offset a straight line parallel to itself.", "Cartesian")
def parallel_offset(evidence: Evidence) -> Outcome:
    error = evidence.star("cartesian", FEED_MM_MIN, (45.0,), *UNEQUAL)[45.0]["contour_error_um"]
    return judged(
        abs(error["mean"]) > 1.0 and error["std"] < 0.01 * abs(error["mean"]),
        f"Kv 20 and 24 1/s, 45 deg, 3000 mm/min: {error['mean']:+.2f} um, standard deviation {error['std']:.1e} um",
    )


@claim("2.2.5 (fig. 2-12)", "With a higher gain in y a circle becomes an ellipse, and 2-12 does not hold.", "Cartesian")
def ellipse(evidence: Evidence) -> Outcome:
    path = evidence.circle("cartesian", FEED_MM_MIN, RADIUS_MM, *UNEQUAL).path
    spectrum = np.abs(np.fft.rfft(per_degree(path))) / 180.0
    mean, second = float(spectrum[0] / 2.0), float(spectrum[2])
    others = float(max(spectrum[1], *spectrum[3:13]))
    by_2_12 = 1e3 * (FEED_MM_MIN / 60.0 / KV) ** 2 / (2.0 * RADIUS_MM)
    return judged(
        second > 10.0 * others and second > by_2_12,
        f"radial deviation {mean:.1f} um in the mean, its second harmonic {second:.1f} um, all others "
        f"below {others:.2f} um; 2-12 with Kv 20 1/s {by_2_12:.1f} um",
    )


@claim("2.2.6 (fig. 2-14)", "Feed-forward reduces the tracking error, and so the contour error.", "star test")
def feed_forward(evidence: Evidence) -> Outcome:
    plain = evidence.star("tripod", 6000.0, (105.0, 15.0))[15.0]
    ahead = evidence.star("tripod", 6000.0, (105.0, 15.0), *FEED_FORWARD)[15.0]
    lags = [line["tracking_error_mm"]["mean"] for line in (plain, ahead)]
    errors = [left_um(line) for line in (plain, ahead)]
    return judged(
        lags[1] < 0.5 * lags[0] and abs(errors[1]) < 0.5 * abs(errors[0]),
        f"Tripod, 15 deg, 6000 mm/min, K_nV 1 with balancing filter: tracking error {lags[0]:.3f} to {lags[1]:.3f} mm, "
        f"contour error {errors[0]:+.3f} to {errors[1]:+.4f} um",
        remark="of linear drives that are known exactly",
    )


FEED_FORWARD = ("drive.velocity_feed_forward=1.0", "drive.equivalent_delay=0.00082", "drive.setpoint_delay=0.0005")


@claim("2.2.6", "Feed-forward cannot considerably improve the performance of machine axes ([PRI92]).", "-")
def feed_forward_not_considerable(evidence: Evidence) -> Outcome:
    return not_checkable("a judgement of practice, without a figure")


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


CLAIMS = tuple(value for value in list(vars().values()) if isinstance(value, Claim))
"""In the order of the thesis."""
