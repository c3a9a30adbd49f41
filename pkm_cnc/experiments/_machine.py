"""What the experiments in the plane ask of a machine."""

from __future__ import annotations

from collections.abc import Sequence

from pkm_cnc.config import Setup
from pkm_cnc.errors import InputError

__all__ = ["place", "points", "require_plane", "resting"]

AT_REST = 1e-9
"""m. What a line begins with from the motion before: on the judged part 1e-12 m or less is left of it."""


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


def resting(setup: Setup) -> list[str]:
    """Overrides by which every motion begins at rest, so that lines do not depend on those before them.

    None for scales with a resolution: with them the TCP need not come to rest.
    """
    if any(parts.scale.resolution > 0.0 for parts in setup.axes.values()):
        return []
    return ["motion.wait_in_position=true", f"motion.in_position_tolerance={AT_REST}"]
