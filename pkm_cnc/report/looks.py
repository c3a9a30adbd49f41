"""How the curves of a figure look, on paper and on the screen alike: told apart by tone, dashes and markers."""

from __future__ import annotations

from typing import NamedTuple

from pkm_cnc.report.figure import Curve, Figure

__all__ = ["Look", "looks"]


class Look(NamedTuple):
    """Colour, width (pt), dashes (lengths of line and gap, pt; none = solid), marker by matplotlib's and plotly's name.

    An open marker is drawn as its outline.
    """

    color: str
    width: float
    dashes: tuple[float, ...]
    marker: tuple[str, str]
    open: bool


PROGRAMMED = Look("#595959", 0.8, (), ("o", "circle"), False)
ASIDE = Look("#a6a6a6", 0.9, (), ("o", "circle"), False)
SCALE = Look("#9a9a9a", 0.6, (1.5, 2.0), ("o", "circle"), False)
OTHERS = {"programmed": PROGRAMMED, "aside": ASIDE, "scale": SCALE}
DATA = (
    Look("#0b4f8a", 1.4, (), ("o", "circle"), False),
    Look("#d9730d", 1.4, (6.0, 2.0), ("s", "square"), True),
    Look("#000000", 1.0, (12.0, 3.0), ("D", "diamond"), True),
    Look("#d660a8", 1.6, (1.5, 1.5), ("v", "triangle-down"), True),
    Look("#1d6b3f", 1.4, (8.0, 2.0, 1.5, 2.0), ("^", "triangle-up"), False),
    Look("#6aaee6", 2.2, (), ("x", "x"), False),
    Look("#6b5400", 1.4, (4.0, 1.5, 1.0, 1.5, 1.0, 1.5), ("P", "cross"), False),
    Look("#9c9c9c", 1.8, (3.0, 1.0), ("*", "star"), True),
)
"""In the order in which names take them; dark and light alternate, so that neighbours differ in grey."""

SHADE = 0.13
"""Opacity of an area."""
DARKEST = 0.3
"""Where the colours of maps begin on the scale "viridis": above it black lines and numbers stay readable, and lightness
rises all the way, so that a map is read in grey too."""


def looks(figure: Figure) -> list[list[Look]]:
    """The look of every curve, by panel: a name has one look in the whole figure."""
    by_name: dict[str, Look] = {}
    last = DATA[0]

    def look(curve: Curve) -> Look:
        nonlocal last
        if curve.role != "data":
            return OTHERS[curve.role]
        name = curve.like or curve.name
        if name:
            last = by_name.setdefault(name, DATA[len(by_name) % len(DATA)])
        return last

    return [[look(curve) for curve in panel.curves] for panel in figure.panels]
