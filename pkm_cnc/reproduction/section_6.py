"""Claims of chapter 6: the Tripod, its kinematics, star and circular test, and the mismatch of velocity gains."""

from __future__ import annotations

import math

import numpy as np

from pkm_cnc.kinematics import Machine
from pkm_cnc.reproduction import printed_tripod
from pkm_cnc.reproduction.claim import Claim, Outcome, claim, judged, not_checkable
from pkm_cnc.reproduction.evidence import Circle, Evidence
from pkm_cnc.reproduction.reading import (
    Array,
    around,
    circle_motion,
    exponent,
    left_um,
    maxima_of,
    nearest,
    per_degree,
    strut_angles,
    turning_points,
    zero_heading,
)

__all__ = ["CLAIMS"]

EVERY_15_DEG = tuple(range(0, 360, 15))
UNDER_A_COLUMN = (45, 165, 285)
OPPOSITE = (105.0, 225.0, 345.0)
"""Where the circle is farthest from a column, deg; in the order of the columns 285, 45, 165."""
SAMPLE = np.array([[0.0, 0.0, 0.0], [0.08, -0.03, 0.02], [-0.06, 0.09, -0.05], [0.1, 0.1, 0.05]])
"""TCP points, m."""


def _star(evidence: Evidence, feed: float = 6000.0) -> dict[float, float]:
    """Signed in-plane error over the heading, um."""
    lines = evidence.star("tripod", feed, EVERY_15_DEG)
    return {heading: left_um(line) for heading, line in lines.items()}


def _circle(evidence: Evidence, direction: str = "ccw", radius: float = 100.0, feed: float = 3000.0) -> Circle:
    return evidence.circle("tripod", feed, radius, direction=direction)


def _tripod(evidence: Evidence) -> Machine:
    return evidence.setup("tripod").kinematics


# 6.3 kinematics


@claim("6.3.1 (6-1..6-4)", "6-4 with the positive root gives the sliders; they are above the platform.", "kinematics")
def inverse_closes_the_loop(evidence: Evidence) -> Outcome:
    u = _tripod(evidence).inverse(SAMPLE)
    struts = SAMPLE[:, None, :] - printed_tripod.sphere_centers(u)
    off = float(np.abs(np.sqrt((struts * struts).sum(axis=2)) - printed_tripod.LENGTH).max())
    least = float((u - SAMPLE[:, 2:]).min())
    return judged(
        off < 1e-12 and least > 0.0,
        f"strut lengths met within {off:.1e} m, sliders at least {1e3 * least:.1f} mm above the TCP",
    )


def _forward_error(evidence: Evidence, *misprints: str) -> float:
    """Largest round-trip error over the sample, m, with these equations as printed, all others corrected; inf: none."""
    u = _tripod(evidence).inverse(SAMPLE)
    found = np.array([printed_tripod.forward(row, misprints) for row in u])
    return float(np.nan_to_num(np.abs(found - SAMPLE), nan=math.inf).max())


def _forward_as_printed(evidence: Evidence, equation: str, correct: str) -> Outcome:
    printed, corrected = _forward_error(evidence, equation), _forward_error(evidence)
    off = f"off by {1e3 * printed:.4g} mm" if math.isfinite(printed) else "without a real root"
    return judged(
        printed < 1e-9,
        f"round trip {off} as printed, off by {corrected:.1e} m corrected",
        otherwise=f"misprint: {correct}",
    )


@claim("6.3.2 (6-7)", "The height of the TCP from the line on which two pairs of spheres agree.", "formula as printed")
def forward_6_7(evidence: Evidence) -> Outcome:
    return _forward_as_printed(evidence, "6-7", "the root lacks the constant term c/a of the quadratic equation")


@claim("6.3.2 (6-9)", "The offset j of that line in x.", "formula as printed")
def forward_6_9(evidence: Evidence) -> Outcome:
    return _forward_as_printed(evidence, "6-9", "(c3y - c2y) where (c2z - c2y) stands, and the second bracket is added")


