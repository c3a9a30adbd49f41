"""Reads random and mutated part programs: `.venv/bin/python tools/fuzz.py [--count 1000000] [--seed 1]`.

Every program must be read or refused by a ProgramError or InputError of one line: no other exception, no hang, bounded
memory. What is read must be a toolpath: elements of finite length that connect. The first that fails is written out.
"""

from __future__ import annotations

import argparse
import math
import random
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterator

from pkm_cnc.errors import InputError
from pkm_cnc.program import Event, ProgramError, ProgramParameters, program_from_bytes, read_elements

BLOCK_LIMIT = 500
LONGEST = 2.0
"""s of processor time for one program of some hundred bytes and BLOCK_LIMIT blocks: a thousand times what it takes."""
MOST_MEMORY = 200
"""MB by which the process may grow."""

SEEDS = [
    text.replace(" | ", "\n").encode()
    for text in (
        "% | N10 G17 G20 G40 G49 G54 G80 G90 G94 | T1 M6 | S1200 M3 M8 | G0 X1 Y0 Z.1 | G1 Z-.1 F10 | X2 | M30 | %",
        "G64 P.1 Q.05 F500 | G18 G2 X10 Z10 I10 | G19 G3 Y5 Z3 R-9 | G17 G3 I5 P3 Z-2 | G28 Z0 | G90.1 G3 I1 J1",
        "#1=0 #<deep>=[-2.5 * sin[30]] | o100 while [#1 lt 5] | G1 F300 X[#1*10] Z#<deep> | #1=[#1+1] | o100 endwhile",
        "o<arc> sub | g3 x[#1] y[#2] r[sqrt[#1**2+#2**2]] | o<arc> endsub [1] | f60 | o<arc> call [5] [6] | G1 X3",
        "f60 | o5 call [3] | M2 | o5 sub | o6 if [#1 gt 0] | g1 x#1 | o5 call [#1-1] | o6 endif | o5 endsub",
        "o1 repeat [3] | o2 if [#1 eq 1] | o1 continue | o2 elseif [#1 gt 7] | o1 break | o2 else | G0 X3 | o2 endif"
        " | #1=[#1+1] | o1 endrepeat",
        "o1 do | #1=[#1+1] | G0 X#1 | o1 while [#1 lt 9 and exists[#<_line>]] | /G1 X0 | (MSG, done) | G92 X1 | G92.1",
        "G0 X1(c)Y2;rest | G4 P.5 | G61 | g1f60x.5y-.5 | G61.1 X+1. | M0 | M1 M5 M9 | G30 X1 | G53 G0 X#5420",
        "#3=1 | #[1+2]=##3 G1 F9 X#3 Y-[fix[2.5] mod 2] | G91 G3 X.02 Y.02 I5 | G2 X-.02 Y-.02 I4.99 P3",
    )
]
"""Programs that are read as they stand."""
WORDS = [
    *b"G0 G1 G2 G3 G4 G17 G18 G19 G20 G21 G28 G53 G64 G80 G90 G91 G92 X1 Y2 Z3 I1 J1 K1 R5 P2 Q1 F9 S1 T1 M3".split(),
    *b"X-5.5 Y[1+2] #1=3 #<a>=1 X#1 X#<a> [ ] ( ) ; / % # = < > - + . ** * o1 o2 o<a> sub endsub call return".split(),
    *b"if elseif else endif while endwhile do repeat endrepeat break continue [1] [0] [#1lt3] sin[ atan[1]/[2]".split(),
    *[b"99999999999", b"1e9", b"\n", b"\n", b"\n", b"\0", b"\xff", b"\xc3\xbc", b"\xef\xbb\xbf", b"\r"],
]
LETTERS = b"GXYZIJKRPQFSTMNO0123456789.-+[]#<>=()%;/* \n\n\n"


