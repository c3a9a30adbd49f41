"""Identification of drives by least squares: which parameters explain what the drives did, and which the data tell.

The model is the machine's own (`array_path`); unknowns are counted in steps (`DriveUnknown`). With r the observed less
the predicted values, S their derivative by the steps and s the standard deviation of the noise,

    minimise r.r,   uncertainty of a step before the fit: s sqrt((S^T S)^-1_ii).

In the order of `SIZES`, first the velocity gains of all drives, an unknown is estimated if all so far are then known
within `TOLD` of a step; else the data do not tell it beside them and it is left alone, at the value of the machine
file, and the others are true if that is. The choice is made anew at the estimate until it stays. The singular values of
S beside s say the same by direction. Last, what is then told beside the noise, but not beside the deviations that are
left (friction, backlash: what the model lacks), counted as for the intervals below, is left alone, too.

Without feed-forwards, dead time and velocity feed-forward cannot both be told. The feed-forwards are believed to be
those of the machine file unless drives with others, told before the dead time, leave less than `LESS` of the
deviations: noise and other errors of the model must not make settings doubtful.

Intervals. Readings that feed back into the loop, and whatever the model lacks, leave deviations that are correlated
over some time, and then n of them say as much as n / g independent ones, g = 1 + 2 (r_1 + r_2 + ...) with their
autocorrelation r, summed as Geyer, Statistical Science 7 (1992) 473, does. The covariance is g s^2 (S^T S)^-1, the
interval +-t(0.975) times the deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from threadpoolctl import threadpool_limits

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.identification.drive_data import DriveData
from pkm_cnc.identification.drive_unknowns import SIZES, DriveUnknown, drive_setup, drive_values

__all__ = ["DriveEstimate", "DriveFit", "fit_drives", "fit_of", "rms", "sensitivity", "steps_model", "told_unknowns"]

Array = NDArray[np.float64]

STEP = 1e-3
"""Steps: half the distance of the numerical derivative. Truncation 1e-7 of the derivative, rounding 1e-9."""
LESS = 0.5
"""1. See above."""
ROUNDING = 1e-11
"""m. Deviations that are none."""
EXPLAINED = 1.1
"""1. Deviations of this many times the noise, as far as that can be estimated, are noise."""
SETTINGS_UNKNOWN = ("kv", "velocity_gain", "velocity_feed_forward", "dead_time", "acceleration_feed_forward")
"""The order in which the unknowns are wanted if the feed-forwards are not those of the machine file."""
TOLD = 0.1
"""Steps. What is known no better than this (10 % of Kv) is not known."""
LEAST_NOISE = 1e-7
"""m. What the instrument of thesis 6.4.1.1 reads; data without noise are taken to tell no more."""
ROUNDS = 3
"""Choices of what to estimate: at the machine file's values, at the estimate, and once more."""
FAR = (-0.8, 4.0)
"""Steps. How far from the machine file an estimate is looked for: five times kv, beyond which a loop may be unstable,
to a fifth of it."""
EDGE = 0.99
"""1. An estimate beyond this share of the way lies at the end."""
STAGES = ("kv", "velocity_feed_forward", "velocity_gain", "dead_time", "acceleration_feed_forward")
"""The unknowns from what motions tell best to what they tell least: lag of a steady motion first."""
EXACT, NEARLY = 1e-9, 1e-3
"""Steps, of the step from the start: where the last fit ends and where those before it."""
UNIT = 1e-3
"""m. Of the deviations in the fit."""
PROBABILITY = 0.95


@dataclass(frozen=True)
class DriveEstimate:
    """What became of one unknown: value before and after, half the 95 % interval (NaN = left alone), in its unit."""

    unknown: DriveUnknown
    before: float
    value: float
    half_interval: float

    @property
    def left_alone(self) -> bool:
        """Whether the data do not tell it."""
        return bool(np.isnan(self.half_interval))


@dataclass(frozen=True)
class DriveFit:
    """Drives that explain one set of data: `name` of it; `before` and `after` the deviations (m,), m.

    `singular` (p,), m per step, of all unknowns together, and `directions` (p, p), row by row, in steps: what changes
    together. `noise` of one observation, m, `rank` how many unknowns were estimated. `spread` (of networks, else None):
    the standard deviation of each estimate over repeated measurements, in the unit of the unknown, NaN = left alone.
    """

    name: str
    method: str
    estimates: tuple[DriveEstimate, ...]
    before: Array
    after: Array
    singular: Array
    directions: Array
    noise: float
    spread: Array | None = None

    @property
    def rank(self) -> int:
        """Number of estimated unknowns."""
        return sum(not estimate.left_alone for estimate in self.estimates)

    @property
    def values(self) -> Array:
        """(p,), in the units of the unknowns."""
        return np.array([estimate.value for estimate in self.estimates])


