"""Blocks -> modal state -> toolpath: what runs, what it means, and what is refused with which words."""

import math
import re

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import InputError
from pkm_cnc.program import (
    NOT_EVALUATED_COMMENT,
    Arc,
    Line,
    Program,
    ProgramError,
    Toolpath,
    canonical_motion,
    interpret,
    read_motions,
)
from pkm_cnc.records import Vector

KNOWN_G = (
    "known: G0 G1 G2 G3 G4 G17 G18 G19 G20 G21 G28 G30 G40 G49 G53 G54 G61 G61.1 G64 G80 G90 G90.1 G91 G91.1 G92 G92.1 "
    "G94"
)
ORIGIN = (0.0, 0.0, 0.0)
RAPID = 0.5


def toolpath(text: str, start: Vector = ORIGIN, zero: Vector = ORIGIN) -> Toolpath:
    return interpret(Program("part.ngc", text), start=start, zero=zero, rapid=RAPID)


def arc(text: str) -> Arc:
    """The one arc of a block that starts at 0, at 600 mm/min."""
    (element,) = toolpath(f"F600\n{text}").elements
    assert isinstance(element, Arc)
    return element


def test_modal_program() -> None:
    path = toolpath("%\nN1 G17 G21 G90\nG0 X10\nG1 Y20 F600\nX0 F1200\nG2 X20 I10\nX40 R10\nG3 X0 I-20\nG0 Z5\nM30\n%")
    kinds = [type(element) for element in path]
    assert kinds == [Line, Line, Line, Arc, Arc, Arc, Line]
    assert [element.line for element in path] == [3, 4, 5, 6, 7, 8, 9]
    assert [element.feed for element in path] == [RAPID, 0.01, 0.02, 0.02, 0.02, 0.02, RAPID]
    assert [element.traverse for element in path] == [True, False, False, False, False, False, True]
    assert [element.evaluated for element in path] == [False, True, True, True, True, True, False]
    ends_mm = [(10, 0, 0), (10, 20, 0), (0, 20, 0), (20, 20, 0), (40, 20, 0), (0, 20, 0), (0, 20, 5)]
    assert [element.end for element in path] == [(x / 1000, y / 1000, z / 1000) for x, y, z in ends_mm]
    lengths = [0.01, 0.02, 0.01, 0.01 * math.pi, 0.01 * math.pi, 0.02 * math.pi, 0.005]
    assert [element.length for element in path] == pytest.approx(lengths, rel=1e-15)
    assert path.starts == pytest.approx([sum(lengths[:index]) for index in range(7)], rel=1e-15)
    assert path.length == pytest.approx(sum(lengths), rel=1e-15)


def test_program_zero_and_start() -> None:
    (element,) = toolpath("G1 F60 X100 Z-2", start=(0.25, 0.5, 0.75), zero=(1.0, 2.0, 3.0)).elements
    assert element.start == (0.25, 0.5, 0.75)
    assert element.end == (1.1, 0.5, 3.0 - 0.002)


@pytest.mark.parametrize(
    "text",
    [
        "g1f600x10\ny20\ng2x20i5\nm2",
        "G 0 1 F 6 0 0 X 1 0\nY 2 0\nG 2 X 2 0 I 0 5\nM 2",
        "N1 X10. F600.0 G01\nn2 y+20\nn3(arc)I5(center)X20 G02 ; end\nM02",
        "(mode)\n\nG1\nF600\nX10\nY20\nG2.0 X2 0.0 I 5.\n\nM30\nnot read",
    ],
)
def test_spacing_case_and_order_have_no_meaning(text: str) -> None:
    ends = [(element.end, element.length, element.feed) for element in toolpath(text)]
    plain = toolpath("G1 F600 X10\nY20\nG2 X20 I5\nM2")
    assert ends == [(element.end, element.length, element.feed) for element in plain]


