"""O-words: the order in which blocks are run, and the limits that end every program."""

import pytest

from pkm_cnc.program import Program, ProgramError
from pkm_cnc.program.flow import executed_blocks
from pkm_cnc.program.parameters import Parameters


def xs(text: str, *, block_delete: bool = True, block_limit: int = 10_000) -> list[float]:
    """The X of every block that is run."""
    run = executed_blocks(Program("p", text), Parameters({}), block_delete=block_delete, block_limit=block_limit)
    return [number for block in run for letter, number in block.words if letter == "X"]


def refused(text: str, **options: int) -> ProgramError:
    with pytest.raises(ProgramError) as caught:
        xs(text, **options)
    return caught.value


def test_block_delete() -> None:
    text = "X1\n/X2\n / X3\n//X4\nX5"
    assert xs(text) == [1, 5]
    assert xs("X1\n/X2\n / N3 X3\nX5", block_delete=False) == [1, 2, 3, 5]
    assert xs("/this is [ not read\nX1") == [1]


def test_while() -> None:
    assert xs("#1=0\no101 while [#1 LT 3]\nX#1\n#1=[#1+1]\no101 endwhile\nX9") == [0, 1, 2, 9]
    assert xs("o101 while [0]\nX1\no101 endwhile\nX9") == [9]


def test_do() -> None:
    """The example of LinuxCNC's manual."""
    text = "#1=0\nO100 DO\nO110 IF [#1 EQ 2]\n#1=3\nO100 CONTINUE\nO110 ENDIF\nX#1\n#1=[#1+1]\nO100 WHILE [#1 LT 3]\nX9"
    assert xs(text) == [0, 1, 9]


def test_repeat_break_and_continue() -> None:
    assert xs("o1 repeat [3]\nX1\no1 endrepeat\nX9") == [1, 1, 1, 9]
    assert xs("o1 repeat [0]\nX1\no1 endrepeat\no2 repeat [-5]\nX2\no2 endrepeat\nX9") == [9]
    assert xs("o1 repeat [2]\no2 repeat [2]\nX1\no2 endrepeat\nX2\no1 endrepeat") == [1, 1, 2, 1, 1, 2]
    text = "#1=0\no1 repeat [5]\n#1=[#1+1]\no2 if [#1 eq 2]\no1 continue\no2 endif\nX#1\no3 if [#1 eq 4]\no1 break\n"
    assert xs(text + "o3 endif\no1 endrepeat\nX9") == [1, 3, 4, 9]


@pytest.mark.parametrize(("number", "taken"), [(1, 1), (2, 2), (3, 3), (4, 9)])
def test_if(number: int, taken: int) -> None:
    text = f"#1={number}\no1 if [#1 eq 1]\nX1\no1 elseif [#1 eq 2]\nX2\no1 elseif [#1 eq 3]\nX3\no1 else\nX9\no1 endif"
    assert xs(text) == [taken]
    assert xs(f"#1={number}\no1 if [#1 eq 1]\nX1\no1 endif\nX8") == ([1, 8] if number == 1 else [8])


def test_subroutines() -> None:
    text = (
        "o<side> sub\nX#1\n#2=[#2+1]\n#31=[#31+#2]\n#<own>=5\no<side> endsub [#1*2]\n"
        "#2=7\no<side> call [3]\nX#<_value>\nX#<_value_returned>\nX#2\nX#31\no<S I D E> call [4] [10]\nX#31"
    )
    assert xs(text) == [3, 6, 1, 7, 8, 4, 19]
    assert "#<own> was not set" in refused(text + "\nX#<own>").reason


def test_subroutines_may_stand_behind_their_call_and_return_early() -> None:
    text = (
        "o1 call [1]\nX#<_value_returned>\no1 sub\no2 if [#1 gt 0]\no3 repeat [5]\no1 return\no3 endrepeat\no2 endif\n"
    )
    assert xs(text + "X1\no1 endsub\nX9") == [0, 9]