def steps_model(setup: Setup, unknowns: Sequence[DriveUnknown], values: Array, steps: Array) -> Setup:
    """The model that is `steps` (p,) from `values` (p,) of the unknowns."""
    moved = [
        one.stepped(value, step)
        for one, value, step in zip(unknowns, values.tolist(), np.asarray(steps).tolist(), strict=True)
    ]
    return drive_setup(setup, unknowns, np.array(moved))


def fit_drives(setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData) -> DriveFit:
    """Estimate `unknowns` from `data`, starting from their values in `setup`.

    Raises InputError, naming the motion that is missing, if the data tell the velocity gain of no drive among them.
    """
    with threadpool_limits(1):  # the result shall not depend on their number
        fit = _fit(setup, unknowns, data, tuple(SIZES))
        if rms(fit.after) > max(ROUNDING, EXPLAINED * data.noise):
            doubted = _fit(setup, unknowns, data, SETTINGS_UNKNOWN)
            fit = doubted if rms(doubted.after) < LESS * rms(fit.after) else fit
        chosen = [place for place, estimate in enumerate(fit.estimates) if not estimate.left_alone]
        _check_near([unknowns[place] for place in chosen], drive_values(setup, unknowns)[chosen], fit.values[chosen])
        return fit


def _fit(setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData, order: Sequence[str]) -> DriveFit:
    """Least squares for the unknowns that the data tell, wanted in this `order`."""
    before, noise = drive_values(setup, unknowns), max(data.noise, LEAST_NOISE)
    kept: list[int] = []
    values = before.copy()
    for _ in range(ROUNDS):
        derivative = sensitivity(setup, unknowns, data, values)
        told = told_unknowns(unknowns, derivative, noise, data, order=order)
        if told == kept:
            break
        start = drive_setup(setup, unknowns, values if set(kept) <= set(told) else before)
        kept, values = told, _fitted(start, unknowns, data, told)
    left = data.observed - data.predicted(drive_setup(setup, unknowns, values))
    beside = max(noise, rms(left) * math.sqrt(_correlation(left)))
    chosen = [unknowns[place] for place in kept]
    derivative = sensitivity(setup, unknowns, data, values)[:, kept]
    still = [kept[place] for place in told_unknowns(chosen, derivative, beside, data, order=order)]
    if still != kept:
        kept, values = still, _fitted(setup, unknowns, data, still)
    return fit_of("least-squares", setup, unknowns, data, values, kept, noise)


def fit_of(
    method: str,
    setup: Setup,
    unknowns: Sequence[DriveUnknown],
    data: DriveData,
    values: Array,
    kept: Sequence[int],
    noise: float,
    spread: Array | None = None,
) -> DriveFit:
    """The fit that has `values` (p,) of the unknowns, those at the places `kept` estimated, with its intervals.

    `spread` (of those, in their units) and `noise`, m, as of `DriveFit`.
    """
    before = drive_values(setup, unknowns)
    after = data.observed - data.predicted(drive_setup(setup, unknowns, values))
    derivative = sensitivity(setup, unknowns, data, values)
    chosen, places = [unknowns[place] for place in kept], list(kept)
    halves, spreads = np.full(len(unknowns), np.nan), np.full(len(unknowns), np.nan)
    halves[places] = _told_within(chosen, values[places], derivative[:, places], after)
    if spread is not None:
        spreads[places] = spread
    _, singular, directions = np.linalg.svd(derivative, full_matrices=False)
    return DriveFit(
        name=data.name,
        method=method,
        estimates=tuple(map(DriveEstimate, unknowns, before.tolist(), values.tolist(), halves.tolist())),
        before=data.observed - data.predicted(drive_setup(setup, unknowns, before)),
        after=after,
        singular=singular,
        directions=directions,
        noise=noise,
        spread=None if spread is None else spreads,
    )


def rms(deviations: Array) -> float:
    """Root of the mean square of (m,), same unit."""
    return float(np.sqrt(np.mean(np.square(deviations))))


def _check_near(unknowns: Sequence[DriveUnknown], before: Array, values: Array) -> None:
    """Raises InputError for an estimate at the end of where it was looked for, or beyond."""
    for one, start, value in zip(unknowns, before.tolist(), values.tolist(), strict=True):
        low, high = sorted(one.stepped(start, EDGE * step) for step in FAR)
        if not low <= value <= high:
            raise InputError(
                f"identify: {one.key} would be {value:.6g} {one.unit}, far from the machine file's {start:.6g} "
                f"{one.unit}: was it recorded on a machine with such drives, and does the file have its feed-forwards?"
            )


