"""A part program as text, and as blocks: one line, one block of words and comments.

The form is that of RS-274 (NIST RS274/NGC version 3, section 3): any case, blanks of no meaning outside comments (even
within a number), comments in parentheses between words or after a semicolon. Most blocks of most programs are letters
and numbers alone; they are read by one regular expression, the others by `expressions.Reader`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from pkm_cnc.errors import InputError
from pkm_cnc.program.expressions import WHOLE, MalformedError, Reader
from pkm_cnc.program.parameters import Key, ParameterError, Parameters

__all__ = [
    "Block",
    "Control",
    "Program",
    "ProgramError",
    "Word",
    "control_of",
    "program_from_bytes",
    "read_line",
    "read_program",
]

Word = tuple[str, float]
"""A letter, upper case, and its number."""

LARGEST_NUMBER = 1e9
"""A thousand kilometres in mm: up to there a float still tells coordinates 1 nm apart."""

_COMMENT = re.compile(r"(\([^()]*\)|;.*)")
_WORD = r"([A-NP-Za-np-z])([-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+))"
_ONE_WORD = re.compile(_WORD)
_ALL_WORDS = re.compile(f"(?:{_WORD})*")
_LINE_NUMBER = re.compile(r"[Nn]([0-9]+(?:\.[0-9]*)?)")
_COMPUTED = re.compile(r"[#\[\]=<>]")
_CONTROL = re.compile(
    r"O([0-9]+|<[^<>]+>)(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE)"
)


@dataclass(frozen=True)
class Program:
    """A part program: the name it is known by in messages, and its text."""

    name: str
    text: str


class ProgramError(InputError):
    """A block of a part program that cannot be run: `file`, `line` (from 1), `block` (its text), `reason`."""

    def __init__(self, file: str, line: int, block: str, reason: str) -> None:
        shown = block if len(block) <= 100 else block[:97] + "..."
        super().__init__(f"{file}:{line}: {reason}: {shown!r}")
        self.file, self.line, self.block, self.reason = file, line, block, reason


class Block(NamedTuple):
    """One line of a part program: where it stands, its text, its words in order and its comments as written."""

    file: str
    line: int
    text: str
    number: float | None
    """The N word, which means nothing to the machine."""
    words: tuple[Word, ...]
    comments: tuple[str, ...]

    def error(self, reason: str) -> ProgramError:
        """The error that refuses this block."""
        return ProgramError(self.file, self.line, self.text, reason)


def read_program(path: str | PathLike[str]) -> Program:
    """Read a part program (UTF-8). Raises InputError for a file that is missing, unreadable or no text."""
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"part program {path}: {error.strerror}") from None
    return program_from_bytes(str(path), content)


def program_from_bytes(name: str, content: bytes) -> Program:
    """The part program that a file's content is (UTF-8), known as `name`. Raises InputError for what is no text."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = content[error.start]
        raise InputError(f"part program {name}: not a text file: byte 0x{byte:02x} at offset {error.start}") from None
    if "\0" in text:
        raise InputError(f"part program {name}: not a text file: byte 0x00 at offset {content.index(0)}")
    return Program(name, text.replace("\r\n", "\n").replace("\r", "\n"))


class Control(NamedTuple):
    """A block with an O-word: where it stands, its text, label, keyword, and the code behind them, not yet read."""

    file: str
    line: int
    text: str
    label: str
    keyword: str
    code: str

    def error(self, reason: str) -> ProgramError:
        """The error that refuses this block."""
        return ProgramError(self.file, self.line, self.text, reason)


