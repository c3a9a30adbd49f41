"""Geometric calibration by neural networks, as thesis 4.2.2 does it for gamma, dx and du of the Monopod.

One unknown after the other: vectors of deviations are computed for geometries drawn at random around the present
estimate, in a band of every unknown; a network learns from them the one unknown; what was measured is put in and the
estimate moves. Then a new set of vectors is drawn for the next unknown. One iteration has a step for every unknown, and
the next one has a band half as wide. As the thesis has it, 300 vectors are drawn for each network; it gives neither
the band nor the network, both are ours.

The first networks see the whole band and hence the curvature of the map from parameters to deviations, which on the
Monopod is as large as the effect of its worst observable direction; in the narrow bands of later iterations the map is
straight. The vectors carry noise of the size that was measured: the part of the deviations that no unknown explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.identification.calibration import (
    Believed,
    Calibration,
    Unknown,
    condition_of,
    covariance_of,
    estimates_of,
    freedom_of,
    sensitivity,
    unknowns_of,
    values_of,
    with_values,
)
from pkm_cnc.identification.measurements import Measurements
from pkm_cnc.identification.networks import Network, train
from pkm_cnc.kinematics import Machine

__all__ = ["ITERATIONS", "VECTORS", "NetworkCalibration", "calibrate_by_networks"]

Array = NDArray[np.float64]

ITERATIONS = 7
"""Of thesis fig. 4-5."""
VECTORS = 300
"""Training vectors of one network: "a set of 300 training vectors proves to be sufficient"."""
BAND = 3.0
"""Tolerances of assembly (1 mm, 1 mrad): half the band of the first iteration."""
NARROWER = 0.5
"""By how much the band narrows from one iteration to the next."""
REPETITIONS = 200
"""Noisy measurements put into the first iteration's networks to learn their spread."""


@dataclass(frozen=True)
class NetworkCalibration:
    """The calibrated machine and how it came about.

    `history` (iterations + 1, m), m: the deviations at the start and after each iteration (fig. 4-5). `networks` of the
    first iteration, which saw the widest band, one for every unknown; `spread` (p,), in their units, the standard
    deviation of what they make of `REPETITIONS` measurements that differ by their noise alone. It is no uncertainty:
    where the data tell nothing a network answers the middle of its band, every time. The intervals of `calibration` are
    those of least squares at its values, which is what the data can tell.
    """

    calibration: Calibration
    history: Array
    networks: tuple[Network, ...]
    spread: Array


def calibrate_by_networks(
    machine: Machine,
    measurements: Measurements,
    *,
    seed: int = 0,
    iterations: int = ITERATIONS,
    vectors: int = VECTORS,
    tilt: bool = False,
) -> NetworkCalibration:
    """Estimate the geometry of `machine` by networks, starting from its own, and its `tilt`.

    Equal arguments give equal results. Raises InputError if the measurements miss a motion, leave an unknown
    unobservable, or come from a machine further off than the band of training, and as `calibrate` for a tilt.
    """
    believed = Believed.start(machine, tilt)
    unknowns = unknowns_of(believed)
    generator = np.random.default_rng(seed)
    with threadpool_limits(1):
        try:
            measurements.check(machine)
            _require_observable(believed, unknowns, measurements)
            return _calibrated(believed, unknowns, measurements, generator, iterations, vectors)
        except UnreachableError as error:
            raise InputError(f"calibrate: the measurements do not fit the machine: {error}") from None


def _require_observable(believed: Believed, unknowns: Sequence[Unknown], measurements: Measurements) -> None:
    rank, _ = condition_of(sensitivity(believed, unknowns, measurements, values_of(believed, unknowns)))
    if rank < len(unknowns):
        raise InputError(
            f"calibrate: these measurements tell {rank} of {len(unknowns)} unknowns: no network can learn the others; "
            "method least-squares names them"
        )
    freedom_of(len(measurements.observed), rank)


def _calibrated(
    believed: Believed,
    unknowns: Sequence[Unknown],
    measurements: Measurements,
    generator: np.random.Generator,
    iterations: int,
    vectors: int,
) -> NetworkCalibration:
    before = values_of(believed, unknowns)
    values, observed = before.copy(), measurements.observed
    history = [observed - measurements.predicted(believed)]
    first: list[Network] = []
    half_band = BAND * np.array([one.tolerance for one in unknowns])
    for iteration in range(iterations):
        for place in range(len(unknowns)):
            network = _taught(believed, unknowns, measurements, values, half_band, place, generator, vectors)
            deviation = observed - measurements.predicted(with_values(believed, unknowns, values))
            values[place] += network.estimate(deviation)[0, 0]
            first += [network] if iteration == 0 else []
        half_band = NARROWER * half_band
        history.append(observed - measurements.predicted(with_values(believed, unknowns, values)))
    derivative = sensitivity(believed, unknowns, measurements, values)
    rank, condition = condition_of(derivative)
    scatter = _scatter(believed, unknowns, measurements, values)
    covariance = covariance_of(unknowns, derivative, scatter)
    found = with_values(believed, unknowns, values)
    result = Calibration(
        method="nn",
        machine=found.machine,
        tilt=found.tilt,
        estimates=estimates_of(unknowns, before, values, covariance, freedom_of(len(observed), rank)),
        before=history[0],
        after=history[-1],
        rank=rank,
        condition=condition,
        covariance=covariance,
        scatter=scatter,
    )
    return NetworkCalibration(
        result, np.stack(history), tuple(first), _spread(first, len(observed), scatter, generator)
    )


def _taught(
    believed: Believed,
    unknowns: Sequence[Unknown],
    measurements: Measurements,
    values: Array,
    half_band: Array,
    place: int,
    generator: np.random.Generator,
    vectors: int,
) -> Network:
    """A network for the step of unknown `place` from `values` (p,), trained within `half_band` (p,) around them."""
    here = measurements.predicted(with_values(believed, unknowns, values))
    steps = generator.uniform(-half_band, half_band, (vectors, len(unknowns)))
    noise = _scatter(believed, unknowns, measurements, values)
    rows = [measurements.predicted(with_values(believed, unknowns, values + step)) - here for step in steps]
    inputs = np.stack(rows) + generator.normal(0.0, noise, (vectors, len(here)))
    trained_on = {
        f"{one.key}_{one.unit}": f"{value - half:.4g} to {value + half:.4g}"
        for one, value, half in zip(unknowns, values.tolist(), half_band.tolist(), strict=True)
    }
    name = unknowns[place].key
    seed = int(generator.integers(2**31))
    return train(name, inputs, {name: steps[:, place]}, trained_on=trained_on, seed=seed, noise=noise)


def _scatter(believed: Believed, unknowns: Sequence[Unknown], measurements: Measurements, values: Array) -> float:
    """Standard deviation, m, of that part of the deviations that no unknown explains, to first order at `values`."""
    deviation = measurements.observed - measurements.predicted(with_values(believed, unknowns, values))
    axes, _ = np.linalg.qr(sensitivity(believed, unknowns, measurements, values))
    left = deviation - axes @ (axes.T @ deviation)
    return float(np.sqrt(np.square(left).sum() / freedom_of(len(left), len(unknowns))))


def _spread(networks: Sequence[Network], inputs: int, scatter: float, generator: np.random.Generator) -> Array:
    """Standard deviations (p,) of what the networks make of the nominal machine measured with noise `scatter`, m."""
    noise = generator.normal(0.0, scatter, (REPETITIONS, inputs))
    return np.asarray(np.hstack([network.estimate(noise) for network in networks]).std(axis=0))