def test_recursion() -> None:
    """5! by a subroutine that calls itself, with a loop of its own at every depth."""
    text = (
        "o1 sub\no2 if [#1 le 1]\no1 return [1]\no2 endif\n#3=0\no4 repeat [2]\n#3=[#3+1]\no4 endrepeat\n"
        "o1 call [#1-1]\n#4=#<_value>\nX#3\no1 endsub [#1*#4]\no1 call [5]\nX#<_value>"
    )
    assert xs(text) == [2, 2, 2, 2, 120]


def test_percent_signs_bound_the_subroutines_too() -> None:
    assert xs("%\nX1\n%\no1 sub\no1 endwhile") == [1]


def test_labels_may_be_used_again() -> None:
    assert xs("o1 repeat [2]\nX1\no1 endrepeat\no1 if [1]\nX2\no1 endif") == [1, 1, 2]


def test_every_program_ends() -> None:
    error = refused("X0\no1 while [1]\no1 endwhile", block_limit=100)
    assert error.reason == (
        "the program has run 100 blocks more than it has lines (program.block_limit): does it loop for ever?"
    )
    assert "loop for ever" in refused("o1 repeat [1000000000]\nX1\no1 endrepeat", block_limit=50).reason
    assert refused("o1 sub\no1 call\no1 endsub\no1 call").reason == "more than 10 subroutines called within each other"
    assert len(xs("\n".join(["X1"] * 500), block_limit=0)) == 500


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("o1 call", 1, "there is no subroutine O1 in the program"),
        ("o<a> call [1]", 1, "there is no subroutine O<a> in the program"),
        ("o1 sub\nX1", 1, "O1 sub is not closed"),
        ("o1 sub\no2 sub\no2 endsub\no1 endsub", 2, "a subroutine within O1 sub"),
        ("o1 sub\no1 endsub\no1 sub\no1 endsub", 3, "subroutine O1 was defined before, in line 1"),
        ("o1 if [1]\no2 endif", 2, "endif without O2 if before it: the last one open is O1 if"),
        ("o1 endwhile", 1, "endwhile without O1 while before it: none is open"),
        ("o1 if [1]\no1 else\no1 elseif [1]\no1 endif", 3, "elseif after else"),
        ("o1 repeat [1]\no2 if [1]\no1 endrepeat\no2 endif", 3, "endrepeat without O1 repeat before it: "),
        ("o1 while [1]\no2 break\no1 endwhile", 2, "break is not within a loop O2"),
        ("o1 return", 1, "return is not within a subroutine O1"),
        ("o1 repeat [1.5]\no1 endrepeat", 1, "the number of repetitions, 1.5, is not a whole number"),
        ("o1 if 1\no1 endif", 1, "'[' wanted before '1'"),
        ("o1 while [1] [2]\no1 endwhile", 1, "'[2]' does not belong behind while"),
        ("o1 if [0]\no1 elseif [1] 2\no1 endif", 2, "'2' does not belong behind elseif"),
        ("o1 if [0]\no1 elseif\no1 endif", 2, "'[' wanted before the end of the block"),
        ("o1 do\no1 while [1/0]", 2, "1 / 0 has no finite value"),
        ("o1 sub\no1 endsub\no1 call" + "[1]" * 31, 3, "31 arguments, at most 30 are passed"),
        ("o1 sub\no1 endsub\no1 call #1", 3, "'#1' does not belong behind call"),
        ("o100", 1, "not an O-word: 'O' takes a number or a <name>, then sub, "),
        ("o[1] call", 1, "not an O-word"),
        ("o1 (why) sub X1", 1, "not an O-word"),
        ("o1 sub (why) X1\no1 endsub", 1, "'X1' does not belong into a block with an O-word"),
    ],
)
def test_refused_o_words(text: str, line: int, reason: str) -> None:
    error = refused(text)
    assert error.reason.startswith(reason)
    assert (error.line, error.block) == (line, text.split("\n")[line - 1])