@claim("6.3.2 (6-11)", "The offset l of that line in y.", "formula as printed")
def forward_6_11(evidence: Evidence) -> Outcome:
    return _forward_as_printed(evidence, "6-11", "the second bracket is added")


@claim("6.3.2 (6-14)", "The height of a strut's sphere is E - Bz - Az.", "formula as printed")
def forward_6_14(evidence: Evidence) -> Outcome:
    """The thesis' base points and platform joints have no z: raised ones show which sign is right."""
    base, joint = 0.010, 0.004
    pose = np.array([0.03, -0.02, 0.01])
    slider = _tripod(evidence).inverse(pose) - base + joint
    correct = printed_tripod.forward(slider + base - joint)
    printed = printed_tripod.forward(slider - base - joint)
    return judged(
        bool(np.abs(printed - pose).max() < 1e-9),
        f"base points 10 mm up, platform joints 4 mm up: z off by {1e3 * (printed - pose)[2]:+.1f} mm as printed, "
        f"{abs((correct - pose)[2]):.1e} m with E + Bz - Az",
        otherwise="sign: a base point that is higher carries its slider up",
    )


@claim("6.3.2 (6-15)", "Newton's iteration finds the TCP and agrees with the closed form.", "kinematics")
def newton_converges(evidence: Evidence) -> Outcome:
    tripod = _tripod(evidence)
    u = tripod.inverse(SAMPLE)
    steps = max(printed_tripod.newton_steps(row, corrected=True) or math.inf for row in u)
    apart = float(np.abs(tripod.forward(u) - tripod.forward_newton(u)).max())
    return judged(
        steps <= 10 and apart < 1e-12,
        f"{steps:g} steps to 1e-12 m from 7 mm beside; closed form and iteration {apart:.1e} m apart",
        remark="with the matrix 6-16 corrected",
    )


@claim("6.3.2 (6-16)", "The Jacobi matrix for that iteration.", "formula as printed")
def newton_matrix_6_16(evidence: Evidence) -> Outcome:
    u = _tripod(evidence).inverse(SAMPLE)
    steps = [printed_tripod.newton_steps(row, corrected=False) for row in u]
    arrived = sum(step is not None for step in steps)
    return judged(
        arrived == len(steps),
        f"as printed {arrived} of {len(steps)} poses are reached within 50 steps, corrected all",
        otherwise="misprint: P + A - B stands as P + (A - B)^2",
    )


# 6.4.1 and 6.5.1 star test


@claim("6.4.1.2", "The Tripod keeps to a line only in the directions of its columns: 45, 165, 285 deg.", "star test")
def zero_headings(evidence: Evidence) -> Outcome:
    error = _star(evidence)
    both_ways = {angle % 360 for column in UNDER_A_COLUMN for angle in (column, column + 180)}
    on = max(abs(error[heading]) for heading in both_ways)
    off = min(abs(size) for heading, size in error.items() if heading not in both_ways)
    return judged(
        on < 0.01 and off > 1.0,
        f"at most {on:.4f} um there, at least {off:.3f} um at every other multiple of 15 deg",
        remark="in the plane, on lines through the axis, and backwards (225, 345, 105 deg) too; not in z",
    )


@claim("6.4.1.2", "In all other directions the distance to the line is almost constant.", "star test")
def distance_is_almost_constant(evidence: Evidence) -> Outcome:
    lines = evidence.star("tripod", 6000.0, EVERY_15_DEG).values()
    spread = max(line["contour_error_um"]["std"] / abs(left_um(line)) for line in lines if abs(left_um(line)) > 1.0)
    return judged(spread < 0.1, f"standard deviation at most {100 * spread:.1f} % of the mean, on the middle half")


@claim("6.4.1.2", "Deviations are right of travel from -15 to 45 deg, left of travel from 45 to 105 deg.", "star test")
def sides(evidence: Evidence) -> Outcome:
    error = _star(evidence)
    right, left = [error[heading] for heading in (0, 15, 30)], [error[heading] for heading in (60, 75, 90)]
    return judged(
        max(right) < 0.0 < min(left),
        f"0, 15, 30 deg: {_listed(right)} um; 60, 75, 90 deg: {_listed(left)} um (+ = left)",
        remark="the thesis measured it; this is the model's answer",
    )


