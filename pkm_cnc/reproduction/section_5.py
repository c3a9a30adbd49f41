"""Claims of chapter 5: the Bipod, contour errors from joint signals, star and circular test."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pkm_cnc.contour import (
    circle_program,
    circle_radial_deviation,
    left_and_up,
    line_contour_error,
    star_program,
    tcp_tracking_error,
    tcp_velocity,
)
from pkm_cnc.experiments import Trial
from pkm_cnc.kinematics import Machine
from pkm_cnc.reproduction.claim import Claim, Outcome, claim, judged
from pkm_cnc.reproduction.evidence import Evidence
from pkm_cnc.reproduction.reading import (
    Array,
    around,
    circle_motion,
    left_um,
    nearest,
    strut_angles,
    turning_points,
    zero_heading,
)

__all__ = ["CLAIMS"]

HALF, LENGTH = 0.200, 0.600
"""b and L of section 5.3.2, m."""
SAMPLE = np.array([[0.0, 0.0], [0.07, 0.03], [-0.05, -0.08], [0.1, 0.1]])
"""TCP points, m."""
RADIUS, FEED, KV = 0.100, 3000.0, 20.0


def _bipod(evidence: Evidence) -> Machine:
    return evidence.setup("bipod").kinematics


# 5.2 kinematics


@claim("5.2.1 (5-3, 5-4)", "The sliders by 5-3 and 5-4.", "kinematics")
def inverse(evidence: Evidence) -> Outcome:
    off = float(np.abs(_bipod(evidence).inverse(SAMPLE) - _by_5_3(SAMPLE)).max())
    return judged(off < 1e-12, f"{off:.1e} m from the machine's")


def _by_5_3(points: Array) -> Array:
    x, y = points.T
    return np.column_stack([y - np.sqrt(LENGTH**2 - (HALF - x) ** 2), y - np.sqrt(LENGTH**2 - (HALF + x) ** 2)])


@claim("5.2.1 (5-1)", "The vectors close as P + L + u + B = 0.", "formula as printed")
def closure(evidence: Evidence) -> Outcome:
    """With u of 5-3, as the length that the strut then has."""
    u = _by_5_3(SAMPLE)[:, 0]
    x, y = SAMPLE.T
    printed = float(np.abs(np.hypot(x + HALF, y + u) - LENGTH).max())
    correct = float(np.abs(np.hypot(x - HALF, y - u) - LENGTH).max())
    return judged(
        printed < 1e-12,
        f"strut 1 off its length by {1e3 * printed:.1f} mm as printed, {correct:.1e} m with B + u + L - P = 0",
        otherwise="signs: it contradicts 5-3 and 5-4",
    )


def _forward(u: Array, sign: float) -> Array:
    """5-5..5-7 with n = sign (u2^2 - u1^2), the upper root."""
    u1, u2 = u.T
    m, n = 2.0 * (u2 - u1), sign * (u2 * u2 - u1 * u1)
    q = 1.0 + m * m / (16.0 * HALF**2)
    r = -2.0 * u1 + 2.0 * m * n / (16.0 * HALF**2) - m / 2.0
    s = u1 * u1 - LENGTH**2 + HALF**2 + n * n / (16.0 * HALF**2) - n / 2.0
    y = -r / (2.0 * q) + np.sqrt(r * r / (4.0 * q * q) - s / q)
    return np.column_stack([(m * y + n) / (4.0 * HALF), y])


@claim("5.2.1 (5-5..5-7)", "The TCP from the sliders, with n = u2^2 - u1^2.", "formula as printed")
def forward(evidence: Evidence) -> Outcome:
    u = _bipod(evidence).inverse(SAMPLE)
    with np.errstate(invalid="ignore"):
        printed = float(np.nan_to_num(np.abs(_forward(u, 1.0) - SAMPLE), nan=math.inf).max())
    correct = float(np.abs(_forward(u, -1.0) - SAMPLE).max())
    off = f"off by {1e3 * printed:.1f} mm" if math.isfinite(printed) else "without a real root"
    return judged(
        printed < 1e-9,
        f"round trip {off} as printed, off by {correct:.1e} m with n = u1^2 - u2^2",
        otherwise="sign of n",
    )


@claim("5.2.1, 5.2.2 (5-8, 5-11)", "The J of 5-8 carries drive velocities to the TCP: X' = J U'.", "formula as printed")
def one_jacobian(evidence: Evidence) -> Outcome:
    machine, velocity = _bipod(evidence), np.array([0.04, 0.03])
    x = SAMPLE[:, 0]
    one = np.ones_like(x)
    rows = ((x - HALF) / np.sqrt(LENGTH**2 - (HALF - x) ** 2), (x + HALF) / np.sqrt(LENGTH**2 - (HALF + x) ** 2))
    j = np.stack([np.column_stack([row, one]) for row in rows], axis=1)
    drives = (machine.jacobian(SAMPLE) * velocity).sum(axis=2)
    printed = float(np.abs((j * drives[:, None, :]).sum(axis=2) - velocity).max())
    correct = float(np.abs((np.linalg.inv(j) * drives[:, None, :]).sum(axis=2) - velocity).max())
    return judged(
        printed < 1e-12,
        f"50 mm/s: off by {1e3 * printed:.1f} mm/s with the J of 5-8, {correct:.1e} m/s with its inverse",
        otherwise="5-8 is dU/dP, 5-11 wants dP/dU: the same letter for a matrix and its inverse, as in 2-8",
    )


@claim("5.2.2", "The ratio of drive and Cartesian velocity is not constant.", "kinematics")
def ratio_varies(evidence: Evidence) -> Outcome:
    first = _bipod(evidence).jacobian(np.array([[-0.1, 0.0], [0.0, 0.0], [0.1, 0.0]]))[:, 0, 0]
    return judged(
        float(np.ptp(first)) > 0.01, f"du1/dx {', '.join(f'{value:.3f}' for value in first)} at x -100, 0, 100 mm"
    )


# 5.3.1 star test


@claim("5.3.1 (fig. 5-6)", "No contour error at 90 deg.", "star test")
def zero_at_90(evidence: Evidence) -> Outcome:
    up, down = (zero_heading(evidence, "bipod", 6000.0, at, (0.0, 0.0), 15.0) for at in (90.0, 270.0))
    lines = evidence.star("bipod", 6000.0, (0.0, 90.0, 270.0))
    largest = max(abs(left_um(lines[heading])) for heading in (90.0, 270.0))
    return judged(
        largest < 0.01 and abs(up - 90.0) < 0.5 and abs(down - 270.0) < 0.5,
        f"zero at {up:.2f} and {down:.2f} deg; {largest:.1e} um there, {left_um(lines[0.0]):+.2f} um at 0 deg",
        remark="a flat zero: the error goes about with the cube of the heading's cosine",
    )


@claim("5.3.1, 8", "It vanishes where both struts have the same and a constant inclination.", "kinematics, star test")
def equal_struts(evidence: Evidence) -> Outcome:
    along = np.column_stack([np.zeros(21), np.linspace(-0.1, 0.1, 21)])
    rows = _bipod(evidence).jacobian(along)
    beta = np.degrees(np.arccos(1.0 / np.sqrt((rows * rows).sum(axis=2))))
    largest = abs(left_um(evidence.star("bipod", 6000.0, (0.0, 90.0, 270.0))[90.0]))
    unequal = abs(left_um(evidence.star("bipod", 6000.0, (0.0, 90.0), pivot=(100.0, 0.0))[90.0]))
    return judged(
        float(np.ptp(beta)) < 1e-9 and largest < 0.01,
        f"on the line at 90 deg both are {beta[0, 0]:.3f} deg, constant within {np.ptp(beta):.0e} deg, error "
        f"{largest:.1e} um; 100 mm beside, with unequal inclinations, {unequal:.1e} um",
        remark="constant is what matters: along y it vanishes with unequal inclinations too",
    )


@claim("5.3.1, 8", "The Bipod's contour error depends on the place in the workspace.", "star test")
def depends_on_place(evidence: Evidence) -> Outcome:
    middle = left_um(evidence.star("bipod", 6000.0, (0.0, 90.0, 270.0))[0.0])
    beside = left_um(evidence.star("bipod", 6000.0, (0.0, 90.0), pivot=(100.0, 0.0))[0.0])
    return judged(
        abs(beside - middle) > 0.1, f"0 deg: {middle:+.2f} um about (0, 0), {beside:+.2f} um about (100, 0) mm"
    )


def _line(evidence: Evidence) -> Trial:
    return evidence.trial("bipod", star_program(6000.0, (30.0,), (20.0, 10.0), 200.0))


@claim("5.3.1 (5-15..5-21)", "Joint signals alone give the contour error of a line, as corrected.", "joint signals")
def line_from_joints(evidence: Evidence) -> Outcome:
    trial = _line(evidence)
    segment = len(trial.evaluation.elements) - 1
    rows = trial.cycles_of(segment)
    length = trial.evaluation.elements[segment].length
    begin = trial.evaluation.starts[segment]
    rows = rows[[0.25 < (trial.evaluation.errors[row].path_length - begin) / length < 0.75 for row in rows]]
    u, velocity = trial.axis_setpoint[rows, :, 0], trial.axis_setpoint[rows, :, 1]
    error = line_contour_error(trial.setup.machine, u, velocity, trial.tracking_error[rows])
    left, _ = left_and_up(error, tcp_velocity(trial.setup.machine, u, velocity))
    exact = np.array([trial.evaluation.errors[row].left for row in rows])
    apart = float(np.abs(left - exact).max())
    return judged(
        apart < 1e-12,
        f"{apart:.1e} m from the shortest distance at most, {len(rows)} cycles of an error of "
        f"{1e6 * exact.mean():+.2f} um",
        remark="opposite in sign to 5-19; 5-21 as printed divides by J U_s and lacks the last vector",
    )


@claim("5.3.1 (5-21)", "5-21 as printed is that contour error.", "formula as printed")
def line_as_printed(evidence: Evidence) -> Outcome:
    """The along-path part that 5-21 takes away: X . (J U_s) / (J U_s . J U_s), a number, from both components."""
    trial = _line(evidence)
    row = trial.cycles_of(len(trial.evaluation.elements) - 1)[1000]
    machine, u = trial.setup.machine, trial.axis_setpoint[row, :, 0]
    lag = tcp_tracking_error(machine, u, trial.tracking_error[row])[:2]
    printed = tcp_velocity(machine, u, u)[:2]
    vector = lag - float((lag * printed).sum() / (printed * printed).sum())
    exact = abs(trial.evaluation.errors[row].left)
    length = float(np.hypot(*vector))
    return judged(
        abs(length - exact) < 1e-9,
        f"{length:.4g} (in no consistent unit) for {exact:.4g} m",
        otherwise="misprints: J U' stands below, and the quotient multiplies the vector J U'",
    )


# 5.3.2 circular test


class _Arc(NamedTuple):
    """The data arc: joint setpoints, their rates, tracking errors by cycle; its radial deviation; all SI."""

    machine: Machine
    u: Array
    rate: Array
    lag: Array
    deviation: Array
    center: tuple[float, ...]
    radius: float


def _arc(evidence: Evidence, direction: str) -> _Arc:
    program = circle_program(
        feed_mm_min=FEED,
        radius_mm=1e3 * RADIUS,
        center_mm=(0.0, 0.0),
        direction=direction,
        overshoot_deg=45.0,
        acceleration_mm_s2=2000.0,
    )
    trial = evidence.trial("bipod", program)
    [(segment, path)] = trial.evaluation.circles().items()
    ahead = round(2.0 / KV / trial.setup.servo_period)  # the setpoint leaves the arc 1/Kv before the tool
    rows = trial.cycles_of(segment)[:-ahead]
    setpoint = trial.axis_setpoint[rows]
    return _Arc(
        machine=trial.setup.machine,
        u=setpoint[..., 0],
        rate=setpoint[..., 1],
        lag=trial.tracking_error[rows],
        deviation=path.deviation[:-ahead],
        center=tuple(path.arc.center),
        radius=path.arc.radius,
    )


@claim("5.3.2 (5-25, 5-26)", "Joint signals alone give the radial deviation of a circle.", "joint signals")
def circle_from_joints(evidence: Evidence) -> Outcome:
    apart = []
    for direction in ("ccw", "cw"):
        arc = _arc(evidence, direction)
        by_joints = circle_radial_deviation(arc.machine, arc.u, arc.lag, arc.center, arc.radius)
        apart.append(float(np.abs(by_joints - arc.deviation).max()))
    return judged(max(apart) < 1e-12, f"{max(apart):.1e} m from the actual radius at most, both directions")


def _from_direction(arc: _Arc, velocity: Array, sine_sign: float = -1.0) -> Array:
    """dR by 5-25 with cos(alpha) = v_y/v, sin(alpha) = sine_sign v_x/v."""
    vx, vy = velocity[:, 0], velocity[:, 1]
    speed = np.hypot(vx, vy)
    lag = tcp_tracking_error(arc.machine, arc.u, arc.lag)
    x = arc.radius * vy / speed - lag[:, 0]
    y = arc.radius * sine_sign * vx / speed - lag[:, 1]
    return np.asarray(arc.radius - np.hypot(x, y))


@claim("5.3.2 (5-24)", "sin(alpha) = -v_x/v and cos(alpha) = v_y/v on a circle.", "formula as printed")
def angle_from_velocity(evidence: Evidence) -> Outcome:
    off = {}
    for direction in ("ccw", "cw"):
        arc = _arc(evidence, direction)
        velocity = tcp_velocity(arc.machine, arc.u, arc.rate)
        off[direction] = float(np.abs(_from_direction(arc, velocity) - arc.deviation).max())
    return judged(
        max(off.values()) < 1e-9,
        f"radial deviation off by {off['ccw']:.1e} m counter-clockwise, {1e3 * off['cw']:.3g} mm clockwise",
        otherwise="it holds for counter-clockwise; clockwise both change sign",
    )


@claim("5.3.2 (5-27)", "5-27 as printed is the radial deviation.", "formula as printed")
def circle_as_printed(evidence: Evidence) -> Outcome:
    arc = _arc(evidence, "ccw")
    setpoint, actual = (tcp_velocity(arc.machine, arc.u, rate) for rate in (arc.rate, KV * arc.lag))
    printed, signed, correct = (
        float(np.abs(_from_direction(arc, velocity, sine) - arc.deviation).max())
        for velocity, sine in ((actual, 1.0), (actual, -1.0), (setpoint, -1.0))
    )
    return judged(
        printed < 1e-9,
        f"off by {1e3 * printed:.3g} mm as printed, {1e6 * signed:.3g} um with - J_1, {correct:.1e} m with the "
        "setpoint's velocity too",
        otherwise="the J_1 term is subtracted, and the direction is that of the setpoint J U', not of Kv Delta-U",
    )


@claim("5.3.2 (fig. 5-8), 8", "The Bipod's radial deviation is a function of the angular position.", "circle")
def varies_around_the_circle(evidence: Evidence) -> Outcome:
    deviation = evidence.circle("bipod", FEED, 1e3 * RADIUS).report["radial_deviation_um"]
    return judged(
        deviation["max"] > 1.05 * deviation["min"],
        f"R 100 mm, 3000 mm/min: {deviation['min']:.2f} to {deviation['max']:.2f} um",
    )


def _ends(evidence: Evidence) -> tuple[float, float]:
    """Angles of the largest and of the smallest radial deviation, deg."""
    path = evidence.circle("bipod", FEED, 1e3 * RADIUS).path
    step = 360.0 / len(path.by_angle)
    return float(np.argmax(path.by_angle)) * step, float(np.argmin(path.by_angle)) * step


@claim("5.3.2 (fig. 5-8-c), 8", "An extremum is where both struts have the same angle, beta1 = beta2.", "circle")
def extremum_at_equal_struts(evidence: Evidence) -> Outcome:
    angles, beta = strut_angles(evidence.setup("bipod"), RADIUS)
    equal = turning_points(angles, beta[:, 0] - beta[:, 1])
    ends = _ends(evidence)
    apart = max(abs(around(end - nearest(equal, end))) for end in ends)
    return judged(
        apart < 2.0,
        f"largest deviation at {ends[0]:.1f} deg, smallest at {ends[1]:.1f} deg; beta1 = beta2 at 90 and 270 deg",
    )


@claim("5.3.2 (fig. 5-8-d), 8", "An extremum is where the sliders' velocities are near zero and change most.", "circle")
def extremum_at_turning_sliders(evidence: Evidence) -> Outcome:
    angles, _, velocity, _ = circle_motion(evidence.setup("bipod"), RADIUS, FEED / 60e3)
    turning = np.concatenate([turning_points(angles, column) for column in velocity.T])
    apart = max(abs(around(end - nearest(turning, end))) for end in _ends(evidence))
    return judged(
        apart < 5.0,
        f"the sliders turn at {', '.join(f'{angle:.1f}' for angle in np.sort(turning))} deg, the extrema are "
        f"{apart:.1f} deg from there at most",
        otherwise="the two sliders turn on either side of each extremum, which is midway between",
    )


CLAIMS = tuple(value for value in list(vars().values()) if isinstance(value, Claim))
"""In the order of the thesis."""
