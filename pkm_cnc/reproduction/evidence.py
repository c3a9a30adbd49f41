"""What claims are judged by: runs on machines and findings of experiments, each made once, when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.contour import CirclePath, circle_program, circle_report, star_program
from pkm_cnc.experiments import Findings, Lab, Trial, load_experiment, simulated

__all__ = ["Circle", "Evidence"]

Made = TypeVar("Made")


@dataclass(frozen=True)
class Circle:
    """The data arc of a circular test: its path, and what `evaluate` says of it."""

    path: CirclePath
    report: Mapping[str, Any]


class Evidence:
    """Runs and findings by what they are of; `data` of experiments already run, by name, may be given."""

    def __init__(self, data: Mapping[str, dict[str, Any]] | None = None) -> None:
        self._made: dict[object, Any] = {("experiment", name): found for name, found in (data or {}).items()}

    def setup(self, machine: str, *overrides: str) -> Setup:
        """The machine of the package called `machine`."""
        return self._once(("setup", machine, overrides), lambda: load_setup(machine, overrides))

    def data(self, experiment: str) -> dict[str, Any]:
        """The data of an experiment run with its defaults."""
        return self._once(("experiment", experiment), lambda: self._findings(experiment).data)

    def trial(self, machine: str, program: str, *overrides: str) -> Trial:
        """A run of a part program."""
        return self._once(("trial", machine, program, overrides), lambda: self._run(machine, program, overrides))

    def star(
        self,
        machine: str,
        feed: float,
        headings: Sequence[float],
        *overrides: str,
        pivot: tuple[float, float] = (0.0, 0.0),
        length: float = 200.0,
    ) -> dict[float, dict[str, Any]]:
        """The lines of a star test (mm, mm/min, deg), as `evaluate` says them, by heading as asked for."""

        def run() -> dict[float, dict[str, Any]]:
            trial = self._run(machine, star_program(feed, headings, pivot, length), overrides)
            lines: list[Any] = [entry for entry in trial.evaluation.segments() if entry["kind"] == "line"]
            return dict(zip(headings, lines, strict=True))

        return self._once(("star", machine, feed, tuple(headings), overrides, pivot, length), run)

    def circle(
        self,
        machine: str,
        feed: float,
        radius: float,
        *overrides: str,
        direction: str = "ccw",
        center: tuple[float, float] = (0.0, 0.0),
    ) -> Circle:
        """A circular test in one direction (mm, mm/min)."""

        def run() -> Circle:
            program = circle_program(
                feed_mm_min=feed,
                radius_mm=radius,
                center_mm=center,
                direction=direction,
                overshoot_deg=45.0,
                acceleration_mm_s2=1e3 * self.setup(machine, *overrides).motion.acceleration,
            )
            [path] = self._run(machine, program, overrides).evaluation.circles().values()
            return Circle(path, circle_report(path))

        return self._once(("circle", machine, feed, radius, overrides, direction, center), run)

    def _once(self, key: object, make: Callable[[], Made]) -> Made:
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made

    def _run(self, machine: str, program: str, overrides: Sequence[str]) -> Trial:
        return self._lab(machine).run(self.setup(machine, *overrides), program, "claim.ngc")

    def _findings(self, name: str) -> Findings:
        experiment = load_experiment(name)
        return experiment.run(self._lab(experiment.machine), experiment.options())

    def _lab(self, machine: str) -> Lab:
        return Lab(machine, (), simulated)
