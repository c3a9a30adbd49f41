"""Text -> blocks: the form of RS-274, and what is refused for its form."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.program import Program, ProgramError, read_program
from pkm_cnc.program.blocks import Block
from pkm_cnc.program.flow import executed_blocks
from pkm_cnc.program.parameters import Parameters


def reader(text: str, *, block_delete: bool = True, block_limit: int = 1000) -> Iterator[Block]:
    program = Program("part.ngc", text)
    return executed_blocks(program, Parameters({}), block_delete=block_delete, block_limit=block_limit)


def blocks(text: str) -> list[Block]:
    return list(reader(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G1X10Y-5.", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        ("g1x10y-5.", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        (" G 1 X 1 0 Y - 5 . ", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        ("g\t01 x+1 0.0(to the edge)y-0 5", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        ("(approach) G1 (x) X10. ( y ) Y-5.000 ; (rest", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        ("G1 X10 Y-5\r", (("G", 1.0), ("X", 10.0), ("Y", -5.0))),
        ("Y.5 X-.25", (("Y", 0.5), ("X", -0.25))),
        ("G1 ; feed (and more; and more", (("G", 1.0),)),
        ("G1 (a ; b) X2", (("G", 1.0), ("X", 2.0))),
        ("G5.1 K3 E2", (("G", 5.1), ("K", 3.0), ("E", 2.0))),
    ],
)
def test_words(text: str, words: tuple[tuple[str, float], ...]) -> None:
    (block,) = blocks(text)
    assert block.words == words
    assert block.number is None


def test_a_block_knows_its_place_its_text_and_its_comments() -> None:
    first, second = blocks("\n  N10 G0 (up) Z5 ; Über\n\n(only this)\n")
    assert first == Block("part.ngc", 2, "N10 G0 (up) Z5 ; Über", 10.0, (("G", 0.0), ("Z", 5.0)), ("(up)", "; Über"))
    assert second == Block("part.ngc", 4, "(only this)", None, (), ("(only this)",))


@pytest.mark.parametrize(("text", "number"), [("N5G1", 5.0), ("n 0 0 7 G1", 7.0), ("(c) N12.5 G1", 12.5)])
def test_line_numbers_are_kept_apart(text: str, number: float) -> None:
    (block,) = blocks(text)
    assert block.number == number
    assert block.words == (("G", 1.0),)


def test_percent_signs_enclose_the_program() -> None:
    assert [block.line for block in blocks("(first)\n % (begin)\nG0 X1\n%\nnothing # of this / is read")] == [1, 3]
    with pytest.raises(ProgramError, match="'%' without a '%' before the first block"):
        blocks("G0 X1\n%\n")


def test_blocks_are_read_only_when_asked_for() -> None:
    unread = reader("G1\nX1.2.3")
    assert next(unread).line == 1
    with pytest.raises(ProgramError):
        next(unread)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("G1 X", "malformed number in 'X'"),
        ("G1 X Y1", "malformed number in 'X'"),
        ("G1 X1.2.3 Y1", "malformed number in 'X1.2.3'"),
        ("G1 X--1", "malformed number in 'X--1'"),
        ("G1 X-", "malformed number in 'X-'"),
        ("G1 X. Y1", "malformed number in 'X.'"),
        ("G1 X1-2", "malformed number in 'X1-2'"),
        ("G1 X1,5", "malformed number in 'X1,5'"),
        ("12 G1", "malformed number in '12'"),
        ("G1 X1(was 2)0", "malformed number in '0'"),
        ("G1 X(one)1", "malformed number in 'X'"),
        ("G1 X\u0661", "malformed number in 'X\u0661'"),
        ("G1 ß1", "malformed number in 'ß1'"),
        ("G1 X" + "9" * 400, "the number of a word X is beyond +-1000000000"),
        ("G1 X1 (never closed", "comment without ')'"),
        ("G1 (a (b) c) X1", "comment within a comment"),
        ("G1 X1 (a (b", "comment within a comment"),
        ("(closed) G1 X1 (never closed", "comment without ')'"),
        ("G1 X1) Y2", "')' without '('"),
        ("G1 /X1", "a block delete '/' must be the first character of its line"),
        ("N1 /G1 X1", "a block delete '/' must be the first character of its line"),
        ("G1 o100 call", "an O-word must be the first of its block"),
        ("G1 X1 %", "'%' must stand alone on its line"),
        ("N-5 G1", "a line number (N) must not be negative"),
    ],
)
def test_malformed_blocks(text: str, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        blocks(f"G21\n  {text}  ")
    error = caught.value
    assert error.reason == reason
    assert (error.file, error.line, error.block) == ("part.ngc", 2, text)
    assert error.exit_code == 2


def test_errors_are_one_line_of_bearable_length() -> None:
    error = ProgramError("part.ngc", 7, "G1\x0bX1 " + "(long)" * 1000, "reason")
    assert str(error).startswith("part.ngc:7: reason: 'G1\\x0bX1 (long)")
    assert len(str(error)) < 150
    assert str(ProgramError("a.ngc", 3, "G20", "G20 is not supported")) == "a.ngc:3: G20 is not supported: 'G20'"


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_read_program(tmp_path: Path, ending: str) -> None:
    path = tmp_path / "part.ngc"
    path.write_bytes(("\ufeffG1 X1 (über)" + ending + "M2" + ending).encode())
    assert read_program(path) == Program(str(path), "G1 X1 (über)\nM2\n")


def test_files_that_are_no_program(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"part program .*missing\.ngc: No such file or directory"):
        read_program(tmp_path / "missing.ngc")
    with pytest.raises(InputError, match="Is a directory"):
        read_program(tmp_path)
    (tmp_path / "binary.ngc").write_bytes(b"G1 X1\n\0\0")
    with pytest.raises(InputError, match="not a text file: byte 0x00 at offset 6"):
        read_program(tmp_path / "binary.ngc")
    (tmp_path / "latin.ngc").write_bytes("G1 (für)".encode("latin-1"))
    with pytest.raises(InputError, match="not a text file: byte 0xfc at offset 5"):
        read_program(tmp_path / "latin.ngc")
