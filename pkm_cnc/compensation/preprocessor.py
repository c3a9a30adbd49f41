"""The preprocessor: a part program in, a part program out that takes the tool to where the first one said.

Each pass writes the compensated program, reads it back as the controller will, and looks at a run of that: what it
predicts is what its file does, with everything that the file and the planner add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    toolpath_of,
)
from pkm_cnc.compensation.writer import compensated_program
from pkm_cnc.config import Setup
from pkm_cnc.contour import ContourTracker
from pkm_cnc.errors import InputError, MachineFault, UnreachableError
from pkm_cnc.parameters import parameter
from pkm_cnc.program import Program, Toolpath, carried_original

__all__ = ["Compensated", "CompensationOptions", "Pass", "compensate"]

SLOWER = 0.005
"""1. A compensated program may be slower than the original by this part of its feed before it is refused: the error
that it is made for goes with the square of the speed."""


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
    spacing_mm: float = parameter(
        2.0,
        "distance of the knots of the correction along the path: details below twice that are taken for noise; it is "
        "a quarter of the distance by which the tool lags at 9000 mm/min",
        unit="mm",
        minimum=0.1,
        maximum=100.0,
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
    """What one pass leads to: the correction's largest coefficient, m, and the errors predicted with it."""

    correction: float
    figures: ErrorFigures


@dataclass(frozen=True)
class Compensated:
    """The compensated program, the errors before it and after every pass; `passes[chosen]` is that of `program`."""

    program: Program
    toolpath: Toolpath
    before: ErrorFigures
    passes: tuple[Pass, ...]
    chosen: int

    @property
    def after(self) -> ErrorFigures:
        """The errors predicted for `program`."""
        return self.passes[self.chosen].figures


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
        self.contour = self.toolpath.contour
        kv = min(parts.drive.kv for parts in setup.axes.values())
        self.spans = spans_of(self.contour, setup.motion, kv, options.spacing_mm * 1e-3)
        if not self.spans:
            raise InputError(f"part program {program.name}: it has rapids alone: nothing to compensate")
        self.correction = self._carried()

    def from_model(self, name: str) -> Compensated:
        run = first = self._run(self.given)
        before = judged(run.errors, self.contour)
        correction, done = self.correction, []
        best: tuple[float, Program, Observation] | None = None
        for _ in range(self.options.iterations if self.method.learns else 1):
            correction = self.method.learn(self._situation(correction, [run]))
            program = self._written(correction, f"by {name} from the model")
            run = self._run(program)
            done.append(Pass(correction.size(), judged(run.errors, self.contour)))
            size = done[-1].figures.largest
            last = done[-2].figures.largest if len(done) > 1 else before.largest
            if best is None or size < best[0]:
                best = (size, program, run)
            if not abs(last - size) > self.options.until_um * 1e-6 or size > 2.0 * last:
                break
        assert best is not None
        if best[0] > before.largest:
            raise InputError(
                f"{self.given.name}: {name} makes the largest error {best[0] * 1e6:.4g} um from "
                f"{before.largest * 1e6:.4g} um: a smaller gain or a lower feed helps"
            )
        chosen = next(place for place, one in enumerate(done) if one.figures.largest == best[0])
        return Compensated(best[1], self._checked(best[1], first, best[2]), before, tuple(done), chosen)

    def from_bags(self, runs: list[Observation], name: str) -> Compensated:
        """One pass; predicted is what the model says of the change, added to what the bags hold."""
        errors = [error for run in runs for error in run.errors]
        before = judged(errors, self.contour)
        correction = self.method.learn(self._situation(self.correction, runs))
        program = self._written(correction, f"by {name} from bags: {len(runs)}")
        old, new = self._run(self.given), self._run(program)
        figures = self._predicted(runs, old, new)
        toolpath = self._checked(program, old, new)
        return Compensated(program, toolpath, before, (Pass(correction.size(), figures),), 0)

    def _predicted(self, runs: list[Observation], old: Observation, new: Observation) -> ErrorFigures:
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
        return judged(errors, self.contour)

    def _situation(self, correction: Correction, runs: list[Observation]) -> Situation:
        return Situation(self.contour, self.model, correction, runs, self.options.gain, self.options.cutoff_hz)

    def _run(self, program: Program) -> Observation:
        try:
            return observe(self.model, program)
        except (MachineFault, UnreachableError) as fault:
            raise InputError(f"{self.given.name}: the model cannot run it: {fault}") from None

    def _written(self, correction: Correction, how: str) -> Program:
        text = compensated_program(
            self.original,
            toolpath_of(self.setup, self.original).items(),
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
        tracker = ContourTracker()
        for index, (element, start) in enumerate(zip(self.contour.elements, self.contour.starts, strict=True)):
            tracker.add(index, element, start)
        setpoints = setpoints_of(self.setup, self.toolpath)
        errors = [tracker.step((point.x, point.y, point.z), point.segment) for point in setpoints]
        tangents = np.array(
            [
                self.contour.elements[error.segment].tangent(error.path_length - self.contour.starts[error.segment])
                for error in errors
            ]
        )
        vectors = across(np.array([error[:3] for error in errors]), tangents)
        places = np.array([error.path_length for error in errors])
        return Correction.fitted(self.spans, places, vectors)

    def _checked(self, program: Program, before: Observation, after: Observation) -> Toolpath:
        """The toolpath, checked like any other, and where the correction is full not slower than the original."""
        try:
            prepare(self.setup, program)
        except InputError as error:
            raise InputError(f"compensated, {error}") from None
        steady = self.correction.settled(before.s) & (before.reached >= 1.0 - SLOWER)
        lost = np.where(steady, before.reached - np.interp(before.s, after.s, after.reached), 0.0)
        row = int(np.argmax(lost))
        if lost[row] > SLOWER:
            line = self.contour.elements[before.segment[row]].line
            raise InputError(
                f"{self.given.name}:{line}: compensated, the tool would have to slow down by {lost[row] * 100.0:.3g} % "
                "of its feed to keep the limits of TCP and drives (motion, limits): a lower feed leaves them room"
            )
        return toolpath_of(self.setup, program)


def _at(s: NDArray[np.float64], places: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """`vectors` (n, 3) of a run that was at `places` (n,), m, at path lengths `s` (m,)."""
    order = np.argsort(places, kind="stable")
    return np.stack([np.interp(s, places[order], column[order]) for column in vectors.T], axis=1)
