"""The words of a block: which are known, what each means, and which exclude one another."""

from __future__ import annotations

from pkm_cnc.program.blocks import Block
from pkm_cnc.program.toolpath import EventKind

__all__ = ["ARCS", "EVENTS", "FEED", "TRAVERSE", "words_by_meaning"]

TRAVERSE, FEED, ARC_CW, ARC_CCW, NO_MOTION = 0.0, 1.0, 2.0, 3.0, 80.0
ARCS = (ARC_CW, ARC_CCW)

_GROUPS: dict[str, dict[str, tuple[float, ...]]] = {
    "G": {
        "non-modal": (4.0, 28.0, 30.0, 53.0, 92.0, 92.1),
        "motion": (TRAVERSE, FEED, ARC_CW, ARC_CCW, NO_MOTION),
        "plane": (17.0, 18.0, 19.0),
        "units": (20.0, 21.0),
        "cutter compensation": (40.0,),
        "tool length": (49.0,),
        "coordinate system": (54.0,),
        "path mode": (61.0, 61.1, 64.0),
        "distance mode": (90.0, 91.0),
        "arc distance mode": (90.1, 91.1),
        "feed mode": (94.0,),
    },
    "M": {
        "stop": (0.0, 1.0, 2.0, 30.0),
        "tool change": (6.0,),
        "spindle": (3.0, 4.0, 5.0),
        "coolant": (7.0, 8.0, 9.0),
    },
}
_MEANINGS = {(letter, code): group for letter in _GROUPS for group, codes in _GROUPS[letter].items() for code in codes}
_VALUES = frozenset("FIJKPQRSTXYZ")

EVENTS: dict[float, EventKind] = {
    0.0: "program_stop",
    1.0: "optional_stop",
    2.0: "program_end",
    30.0: "program_end",
    3.0: "spindle_clockwise",
    4.0: "spindle_counterclockwise",
    5.0: "spindle_stop",
    6.0: "tool_change",
    7.0: "mist_on",
    8.0: "flood_on",
    9.0: "coolant_off",
}
"""The events that M words make."""

_ABSENT = {letter: f"axis {letter}" for letter in "ABCUVW"} | {"D": "cutter compensation", "H": "tool length"}


def words_by_meaning(block: Block) -> dict[str, float]:
    """The block's numbers by letter or, for G and M, by modal group.

    Raises ProgramError for a word that is not known, and for two words of one meaning; but G80, which most programs
    write beside the motion they begin with, gives way to that (so does LinuxCNC).
    """
    words: dict[str, float] = {}
    for letter, number in block.words:
        meaning = letter if letter in _VALUES else _MEANINGS.get((letter, number))
        if meaning is None:
            raise block.error(_why_not_known(letter, number))
        if meaning in words:
            if meaning == "motion" and NO_MOTION in (number, words[meaning]):
                words[meaning] = number if words[meaning] == NO_MOTION else words[meaning]
                continue
            if meaning in _VALUES:
                raise block.error(f"two {letter} words")
            both = f"{letter}{words[meaning]:g} and {letter}{number:g}"
            raise block.error(f"{both} are of one modal group ({meaning}), only one is allowed in a block")
        words[meaning] = number
    return words


def _why_not_known(letter: str, number: float) -> str:
    if letter == "N":
        return "N word not at the start of the block"
    spelled = f"{letter}{number:.12g} is not supported"
    if letter in _GROUPS:
        known = sorted(code for one, code in _MEANINGS if one == letter)
        return f"{spelled} (known: {' '.join(f'{letter}{code:g}' for code in known)})"
    return f"{spelled}: there is no {_ABSENT[letter]}" if letter in _ABSENT else spelled