@claim("6.4.1.2", "No hysteresis: reversing the travel leaves the deviation on the same side of the line.", "star test")
def one_sided(evidence: Evidence) -> Outcome:
    error = _star(evidence)
    pairs = [(error[heading], error[heading + 180]) for heading in EVERY_15_DEG if heading < 180]
    pairs = [pair for pair in pairs if abs(pair[0]) > 1.0]
    apart = max(abs(forth + back) for forth, back in pairs)
    return judged(
        apart < 0.02 * max(abs(forth) for forth, _ in pairs),
        f"{len(pairs)} lines both ways: left of travel turns into right, {apart:.4f} um apart at most",
    )


@claim("6.4.1.2", "The deviations are a function of orientation and feed rate.", "star test")
def grows_with_feed(evidence: Evidence) -> Outcome:
    slow, fast = _star(evidence, 6000.0), _star(evidence, 9000.0)
    ratios = [fast[heading] / slow[heading] for heading in EVERY_15_DEG if abs(slow[heading]) > 1.0]
    return judged(
        min(ratios) > 1.1 and max(slow.values()) - min(slow.values()) > 1.0,
        f"9000 against 6000 mm/min: {min(ratios):.3f} to {max(ratios):.3f} times, (9000/6000)^2 = 2.25; "
        f"at 6000 mm/min from {min(slow.values()):+.2f} to {max(slow.values()):+.2f} um over the heading",
        remark="the thesis measured it; in the model it goes with the square of the feed",
    )


@claim("6.4.1.2", "That there is a deviation shows that the velocity gains in x and y differ.", "star test")
def different_gains_in_x_and_y(evidence: Evidence) -> Outcome:
    return _explained_by_6_21(evidence)


@claim("6.4.1.2", "At 15 and 90 deg and 9000 mm/min the machine vibrates and cannot be measured.", "-")
def vibration(evidence: Evidence) -> Outcome:
    return not_checkable("needs the machine's compliance: the model's mechanics are rigid")


@claim("6.4.1.2", "Measured means and standard deviations of five star tests (figures 6-15, 6-17, 6-18).", "-")
def measured_star_tests(evidence: Evidence) -> Outcome:
    return not_checkable("the figures are lost; the simulated ones are in the experiment star")


@claim("6.5.1 (5-20)", "The contour error of the Tripod's star test is what 5-20 makes of x and y.", "star test")
def only_in_the_plane(evidence: Evidence) -> Outcome:
    lines = evidence.star("tripod", 6000.0, EVERY_15_DEG).values()
    plane = max(abs(left_um(line)) for line in lines)
    height = max(abs(line["contour_error_z_um"]["mean"]) for line in lines)
    return judged(
        height < 0.1 * plane,
        f"at most {plane:.2f} um in the plane, at most {height:.2f} um in z",
        otherwise="the same nonlinearity moves the tool in z, which the thesis neither simulates nor measures",
    )


def _zero_at(evidence: Evidence, pivot: tuple[float, float], expected: float) -> Outcome:
    found = zero_heading(evidence, "tripod", 6000.0, expected, pivot)
    return judged(abs(found - expected) < 0.5, f"{found:.2f} deg")


@claim("6.5.1", "Star test about o, the axis: no error at 45 deg.", "star test")
def zero_at_45(evidence: Evidence) -> Outcome:
    return _zero_at(evidence, (0.0, 0.0), 45.0)


@claim("6.5.1", "Star test about s1, (50, 0) mm: no error at 52 deg.", "star test")
def zero_at_52(evidence: Evidence) -> Outcome:
    return _zero_at(evidence, (50.0, 0.0), 52.0)


@claim("6.5.1", "Star test about s4, (0, 50) mm: no error at 38 deg.", "star test")
def zero_at_38(evidence: Evidence) -> Outcome:
    return _zero_at(evidence, (0.0, 50.0), 38.0)


# 6.4.2 and 6.5.2 circular test


