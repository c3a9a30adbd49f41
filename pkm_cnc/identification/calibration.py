"""Geometric calibration by least squares: which geometry explains where the TCP was at what the drive scales read.

The unknowns are the geometry's parameters that a drawing does not have: offsets, inclinations and errors by strut; and,
if asked for, the tilt of the platform (`config.TiltParameters`), of which only the products with its lever show: they
are estimated for a lever of 1 m. Unknowns are counted in tolerances of assembly, so that lengths and angles compare.
With r(p) the observed less the predicted values and S their derivative by the unknowns,

    minimise r.r,   covariance s^2 (S^T S)^-1,   s^2 = r.r / (m - rank),   interval +-t(0.975, m - rank) sqrt(cov_ii).

What can be known. S = U diag(w) V^T: directions of V with w below `RANK` of the largest change nothing that was
measured. Of the parameters in such directions so many are left alone, at the value they had, as there are directions; a
QR decomposition with column pivoting chooses them, the worst measured last (Golub, Klema, Stewart 1976; for machines
Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991). The others are then estimated relative to those.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, stats
from threadpoolctl import threadpool_limits

from pkm_cnc.config import TiltParameters
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.identification.measurements import UNKNOWNS, Measurements
from pkm_cnc.kinematics import Machine
from pkm_cnc.parameters import parameters_of

__all__ = [
    "Believed",
    "Calibration",
    "Estimate",
    "Unknown",
    "calibrate",
    "condition_of",
    "covariance_of",
    "estimates_of",
    "freedom_of",
    "sensitivity",
    "unknowns_of",
    "values_of",
    "with_values",
]

Array = NDArray[np.float64]

TOLERANCE = {"m": 1e-3, "rad": 1e-3, "rad/m": 1e-3}
"""By which a machine is off as assembled: the scale of an unknown, in its unit."""
LEVER = 1.0
"""m, of a tilt that is estimated."""
STEP = 0.1
"""Tolerances: step of the numerical derivative. 0.1 mm of 0.6 m: truncation below 1e-7, rounding below 1e-11."""
RANK = 1e-6
"""1. Singular values below this share of the largest are none: the derivative's own error is 1e-7."""
SHARE = 1e-3
"""1. Part of a parameter in directions that nothing measured, above which its value depends on those left alone."""
PROBABILITY = 0.95


@dataclass(frozen=True)
class Unknown:
    """One number of `section`: `name` of its parameter, `index` in it if it is a list; `unit`, m, rad or rad/m."""

    name: str
    index: int | None
    unit: str
    section: str = "geometry"

    @property
    def key(self) -> str:
        """As the machine file has it, with the place in the list counted from 0."""
        return f"{self.section}.{self.name}" + ("" if self.index is None else f"[{self.index}]")

    @property
    def tolerance(self) -> float:
        """In `unit`."""
        return TOLERANCE[self.unit]


@dataclass(frozen=True)
class Believed:
    """What a calibration varies: a machine and, on one in space, how its platform tilts."""

    machine: Machine
    tilt: TiltParameters | None = None

    @staticmethod
    def start(machine: Machine, tilt: bool) -> Believed:
        """`machine`, level, with a tilt to be estimated or none. Raises InputError for a tilt of one not in space."""
        if tilt and tuple(machine.coordinates) != ("x", "y", "z"):
            raise InputError(
                f"calibrate: a {type(machine).__name__.lower()} moves in {', '.join(machine.coordinates)}: a tilt is "
                "estimated on a machine that moves in x, y, z"
            )
        return Believed(machine, TiltParameters(lever=LEVER) if tilt else None)

    def forward(self, joints: ArrayLike) -> Array:
        """True TCP (..., coordinates), m, in `base_link` with the drives at `joints` (..., axes), m."""
        tcp = self.machine.forward(joints)
        return tcp if self.tilt is None else self.tilt.displaced(tcp)


@dataclass(frozen=True)
class Estimate:
    """What became of one unknown: value before and after, half the 95 % interval (NaN = none), in its unit.

    `status`: "estimated"; "relative": estimated, and true if those left alone are; "left alone": not observable.
    """

    unknown: Unknown
    before: float
    value: float
    half_interval: float
    status: str

    @property
    def fixed(self) -> bool:
        """Whether the data fix it: the interval is within the tolerance of assembly."""
        return self.half_interval <= self.unknown.tolerance


