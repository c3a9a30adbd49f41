"""Numbers, parameters and expressions of RS-274: examples of its definition, and random expressions."""

import math
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.program import Program, ProgramError
from pkm_cnc.program.expressions import MalformedError, Reader
from pkm_cnc.program.flow import executed_blocks
from pkm_cnc.program.parameters import Parameters


def value(text: str, **named: float) -> float:
    parameters = Parameters({5420: lambda: 7.5})
    parameters.line = 3
    parameters.set(3, 3.0)
    parameters.set(4, 3.0)
    for name, number in named.items():
        parameters.set(name.upper(), number)
    reader = Reader("".join(text.split()).upper(), parameters)
    result = reader.value()
    assert reader.at_end
    return result


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[2.0 / 3 * 1.5 - 5.5 / 11.0]", 0.5),  # the examples of LinuxCNC's manual
        ("[1 + acos[0] - [#3 ** [4.0/2]]]", 82.0),
        ("fix[2.8]", 2.0),
        ("fix[-2.8]", -3.0),
        ("fup[2.8]", 3.0),
        ("fup[-2.8]", -2.0),
        ("round[2.5]", 3.0),
        ("round[-2.5]", -3.0),
        ("round[-0.2]", 0.0),
        ("[2 ** 3 ** 2]", 64.0),  # from left to right
        ("[2 + 3 * 4 ** 2]", 50.0),
        ("[10 - 4 - 3]", 3.0),
        ("[7 mod 4]", 3.0),
        ("[-7 mod 4]", 1.0),
        ("[5.5 mod -4]", 1.5),
        ("atan[1]/[-1]", 135.0),
        ("atan[-1]/[0]", -90.0),
        ("asin[0.5]", 30.0),
        ("cos[60]", 0.5),
        ("sin[-30]", -0.5),
        ("tan[45]", 1.0),
        ("sqrt[2]", math.sqrt(2.0)),
        ("exp[1]", math.e),
        ("ln[exp[2]]", 2.0),
        ("abs[-3]", 3.0),
        ("-[3]", -3.0),
        ("+#3", 3.0),
        ("-#3", -3.0),
        ("[1 - -2]", 3.0),
        ("#3", 3.0),
        ("##4", 3.0),
        ("#[1+2]", 3.0),
        ("[#1 + 2]", 2.0),  # not set: 0
        ("[1 eq 1.0000001]", 1.0),
        ("[1 ne 1.0001]", 1.0),
        ("[1 gt 1]", 0.0),
        ("[1 ge 1]", 1.0),
        ("[1 lt 2 and 2 lt 1]", 0.0),
        ("[1 lt 2 or 2 lt 1]", 1.0),
        ("[1 xor 2]", 0.0),
        ("[1 xor 0]", 1.0),
        ("[1 and 0 or 1]", 1.0),
        ("exists[#<wide>]", 1.0),
        ("exists[#<w i d e>]", 1.0),
        ("exists[#<narrow>]", 0.0),
        ("exists[#<_line>]", 1.0),
        ("#<Wide>", 12.5),
        ("#5420", 7.5),
        ("#<_line>", 3.0),
        ("#31", 0.0),
        (".5", 0.5),
        ("5.", 5.0),
    ],
)
def test_values(text: str, expected: float) -> None:
    assert value(text, wide=12.5) == pytest.approx(expected, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[1/0]", "1 / 0 has no finite value"),
        ("[1 mod 0]", "1 MOD 0 has no finite value"),
        ("[0 ** -1]", "0 ** -1 has no finite value"),
        ("[-8 ** [1/3]]", "-8 ** 0.333333 has no finite value"),
        ("[10 ** 400]", "10 ** 400 has no finite value"),
        ("[[10**300] * [10**300]]", "1e+300 * 1e+300 has no finite value"),
        ("sqrt[-1]", "SQRT[-1] has no finite value"),
        ("ln[0]", "LN[0] has no finite value"),
        ("asin[2]", "ASIN[2] has no finite value"),
        ("exp[1000]", "EXP[1000] has no finite value"),
        ("[1", "expression without ']'"),
        ("[1 2", "expression without ']'"),
        ("[1 foo 2]", "operator or ']' wanted before 'FOO2]'"),
        ("[]", "number wanted before ']'"),
        ("[1 +]", "number wanted before ']'"),
        ("[1 + + + 2]", "number wanted before '+2]'"),
        ("cos 60", "'[' wanted before '60'"),
        ("atan[1]", "ATAN takes two numbers: ATAN[y]/[x]"),
        ("exists[3]", "EXISTS takes the name of a parameter: EXISTS[#<name>]"),
        ("#", "number wanted before the end of the block"),
        ("#1.5", "parameter number 1.5 is not a whole number"),
        ("#<narrow>", "parameter #<narrow> was not set before"),
        ("#<_anywhere>", "parameter #<_anywhere> was not set before"),
        ("#0", "parameter #0 is none of those that can be read: #1 to #5000, #5420"),
        ("#5061", "parameter #5061 is none of those that can be read: #1 to #5000, #5420"),
        ("[" * 51 + "1" + "]" * 51, "more than 50 brackets within each other"),
        ("#" * 10_000 + "1", "more than 50 brackets within each other"),
        ("9" * 400, "9" * 40 + " has no finite value"),
    ],
)
def test_what_has_no_value(text: str, reason: str) -> None:
    with pytest.raises(MalformedError) as caught:
        value(text)
    assert str(caught.value) == reason


