"""What the experiments in the plane ask of a machine."""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError

__all__ = ["place", "points", "require_plane"]


def require_plane(setup: Setup, experiment: str) -> None:
    """Raise InputError, saying why, if the machine does not move its TCP in x and y."""
    moved = setup.kinematics.coordinates
    if not {"x", "y"} <= set(moved):
        raise InputError(
            f"experiment {experiment}: it needs a machine that moves its TCP in x and y; "
            f"{setup.machine_name} moves it in {' and '.join(moved)} only"
        )


def points(numbers: Sequence[float]) -> list[tuple[float, float]]:
    """The points (x, y) of an option that lists them one after the other."""
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def place(point: tuple[float, float]) -> str:
    """A point of the plane as a text, mm."""
    return f"{point[0]:g} {point[1]:g} mm"