def told_unknowns(
    unknowns: Sequence[DriveUnknown],
    derivative: Array,
    noise: float,
    data: DriveData,
    within: float = TOLD,
    order: Sequence[str] = tuple(SIZES),
) -> list[int]:
    """Places of the unknowns that `data` tell `within` so many steps with `noise` (m), from their `derivative` (m, p).

    They are wanted in this `order`. Raises InputError if there is no velocity gain among them.
    """
    kept: list[int] = []
    for place in sorted(range(len(unknowns)), key=lambda place: order.index(unknowns[place].name)):
        tried = sorted([*kept, place])
        if (noise * _root_of_inverse(derivative[:, tried])).max() <= within:
            kept = tried
    if not any(unknowns[place].name == "kv" for place in kept):
        worst = next(one for one in unknowns if one.name == "kv")
        raise InputError(f"identify: too little motion to tell {worst.key}: {data.missing(worst)}")
    return kept


def _told_within(unknowns: Sequence[DriveUnknown], values: Array, derivative: Array, deviations: Array) -> Array:
    """Half the 95 % intervals (p,) of the unknowns at `values` (p,), in their units.

    From the `derivative` (m, p) there, m per step, and the deviations (m,), m. Raises InputError if m is not above p.
    """
    freedom = len(deviations) - len(unknowns)
    if freedom < 1:
        raise InputError(f"identify: {len(deviations)} observations for {len(unknowns)} unknowns: run longer motions")
    variance = float(np.square(deviations).sum()) / freedom * _correlation(deviations)
    deviation = np.sqrt(variance) * _root_of_inverse(derivative)
    sizes = np.array([one.size(value) for one, value in zip(unknowns, values.tolist(), strict=True)])
    return np.asarray(stats.t.ppf(0.5 + 0.5 * PROBABILITY, freedom) * deviation * sizes)


def _correlation(deviations: Array) -> float:
    """How many of the deviations (m,) say as much as one independent one: 1 if they are white, never less.

    Sums of two neighbouring autocorrelations are added up to the first that is not positive: beyond is noise.
    """
    spectrum = np.abs(np.fft.rfft(deviations, 2 * len(deviations))) ** 2
    covariance = np.fft.irfft(spectrum)[: len(deviations) // 2 * 2]
    if not covariance[0] > 0.0:
        return 1.0
    pairs = (covariance / covariance[0]).reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    return max(1.0, float(2.0 * pairs[:end].sum() - 1.0))


def _root_of_inverse(derivative: Array) -> Array:
    """Square roots of the diagonal of (S^T S)^-1, (p,), infinite where nothing tells an unknown."""
    _, singular, directions = np.linalg.svd(derivative, full_matrices=False)
    least = np.finfo(float).eps * max(float(singular[0]), np.finfo(float).tiny)
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(np.linalg.norm(directions.T / np.maximum(singular, least), axis=1))


def sensitivity(
    setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData, values: Array, steps: Array | None = None
) -> Array:
    """d predicted / d step, (m, p), m per step, `steps` (p,) from `values` (p,), at them without."""
    there = np.zeros(len(unknowns)) if steps is None else steps
    columns = []
    for way in STEP * np.eye(len(unknowns)):
        high, low = (data.predicted(steps_model(setup, unknowns, values, there + sign * way)) for sign in (1.0, -1.0))
        columns.append((high - low) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def _fitted(setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData, kept: Sequence[int]) -> Array:
    """The values (p,) of the unknowns, those at the places `kept` estimated, the others as in `setup`.

    In the order of `STAGES`, each with those before it: what the data hardly tell is not tried before what they tell
    well is nearly right.
    """
    values = drive_values(setup, unknowns)
    for stage in range(1, len(STAGES) + 1):
        places = [place for place in kept if unknowns[place].name in STAGES[:stage]]
        if any(unknowns[place].name == STAGES[stage - 1] for place in places):
            chosen = [unknowns[place] for place in places]
            exact = EXACT if len(places) == len(kept) else NEARLY
            values[places] = _minimised(drive_setup(setup, unknowns, values), chosen, data, values[places], exact)
    return values


def _minimised(setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData, start: Array, exact: float) -> Array:
    """The values (p,) within `FAR` of `start` (p,) that leave the smallest deviations, to `exact` steps."""
    observed = data.observed

    def residual(steps: Array) -> Array:
        return (data.predicted(steps_model(setup, unknowns, start, steps)) - observed) / UNIT

    def derivative(steps: Array) -> Array:
        return sensitivity(setup, unknowns, data, start, steps) / UNIT

    found = optimize.least_squares(
        residual,
        np.zeros(len(unknowns)),
        jac=derivative,
        bounds=FAR,
        xtol=exact,
        ftol=1e-12,
        gtol=1e-15,
        max_nfev=50,
    )
    steps = found.x.tolist()
    return np.array([one.stepped(*pair) for one, *pair in zip(unknowns, start.tolist(), steps, strict=True)])