@claim("6.4.2, 6.5.2", "R 100 mm, 3000 mm/min: three extrema, opposite the columns, at 105, 225 and 345 deg.", "circle")
def three_extrema(evidence: Evidence) -> Outcome:
    forth, back = (sorted(_circle(evidence, way).report["extrema_deg"]) for way in ("ccw", "cw"))
    holds = len(forth) == len(back) == 3 and all(
        abs(angle - place) < 2.0 for angles in (forth, back) for angle, place in zip(angles, OPPOSITE, strict=True)
    )
    return judged(
        holds,
        f"largest radial deviation at {_angles(forth)} deg counter-clockwise, {_angles(back)} deg clockwise",
        remark="each direction is a degree late, their mean is at 105, 225, 345 deg",
    )


@claim("6.4.2, 6.5.2", "The actual radius is smaller than the commanded one, by an amount that varies.", "circle")
def smaller_and_not_constant(evidence: Evidence) -> Outcome:
    deviation = _circle(evidence).report["radial_deviation_um"]
    return judged(
        deviation["min"] > 0.0 and deviation["max"] > 1.05 * deviation["min"],
        f"radial deviation {deviation['min']:.2f} to {deviation['max']:.2f} um, + = too small",
    )


def _at_extremum(evidence: Evidence, angles_by_axis: list[Array]) -> tuple[float, str]:
    """How far (deg) each extremum is from the nearest of the angles of the axis opposite to it, at most, and all."""
    extrema = sorted(_circle(evidence).report["extrema_deg"])
    opposite = (2, 0, 1)  # axis of the column at 285, 45, 165 deg
    found = [nearest(angles_by_axis[axis], angle) for angle, axis in zip(extrema, opposite, strict=True)]
    return max(abs(around(a - b)) for a, b in zip(found, extrema, strict=True)), _angles(found)


@claim("6.5.2 (fig. 6-24)", "At an extremum the slider opposite changes direction: its velocity is zero.", "circle")
def slider_turns_at_extremum(evidence: Evidence) -> Outcome:
    angles, _, velocity, _ = circle_motion(evidence.setup("tripod"), 0.100, 0.050)
    turning = [turning_points(angles, column) for column in velocity.T]
    apart, found = _at_extremum(evidence, turning)
    return judged(apart < 2.0, f"sliders turn at {found} deg, {apart:.2f} deg from the extrema at most")


@claim("6.5.2 (fig. 6-24)", "At an extremum the strut opposite is most horizontal: beta is largest.", "circle")
def strut_most_horizontal_at_extremum(evidence: Evidence) -> Outcome:
    angles, beta = strut_angles(evidence.setup("tripod"), 0.100)
    apart, found = _at_extremum(evidence, [maxima_of(angles, column) for column in beta.T])
    return judged(
        apart < 2.0, f"beta is largest, {math.degrees(beta.max()):.2f} deg, at {found} deg, {apart:.2f} deg from them"
    )


@claim("6.5.2 (fig. 6-26)", "Where a slider's velocity is zero at an extremum, it changes most quickly.", "circle")
def acceleration_largest_at_extremum(evidence: Evidence) -> Outcome:
    angles, _, _, acceleration = circle_motion(evidence.setup("tripod"), 0.100, 0.050)
    apart, found = _at_extremum(evidence, [maxima_of(angles, np.abs(column)) for column in acceleration.T])
    largest = np.abs(acceleration).max(axis=0)
    there = [nearest(angles, angle) for angle in OPPOSITE]
    sizes = [abs(acceleration[np.flatnonzero(angles == a)[0], axis]) for a, axis in zip(there, (2, 0, 1), strict=True)]
    share = min(size / largest[axis] for size, axis in zip(sizes, (2, 0, 1), strict=True))
    return judged(
        apart < 2.0 and share > 0.99,
        f"nearest maxima of its acceleration at {found} deg; at the extremum {100 * share:.1f} % of its largest",
        otherwise="there the slider's acceleration has a lesser maximum or none: it is largest where the slider is "
        "nearest to its own column's side of the circle",
    )


