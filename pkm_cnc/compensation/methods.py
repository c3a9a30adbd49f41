"""The methods: from what a run shows to the correction of the contour that the next run is to have.

| method | source | knows | passes |
|---|---|---|---|
| mirror | thesis 7.2 | the contour error | any number |
| ilc | inversion-based iterative learning, Bristow, Tharayil, Alleyne 2006 | drives' positions; a model | any number |
| inverse | inverse compensation filter, Weck and Ye 1990, in joint space | a model of the drives | one |
| zpetc | zero phase error tracking, Tomizuka 1987, in joint space | a model of the drives | one |

All look for a correction across the contour: the tool's lag along its path is no contour error, and stays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.compensation.correction import SMOOTH, Correction, across, product
from pkm_cnc.compensation.drive_inverse import drive_inverse
from pkm_cnc.compensation.mirror import mirrored
from pkm_cnc.compensation.observation import Observation, tangents_at
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.program import Toolpath

__all__ = ["METHODS", "Method", "Situation"]

Array = NDArray[np.float64]


class Situation(NamedTuple):
    """What a method is given: the contour, the model, the correction so far and the runs that had it.

    `gain` is what is taken of a correction that is learnt (damping below 1), `cutoff` (Hz) that of the filters F.
    """

    contour: Toolpath
    model: Setup
    correction: Correction
    runs: list[Observation]
    gain: float
    cutoff: float


class Learn(Protocol):
    """The next correction."""

    def __call__(self, situation: Situation) -> Correction:
        """Raises InputError where the model cannot be used."""


class Method(NamedTuple):
    """`learns`: it looks at the errors, so that it may be repeated and may take them from bags."""

    learn: Learn
    learns: bool


def _mirror(situation: Situation) -> Correction:
    """c += gain * d, d the change that the drives turn into the errors' mirror image."""
    tangents = [
        tangents_at(situation.contour, run.error_vectors()[0], [error.segment for error in run.errors])
        for run in situation.runs
    ]
    found = mirrored(situation.model, situation.correction, situation.runs, tangents)
    return situation.correction.plus(found.plus(situation.correction, -1.0), situation.gain)


def _ilc(situation: Situation) -> Correction:
    """c += gain * J^-1 L J e, e the part of P[k] - actual TCP[k + m] across the contour.

    P is the place on the original contour. The learning filter L is the inverse of the drives. The part along the path
    is left out before it: it stays, and the filter would bring some of it across. What is fitted is c, not its change:
    where nothing is learnt, near stops, it is the smooth way between what is learnt and zero, however many passes.
    """
    inverse = drive_inverse(situation.model)
    machine = situation.model.machine
    places, wanted = [], []
    for run in situation.runs:
        late = _delayed(run.actual, _delay(run))
        tangents = tangents_at(situation.contour, run.s)
        corrected = situation.correction.at(run.s)
        missing = across(run.setpoint - corrected - machine.forward(late), tangents)
        asked = inverse.learning(product(machine.jacobian(run.setpoint), missing), situation.cutoff)
        change = across(product(machine.inverse_jacobian(run.setpoint), asked), tangents)
        learnt = situation.correction.settled(run.s)
        places.append(run.s[learnt])
        wanted.append((corrected + situation.gain * change)[learnt])
    return Correction.fitted(situation.correction.spans, np.concatenate(places), np.concatenate(wanted), SMOOTH)


def _delay(run: Observation) -> float:
    """By how many cycles the drives follow their setpoints, all together, by least squares."""
    steps = np.gradient(run.joints, axis=0)
    return float(((run.joints - run.actual) * steps).sum() / (steps * steps).sum())


def _delayed(series: Array, delay: float) -> Array:
    """`series` (n, m) so many cycles later; at its end it rests."""
    count = len(series)
    places = np.minimum(np.arange(count) + delay, count - 1.0)
    return np.stack([np.interp(places, np.arange(count), column) for column in series.T], axis=1)


def _inverse(situation: Situation) -> Correction:
    """u' = (1 + F (1/G - 1)) u: what of 1/G is slow enough for F."""
    inverse = drive_inverse(situation.model)
    return _by_joints(situation, lambda joints: inverse.inverse(joints, situation.cutoff))


def _zpetc(situation: Situation) -> Correction:
    """u' = (Z / G) u: all poles and the zeros that allow it cancelled, the phase of the others."""
    return _by_joints(situation, drive_inverse(situation.model).zero_phase)


def _by_joints(situation: Situation, filtered: Callable[[Array], Array]) -> Correction:
    run = situation.runs[0]
    if situation.correction.size() > 0.0:
        raise InputError("the program is compensated already: this method starts from the original")
    try:
        wanted = situation.model.machine.forward(filtered(run.joints))
    except UnreachableError as error:
        raise InputError(f"the inverse of the drives asks for a place out of reach: {error}") from None
    change = across(wanted - run.setpoint, tangents_at(situation.contour, run.s))
    learnt = situation.correction.settled(run.s)
    return Correction.fitted(situation.correction.spans, run.s[learnt], change[learnt], SMOOTH)


METHODS: dict[str, Method] = {
    "mirror": Method(_mirror, learns=True),
    "ilc": Method(_ilc, learns=True),
    "inverse": Method(_inverse, learns=False),
    "zpetc": Method(_zpetc, learns=False),
}
"""By the name that --method takes."""
