"""Real part programs: each is read as the peer read it, or refused where the peer refuses it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from pkm_cnc.program import ProgramError, canonical_motion, read_motions, read_program

DECIMALS = 5e-5
"""In the program's length unit: a .canon has four decimals."""
START = (0.0, 0.0, 0.0)
UNITS = {"CANON_UNITS_MM": 1.0, "CANON_UNITS_INCHES": 25.4}
AXES = {"xy": (0, 1, 2), "zx": (2, 0, 1), "yz": (1, 2, 0)}
"""Index of the first axis, the second and the normal of a plane."""
PLANES = {"CANON_PLANE_XY": "xy", "CANON_PLANE_XZ": "zx", "CANON_PLANE_YZ": "yz"}

FAULTY = {"bad-arc": "radii disagree", "no-feed-rate": "needs a feed"}
"""What the peer refuses, and why."""


class Motion(NamedTuple):
    """One motion of a .canon in its own unit (`unit` mm); an arc has a plane, a center in it, and turns."""

    kind: str
    end: tuple[float, ...]
    feed: float
    unit: float
    plane: str = ""
    center: tuple[float, ...] = ()
    turns: int = 0


def _motions_of_canon(path: Path) -> list[Motion]:
    motions: list[Motion] = []
    feed, unit, plane = 0.0, 1.0, "xy"
    for name, text in re.findall(r"^ *N\S+ (\w+)\((.*)\)$", path.read_text(encoding="utf-8"), re.MULTILINE):
        arguments = [argument.strip() for argument in text.split(",")]
        if name == "USE_LENGTH_UNITS":
            feed, unit = feed * unit / UNITS[arguments[0]], UNITS[arguments[0]]
        elif name == "SELECT_PLANE":
            plane = PLANES[arguments[0]]
        elif name == "SET_FEED_RATE":
            feed = float(arguments[0])
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            end = tuple(map(float, arguments[:3]))
            motions.append(Motion(name.removeprefix("STRAIGHT_").lower(), end, feed, unit))
        elif name == "ARC_FEED":
            first, second, *center, turns, axial = map(float, arguments[:6])
            by_axis = dict(zip(AXES[plane], (first, second, axial), strict=True))
            end = (by_axis[0], by_axis[1], by_axis[2])
            motions.append(Motion("arc", end, feed, unit, plane, tuple(center), int(turns)))
    return motions


def _read(path: Path) -> list[dict[str, Any]]:
    return canonical_motion(read_motions(read_program(path), start=START, zero=START, rapid=0.1), START)


def _assert_same(motion: dict[str, Any], peer: Motion) -> None:
    def in_unit(*values: float) -> tuple[float, ...]:
        return tuple(value / peer.unit for value in values)

    assert motion["kind"] == peer.kind
    assert in_unit(*motion["end_mm"]) == pytest.approx(peer.end, abs=DECIMALS)
    if peer.kind != "traverse":
        assert in_unit(motion["feed_mm_min"]) == pytest.approx((peer.feed,), abs=DECIMALS)
    if peer.kind == "arc":
        assert (motion["plane"], motion["turns"]) == (peer.plane, peer.turns)
        first, second, _ = AXES[peer.plane]
        center = in_unit(motion["center_mm"][first], motion["center_mm"][second])
        assert center == pytest.approx(peer.center, abs=DECIMALS)


def test_read_as_the_peer_read_it_or_refused_as_it_refuses(program: Path) -> None:
    reason = next((reason for name, reason in FAULTY.items() if program.name.startswith(name)), None)
    if reason is None:
        motions, expected = _read(program), _motions_of_canon(program.with_suffix(".canon"))
        assert len(motions) == len(expected)
        for motion, peer in zip(motions, expected, strict=True):
            _assert_same(motion, peer)
        return
    with pytest.raises(ProgramError, match=reason) as caught:
        _read(program)
    error = caught.value
    assert str(error).startswith(f"{program}:{error.line}: ")
    assert error.block == program.read_text(encoding="utf-8").splitlines()[error.line - 1].strip()


def test_what_must_be_refused_and_arcs_of_every_kind_are_among_them(programs: list[Path]) -> None:
    names = [program.name for program in programs]
    assert all(any(name.startswith(faulty) for name in names) for faulty in FAULTY)
    arcs = [motion for path in programs for motion in _motions_of_canon(path.with_suffix(".canon")) if motion.plane]
    assert {motion.plane for motion in arcs} == set(AXES.keys())
    assert {abs(motion.turns) for motion in arcs} == {1, 2}
