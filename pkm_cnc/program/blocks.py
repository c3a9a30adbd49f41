"""A part program as text, and as blocks: one line, one block of words and comments.

The form is that of RS-274 (NIST RS274/NGC version 3, section 3): any case, blanks of no meaning outside comments (even
within a number), comments in parentheses between words or after a semicolon, `%` around the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from pkm_cnc.errors import InputError

__all__ = ["Block", "Program", "ProgramError", "Word", "read_blocks", "read_program"]

Word = tuple[str, float]
"""A letter, upper case, and its number."""

LARGEST_NUMBER = 1e9
"""A thousand kilometres in mm: up to there a float still tells coordinates 1 nm apart."""

_COMMENT = re.compile(r"(\([^()]*\)|;.*)")
_WORD = r"([A-Za-z])([-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+))"
_ONE_WORD = re.compile(_WORD)
_ALL_WORDS = re.compile(f"(?:{_WORD})*")
_FEATURES = {
    "/": "block delete '/' is not supported",
    "#": "parameter '#' is not supported",
    "[": "expression '[' is not supported",
    "O": "O-words are not supported",
    "%": "'%' must stand alone on its line",
}
_FEATURE = re.compile(r"[/#\[O%]", re.IGNORECASE)


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
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = content[error.start]
        raise InputError(f"part program {path}: not a text file: byte 0x{byte:02x} at offset {error.start}") from None
    if "\0" in text:
        raise InputError(f"part program {path}: not a text file: byte 0x00 at offset {content.index(0)}")
    return Program(str(path), text.replace("\r\n", "\n").replace("\r", "\n"))


def read_blocks(program: Program) -> Iterator[Block]:
    """The blocks of a program that hold anything, read one by one as they are asked for, up to the second `%`.

    Raises ProgramError for what has not the form of RS-274.
    """
    in_percent = False
    any_words = False
    for line, source in enumerate(program.text.split("\n"), start=1):
        text = source.strip()
        if text == "%" or (text.startswith("%") and _COMMENT.sub("", text).strip() == "%"):
            if in_percent:
                return
            if any_words:
                raise ProgramError(program.name, line, text, "'%' without a '%' before the first block")
            in_percent = True
        elif text:
            block = _read_block(program.name, line, text)
            any_words = any_words or bool(block.words)
            yield block


def _read_block(file: str, line: int, text: str) -> Block:
    pieces = _COMMENT.split(text)  # words, comment, words, comment, ..., words
    words: list[Word] = []
    for piece in pieces[::2]:
        if piece:
            words += _read_words(file, line, text, piece)
    number = None
    if words and words[0][0] == "N":
        number = words.pop(0)[1]
        if number < 0.0:
            raise ProgramError(file, line, text, "a line number (N) must not be negative")
    return Block(file, line, text, number, tuple(words), tuple(pieces[1::2]))


def _read_words(file: str, line: int, text: str, piece: str) -> list[Word]:
    code = "".join(piece.split())
    if not _ALL_WORDS.fullmatch(code):
        raise ProgramError(file, line, text, _why_not_words(code, text))
    words = [(letter, float(number)) for letter, number in _ONE_WORD.findall(code.upper())]
    for letter, number in words:
        if not -LARGEST_NUMBER <= number <= LARGEST_NUMBER:
            raise ProgramError(file, line, text, f"the number of a word {letter} is beyond +-{LARGEST_NUMBER:.0f}")
    return words


def _why_not_words(code: str, text: str) -> str:
    if "(" in code:
        return "comment within a comment" if re.search(r"\([^)]*\(", text) else "comment without ')'"
    if ")" in code:
        return "')' without '('"
    feature = _FEATURE.search(code)
    if feature:
        return _FEATURES[feature.group().upper()]
    good = _ALL_WORDS.match(code)
    end = good.end() if good else 0
    if not code[end].isalpha():  # what follows a good number belongs to it: X1.2.3
        end = max((index for index in range(end) if code[index].isalpha()), default=end)
    bad = code[end] + re.split("[A-Za-z]", code[end + 1 :])[0]
    return f"malformed number in {bad[:40]!r}"
