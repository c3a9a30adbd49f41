"""The preprocessor: a part program in, a part program out that takes the tool to where the first one said.

Each pass writes the compensated program, reads it back as the controller will, and looks at a run of that: what it
predicts is what its file does, with everything that the file and the planner add.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pkm_cnc.bag import Run
from pkm_cnc.check import prepare
from pkm_cnc.compensation.correction import Correction, across, spans_of
from pkm_cnc.compensation.methods import METHODS, Method, Situation
from pkm_cnc.compensation.nominal import model_of, nominal
from pkm_cnc.compensation.observation import (
    ErrorFigures,
    Observation,
    judged,
    observe,
    recorded,
    setpoints_of,
    tangents_at,
    toolpath_of,
    tracker_of,
)
from pkm_cnc.compensation.writer import compensated_program
from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError, MachineFault, UnreachableError
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Program, Toolpath, carried_original
from pkm_cnc.records import ContourError

__all__ = ["Compensated", "CompensationOptions", "Pass", "compensate"]

SLOWER = 0.01
"""1. A compensated program may be slower than the original by this part of its feed before it is refused: the error
that it is made for goes with the square of the speed."""

RECORDS = 10_000
"""New objects that the garbage collector waits for before it looks for garbage among them: a pass makes ten times as
many records and no garbage that needs it, and looking costs a fifth of the time."""


TANGENT = 1e-6
"""1. Distance of unit tangents that are the same."""


@dataclass(frozen=True)
class CompensationOptions:
    """How a program is compensated; lengths in mm and um, as the command line takes them."""

    iterations: int = parameter(5, "most passes over the model; from bags it is one", minimum=1, maximum=100)
    until_um: float = parameter(
        0.01, "passes end when the largest contour error changes by less than this", unit="um", minimum=0.0
    )
    gain: float = parameter(
        1.0,
        "part that is taken of the correction that a pass finds (mirror, ilc): 1 = all, less = slower, and safer where "
        "the machine is not repeatable",
        above=0.0,
        maximum=1.0,
    )
    cutoff_hz: float = parameter(
        20.0,
        "cut-off (-3 dB) of the low-pass F of ilc and inverse, Gaussian and without phase; far above what contours "
        "ask of drives and far below half the servo rate",
        unit="Hz",
        above=0.0,
        maximum=1000.0,
    )
    spacing: float = parameter(
        0.25,
        "distance of the knots of the correction along the path, in distances v/Kv by which the tool lags at the feed: "
        "details below twice that are taken for noise, and drives pass little of what is shorter than one",
        unit="lags",
        minimum=0.02,
        maximum=10.0,
    )
    tolerance_um: float = parameter(
        0.01,
        "largest distance of the written lines and arcs from the corrected contour",
        unit="um",
        minimum=1e-4,
        maximum=1000.0,
    )


@dataclass(frozen=True)
class Pass:
    """What one pass leads to: the correction's largest coefficient, m, the errors predicted with it, and the largest of
    them, m, away from stops and what is too tight, where the passes are judged.
    """

    correction: float
    figures: ErrorFigures
    settled: float


@dataclass(frozen=True)
class Compensated:
    """The compensated program, the errors before it and after every pass; `passes[chosen]` is that of `program`.

    `untouched`: the lines of the original with feed motions of which nothing is compensated, because they are too near
    to stops or too tight for the drives.
    """

    program: Program
    toolpath: Toolpath
    before: ErrorFigures
    settled_before: float
    passes: tuple[Pass, ...]
    chosen: int
    untouched: tuple[int, ...]

    @property
    def after(self) -> ErrorFigures:
        """The errors predicted for `program`."""
        return self.passes[self.chosen].figures


@contextmanager
def _many_records() -> Iterator[None]:
    """Lets the garbage collector wait for RECORDS, and linear algebra do with one thread.

    No result shall depend on the number of threads, and its small matrices are faster so.
    """
    before = gc.get_threshold()
    gc.set_threshold(RECORDS, *before[1:])
    try:
        with threadpool_limits(1):
            yield
    finally:
        gc.set_threshold(*before)


@_many_records()
def compensate(
    setup: Setup,
    program: Program,
    method: str = "mirror",
    *,
    model: Setup | None = None,
    bags: Sequence[Run] = (),
    options: CompensationOptions | None = None,
) -> Compensated:
    """The compensated program for a machine as its controller knows it (`setup`).

    The errors are those of runs of the machine that `model` describes (`model_of`; default: `setup` as its controller
    knows it) or, where `bags` are given, those recorded there, taken together. A program that is compensated already is
    compensated further. Raises InputError for what cannot be compensated, with the reason.
    """
    believed = nominal(setup) if model is None else model_of(setup, model)
    work = _Work(setup, program, METHODS[method], believed, options or CompensationOptions())
    if bags:
        if not work.method.learns:
            raise InputError(f"--method {method} does not look at errors: it has no use for a bag")
        return work.from_bags([recorded(bag, setup, program.text) for bag in bags], method)
    return work.from_model(method)


class _Work:
    """One program on its way through the passes."""

    def __init__(self, setup: Setup, program: Program, method: Method, model: Setup, options: CompensationOptions):
        self.setup, self.model, self.options, self.method = setup, model, options, method
        self.given = program
        self.original = carried_original(program) or program
        prepare(setup, program)
        self.toolpath = toolpath_of(setup, program)
        self.path_of_original = self.toolpath if self.original is program else toolpath_of(setup, self.original)
        self.contour = self.toolpath.contour
        self.kv = min(parts.drive.kv for parts in setup.axes.values())
        self.spans = spans_of(self.contour, setup.motion, self.kv, options.spacing)
        if Correction.none(self.spans).untouched(0.0, self.contour.length):
            raise InputError(
                f"part program {program.name}: nothing to compensate: it has rapids alone, or ways between two stops "
                "that are too short for the tool to leave the one and not yet come to the other (a lower feed helps)"
            )
        self.correction = self._carried()

    def from_model(self, name: str) -> Compensated:
        run = first = self._run(self.given, self.toolpath)
        before, settled = judged(run.errors, self.contour), self._settled(run.errors)
        if not settled > 0.0:
            raise InputError(f"{self.given.name}: nothing to compensate: the model has no contour error")
        correction = self.correction
        done: list[Pass] = []
        chosen, best = -1, (self.given, self.toolpath, run)
        for _ in range(self.options.iterations if self.method.learns else 1):
            correction = self.method.learn(self._situation(correction, [run]))
            program = self._written(correction, f"by {name} from the model")
            toolpath = toolpath_of(self.setup, program)
            run = self._run(program, toolpath)
            last = done[-1].settled if done else settled
            done.append(Pass(correction.size(), judged(run.errors, self.contour), self._settled(run.errors)))
            now = done[-1].settled
            if now < (done[chosen].settled if chosen >= 0 else settled):
                chosen, best = len(done) - 1, (program, toolpath, run)
            if not abs(last - now) > self.options.until_um * 1e-6 or now > 2.0 * last:
                break
        if chosen < 0:
            least = min(one.settled for one in done)
            raise InputError(
                f"{self.given.name}: {name} makes the largest error {least * 1e6:.4g} um from "
                f"{settled * 1e6:.4g} um: a smaller gain or a lower feed helps"
            )
        program, toolpath, run = best
        self._check(program, toolpath, first, run)
        return Compensated(program, toolpath, before, settled, tuple(done), chosen, self._untouched())

    def _untouched(self) -> tuple[int, ...]:
        parts = zip(self.contour.elements, self.contour.starts, strict=True)
        lines = [
            element.line
            for element, start in parts
            if not element.traverse and self.correction.untouched(start, start + element.length)
        ]
        return tuple(dict.fromkeys(lines))

    def _settled(self, errors: Sequence[ContourError]) -> float:
        """The largest error, m, of what is judged at settled places; of all of them where nothing is judged there.

        Behind stops it is the corner's and stays.
        """
        settled = self.correction.settled(np.array([error.path_length for error in errors]))
        there = [error for error, one in zip(errors, settled.tolist(), strict=True) if one]
        figures = judged(there, self.contour)
        return figures.largest if figures.cycles else max((error.magnitude for error in there), default=0.0)

    def from_bags(self, runs: list[Observation], name: str) -> Compensated:
        """One pass; predicted is what the model says of the change, added to what the bags hold."""
        errors = [error for run in runs for error in run.errors]
        before, settled = judged(errors, self.contour), self._settled(errors)
        if not settled > 0.0:
            raise InputError(f"{self.given.name}: nothing to compensate: the bags have no contour error")
        correction = self.method.learn(self._situation(self.correction, runs))
        program = self._written(correction, f"by {name} from bags: {len(runs)}")
        toolpath = toolpath_of(self.setup, program)
        old, new = self._run(self.given, self.toolpath), self._run(program, toolpath)
        after = self._predicted(runs, old, new)
        self._check(program, toolpath, old, new)
        only = Pass(correction.size(), judged(after, self.contour), self._settled(after))
        return Compensated(program, toolpath, before, settled, (only,), 0, self._untouched())

    def _predicted(self, runs: list[Observation], old: Observation, new: Observation) -> list[ContourError]:
        """The errors of the bags with the change that the model makes of the one program for the other."""
        errors = []
        for run in runs:
            s, vectors = run.error_vectors()
            change = _at(s, *new.error_vectors()) - _at(s, *old.error_vectors())
            for error, (x, y, z) in zip(run.errors, (vectors + change).tolist(), strict=True):
                place = error.path_length - self.contour.starts[error.segment]
                tx, ty, _ = self.contour.elements[error.segment].tangent(place)
                across_plane = np.hypot(tx, ty)
                left = (tx * y - ty * x) / across_plane if across_plane > 0.0 else np.nan
                errors.append(error._replace(x=x, y=y, z=z, left=left, magnitude=float(np.sqrt(x * x + y * y + z * z))))
        return errors

    def _situation(self, correction: Correction, runs: list[Observation]) -> Situation:
        return Situation(self.contour, self.model, correction, runs, self.options.gain, self.options.cutoff_hz)

    def _run(self, program: Program, toolpath: Toolpath) -> Observation:
        try:
            return observe(self.model, program, toolpath)
        except (MachineFault, UnreachableError) as fault:
            raise InputError(f"{self.given.name}: the model cannot run it: {fault}") from None

    def _written(self, correction: Correction, how: str) -> Program:
        text = compensated_program(
            self.original,
            self.path_of_original.items(),
            correction,
            zero=self.setup.program_zero,
            tolerance=self.options.tolerance_um * 1e-6,
            remarks=[f"pkm_cnc: compensated {how} for {self.setup.machine_name}"],
        )
        return Program(self.given.name, text)

    def _carried(self) -> Correction:
        """The correction that the given program has already."""
        if self.original is self.given:
            return Correction.none(self.spans)
        setpoints = setpoints_of(self.setup, self.toolpath)
        points = np.array([point[:3] for point in setpoints])
        errors = tracker_of(self.contour).follow(points, [point.segment for point in setpoints])
        places = np.array([error.path_length for error in errors])
        tangents = tangents_at(self.contour, places, [error.segment for error in errors])
        vectors = across(np.array([error[:3] for error in errors]), tangents)
        return Correction.fitted(self.spans, places, vectors)

    def _check(self, program: Program, toolpath: Toolpath, before: Observation, after: Observation) -> None:
        """The program, like any other, and that it is not slower than the original where the correction is full."""
        try:
            prepare(self.setup, program, toolpath=toolpath)
        except InputError as error:
            raise InputError(f"compensated, {error}") from None
        paces = [self._pace(run) for run in (before, after)]
        steady = self.correction.settled(before.s) & (paces[0] >= 1.0 - SLOWER) & ~self._at_curves(before.s)
        lost = np.where(steady, paces[0] - np.interp(before.s, after.s, paces[1]), 0.0)
        row = int(np.argmax(lost))
        if lost[row] > SLOWER:
            line = self.contour.elements[before.segment[row]].line
            raise InputError(
                f"{self.given.name}:{line}: compensated, the tool would have to slow down by {lost[row] * 100.0:.3g} % "
                "of its feed to keep the limits of TCP and drives (motion, limits): a lower feed leaves them room"
                + (", and so does a larger motion.jerk" if self.setup.motion.jerk > 0.0 else "")
            )
        longer = len(after.s) / len(before.s) - 1.0
        if longer > SLOWER:
            raise InputError(
                f"{self.given.name}: compensated, it would take {longer * 100.0:.3g} % more time to keep the limits of "
                "TCP and drives (motion, limits): a lower feed leaves them room"
            )

    def _at_curves(self, s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which path lengths (n,) are within a lag of a corner that G64 rounds.

        The curve there has the short pieces beside the corner for room where it had whole lines, and is slower for some
        cycles.
        """
        joints = zip(self.contour.elements, self.contour.elements[1:], self.contour.starts[1:], strict=False)
        curves = [
            (place, max(one.feed, two.feed) / self.kv)
            for one, two, place in joints
            if one.path_mode.code == "G64" and math.dist(one.tangent(one.length), two.tangent(0.0)) > TANGENT
        ]
        if not curves:
            return np.zeros(len(s), dtype=bool)
        places, reaches = np.array(curves).T
        nearest = np.searchsorted(0.5 * (places[1:] + places[:-1]), s)
        return np.asarray(np.abs(s - places[nearest]) < reaches[nearest])

    def _pace(self, run: Observation) -> NDArray[np.float64]:
        """How fast the setpoint goes along the contour, (n,), as a part of the programmed feed."""
        feeds = np.array([element.feed for element in self.contour.elements])
        return np.asarray(np.gradient(run.s, self.setup.servo_period) / feeds[run.segment])


def _at(s: NDArray[np.float64], places: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """`vectors` (n, 3) of a run that was at `places` (n,), m, at path lengths `s` (m,)."""
    order = np.argsort(places, kind="stable")
    return np.stack([np.interp(s, places[order], column[order]) for column in vectors.T], axis=1)
