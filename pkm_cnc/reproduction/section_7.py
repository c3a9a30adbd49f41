"""Claims of chapter 7: the drive's transfer function, its recursion, compensation and identification."""

from __future__ import annotations

import math

import numpy as np

from pkm_cnc.identification import IDENTIFIED
from pkm_cnc.reproduction.claim import Claim, Outcome, claim, judged, not_checkable
from pkm_cnc.reproduction.evidence import Evidence
from pkm_cnc.reproduction.reading import left_um
from pkm_cnc.servo import (
    DriveParameters,
    TransferFunction,
    impulse_response,
    position_loop,
    ramp_lag,
    recursion,
    response_figures,
    step_response,
)

__all__ = ["CLAIMS"]

PRINTED = TransferFunction(
    (3.483e3, 3.599, 5.805e-4),
    (6.264e-5, 0.143, 1.741e2, 3.483e3, 3.599, 5.805e-4),
)
"""N1..N3, D1..D6 of the drive as section 7.6 lists them."""
SECONDS = np.linspace(0.0, 2.0, 2001)
HEADINGS = (15.0, 75.0, 130.0)


def _half(loop: TransferFunction) -> float:
    """Time to half of a step, s."""
    return response_figures(SECONDS, step_response(loop, SECONDS), target=1.0).delay_time


@claim("7.4, 7.6 (7-1..7-3)", "The drive's parameters give the nine coefficients that 7.6 lists.", "transfer function")
def coefficients(evidence: Evidence) -> Outcome:
    ours = position_loop(DriveParameters())
    pairs = zip(ours.numerator + ours.denominator, PRINTED.numerator + PRINTED.denominator, strict=True)
    off = max(abs(a - b) / b for a, b in pairs)
    return judged(
        off < 2e-3,
        f"largest difference {100 * off:.2f} %, within the printed digits",
        remark="with J_e = 0.0087 kg m^2, T_p and T_pi as integral gains and K1 K2 = 2 pi; N3 and D6 are 5.8057e-4, "
        "printed cut off as 5.805e-4",
    )


@claim("7.4 (7-3)", "J_e = 0.087 kg m^2.", "transfer function")
def printed_inertia(evidence: Evidence) -> Outcome:
    as_printed = position_loop(DriveParameters(inertia=0.087))
    d1, half = as_printed.denominator[0], _half(as_printed)
    return judged(
        abs(d1 / PRINTED.denominator[0] - 1.0) < 0.01,
        f"D1 = {d1:.3e}, section 7.6 has {PRINTED.denominator[0]:.3e}; half of a step after {half:.4f} s",
        otherwise="misprint: 0.0087 gives D1, D2, D3 of section 7.6",
    )


@claim("7.4, list of symbols (7-3)", "T_p = 0.002 and T_pi = 0.003 are integral action times, s.", "transfer function")
def integral_times(evidence: Evidence) -> Outcome:
    drive = DriveParameters()
    as_times = position_loop(
        DriveParameters(velocity_integral=drive.velocity_gain / 0.002, current_integral=drive.current_gain / 0.003)
    )
    n3, d6 = as_times.numerator[2], PRINTED.denominator[5]
    return judged(
        abs(n3 / d6 - 1.0) < 0.01,
        f"as times of K (1 + 1/(T s)) N3 = {n3:.3g}, section 7.6 has {d6:.3e}",
        otherwise="7-2 and 7-3 hold for integral gains, K + T/s",
    )


@claim(
    "7.4 (7-3)", "K1 = 2 pi/10 rad/mm and K2 = 10 mm/rev carry the motor to the slider and back.", "transfer function"
)
def stray_two_pi(evidence: Evidence) -> Outcome:
    product = 2.0 * math.pi / 10.0 * 10.0
    drive = DriveParameters()
    without = position_loop(DriveParameters(velocity_gain=2.4, velocity_integral=0.002))
    used = position_loop(drive).numerator[0] / without.numerator[0]
    return judged(
        abs(product - 1.0) < 1e-9,
        f"K1 K2 = {product:.4f}, there and back is 1; the coefficients of section 7.6 hold a factor {used:.4f}",
        otherwise="K2 is per revolution, not per radian; the factor 2 pi acts as a higher velocity gain",
    )


@claim("7.4 (7-5..7-9)", "The recursion with the printed A and B gives the response of the drive.", "recursion")
def recursion_as_printed(evidence: Evidence) -> Outcome:
    from scipy import signal

    a, b = recursion(position_loop(DriveParameters()), 0.001)
    step = np.ones(500)
    exact = step_response(position_loop(DriveParameters()), np.arange(501) * 0.001)[1:]
    with np.errstate(all="ignore"):
        printed = np.abs(signal.lfilter(a, b[:-1], step) - exact)
    complete = float(np.abs(signal.lfilter(a, b, step) - exact).max())
    off = float(printed.max())
    return judged(
        bool(off < 0.01),
        f"a step of 1, 0.5 s at 1 ms: off by {off:.2g} at most as printed, {complete:.1e} with B5",
        otherwise="7-9 leaves out B5 = -D1/dt^5, without which the recursion diverges",
    )


@claim("7.4 (7-4)", "Backward differences S x = (x[i] - x[i-1])/dt stand for the transfer function.", "recursion")
def backward_differences(evidence: Evidence) -> Outcome:
    from scipy import signal

    loop = position_loop(DriveParameters())
    off = []
    for period in (0.002, 0.001):
        times = np.arange(1, round(0.5 / period) + 1) * period
        answer = signal.lfilter(*recursion(loop, period), np.ones(len(times)))
        off.append(float(np.abs(answer - step_response(loop, np.append(0.0, times))[1:]).max()))
    return judged(
        off[1] < 0.01 and off[1] < 0.7 * off[0],
        f"off a step of 1 by {off[0]:.4f} at 2 ms, {off[1]:.4f} at 1 ms: first order in dt",
        remark="with B5",
    )