@dataclass(frozen=True)
class Calibration:
    """A calibrated machine: `estimates` in the geometry's order, `before` and `after` the deviations (m,), m.

    `rank` of the problem, `condition` of what is observable (largest by smallest singular value, unknowns in
    tolerances), `covariance` (rank, rank) of the parameters not left alone, `scatter` the standard deviation of what
    is left, m. `tilt` is None if it was not asked for.
    """

    method: str
    machine: Machine
    tilt: TiltParameters | None
    estimates: tuple[Estimate, ...]
    before: Array
    after: Array
    rank: int
    condition: float
    covariance: Array
    scatter: float


def unknowns_of(believed: Believed) -> tuple[Unknown, ...]:
    """What a calibration of `believed` looks for. Raises InputError if its geometry has no such parameter."""
    machine = believed.machine
    geometry = getattr(machine, "geometry", None)
    found: list[Unknown] = []
    for spec in parameters_of(machine.Geometry):
        if spec.name not in UNKNOWNS:
            continue
        if spec.name == "strut_length_error" and getattr(geometry, "closure", "given") == "start":
            continue  # it follows from the start point
        places = range(len(spec.default)) if isinstance(spec.default, tuple) else [None]
        found += [Unknown(spec.name, place, spec.unit) for place in places]
    if not found:
        raise InputError(f"calibrate: the machine {type(machine).__name__.lower()} has no geometry to calibrate")
    if believed.tilt is not None:
        found += [Unknown(name, None, "rad/m", "actual.tilt") for name in ("about_y", "about_x")]
    return tuple(found)


def _section(believed: Believed, unknown: Unknown) -> Any:
    return believed.machine.geometry if unknown.section == "geometry" else believed.tilt  # type: ignore[attr-defined]


def values_of(believed: Believed, unknowns: Sequence[Unknown]) -> Array:
    """The unknowns' values in `believed`, (p,), in their units."""
    values = [getattr(_section(believed, one), one.name) for one in unknowns]
    return np.array(
        [value if one.index is None else value[one.index] for one, value in zip(unknowns, values, strict=True)]
    )


def with_values(believed: Believed, unknowns: Sequence[Unknown], values: Array) -> Believed:
    """The machine with `values` (p,) of the unknowns, in their units. Raises InputError for what cannot be built."""
    changed: dict[str, dict[str, float | tuple[float, ...]]] = {"geometry": {}, "actual.tilt": {}}
    for one, value in zip(unknowns, values.tolist(), strict=True):
        there = changed[one.section]
        if one.index is None:
            there[one.name] = value
        else:
            present: Any = there.get(one.name, getattr(_section(believed, one), one.name))
            there[one.name] = (*present[: one.index], value, *present[one.index + 1 :])
    machine = believed.machine
    geometry: Any = machine.geometry  # type: ignore[attr-defined]
    tilt: Any = believed.tilt
    moved = type(machine)(dataclasses.replace(geometry, **changed["geometry"]))
    return Believed(moved, None if tilt is None else dataclasses.replace(tilt, **changed["actual.tilt"]))


