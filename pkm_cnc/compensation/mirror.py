"""The mirrored error, asked for where and when the drives make the tool arrive with it.

Thesis 7.2 asks for the error, to the other side, at the error's own place. That is right as far as the correction
hardly bends over the distance v/Kv by which the tool lags: the drives smooth over that distance what they are asked
for. Here the drives' responses are taken into account: with e(t) the errors of a run that had the correction c and R
the response of the tool to a change of it,

    R c' (t) = J(tool)^-1 sum over tau of g(tau) J(setpoint) c'(s(t - tau)),   s(t) the setpoint's place,

the next correction c + d minimises |e + R d|^2 + lambda |second differences of c + d|^2: a least-squares fit over the
knots of every span. Where the drives are not what the model says, what is left is taken away by the next pass, as long
as the phase of the true response is within 90 deg of the model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.compensation.correction import DEGREE, SMOOTH, Correction, Span, across, product
from pkm_cnc.compensation.drive_response import drive_responses
from pkm_cnc.compensation.observation import Observation
from pkm_cnc.compensation.smooth_fit import SmoothFit
from pkm_cnc.config import Setup

__all__ = ["mirrored"]

Array = NDArray[np.float64]

ROUNDS = 2
"""Fits, each of what the one before left: they take one response for all drives and let the Jacobian stand."""
NEGLIGIBLE = 1e-5
"""1. The part of the response that is cut off at its end."""
ROWS = 8
"""Cycles of a knot interval that the fit looks at: neighbouring ones say the same."""


class _Seen(NamedTuple):
    """What one run shows, cycle by cycle (n): place of setpoint and tool, m; errors (n, 3) across the contour, m."""

    asked: Array
    place: Array
    errors: Array
    tangents: Array
    to_joints: Array
    to_tcp: Array

    def responded(self, change: Correction, responses: Array) -> Array:
        """R of `change` (n, 3), m, by the `responses` (axes, taps) of the drives."""
        from scipy.signal import oaconvolve

        joints = product(self.to_joints, change.at(self.asked))
        followed = oaconvolve(joints, responses.T, axes=0)[: len(joints)]
        return across(product(self.to_tcp, followed), self.tangents)


def mirrored(
    model: Setup, correction: Correction, runs: Sequence[Observation], tangents: Sequence[Array]
) -> Correction:
    """The correction of the next run, from `runs` that had `correction`; `tangents[i]` (n, 3) at the tool's places.

    Of `model` the kinematics and the drives count, taken as linear. Raises InputError for drives that are unstable.
    """
    responses = drive_responses(model)
    seen = [_seen(model, run, along) for run, along in zip(runs, tangents, strict=True)]
    common = responses.mean(axis=0)
    kept = int(np.nonzero(np.abs(np.cumsum(common[::-1]))[::-1] > NEGLIGIBLE)[0][-1]) + 1
    fits = [_Fit(span, seen, common[:kept]) for span in correction.spans]
    result = correction
    for _ in range(ROUNDS):
        change = result.plus(correction, -1.0)
        left = [one.errors + one.responded(change, responses) for one in seen]
        parts = zip(fits, result.coefficients, strict=True)
        result = Correction(correction.spans, tuple(fit.improved(coefficients, left) for fit, coefficients in parts))
    return result


def _seen(model: Setup, run: Observation, tangents: Array) -> _Seen:
    place, vectors = run.error_vectors()
    machine = model.machine
    return _Seen(
        run.s,
        place,
        across(vectors, tangents),
        tangents,
        machine.jacobian(run.setpoint),
        machine.inverse_jacobian(machine.forward(run.actual)),
    )


class _Fit:
    """The least-squares fit of one span, of the coefficients that are not zero at its ends.

    Looked at are the cycles from where the tool has left the `run_up` to where the setpoint comes into the `run_out`.
    """

    def __init__(self, span: Span, seen: Sequence[_Seen], response: Array) -> None:
        self._free = span.free
        found = [(index, _rows(span, run, response)) for index, run in enumerate(seen)]
        self._parts = [(index, *part) for index, part in found if part]
        if self._parts:
            weight = SMOOTH * max(1.0, sum(len(rows) for _, rows, _ in self._parts) / span.intervals)
            self._fit = SmoothFit(sum(matrix.T @ matrix for _, _, matrix in self._parts), weight)

    def improved(self, coefficients: Array, left: Sequence[Array]) -> Array:
        """The coefficients (intervals + 3, 3), m, with which nothing is left of the errors `left` (n, 3) of the runs.

        Zero where no run shows anything.
        """
        result = np.zeros_like(coefficients)
        if self._parts:
            found = sum(matrix.T @ left[index][rows] for index, rows, matrix in self._parts)
            result[self._free] = self._fit.improved(coefficients[self._free], -np.asarray(found))
        return result


def _rows(span: Span, run: _Seen, response: Array) -> tuple[NDArray[np.intp], Any] | None:
    """Cycles of `run` that the fit of `span` looks at, and what they show of a unit of each coefficient: R, sparse."""
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_matrix

    inside = np.nonzero((span.begin <= run.asked) & (run.asked <= span.end))[0]
    looked_at = np.nonzero(
        (span.begin + span.run_up <= run.place) & (span.begin <= run.asked) & (run.asked <= span.end - span.run_out)
    )[0]
    rows = looked_at[:: max(1, len(looked_at) // (ROWS * span.intervals))]
    if not len(rows):
        return None
    basis = BSpline.design_matrix(run.asked[inside], span.knots(), DEGREE).tocsc()
    places, columns, values = [], [], []
    free = span.free
    for column in range(free.start, free.stop):
        entries = slice(basis.indptr[column], basis.indptr[column + 1])
        if entries.start == entries.stop:
            continue
        cycles = inside[basis.indices[entries]]
        window = np.zeros(cycles.max() - cycles.min() + 1)
        window[cycles - cycles.min()] = basis.data[entries]
        shown = np.convolve(window, response)
        found = slice(*np.searchsorted(rows, (cycles.min(), cycles.min() + len(shown))))
        places.append(np.arange(found.start, found.stop))
        columns.append(np.full(found.stop - found.start, column - free.start))
        values.append(shown[rows[found] - cycles.min()])
    shape = (len(rows), free.stop - free.start)
    return rows, csr_matrix((np.concatenate(values), (np.concatenate(places), np.concatenate(columns))), shape=shape)