@claim("7.4 (fig. 7-6)", "The response has no overshoot.", "transfer function")
def no_overshoot(evidence: Evidence) -> Outcome:
    over = float(step_response(position_loop(DriveParameters()), SECONDS).max()) - 1.0
    least = float(impulse_response(position_loop(DriveParameters()), SECONDS).min())
    return judged(over < 1e-6, f"step: {over:+.1e} of its height at most; impulse: never below {least:+.1e} 1/s")


@claim("7.4 (fig. 7-6)", "The delay time is 0.035 s, by the definition of 2.2.2: half of a step.", "transfer function")
def delay_to_half(evidence: Evidence) -> Outcome:
    half = _half(position_loop(DriveParameters()))
    return judged(abs(half - 0.035) < 0.0005, f"half of a step after {half:.4f} s")


@claim("7.4 (fig. 7-6)", "The drive is 0.035 s late, with a ramp too.", "transfer function")
def delay_of_a_ramp(evidence: Evidence) -> Outcome:
    lag = ramp_lag(position_loop(DriveParameters()))
    return judged(
        abs(lag - 0.035) < 0.0005,
        f"lag behind a ramp {lag:.4f} s, 1/Kv = {1.0 / DriveParameters().kv:.4f} s",
        otherwise="0.035 s is the time to half of a step; a moving tool is late by 1/Kv",
    )


@claim(
    "7.2 (fig. 7-1)", "A path shifted by the error, the other way, brings the actual path onto the line.", "star test"
)
def shifted_path(evidence: Evidence) -> Outcome:
    approached = (105.0, 15.0)  # the rapid to the second line comes from elsewhere than along it
    error = left_um(evidence.star("tripod", 6000.0, approached)[15.0])
    shift = -1e-3 * error
    heading = math.radians(15.0)
    pivot = (-shift * math.sin(heading), shift * math.cos(heading))
    left = left_um(evidence.star("tripod", 6000.0, approached, pivot=pivot)[15.0]) + 1e3 * shift
    return judged(
        abs(left) < 0.01 * abs(error),
        f"15 deg, 6000 mm/min, straight line shifted by {1e3 * shift:+.2f} um: mean error {error:+.3f} um before, "
        f"{left:+.4f} um after",
        remark="in the plane and in the mean over the middle half; z is left as it is",
    )


@claim("7.5 (fig. 7-7)", "Compensation by measured errors brings measured errors to almost zero.", "-")
def compensation_by_measurement(evidence: Evidence) -> Outcome:
    return not_checkable("needs the measured machine; `experiment compensation` shows it on another")


@claim("7.5 (fig. 7-8)", "By simulated errors the simulated error vanishes, the measured one only shrinks.", "-")
def compensation_by_simulation(evidence: Evidence) -> Outcome:
    return not_checkable("needs the measured machine; `experiment compensation` shows it on another")


@claim("7.6", "The coefficients found after the first iteration describe the machine.", "transfer function")
def identified_set(evidence: Evidence) -> Outcome:
    rest = IDENTIFIED.numerator[2] / IDENTIFIED.denominator[5]
    held = float(step_response(IDENTIFIED, SECONDS)[-1])
    return judged(
        abs(rest - 1.0) < 1e-3 and abs(held - 1.0) < 1e-3,
        f"a step of 100 mm is held at {100 * held:.2f} mm after 2 s; N3/D6 = {rest:.4f}, N1/D4 = "
        f"{IDENTIFIED.numerator[0] / IDENTIFIED.denominator[3]:.4f}",
        otherwise="impossible for a position loop closed on a scale: it must arrive, G(0) = 1",
    )


@claim("7.6", "Contour errors determine the nine coefficients of the transfer function.", "star tests")
def nine_coefficients(evidence: Evidence) -> Outcome:
    """A first-order drive with the same half variance of its impulse response, and no other coefficient alike."""
    response = impulse_response(position_loop(DriveParameters()), SECONDS)
    weight = response / response.sum()
    mean = float((weight * SECONDS).sum())
    kappa = float((weight * (SECONDS - mean) ** 2).sum()) / 2.0
    kv = 1.0 / math.sqrt(2.0 * kappa)
    apart = []
    for feed in (6000.0, 9000.0):
        fifth = evidence.star("tripod", feed, HEADINGS)
        first = evidence.star("tripod", feed, HEADINGS, "drive.kind=first_order", f"drive.kv={kv:.6f}")
        apart.append(max(abs(left_um(fifth[heading]) - left_um(first[heading])) for heading in HEADINGS))
    largest = max(abs(left_um(line)) for line in evidence.star("tripod", 9000.0, HEADINGS).values())
    return judged(
        apart[1] > 0.1,
        f"the drive of order 5 and one of order 1 with Kv {kv:.3f} 1/s: star errors {apart[0]:.3f} um apart at 6000 "
        f"mm/min, {apart[1]:.3f} um at 9000, of {largest:.1f} um",
        otherwise="contour errors tell half the variance of the impulse response and hardly more: drives of another "
        "order differ by less than the 0.1 um the instrument reads (6.4.1.1)",
    )


@claim("7.6 (figs. 7-10..7-12)", "The first iteration improves the measured contour errors.", "-")
def identification_measured(evidence: Evidence) -> Outcome:
    return not_checkable("needs the measured machine")


CLAIMS = tuple(value for value in list(vars().values()) if isinstance(value, Claim))
"""In the order of the thesis."""