def sensitivity(believed: Believed, unknowns: Sequence[Unknown], measurements: Measurements, values: Array) -> Array:
    """d predicted / d unknown, (m, p), m by tolerance, at `values` (p,). Raises InputError."""
    columns = []
    for index, one in enumerate(unknowns):
        step = STEP * one.tolerance * np.eye(len(unknowns))[index]
        high, low = (measurements.predicted(with_values(believed, unknowns, values + way)) for way in (step, -step))
        columns.append((high - low) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def condition_of(derivative: Array) -> tuple[int, float]:
    """Rank of a sensitivity (m, p), and its largest by its smallest singular value that counts.

    Raises InputError if nothing that was measured depends on the unknowns.
    """
    singular = np.linalg.svd(derivative, compute_uv=False)
    if not singular[0] > 0.0:
        raise InputError("calibrate: nothing that was measured depends on the geometry")
    counting = singular[singular > RANK * singular[0]]
    return len(counting), float(counting[0] / counting[-1])


def freedom_of(measured: int, observable: int) -> int:
    """Degrees of freedom of so many measured values and observable parameters. Raises InputError if there are none."""
    if measured <= observable:
        raise InputError(
            f"calibrate: {measured} measured values for {observable} observable parameters: measure more poses"
        )
    return measured - observable


def calibrate(machine: Machine, measurements: Measurements, *, tilt: bool = False) -> Calibration:
    """Estimate the geometry of `machine` by least squares from measurements, starting from its own; and its `tilt`.

    Raises InputError if the measurements are fewer than the unknowns, miss a motion, or fit no such machine, and for
    the tilt of a machine that does not move in space.
    """
    believed = Believed.start(machine, tilt)
    unknowns = unknowns_of(believed)
    with threadpool_limits(1):  # the result shall not depend on their number
        try:
            measurements.check(machine)
            return _calibrated(believed, unknowns, measurements)
        except UnreachableError as error:
            raise InputError(f"calibrate: the measurements do not fit the machine: {error}") from None


def _calibrated(believed: Believed, unknowns: Sequence[Unknown], measurements: Measurements) -> Calibration:
    before, observed = values_of(believed, unknowns), measurements.observed
    kept, unmeasured = _observable(sensitivity(believed, unknowns, measurements, before))
    freedom = freedom_of(len(observed), len(kept))
    chosen = [unknowns[place] for place in kept]
    values = before.copy()
    values[kept] = _fitted(believed, chosen, measurements, before[kept])
    found = with_values(believed, unknowns, values)
    left = observed - measurements.predicted(found)
    scatter = float(np.sqrt(np.square(left).sum() / freedom))
    derivative = sensitivity(found, chosen, measurements, values[kept])
    covariance = covariance_of(chosen, derivative, scatter)
    known = iter(estimates_of(chosen, before[kept], values[kept], covariance, freedom))
    estimates = [
        dataclasses.replace(next(known), status="relative" if unmeasured[place] > SHARE else "estimated")
        if place in kept
        else Estimate(one, before[place], before[place], np.nan, "left alone")
        for place, one in enumerate(unknowns)
    ]
    return Calibration(
        method="least-squares",
        machine=found.machine,
        tilt=found.tilt,
        estimates=tuple(estimates),
        before=observed - measurements.predicted(believed),
        after=left,
        rank=len(kept),
        condition=condition_of(derivative)[1],
        covariance=covariance,
        scatter=scatter,
    )


def estimates_of(
    unknowns: Sequence[Unknown], before: Array, values: Array, covariance: Array, freedom: int
) -> tuple[Estimate, ...]:
    """Estimates of p unknowns with the intervals of their covariance (p, p) from `freedom` degrees of freedom."""
    halves = stats.t.ppf(0.5 + 0.5 * PROBABILITY, freedom) * np.sqrt(np.diag(covariance))
    return tuple(
        Estimate(*row, "estimated")
        for row in zip(unknowns, before.tolist(), values.tolist(), halves.tolist(), strict=True)
    )


def covariance_of(unknowns: Sequence[Unknown], derivative: Array, scatter: float) -> Array:
    """Covariance (p, p) of the unknowns, in their units."""
    scale = np.array([one.tolerance for one in unknowns])
    _, singular, directions = np.linalg.svd(derivative, full_matrices=False)
    root = directions.T * (scale[:, None] / singular)
    return np.asarray(scatter**2 * root @ root.T)


def _observable(derivative: Array) -> tuple[list[int], Array]:
    """Places of the parameters to estimate, in order, and of each the part that lies in unmeasured directions, (p,)."""
    triangle, order = linalg.qr(derivative, mode="r", pivoting=True)
    rank, _ = condition_of(triangle)
    _, _, directions = np.linalg.svd(triangle[: len(order)])
    unmeasured = np.empty(len(order))
    unmeasured[order] = np.linalg.norm(directions[rank:], axis=0)
    return sorted(order[:rank].tolist()), unmeasured


def _fitted(believed: Believed, unknowns: Sequence[Unknown], measurements: Measurements, start: Array) -> Array:
    """The values (p,) that leave the smallest deviations. Raises InputError, UnreachableError."""
    scale = np.array([one.tolerance for one in unknowns])

    def residual(steps: Array) -> Array:
        there = with_values(believed, unknowns, start + scale * steps)
        return (measurements.predicted(there) - measurements.observed) / TOLERANCE["m"]

    def derivative(steps: Array) -> Array:
        return sensitivity(believed, unknowns, measurements, start + scale * steps) / TOLERANCE["m"]

    found = optimize.least_squares(
        residual, np.zeros(len(unknowns)), jac=derivative, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    if not found.success:
        raise InputError("calibrate: the estimate does not converge: do the measurements belong to this machine?")
    return np.asarray(start + scale * found.x)
