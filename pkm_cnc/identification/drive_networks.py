"""Identification of drives by neural networks, after thesis section 7.6, of few physical parameters.

A network is trained on what machines with drives varied at random within a band would have shown for the recorded
setpoints, and then fed what was recorded. The thesis' networks estimate nine free coefficients from contour errors,
which tell only about one of them (docs/identification.md); here they estimate the parameters that the data tell
well. As the thesis does after its first iteration, a second network is trained in a
narrower band around the first answer.

`spread` of the result is the standard deviation of the answers to repeated measurements that differ by their noise:
one training, many measurements. The intervals are those of least squares at the networks' values.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError
from pkm_cnc.identification.drive_data import DriveData
from pkm_cnc.identification.drive_identification import (
    DriveFit,
    fit_drives,
    fit_of,
    rms,
    sensitivity,
    steps_model,
    told_unknowns,
)
from pkm_cnc.identification.drive_unknowns import DriveUnknown, drive_setup, drive_values
from pkm_cnc.identification.networks import Network, train

__all__ = ["fit_drives_by_networks"]

Array = NDArray[np.float64]

BAND = (-0.3, 0.3)
"""Steps: the band of training around the values."""
LATE_BAND = (-0.3, 2.0)
"""Steps: the same of how late a velocity loop is, by bandwidth or dead time: mostly more than a file has it."""
LATE = ("velocity_gain", "dead_time")
NARROWER = (1.0, 1.0 / 6.0)
"""1. By iteration: the share of the band."""
TOLD = 0.01
"""Steps. What least squares would know no better than this a network of some hundred examples does not learn."""
VECTORS = 200
"""Machines of one training."""
INPUTS = 4000
"""Largest number of inputs of a network: neighbouring cycles say the same."""
HIDDEN = 12
"""Neurons of the hidden layer."""
REPETITIONS = 200
"""Repeated measurements of which the spread is told."""


def fit_drives_by_networks(
    setup: Setup, unknowns: Sequence[DriveUnknown], data: DriveData, *, seed: int = 0, vectors: int = VECTORS
) -> tuple[DriveFit, tuple[Network, ...]]:
    """Estimate `unknowns` from `data` by networks trained around their values in `setup`; and the networks.

    Equal arguments give equal results. Raises InputError, naming the motion that is missing, if the data tell the
    velocity gain of no drive, and for data outside of the band of training.
    """
    generator = np.random.default_rng(seed)
    with threadpool_limits(1):
        values, observed = drive_values(setup, unknowns), data.observed
        explained = fit_drives(setup, unknowns, data)
        # the resolution of a scale within the loop moves the tool smoothly, which is no noise from one to the next
        noise = max(explained.noise, rms(explained.after))
        tried = [place for place, estimate in enumerate(explained.estimates) if not estimate.left_alone]
        derivative = sensitivity(setup, unknowns, data, values)[:, tried]
        told = told_unknowns([unknowns[place] for place in tried], derivative, noise, data, TOLD)
        kept = [tried[place] for place in told]
        chosen = [unknowns[place] for place in kept]
        rows = np.unique(np.linspace(0, len(observed) - 1, INPUTS).astype(int))
        networks = []
        for share in NARROWER:
            band = share * np.array([LATE_BAND if one.name in LATE else BAND for one in chosen])
            here = data.predicted(drive_setup(setup, unknowns, values))[rows]
            network = _taught(setup, chosen, data, values[kept], rows, band, noise, generator, vectors)
            steps = network.estimate(observed[rows] - here)[0]
            spread = _spread(network, observed[rows] - here, noise, generator)
            spread *= [one.size(value) for one, value in zip(chosen, values[kept].tolist(), strict=True)]
            values[kept] = [
                one.stepped(value, step) for one, value, step in zip(chosen, values[kept], steps.tolist(), strict=True)
            ]
            networks.append(network)
        return fit_of("nn", setup, unknowns, data, values, kept, noise, spread), tuple(networks)


def _taught(
    setup: Setup,
    unknowns: Sequence[DriveUnknown],
    data: DriveData,
    values: Array,
    rows: NDArray[np.intp],
    band: Array,
    noise: float,
    generator: np.random.Generator,
    vectors: int,
) -> Network:
    """A network from the deviations in `rows` to the steps from `values` (p,), trained in the `band` (p, 2), steps."""
    low, high = band.T
    steps = np.asarray(generator.uniform(low, high, (vectors, len(unknowns))))
    here = data.predicted(steps_model(setup, unknowns, values, 0.0 * steps[0]))[rows]
    inputs = np.stack([data.predicted(steps_model(setup, unknowns, values, step))[rows] - here for step in steps])
    inputs += generator.normal(0.0, noise, inputs.shape)
    trained_on = {
        one.key: " to ".join(f"{end:.4g}" for end in sorted(one.stepped(value, way) for way in ways))
        for one, value, ways in zip(unknowns, values.tolist(), band.tolist(), strict=True)
    }
    outputs = {one.key: column for one, column in zip(unknowns, steps.T, strict=True)}
    seed = int(generator.integers(2**31))
    return train(data.name, inputs, outputs, trained_on=trained_on, seed=seed, noise=noise, hidden=HIDDEN)


def _spread(network: Network, measured: Array, noise: float, generator: np.random.Generator) -> Array:
    """Standard deviations (p,), in steps, of the answers to `measured` (m,) with noise anew.

    Of those that the network answers: near the band's edge the noise may carry a measurement beyond it. NaN if that
    are most.
    """
    answers = []
    for repeated in measured + generator.normal(0.0, noise, (REPETITIONS, len(measured))):
        with contextlib.suppress(InputError):
            answers.append(network.estimate(repeated)[0])
    if 2 * len(answers) < REPETITIONS:
        return np.full(len(network.outputs), np.nan)
    return np.asarray(np.std(answers, axis=0))