def programs(seed: int) -> Iterator[bytes]:
    """Programs without end: random bytes, characters and words of the language, and good programs with errors."""
    rng = random.Random(seed)
    while True:
        kind = rng.randrange(8)
        if kind == 0:
            yield rng.randbytes(rng.randrange(120))
        elif kind == 1:
            yield bytes(rng.choices(LETTERS, k=rng.randrange(160)))
        elif kind == 2:
            yield rng.choice((b"", b" ")).join(rng.choices(WORDS, k=rng.randrange(60)))
        else:
            yield mutated(rng, rng.choice(SEEDS))


def mutated(rng: random.Random, program: bytes) -> bytes:
    """The program with one to eight bytes, words, numbers or lines removed, put in, exchanged, or from another."""
    content = bytearray(program)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(content) + 1)
        to = min(len(content), at + rng.randrange(1, 12))
        kind = rng.randrange(10)
        if kind == 0:
            del content[at:to]
        elif kind == 1:
            content[at:at] = rng.choice(WORDS)
        elif kind == 2:
            content[at : at + 1] = rng.choices(LETTERS)
        elif kind == 3:
            content[at:at] = content[at:to] * rng.randrange(1, 4)
        elif kind == 4:
            other = rng.choice(SEEDS)
            begin = rng.randrange(len(other))
            content[at:to] = other[begin : begin + rng.randrange(1, 60)]
        elif kind < 9:
            digits = [place for place, byte in enumerate(content) if byte in b"0123456789"] or [0]
            place = rng.choice(digits)
            content[place : place + 1] = rng.choice((b"0", b"1", b"7", b"99", b".", b"-3"))
        else:
            lines = content.split(b"\n")
            rng.shuffle(lines)
            content = bytearray(b"\n".join(lines))
    return bytes(content)


def outcome(content: bytes) -> str:
    """Reads a program: "read", or "refused". Raises AssertionError, or whatever comes, for what must not be."""
    begin = time.process_time()
    try:
        check_toolpath(content)
        result = "read"
    except ProgramError as error:
        check_message(str(error), 1 <= error.line <= content.count(b"\n") + content.count(b"\r") + 1)
        result = "refused"
    except InputError as error:
        check_message(str(error))
        result = "no text"
    assert time.process_time() - begin < LONGEST, "too long"
    return result


def check_toolpath(content: bytes) -> None:
    """Reads a program and checks what comes of it."""
    program = program_from_bytes("fuzz.ngc", content)
    parameters = ProgramParameters(block_limit=BLOCK_LIMIT)
    end, length = None, 0.0
    zero = (0.01, 0.02, 0.03)
    for item in read_elements(program, start=zero, zero=zero, rapid=0.1, parameters=parameters):
        if isinstance(item, Event):
            assert math.isclose(item.path_length, length, rel_tol=1e-12), item
            continue
        assert end is None or item.start == end, item
        assert 0.0 < item.length < math.inf, item
        assert 0.0 < item.feed < math.inf, item
        assert all(map(math.isfinite, item.position(0.5 * item.length))), item
        end = item.end
        length += item.length


def check_message(message: str, line_is_there: bool = True) -> None:
    """One line of bearable length, about a line that is there."""
    assert line_is_there, message
    assert message.isprintable(), message
    assert len(message) < 1000, message


def main() -> int:
    """Read many programs; 1 if one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000, help="how many programs (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers (%(default)s)")
    arguments = parser.parse_args()
    outcomes: Counter[str] = Counter()
    begin, memory = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number, content in enumerate(programs(arguments.seed)):
        if number == arguments.count:
            break
        try:
            outcomes[outcome(content)] += 1
        except Exception as error:
            print(f"program {number} of seed {arguments.seed}: {type(error).__name__}: {error}\n{content!r}")
            return 1
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    counted = ", ".join(f"{count} {name}" for name, count in sorted(outcomes.items()))
    print(
        f"{sum(outcomes.values())} programs: {counted}; {time.perf_counter() - begin:.0f} s, {grown:.0f} MB more memory"
    )
    return 0 if grown < MOST_MEMORY else 1


if __name__ == "__main__":
    sys.exit(main())
