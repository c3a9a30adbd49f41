"""Which block is next: `%`, block delete, and the O-words (subroutines, conditions, loops), as LinuxCNC has them.

    O1 sub ... O1 return [value] ... O1 endsub [value]        O1 call [argument] [argument] ...
    O1 if [condition] ... O1 elseif [condition] ... O1 else ... O1 endif
    O1 while [condition] ... O1 endwhile    O1 do ... O1 while [condition]    O1 repeat [times] ... O1 endrepeat
    O1 break and O1 continue in a loop, with the loop's label

The label behind the O is a number or a <name>. Constructs lie within each other, never across; a subroutine lies within
nothing and may stand anywhere in the file. No program runs for ever: CALLS_WITHIN and `block_limit` bound it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from pkm_cnc.program.blocks import Block, Control, Program, ProgramError, control_of, read_line
from pkm_cnc.program.expressions import WHOLE, MalformedError, Reader
from pkm_cnc.program.parameters import LOCAL_NUMBERS, ParameterError, Parameters

__all__ = ["executed_blocks"]

CALLS_WITHIN = 10
"""Subroutines that may call one another, or themselves, at a time: LinuxCNC's limit."""

_OPENING = {"SUB", "IF", "WHILE", "DO", "REPEAT"}
_CLOSING = {"ENDSUB": "SUB", "ENDIF": "IF", "ENDWHILE": "WHILE", "ENDREPEAT": "REPEAT"}
_LOOPS = {"WHILE", "DO", "REPEAT"}


@dataclass
class _Construct:
    """From an opening O-word to its closing one: the places (indices of lines) of all of them, in order."""

    kind: str
    label: str
    controls: list[tuple[int, Control]]

    @property
    def begin(self) -> int:
        return self.controls[0][0]

    @property
    def end(self) -> int:
        return self.controls[-1][0]


@dataclass
class _Frame:
    """A running subroutine, or the program itself: where it returns to, and what is left of its repeat loops."""

    return_place: int = 0
    repeats: dict[int, int] = field(default_factory=dict)


def executed_blocks(
    program: Program, parameters: Parameters, *, block_delete: bool, block_limit: int
) -> Iterator[Block]:
    """The blocks of a program that hold anything, in the order in which they are run, each read when it is asked for.

    `block_delete` skips the lines that begin with a slash; otherwise the slash is passed over. `block_limit` is by how
    many lines the program may run more than it has. It ends at the second `%`.
    Raises ProgramError for what has not the form of RS-274 and for a program that exceeds a limit.
    """
    return _Run(program, parameters, block_delete).blocks(block_limit)