@dataclass(frozen=True)
class Term:
    """A random expression: its RS-274 text with no bracket more than it needs, its rank, its value."""

    text: str
    rank: int
    value: float


BINARY = {
    "*": (4, lambda a, b: a * b),
    "+": (3, lambda a, b: a + b),
    "-": (3, lambda a, b: a - b),
    "lt": (2, lambda a, b: 1.0 if a < b else 0.0),
    "ge": (2, lambda a, b: 0.0 if a < b else 1.0),
    "and": (1, lambda a, b: 1.0 if a and b else 0.0),
    "or": (1, lambda a, b: 1.0 if a or b else 0.0),
}


def combined(operator: str, left: Term, right: Term) -> Term:
    rank, compute = BINARY[operator]
    a = left.text if left.rank >= rank else f"[{left.text}]"
    b = right.text if right.rank > rank else f"[{right.text}]"
    return Term(f"{a} {operator} {b}", rank, compute(left.value, right.value))


numbers = st.integers(-999, 999).map(lambda n: Term(f"{n / 8:.3f}", 9, n / 8))
terms = st.recursive(
    numbers,
    lambda inner: st.builds(combined, st.sampled_from(sorted(BINARY)), inner, inner),
    max_leaves=12,
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(terms)
def test_random_expressions_bind_as_stated(term: Term) -> None:
    assert value(f"[{term.text}]") == term.value


def test_settings_take_effect_after_their_block() -> None:
    """The example of LinuxCNC's manual: the X of this block is the old #3."""
    text = "#3=15\n#3=6 G1 X#3 #<a>=[#3*2]\nX#3 Y#<a>\n#3=1 #3=2\nX#3"
    blocks = list(executed_blocks(Program("p", text), Parameters({}), block_delete=True, block_limit=0))
    assert [block.words for block in blocks] == [
        (),
        (("G", 1.0), ("X", 15.0)),
        (("X", 6.0), ("Y", 30.0)),
        (),
        (("X", 2.0),),
    ]


def test_words_that_are_computed() -> None:
    text = "#1=5\nN7 g[#1-4] x-#1 (why) y[#1/2]z.5 F#1 ; end\nG[[1/3]*3] X[61/10]\nG[.1*3+91.7]"
    blocks = list(executed_blocks(Program("p", text), Parameters({}), block_delete=True, block_limit=0))
    assert blocks[1].words == (("G", 1.0), ("X", -5.0), ("Y", 2.5), ("Z", 0.5), ("F", 5.0))
    assert (blocks[1].number, blocks[1].comments) == (7.0, ("(why)", "; end"))
    assert blocks[2].words == (("G", 1.0), ("X", 6.1))
    assert blocks[3].words == (("G", 92.0),)


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("#5420=1", "parameter #5420 cannot be set: only #1 to #5000"),
        ("#0=1", "parameter #0 cannot be set: only #1 to #5000"),
        ("#<_value>=1", "parameter #<_value> is only read"),
        ("#1", "'=' wanted behind a parameter that stands where a word should"),
        ("#1=", "number wanted before the end of the block"),
        ("X[1", "expression without ']'"),
        ("X[1 (one) + 1]", "expression without ']'"),
        ("X#<ümlaut>", "'ü' may stand in a comment only"),
        ("X[1]]", "malformed number in ']'"),
        ("X[10**10]", "the number of a word X is beyond +-1000000000"),
    ],
)
def test_refused_blocks(block: str, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        list(executed_blocks(Program("p", "G1\n" + block), Parameters({}), block_delete=True, block_limit=0))
    assert (caught.value.reason, caught.value.line, caught.value.block) == (reason, 2, block)