@claim("6.5.2 (fig. 6-25)", "Largest and smallest radial deviation go with the strut angles.", "circle")
def extrema_go_with_beta(evidence: Evidence) -> Outcome:
    angles, beta = strut_angles(evidence.setup("tripod"), 0.100)
    deviation = per_degree(_circle(evidence).path)
    largest = np.interp(np.arange(360.0), angles, beta.max(axis=1))
    related = float(np.corrcoef(largest, deviation)[0, 1])
    return judged(
        related > 0.95,
        f"correlation of the radial deviation with the largest of the three strut angles: {related:.3f} "
        f"(beta {math.degrees(largest.min()):.1f} to {math.degrees(largest.max()):.1f} deg)",
    )


@claim(
    "6.5.2 (fig. 6-28)", "A larger radius lowers largest and smallest deviation and raises the circularity.", "circle"
)
def larger_radius(evidence: Evidence) -> Outcome:
    radii = (50.0, 100.0, 150.0)
    reports = [_circle(evidence, radius=radius).report for radius in radii]
    largest, smallest = ([report["radial_deviation_um"][end] for report in reports] for end in ("max", "min"))
    circularity = [report["circularity_um"] for report in reports]
    return judged(
        _falls(largest) and _falls(smallest) and _falls(circularity[::-1]),
        f"R 50, 100, 150 mm at 3000 mm/min: largest {_plain(largest)} um, smallest {_plain(smallest)} um, "
        f"circularity {_plain(circularity)} um",
    )


@claim("6.5.2 (fig. 6-29)", "The accuracy of a circle is a nonlinear function of the feed.", "circle")
def nonlinear_in_feed(evidence: Evidence) -> Outcome:
    feeds = (1500.0, 3000.0, 6000.0)
    deviation = [_circle(evidence, feed=feed).report["radial_deviation_um"]["max"] for feed in feeds]
    power = exponent(feeds, deviation)
    return judged(
        abs(power - 1.0) > 0.1,
        f"1500, 3000, 6000 mm/min: largest deviation {_plain(deviation)} um, goes with v^{power:.3f}",
    )


@claim("6.4.2, 6.5.2 (fig. 6-30)", "Measured and simulated radial deviation are highly similar.", "-")
def circle_like_measured(evidence: Evidence) -> Outcome:
    return not_checkable("the measured figure is lost")


@claim("6.5.2 (fig. 6-31)", "The differences come from a tilting platform, which makes the y deviation larger.", "-")
def tilting(evidence: Evidence) -> Outcome:
    return not_checkable("needs the measurement and a platform that tilts: the model's platform only translates")


# 6.6 mismatch of velocity gains


MISMATCH = ("drive.kind=first_order", "x.drive.kv=20.0", "y.drive.kv=16.0")
MISMATCH_HEADINGS = (0, 30, 45, 60, 120, 180, 210, 225)


def _by_6_21(heading: float, feed: float) -> float:
    """6-21 with our sign (+ = left of travel), um; feed in mm/min, gains of MISMATCH."""
    return -1e3 * feed / 60.0 * math.sin(2.0 * math.radians(heading)) / 2.0 * (1.0 / 16.0 - 1.0 / 20.0)


def _mismatched(evidence: Evidence, feed: float) -> dict[float, float]:
    lines = evidence.star("cartesian", feed, MISMATCH_HEADINGS, *MISMATCH)
    return {heading: left_um(line) for heading, line in lines.items()}


@claim("6.6 (6-17..6-21)", "Unequal gains in x and y put a line off by v sin(2 theta)/2 (1/Kvy - 1/Kvx).", "Cartesian")
def mismatch_on_a_line(evidence: Evidence) -> Outcome:
    error = _mismatched(evidence, 3000.0)
    apart = max(abs(size - _by_6_21(heading, 3000.0)) for heading, size in error.items())
    return judged(
        apart < 0.01 * max(abs(size) for size in error.values()),
        f"Kv 20 and 16 1/s, 3000 mm/min: 6-21 and simulation {apart:.4f} um apart at most, of {error[45]:+.1f} um "
        "at 45 deg",
        remark="with the opposite sign: 6-17 counts setpoint less actual, here + = the tool is left of travel",
    )


