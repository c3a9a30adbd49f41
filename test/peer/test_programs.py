"""Real part programs: each is read as the peer read it, or refused by name for what this version does not have."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from pkm_cnc.program import ProgramError, canonical_motion, read_motions, read_program

DECIMALS = 5e-5
"""mm or mm/min: a .canon has four decimals."""
START = (0.0, 0.0, 0.0)

FAULTY = {"bad-arc": "radii disagree", "no-feed-rate": "needs a feed"}
"""The peer refuses these too, and why."""
NARROWER = {"good-arc.big": "radii disagree"}
"""Radii of 3001.4 and 2998.6 mm: the peer makes a spiral of what differs by less than 0.1 %, here an arc is an arc."""


class Motion(NamedTuple):
    """One motion of a .canon, mm and mm/min; an arc has a center and turns, + counter-clockwise."""

    kind: str
    end: tuple[float, float, float]
    feed: float
    center: tuple[float, float, float] | None
    turns: int | None


def _motion_of(entry: dict[str, Any]) -> Motion:
    center = tuple(entry["center_mm"]) if "center_mm" in entry else None
    return Motion(entry["kind"], tuple(entry["end_mm"]), entry["feed_mm_min"], center, entry.get("turns"))


def _motions_of_canon(path: Path) -> list[Motion]:
    """The motions of a .canon in millimetres and the X-Y plane; ValueError for a motion in another unit or plane."""
    motions: list[Motion] = []
    feed, z, foreign = 0.0, 0.0, ""
    for name, text in re.findall(r"^.{8}(\w+)\((.*)\)$", path.read_text(encoding="utf-8"), re.MULTILINE):
        arguments = [argument.strip() for argument in text.split(",")]
        if name in ("USE_LENGTH_UNITS", "SELECT_PLANE"):
            foreign = "" if arguments[0] in ("CANON_UNITS_MM", "CANON_PLANE_XY") else text
        elif name == "SET_FEED_RATE":
            feed = float(arguments[0])
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"):
            if foreign:
                raise ValueError(f"{path}: a motion in {foreign}")
            x, y, *others = map(float, arguments)
            if name == "ARC_FEED":
                center_x, center_y, turns, z, *_ = others
                motions.append(Motion("arc", (x, y, z), feed, (center_x, center_y, z), int(turns)))
            else:
                z = others[0]
                motions.append(Motion(name.removeprefix("STRAIGHT_").lower(), (x, y, z), feed, None, None))
    return motions


def _read(path: Path) -> list[Motion]:
    motions = read_motions(read_program(path), start=START, zero=START, rapid=0.1)
    return [_motion_of(entry) for entry in canonical_motion(motions, START)]


def _expected_refusal(program: Path) -> str:
    named = {**FAULTY, **NARROWER}
    return next((reason for name, reason in named.items() if program.name.startswith(name)), "not supported")


def test_read_as_the_peer_read_it_or_refused_by_name(program: Path) -> None:
    refusal = None
    try:
        motions = _read(program)
    except ProgramError as error:
        refusal = error
    if refusal is not None:
        assert str(refusal).startswith(f"{program}:{refusal.line}: ")
        assert refusal.block == program.read_text(encoding="utf-8").splitlines()[refusal.line - 1].strip()
        assert _expected_refusal(program) in refusal.reason
        return
    expected = _motions_of_canon(program.with_suffix(".canon"))
    assert [motion.kind for motion in motions] == [motion.kind for motion in expected]
    for motion, peer in zip(motions, expected, strict=True):
        assert motion.end == pytest.approx(peer.end, abs=DECIMALS)
        assert motion.turns == peer.turns
        if motion.kind != "traverse":
            assert motion.feed == pytest.approx(peer.feed, abs=DECIMALS)
        if peer.center is not None:
            assert motion.center == pytest.approx(peer.center, abs=DECIMALS)


@pytest.mark.parametrize("name", FAULTY)
def test_what_the_peer_refuses_is_refused(programs: list[Path], name: str) -> None:
    (path,) = [program for program in programs if program.name.startswith(name)]
    with pytest.raises(ProgramError, match=FAULTY[name]):
        _read(path)


def test_some_are_read(programs: list[Path]) -> None:
    """Most need inches, planes or words that this version does not have."""
    read = []
    for program in programs:
        try:
            read.append((program.stem, len(_read(program))))
        except ProgramError:
            continue
    assert ("bug424_long", 18) in read