def read_line(file: str, line: int, text: str, parameters: Parameters) -> Block | Control:
    """Read one line (without its line end, blanks around it and a block delete character).

    What a block sets, parameters, is set when all of it is read. Raises ProgramError for what has not the form of
    RS-274, has no finite value, or reads a parameter that is not there.
    """
    if "(" in text or ";" in text:
        split = _COMMENT.split(text)  # words, comment, words, comment, ..., words
        pieces, comments = ["".join(piece.split()) for piece in split[::2]], tuple(split[1::2])
    else:
        pieces, comments = ["".join(text.split())], ()
    number, pieces = _line_number(pieces)
    try:
        control = _control(file, line, text, pieces)
        if control:
            return control
        words: list[Word] = []
        settings: list[tuple[Key, float]] = []
        for piece in pieces:
            if _ALL_WORDS.fullmatch(piece):
                words += [(letter, float(digits)) for letter, digits in _ONE_WORD.findall(piece.upper())]
            else:
                _read_computed(text, piece, parameters, words, settings)
        for letter, value in words:
            if letter == "N" and value < 0.0:
                raise MalformedError("a line number (N) must not be negative")
            if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:
                raise MalformedError(f"the number of a word {letter} is beyond +-{LARGEST_NUMBER:.0f}")
        for key, value in settings:
            parameters.set(key, value)
    except (MalformedError, ParameterError) as error:
        raise ProgramError(file, line, text, str(error)) from None
    return Block(file, line, text, number, tuple(words), comments)


def control_of(file: str, line: int, text: str) -> Control | None:
    """The O-word block that a line is; None for any other, even one that cannot be read."""
    pieces = ["".join(piece.split()) for piece in _COMMENT.split(text)[::2]]
    try:
        return _control(file, line, text, _line_number(pieces)[1])
    except MalformedError:
        return None


def _line_number(pieces: list[str]) -> tuple[float | None, list[str]]:
    """The N word at the start of a block, which means nothing to the machine, and the pieces without it."""
    for index, piece in enumerate(pieces):
        if piece:
            number = _LINE_NUMBER.match(piece)
            if not number:
                break
            return float(number.group(1)), [*pieces[:index], piece[number.end() :], *pieces[index + 1 :]]
    return None, pieces


def _control(file: str, line: int, text: str, pieces: list[str]) -> Control | None:
    first, *others = [piece for piece in pieces if piece] or [""]
    if first[:1] not in ("O", "o"):
        return None
    code = first.upper()
    found = _CONTROL.match(code) if code.isascii() else None
    if not found:
        raise MalformedError(
            "not an O-word: 'O' takes a number or a <name>, then sub, endsub, call, return, if, elseif, else, endif, "
            "while, endwhile, do, repeat, endrepeat, break or continue"
        )
    if others:
        raise MalformedError(f"{others[0][:40]!r} does not belong into a block with an O-word")
    return Control(file, line, text, found.group(1), found.group(2), code[found.end() :])


def _read_computed(
    text: str, piece: str, parameters: Parameters, words: list[Word], settings: list[tuple[Key, float]]
) -> None:
    """Read words and settings of parameters with their numbers computed."""
    if not _COMPUTED.search(piece) or "(" in piece or ")" in piece:
        raise MalformedError(_why_not_words(piece, text))
    foreign = next((character for character in piece if not character.isascii()), None)
    if foreign:
        raise MalformedError(f"{foreign!r} may stand in a comment only")
    reader = Reader(piece.upper(), parameters)
    while not reader.at_end:
        if reader.take("#"):
            key = reader.parameter()
            if not reader.take("="):
                raise MalformedError("'=' wanted behind a parameter that stands where a word should")
            settings.append((key, reader.value()))
        else:
            letter = reader.code[reader.place]
            if not letter.isalpha() or letter == "O":
                raise MalformedError(_why_not_words(piece[reader.place :], text))
            reader.place += 1
            value = reader.value()
            words.append((letter, _code(value) if letter in "GM" else value))


def _code(value: float) -> float:
    """The number of a G or M word: what an expression missed it by is taken away."""
    code = round(value, 1)
    return code if abs(code - value) < WHOLE else value


def _why_not_words(code: str, text: str) -> str:
    if "(" in code:
        return "comment within a comment" if re.search(r"\([^)]*\(", text) else "comment without ')'"
    if ")" in code:
        return "')' without '('"
    if code == "%":
        return "'%' without a '%' before the first block"
    if "%" in code:
        return "'%' must stand alone on its line"
    good = _ALL_WORDS.match(code)
    end = good.end() if good else 0
    if code[end] == "/":
        return "a block delete '/' must be the first character of its line"
    if code[end] in "Oo":
        return "an O-word must be the first of its block"
    if not code[end].isalpha():  # what follows a good number belongs to it: X1.2.3
        end = max((index for index in range(end) if code[index].isalpha()), default=end)
    bad = code[end] + re.split("[A-Za-z]", code[end + 1 :])[0]
    return f"malformed number in {bad[:40]!r}"
