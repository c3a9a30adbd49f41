"""The report of a run: its tables, its pictures, what it was made with."""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.config import Setup
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.circle_picture import circle_figure, circle_tests
from pkm_cnc.report.figure import Figure, Table
from pkm_cnc.report.page import Page
from pkm_cnc.report.path_picture import path_figure
from pkm_cnc.report.star_picture import star_figure, stars
from pkm_cnc.report.tables import run_headline, run_remarks, run_tables

__all__ = ["parameter_tables", "run_figures", "run_page"]


def run_page(evaluation: Evaluation, setup: Setup, command: str) -> Page:
    """The page of a run that `setup` made; `command` made the page."""
    return Page(
        title=f"{evaluation.program_name} on {evaluation.machine}",
        question=f"How far did the tool leave the programmed contour? {run_headline(evaluation)}.",
        command=command,
        tables=run_tables(evaluation),
        figures=run_figures(evaluation),
        remarks=run_remarks(evaluation),
        parameters=parameter_tables(setup),
        data=evaluation.to_json(),
    )


def run_figures(evaluation: Evaluation) -> list[Figure]:
    """star for lines through one point, circle for full circles (numbered where there are several), contour_error."""
    star_tests, circles = stars(evaluation), circle_tests(evaluation)
    return [
        *(star_figure(evaluation, star, _numbered("star", i, star_tests)) for i, star in enumerate(star_tests, 1)),
        *(circle_figure(evaluation, paths, _numbered("circle", i, circles)) for i, paths in enumerate(circles, 1)),
        path_figure(evaluation, "contour_error"),
    ]


def _numbered(name: str, number: int, of: Sequence[object]) -> str:
    return f"{name}-{number}" if len(of) > 1 else name


def parameter_tables(setup: Setup) -> list[Table]:
    """The machine's parameters in SI units: those that differ from the defaults, then the others."""
    columns = ("parameter", "value", "unit", "meaning")
    rows: dict[bool, list[tuple[str, str, str, str]]] = {True: [], False: []}
    for key, (value, spec) in setup.parameters.items():
        text = ", ".join(f"{part:.10g}" for part in value) if isinstance(value, tuple) else str(value)
        rows[value == spec.default].append((key, text, spec.unit, spec.doc))
    titles = {False: "Parameters that differ from their defaults", True: "Parameters at their defaults"}
    return [Table(title, columns, rows[default]) for default, title in titles.items() if rows[default]]