@claim("6.6", "The error that unequal gains add grows with the feed.", "Cartesian")
def mismatch_grows_with_feed(evidence: Evidence) -> Outcome:
    slow, fast = _mismatched(evidence, 3000.0)[45], _mismatched(evidence, 6000.0)[45]
    return judged(fast / slow > 1.1, f"45 deg: {slow:+.1f} um at 3000 mm/min, {fast:+.1f} um at 6000: linear in v")


@claim(
    "6.4.1.2, 6.6", "On perpendicular axes with unequal gains the deviation changes side with the travel.", "Cartesian"
)
def mismatch_changes_side(evidence: Evidence) -> Outcome:
    error = _mismatched(evidence, 3000.0)
    forth, back = error[45], error[225]
    return judged(
        abs(forth - back) < 0.01 * abs(forth),
        f"45 deg {forth:+.2f} um, 225 deg {back:+.2f} um: the same side of travel, the other side of the line",
    )


@claim("6.6", "On a straight line the contour error is cancelled if the axes are dynamically identical.", "star tests")
def cancelled_by_identical_axes(evidence: Evidence) -> Outcome:
    cartesian = max(abs(left_um(line)) for line in evidence.star("cartesian", 6000.0, EVERY_15_DEG[:13]).values())
    tripod = max(map(abs, _star(evidence).values()))
    return judged(
        max(cartesian, tripod) < 1e-3,
        f"equal drives, 6000 mm/min: Cartesian {cartesian:.1e} um, Tripod {tripod:.2f} um",
        otherwise="true of straight axes only; the thesis' own subject is that it fails on a parallel machine",
    )


@claim("6.6 (6-21)", "6-21 explains the Tripod's deviations: gains that are unequal in Cartesian space.", "star tests")
def explained_by_6_21(evidence: Evidence) -> Outcome:
    return _explained_by_6_21(evidence)


def _explained_by_6_21(evidence: Evidence) -> Outcome:
    """6-21 is linear in v and changes the side of the line on reversal, whatever the gains are."""
    slow, fast = _star(evidence, 6000.0), _star(evidence, 9000.0)
    power = exponent((6000.0, 9000.0), (abs(slow[15]), abs(fast[15])))
    changes_side = slow[15] * slow[195] > 0.0
    return judged(
        abs(power - 1.0) < 0.1 and changes_side,
        f"15 deg: goes with v^{power:.3f}, and is {slow[15]:+.2f} um, backwards {slow[195]:+.2f} um: "
        f"{'changes' if changes_side else 'keeps'} its side of the line",
        otherwise="unequal gains give an error linear in v that changes side on reversal (6-21); this is the "
        "second-order term kappa v^2 J^-1 d2u/ds2",
    )


@claim("6.6", "Errors of curved contours are inversely proportional to Kv.", "circle, Cartesian")
def inversely_proportional_to_kv(evidence: Evidence) -> Outcome:
    gains = (10.0, 20.0, 40.0)
    deviation = [
        evidence.circle("cartesian", 3000.0, 100.0, "drive.kind=first_order", f"drive.kv={gain}").report[
            "radial_deviation_um"
        ]["mean"]
        for gain in gains
    ]
    power = exponent(gains, deviation)
    return judged(
        abs(power + 1.0) < 0.1,
        f"Kv 10, 20, 40 1/s: {_plain(deviation)} um, goes with Kv^{power:.2f}",
        otherwise="with equal gains it goes with 1/Kv^2, as the thesis' own 2-12 has it",
    )


@claim("6.6", "For accuracy at speed Kv must be equal in work coordinates, not in machine coordinates.", "-")
def gains_equal_in_work_coordinates(evidence: Evidence) -> Outcome:
    return not_checkable("no such machine is given; `tcp_control.adapted_gain` shows it in the model")


def _falls(values: list[float]) -> bool:
    return bool((np.diff(values) < 0.0).all())


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:+.2f}" for value in values)


def _plain(values: list[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _angles(values: list[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


CLAIMS = tuple(value for value in list(vars().values()) if isinstance(value, Claim))
"""In the order of the thesis."""