class _Run:
    def __init__(self, program: Program, parameters: Parameters, block_delete: bool) -> None:
        self._file = program.name
        self._lines = program.text.split("\n")
        self._parameters = parameters
        self._block_delete = block_delete
        self._constructs: dict[int, _Construct] | None = None
        self._subroutines: dict[str, _Construct] = {}
        self._frames = [_Frame()]

    def blocks(self, block_limit: int) -> Iterator[Block]:
        file, parameters, lines = self._file, self._parameters, self._lines
        begin, end = self._percents()
        left = len(lines) + block_limit
        place = 0
        while place < end:
            text = self._text(place)
            if not text or place == begin:
                place += 1
                continue
            left -= 1
            if left < 0:
                reason = (
                    f"the program has run {block_limit} blocks more than it has lines (program.block_limit): "
                    "does it loop for ever?"
                )
                raise ProgramError(file, place + 1, text, reason)
            parameters.line = place + 1
            item = read_line(file, place + 1, text, parameters)
            if isinstance(item, Block):
                yield item
                place += 1
            else:
                place = self._follow(place, item)

    def _text(self, place: int) -> str:
        text = self._lines[place].strip()
        if text[:1] == "/":
            return "" if self._block_delete else text[1:].strip()
        return text

    def _percents(self) -> tuple[int, int]:
        """The place of the `%` before the program, -1 if there is none, and the place where the program ends."""
        begin = -1
        for place, line in enumerate(self._lines):
            if "%" in line and line.split("(")[0].split(";")[0].strip() == "%":
                if begin >= 0:
                    return begin, place
                begin = place
            elif begin < 0 and line.split("(")[0].split(";")[0].strip():
                break  # a program without; a % later on is refused when it is come to
        return begin, len(self._lines)

    def _follow(self, place: int, control: Control) -> int:
        """Run an O-word: the place of the line to be run next."""
        construct = self._construct(place, control)
        reader = Reader(control.code, self._parameters)
        try:
            following = self._next_place(place, control, construct, reader)
        except (MalformedError, ParameterError) as error:
            raise control.error(str(error)) from None
        if not reader.at_end:
            raise control.error(
                f"{reader.code[reader.place :][:40]!r} does not belong behind {control.keyword.lower()}"
            )
        return following

    def _next_place(self, place: int, control: Control, construct: _Construct, reader: Reader) -> int:
        keyword = control.keyword
        if keyword == "CALL":
            return self._call(place, construct, reader)
        if keyword in ("RETURN", "ENDSUB"):
            return self._return(reader)
        if keyword == "IF":
            return self._branch(construct, reader)
        if keyword in ("ELSEIF", "ELSE"):  # come to from the branch before
            reader.place = len(reader.code)
            return construct.end + 1
        if keyword == "WHILE":
            if construct.kind == "DO":
                return construct.begin + 1 if reader.bracketed() else place + 1
            return place + 1 if reader.bracketed() else construct.end + 1
        if keyword == "ENDWHILE":
            return construct.begin
        if keyword == "REPEAT":
            times = _whole(reader.bracketed(), "the number of repetitions")
            self._frames[-1].repeats[place] = times
            return place + 1 if times > 0 else construct.end + 1
        if keyword == "ENDREPEAT":
            repeats = self._frames[-1].repeats
            repeats[construct.begin] -= 1
            return construct.begin + 1 if repeats[construct.begin] > 0 else place + 1
        if keyword == "CONTINUE":
            return construct.begin if construct.kind == "WHILE" else construct.end
        if keyword in ("BREAK", "SUB"):
            return construct.end + 1
        return place + 1  # do, endif

    def _call(self, place: int, construct: _Construct, reader: Reader) -> int:
        arguments = []
        while reader.next_is("["):
            arguments.append(reader.bracketed())
        if len(arguments) > LOCAL_NUMBERS:
            raise MalformedError(f"{len(arguments)} arguments, at most {LOCAL_NUMBERS} are passed")
        if len(self._frames) > CALLS_WITHIN:
            raise MalformedError(f"more than {CALLS_WITHIN} subroutines called within each other")
        self._frames.append(_Frame(place + 1))
        self._parameters.enter(arguments)
        return construct.begin + 1

    def _return(self, reader: Reader) -> int:
        value = reader.bracketed() if reader.next_is("[") else None
        self._parameters.returned = value
        self._parameters.leave()
        return self._frames.pop().return_place

    def _branch(self, construct: _Construct, reader: Reader) -> int:
        if reader.bracketed():
            return construct.begin + 1
        for place, control in construct.controls[1:]:
            if control.keyword != "ELSEIF":
                return place + 1
            condition = Reader(control.code, self._parameters)
            try:
                value = condition.bracketed()
            except MalformedError as error:
                raise control.error(str(error)) from None
            if not condition.at_end:
                raise control.error(f"{condition.code[condition.place :][:40]!r} does not belong behind elseif")
            if value:
                return place + 1
        raise AssertionError("a condition without endif")

    def _construct(self, place: int, control: Control) -> _Construct:
        """What an O-word belongs to; for a call the subroutine."""
        if self._constructs is None:
            self._constructs = self._read_constructs()
        if control.keyword == "CALL":
            if control.label not in self._subroutines:
                raise control.error(f"there is no subroutine O{control.label.lower()} in the program")
            return self._subroutines[control.label]
        return self._constructs[place]

    def _read_constructs(self) -> dict[int, _Construct]:
        found: dict[int, _Construct] = {}
        open_ones: list[_Construct] = []
        begin, end = self._percents()
        for place in range(begin + 1, end):
            text = self._text(place)
            control = control_of(self._file, place + 1, text) if "O" in text or "o" in text else None
            if control and control.keyword != "CALL":
                found[place] = self._matched(place, control, open_ones)
        if open_ones:
            _, control = open_ones[-1].controls[0]
            raise control.error(f"O{control.label.lower()} {control.keyword.lower()} is not closed")
        return found

    def _matched(self, place: int, control: Control, open_ones: list[_Construct]) -> _Construct:
        """The construct an O-word opens, continues, closes, or leaves; keeps the list of those that are open."""
        keyword, label = control.keyword, control.label
        last = open_ones[-1] if open_ones else None
        closes_do = keyword == "WHILE" and last is not None and (last.kind, last.label) == ("DO", label)
        if keyword in _OPENING and not closes_do:
            construct = _Construct(keyword, label, [(place, control)])
            if keyword == "SUB":
                self._define(control, construct, last)
            open_ones.append(construct)
            return construct
        if keyword in ("BREAK", "CONTINUE", "RETURN"):
            kinds = {"SUB"} if keyword == "RETURN" else _LOOPS
            around = [construct for construct in open_ones if construct.kind in kinds and construct.label == label]
            if not around:
                wanted = "subroutine" if keyword == "RETURN" else "loop"
                raise control.error(f"{keyword.lower()} is not within a {wanted} O{label.lower()}")
            return around[-1]
        opening = "DO" if closes_do else _CLOSING.get(keyword, "IF")
        if last is None or (last.kind, last.label) != (opening, label):
            opened = f"the last one open is O{last.label.lower()} {last.kind.lower()}" if last else "none is open"
            raise control.error(f"{keyword.lower()} without O{label.lower()} {opening.lower()} before it: {opened}")
        if keyword in ("ELSEIF", "ELSE") and last.controls[-1][1].keyword == "ELSE":
            raise control.error(f"{keyword.lower()} after else")
        last.controls.append((place, control))
        if keyword not in ("ELSEIF", "ELSE"):
            open_ones.pop()
        return last

    def _define(self, control: Control, construct: _Construct, around: _Construct | None) -> None:
        if around:
            raise control.error(f"a subroutine within O{around.label.lower()} {around.kind.lower()}")
        if control.label in self._subroutines:
            first = self._subroutines[control.label].controls[0][1].line
            raise control.error(f"subroutine O{control.label.lower()} was defined before, in line {first}")
        self._subroutines[control.label] = construct


def _whole(value: float, name: str) -> int:
    if abs(value - round(value)) > WHOLE:
        raise MalformedError(f"{name}, {value:g}, is not a whole number")
    return round(value)
