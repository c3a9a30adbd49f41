"""Pictures of a run, as SVG for documents and PNG for a quick look; equal runs give equal files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from pkm_cnc.evaluation import Evaluation
from pkm_cnc.report.circle_picture import circle_figure, circle_tests
from pkm_cnc.report.drawing import save, style
from pkm_cnc.report.path_picture import path_figure
from pkm_cnc.report.star_picture import star_figure, stars

__all__ = ["draw"]


def draw(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write the pictures of a run to `folder`, which is made if it does not exist; return their paths.

    star.* for lines through one point, circle.* for full circles (numbered where there are several), contour_error.*
    for every run. Raises InputError where `folder` cannot be written.
    """
    paths: list[Path] = []
    with style():
        for name, figure in _figures(evaluation):
            paths += save(figure, folder, name)
    return paths


def _figures(evaluation: Evaluation) -> Iterator[tuple[str, Figure]]:
    star_tests, circles = stars(evaluation), circle_tests(evaluation)
    for number, star in enumerate(star_tests, 1):
        yield f"star-{number}" if len(star_tests) > 1 else "star", star_figure(evaluation, star)
    for number, paths in enumerate(circles, 1):
        yield f"circle-{number}" if len(circles) > 1 else "circle", circle_figure(evaluation, paths)
    yield "contour_error", path_figure(evaluation)