@pytest.mark.parametrize("end", ["M2", "M30", "G1 X5 M2", "%"])
def test_nothing_is_read_after_the_end(end: str) -> None:
    path = toolpath(f"%\nG1 F600 X1\n{end}\nG20 # ( X7")
    assert path.elements[-1].end[0] == (0.005 if "X5" in end else 0.001)


@pytest.mark.parametrize("text", ["", "\n\n", "%\n%", "(nothing)\nG21 G90 F100\nM2", "G0 X0 Y0 Z0", "M2\nG1 F1 X1"])
def test_a_program_without_motion(text: str) -> None:
    with pytest.raises(InputError, match=r"^part program part\.ngc: contains no motion$"):
        toolpath(text)


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("G41 D1", f"G41 is not supported ({KNOWN_G})"),
        ("G43 H1", f"G43 is not supported ({KNOWN_G})"),
        ("G55", f"G55 is not supported ({KNOWN_G})"),
        ("G93", f"G93 is not supported ({KNOWN_G})"),
        ("G1.1 X1", f"G1.1 is not supported ({KNOWN_G})"),
        ("G-1 X1", f"G-1 is not supported ({KNOWN_G})"),
        ("G[1/2] X1", f"G0.5 is not supported ({KNOWN_G})"),
        ("M98 P1", "M98 is not supported (known: M0 M1 M2 M3 M4 M5 M6 M7 M8 M9 M30)"),
        ("G1 X1E3", "E3 is not supported"),
        ("G1 A10", "A10 is not supported: there is no axis A"),
        ("H1", "H1 is not supported: there is no tool length"),
        ("S-1", "the spindle speed S-1 is negative"),
        ("T1.5", "the tool, T1.5, is not a whole number from 0 on"),
        ("G4", "G4 needs its time: P, in seconds"),
        ("G4 P-1", "the time P-1 is negative"),
        ("G1 X1 P1", "P belongs to G4, to G64, and to an arc (G2, G3)"),
        ("G64 P.1 G4 P2", "two P words"),
        ("G4 P1 G64", "P could belong to G4 and to G64: make it two blocks"),
        ("G64 P1 G3 I1", "P could belong to G64 and to an arc: make it two blocks"),
        ("G4 P1 G3 I1", "P could belong to G4 and to an arc: make it two blocks"),
        ("G4 P1 Q1", "Q belongs to G64"),
        ("G64 Q1", "G64 with Q needs P, the largest deviation from the path"),
        ("G64 P-1", "the deviation from the path P-1 is negative"),
        ("G53 G2 X1 I1", "G53 belongs to G0 and G1, the motion here is G2"),
        ("G53 G0", "G53 needs X, Y or Z"),
        ("G53 X1", "a motion needs G0, G1, G2 or G3 before it or in its block"),
        ("G92", "G92 needs X, Y or Z: what the position is to be called"),
        ("G92 G1 X1", "G92 and G1 both take the words of the axes: make it two blocks"),
        ("G28 G0 Z1", "G28 and G0 both take the words of the axes: make it two blocks"),
        ("G28 G92 X1", "G28 and G92 are of one modal group (non-modal), only one is allowed in a block"),
        ("G80 X1", "a motion needs G0, G1, G2 or G3 before it or in its block"),
        ("G0 G1 G80 X1", "G0 and G1 are of one modal group (motion), only one is allowed in a block"),
        ("G61 G64", "G61 and G64 are of one modal group (path mode), only one is allowed in a block"),
        ("G90 G91", "G90 and G91 are of one modal group (distance mode), only one is allowed in a block"),
        ("G20 G21", "G20 and G21 are of one modal group (units), only one is allowed in a block"),
        ("G17 G18", "G17 and G18 are of one modal group (plane), only one is allowed in a block"),
        ("M3 M5 S1", "M3 and M5 are of one modal group (spindle), only one is allowed in a block"),
        ("G2 X1 K5", "K is not in the plane G17: its arcs have I J"),
        ("G18 G2 X1 J5", "J is not in the plane G18: its arcs have I K"),
        ("G19 G2 Y1 I5", "I is not in the plane G19: its arcs have J K"),
        ("G2 X1 I.5 P0", "the number of turns, P0, is not from 1 to 1000"),
        ("G2 X1 I.5 P1001", "the number of turns, P1001, is not from 1 to 1000"),
        ("G2 X1 I.5 P1.5", "the number of turns, P1.5, is not a whole number from 0 on"),
        ("G90.1 G2 X1 I.5", "with G90.1 a center needs both its coordinates: J is missing"),
        ("G18 G2 X1", "an arc takes a center (I K) or a radius (R)"),
        ("N1 N2 G1", "N word not at the start of the block"),
        ("G1 N2", "N word not at the start of the block"),
        ("G0 G1 X1", "G0 and G1 are of one modal group (motion), only one is allowed in a block"),
        ("G21 G21", "G21 and G21 are of one modal group (units), only one is allowed in a block"),
        ("M2 M30", "M2 and M30 are of one modal group (stop), only one is allowed in a block"),
        ("G1 X1 X2", "two X words"),
        ("G1 X1 F1 F2", "two F words"),
        ("X1", "a motion needs G0, G1, G2 or G3 before it or in its block"),
        ("I1", "a motion needs G0, G1, G2 or G3 before it or in its block"),
        ("G1 X1 I1", "I belongs to G2 and G3, the motion here is G1"),
        ("G0 X1 R1", "R belongs to G2 and G3, the motion here is G0"),
        ("G2", "an arc takes a center (I J) or a radius (R)"),
        ("G3 X1", "an arc takes a center (I J) or a radius (R)"),
        ("G3 X1 I1 R1", "an arc takes a center (I J) or a radius (R), not both"),
        ("G3 R10", "an arc with R needs an end other than its start: a full circle takes its center (I J K)"),
        ("G3 X0 Y0 R-10", "an arc with R needs an end other than its start: a full circle takes its center (I J K)"),
        ("G3 I0 J0", "the arc's radius is zero: 0.000000 mm at its start, 0.000000 mm at its end"),
        ("G3 X.001 R0", "the arc's radius is zero: 0.000000 mm"),
        ("G3 X10 I0", "the arc's radius is zero: 0.000000 mm at its start, 10.000000 mm at its end"),
        (
            "G2 X2000 I998.5",
            "the arc's radii disagree: 998.500000 mm at its start, 1001.500000 mm at its end, "
            "difference 3.000000 mm (at most 1.001500 mm)",
        ),
        (
            "G3 X20.01 R10",
            "radius too small: the end is 20.010000 mm from the start, twice the radius is 20.000000 mm",
        ),
        (
            "G20 G2 X2 I.997",
            "the arc's radii disagree: 25.323800 mm at its start, 25.476200 mm at its end, "
            "difference 0.152400 mm (at most 0.071842 mm)",
        ),
        (
            "G2 X80000 I39998.5",
            "the arc's radii disagree: 39998.500000 mm at its start, 40001.500000 mm at its end, "
            "difference 3.000000 mm (at most 2.828427 mm)",
        ),
        ("F-1", "the feed F-1 is negative"),
        ("F0 G1 X1", "G1 needs a feed: no F word above 0 in this block or before"),
    ],
)
def test_refused_blocks(block: str, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        toolpath(f"(first)\nF100\n  {block} \nM2")
    assert str(caught.value) == f"part.ngc:3: {reason}: '{block}'"


@pytest.mark.parametrize("block", ["G1 X1", "G2 X2 I1", "G3 X2 R1"])
def test_missing_feed(block: str) -> None:
    with pytest.raises(ProgramError, match=re.escape(f"part.ngc:2: {block[:2]} needs a feed")):
        toolpath(f"G0 Z5\n{block}")


def test_a_mode_set_without_a_motion() -> None:
    (element,) = toolpath("G1\nF100\nX1").elements
    assert element.line == 3


def test_motion_to_where_the_tool_is() -> None:
    path = toolpath("G1 F100 X10\nX10\nG0 X10\nX10.0000000001\nG1 X20")
    assert [element.line for element in path] == [1, 5]
    motions = list(read_motions(Program("part.ngc", "G0 X0\nG1 F60 X1"), start=ORIGIN, zero=ORIGIN, rapid=RAPID))
    assert [motion.length for motion in motions] == [0.0, 0.001]


@pytest.mark.parametrize("comment", [NOT_EVALUATED_COMMENT, NOT_EVALUATED_COMMENT.upper(), "(pkm_cnc:not  evaluated )"])
def test_not_evaluated(comment: str) -> None:
    path = toolpath(f"{comment}\nG1 F60 X10 {comment}\n{comment} X20\nX30 (other)\nG2{comment}I1\nI1\nX40 R5;{comment}")
    assert [element.evaluated for element in path] == [False, False, True, False, True, True]


def test_listing() -> None:
    zero = (0.1, 0.2, 0.3)
    program = Program("part.ngc", "G0 X0 Y0 Z0\nG1 X0.1 F6000\nG3 X0.1 I-10\nG2 X-9.9 Y10 R10\n")
    listing = canonical_motion(read_motions(program, start=zero, zero=zero, rapid=RAPID), zero)
    assert listing == [
        {"kind": "traverse", "line": 1, "end_mm": [0.0, 0.0, 0.0], "feed_mm_min": 30000.0},
        {"kind": "feed", "line": 2, "end_mm": [0.1, 0.0, 0.0], "feed_mm_min": 6000.0},
        {
            "kind": "arc",
            "line": 3,
            "end_mm": [0.1, 0.0, 0.0],
            "feed_mm_min": 6000.0,
            "center_mm": [-9.9, 0.0, 0.0],
            "turns": 1,
            "plane": "xy",
        },
        {
            "kind": "arc",
            "line": 4,
            "end_mm": [-9.9, 10.0, 0.0],
            "feed_mm_min": 6000.0,
            "center_mm": [0.1, 10.0, 0.0],
            "turns": -1,
            "plane": "xy",
        },
    ]


@pytest.mark.parametrize(
    ("block", "center", "sweep"),
    [  # from (0, 0); center in mm, sweep in degrees
        ("G3 X10 Y10 J10", (0.0, 10.0), 90.0),
        ("G2 X10 Y10 J10", (0.0, 10.0), -270.0),
        ("G2 X10 Y10 I10", (10.0, 0.0), -90.0),
        ("G3 X10 Y10 R10", (0.0, 10.0), 90.0),
        ("G3 X10 Y10 R-10", (10.0, 0.0), 270.0),
        ("G2 X10 Y10 R10", (10.0, 0.0), -90.0),
        ("G2 X10 Y10 R-10", (0.0, 10.0), -270.0),
        ("G2 X20 R10", (10.0, 0.0), -180.0),
        ("G3 X20 I10", (10.0, 0.0), 180.0),
        ("G3 X20.002 R10", (10.001, 0.0), 180.0),
        ("G3 I10", (10.0, 0.0), 360.0),
        ("G2 X0 Y0 J-5", (0.0, -5.0), -360.0),
    ],
)
def test_arcs(block: str, center: tuple[float, float], sweep: float) -> None:
    element = arc(block)
    assert element.center == pytest.approx((center[0] / 1000, center[1] / 1000, 0.0), abs=1e-16)
    assert math.degrees(element.sweep) == pytest.approx(sweep, abs=1e-12)


def test_a_full_circle_ends_exactly_where_it_starts() -> None:
    path = toolpath("G1 F60 X33.333 Y.7\nG2 I-12.345 J6.789\nX33.333 Y.7 I-1")
    assert path.elements[1].start == path.elements[1].end == path.elements[2].end


coordinates = st.integers(-200_000, 200_000)  # um


@settings(derandomize=True, max_examples=300, deadline=None)
@given(coordinates, coordinates, st.integers(1000, 200_000), st.floats(0.0, 6.28), st.floats(0.05, 6.2), st.booleans())
def test_rounded_arcs_run_on_one_circle_close_to_the_programmed_one(
    x: int, y: int, radius: int, from_angle: float, sweep: float, ccw: bool
) -> None:
    """Arcs as a CAM system writes them, three decimals of a mm: through both ends, at most 5 um off, right sweep."""
    chord = 2.0 * radius * math.sin(sweep / 2.0)
    assume(abs(chord) > radius)  # below, refusing a long arc is right
    direction = 1.0 if ccw else -1.0
    start = [x / 1000.0, y / 1000.0]
    i, j = (round(-radius * f(from_angle) / 1000.0, 3) for f in (math.cos, math.sin))
    end = [
        round((c + radius * f(from_angle + direction * sweep)) / 1000.0 + o, 3)
        for c, f, o in ((x, math.cos, i), (y, math.sin, j))
    ]
    text = f"G0 X{start[0]} Y{start[1]}\nG{3 if ccw else 2} F60 X{end[0]:.3f} Y{end[1]:.3f} I{i:.3f} J{j:.3f}"
    element = toolpath(text).elements[-1]
    assert isinstance(element, Arc)
    assert element.end == (end[0] / 1000.0, end[1] / 1000.0, 0.0)
    assert math.dist(element.start, element.center) == pytest.approx(math.dist(element.end, element.center), abs=1e-15)
    for part in range(101):
        px, py, _ = element.position(element.length * part / 100.0)
        off = math.dist((px, py), ((start[0] + i) / 1000.0, (start[1] + j) / 1000.0)) - math.hypot(i, j) / 1000.0
        assert abs(off) < 5e-6
    assert element.sweep == pytest.approx(direction * sweep, abs=5e-6 / (radius * 1e-6))
    assert element.position(element.length * (1.0 - 1e-12)) == pytest.approx(element.end, abs=1e-11)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(coordinates, coordinates, st.floats(1.0, 50.0), st.booleans(), st.booleans())
def test_radius_arcs(x: int, y: int, factor: float, ccw: bool, longer: bool) -> None:
    chord = math.hypot(x, y) / 1000.0
    assume(chord > 0.1)
    radius = 0.5 * chord * factor
    element = arc(f"G{3 if ccw else 2} X{x / 1000.0} Y{y / 1000.0} R{'-' if longer else ''}{radius:.9f}")
    assert element.radius == pytest.approx(radius / 1000.0, rel=1e-6)
    assert (element.sweep > 0.0) == ccw
    assert abs(element.sweep) >= math.pi - 1e-3 if longer else abs(element.sweep) <= math.pi + 1e-3
    # independent of the center's formula: chord and sweep make the radius, and the arc bulges to the right side
    assert 2.0 * element.radius * math.sin(abs(element.sweep) / 2.0) == pytest.approx(chord / 1000.0, rel=1e-6)
    mx, my, _ = element.position(0.5 * element.length)
    side = element.end[0] * my - element.end[1] * mx
    assert (side < 0.0) == ccw


def test_elements_connect_bit_for_bit() -> None:
    text = "G1 F600\n" + "\n".join(f"X{index * 0.1:.3f} Y{index * index * 0.01:.3f}" for index in range(1, 200))
    path = toolpath(text, start=(0.1, 0.2, 0.3), zero=(0.1, 0.2, 0.3))
    assert all(a.end == b.start for a, b in zip(path.elements, path.elements[1:], strict=False))


def test_an_arc_keeps_its_height_exactly() -> None:
    (element,) = toolpath("G3 F60 X2 Z0 I1", start=(0.0, 0.0, 1e-13)).elements
    assert element.end == (0.002, 0.0, 1e-13)
