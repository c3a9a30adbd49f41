"""What moves where: planes, units, increments, offsets, machine coordinates, arcs at their tolerances; and events."""

import math
import random
from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pkm_cnc.contour import ContourTracker
from pkm_cnc.program import (
    Arc,
    ArcFeed,
    Event,
    Line,
    PathMode,
    Plane,
    Program,
    ProgramError,
    ProgramParameters,
    canonical_events,
    interpret,
    read_elements,
    read_motions,
)
from pkm_cnc.records import Vector

ORIGIN = (0.0, 0.0, 0.0)


def items(
    text: str, start: Vector = ORIGIN, zero: Vector = ORIGIN, **parameters: object
) -> list[Line | ArcFeed | Event]:
    options = ProgramParameters(**parameters)
    return list(read_motions(Program("p.ngc", text), start=start, zero=zero, rapid=0.1, parameters=options))


def motions(text: str, start: Vector = ORIGIN, zero: Vector = ORIGIN, **parameters: object) -> list[Line | ArcFeed]:
    return [item for item in items(text, start, zero, **parameters) if not isinstance(item, Event)]


def ends_mm(text: str, **others: object) -> list[tuple[float, ...]]:
    return [tuple(round(1e3 * x, 9) + 0.0 for x in motion.end) for motion in motions(text, **others)]


def events(text: str) -> list[tuple[str, float | None]]:
    return [(item.kind, item.value) for item in items(text) if isinstance(item, Event)]


@pytest.mark.parametrize(("code", "letters"), [("G18", "ZXYKIJ"), ("G19", "YZXJKI")])
def test_planes_are_the_first_with_its_letters_renamed(code: str, letters: str) -> None:
    """Every arc of G17 is one of G18 and G19 when X Y Z I J K are renamed cyclically."""
    text = "F600 G2 X10 Y10 I10\nG3 X20 Y0 R-12\nG2 I5 J2 P3\nG3 X30 Y4 Z-7 I5 J2 P2\nG2 X31 Y3 R4 Z2\nG1 X0 Y0 Z0"
    other = "".join(dict(zip("XYZIJK", letters, strict=True)).get(letter, letter) for letter in text)
    plane = {"G18": Plane.ZX, "G19": Plane.YZ}[code]
    for one, renamed in zip(motions(text), motions(f"{code} {other}"), strict=True):
        assert renamed.end == plane.vector(*one.end)
        if isinstance(one, ArcFeed):
            assert isinstance(renamed, ArcFeed)
            assert (renamed.turns, renamed.plane) == (one.turns, plane)
            assert renamed.center == plane.vector(*one.center)
            assert [arc.sweep for arc in renamed.arcs] == [arc.sweep for arc in one.arcs]
            assert [arc.length for arc in renamed.arcs] == [arc.length for arc in one.arcs]


def test_turns_and_helices() -> None:
    full, part, helix = motions("F600 G3 I10 P3\nG2 X10 Y10 I10 P2\nG3 Z-6 I-10 P4")
    assert isinstance(full, ArcFeed)
    assert isinstance(part, ArcFeed)
    assert isinstance(helix, ArcFeed)
    assert [arc.sweep for arc in full.arcs] == [3.0 * math.tau]
    assert part.arcs[0].sweep == pytest.approx(-0.25 * math.tau - math.tau, rel=1e-15)
    assert (full.turns, part.turns, helix.turns) == (3, -2, 4)
    assert helix.length == pytest.approx(math.hypot(4.0 * math.tau * 0.01, 0.006), rel=1e-14)
    assert helix.arcs[0].tangent(0.0)[2] == pytest.approx(-0.006 / helix.length, rel=1e-14)


def test_inches_and_increments() -> None:
    assert ends_mm("G20 G0 X1\nG21 X1\nG91 X1 Y2\nG20 X1\nG90 Y1") == [
        *((25.4, 0, 0), (1, 0, 0), (2, 2, 0), (27.4, 2, 0), (27.4, 25.4, 0))
    ]
    slow, fast = motions("F60 G1 X1\nG20 F60\nX2")
    assert (slow.feed, fast.feed) == (0.001, 0.001)  # as NIST orders it, F comes before the units of its block
    assert motions("G20\nF60 G1 X1")[0].feed == pytest.approx(0.0254, rel=1e-15)
    (arc,) = motions("G20\nF60 G3 G91 X2 I1")
    assert isinstance(arc, ArcFeed)
    assert arc.center == pytest.approx((0.0254, 0.0, 0.0), abs=1e-16)


def test_centers_by_coordinates() -> None:
    relative = motions("G0 X10 Y5\nF60 G3 X20 Y15 J10\nG18 G2 X40 Z20 I20\nG91 G17 G2 X1 R1")
    absolute = motions("G0 X10 Y5\nF60 G90.1 G3 X20 Y15 I10 J15\nG18 G2 X40 Z20 I40 K0\nG91.1 G17 G91 G2 X1 R1")
    for one, other in zip(relative, absolute, strict=True):
        assert other.end == one.end
        if isinstance(one, ArcFeed):
            assert isinstance(other, ArcFeed)
            assert other.arcs[0].sweep == pytest.approx(one.arcs[0].sweep, rel=1e-14)
            assert other.center == pytest.approx(one.center, abs=1e-16)


def test_renamed_position() -> None:
    zero = (0.1, 0.2, 0.3)
    found = motions("G0 X10 Y10 Z10\nG92 X1 Z2\nG0 X5 Y5 Z5\nG92.1\nX0 Y0 Z0\nG92 Y7\nY7", start=zero, zero=zero)
    expected = [(10, 10, 10), (14, 5, 13), (0, 0, 0), (0, 0, 0)]
    for motion, end in zip(found, expected, strict=True):
        assert motion.end == pytest.approx([z + 1e-3 * x for z, x in zip(zero, end, strict=True)], abs=1e-16)


def test_machine_coordinates() -> None:
    assert ends_mm("G0 X1 G53 Y2\nG91 G53 G1 F60 Z3\nZ1", start=(0.1, 0.1, 0.1), zero=(0.05, 0.0, 0.0)) == [
        *((1, 2, 100), (1, 2, 3), (1, 2, 4))
    ]
    assert ends_mm("G92 X50\nG53 G0 X7\nX7") == [(7, 0, 0), (-43, 0, 0)]


def test_reference_poses() -> None:
    poses = {"g28_pose": (0.05, 0.06, 0.07), "g30_pose": (-0.01, 0.0, 0.0)}
    assert ends_mm("G0 X1 Y2\nG28", **poses) == [(1, 2, 0), (50, 60, 70)]
    assert ends_mm("G0 X1 Y2\nG28 Z9", **poses) == [(1, 2, 0), (1, 2, 9), (1, 2, 70)]
    assert ends_mm("G0 X1\nG91 G28 X0 Z1\nX1", **poses) == [(1, 0, 0), (1, 0, 1), (50, 0, 70), (51, 0, 70)]
    found = motions("F60 G1 X1\nG30\nX2", **poses)
    assert [motion.end[0] for motion in found] == [0.001, -0.01, 0.002]
    assert [motion.traverse for motion in found if isinstance(motion, Line)] == [False, True, False]


@pytest.mark.parametrize(
    ("key", "metric", "imperial"),
    [
        ("#5420", -10.0, -10.0 / 25.4),
        ("#<_x>", -10.0, -10.0 / 25.4),
        ("#5421", 25.4, 1.0),
        ("#<_z>", 0.0, 0.0),
        ("#5161", 12.7, 0.5),
        ("#5183", 2.54, 0.1),
        ("#5211", 13.0, 13.0 / 25.4),  # position 3, called -10
        ("#5212", 0.0, 0.0),
        ("#5220", 1.0, 1.0),
        ("#5221", 2.0, 2.0 / 25.4),
        ("#<_feed>", 254.0, 10.0),
        ("#<_rpm>", 700.0, 700.0),
        ("#<_line>", 4.0, 4.0),
        ("#<_metric>", 1.0, 0.0),
        ("#<_imperial>", 0.0, 1.0),
        ("#<_absolute>", 1.0, 1.0),
        ("#<_incremental>", 0.0, 0.0),
    ],
)
def test_reading_the_state(key: str, metric: float, imperial: float) -> None:
    for units, expected in (("G21", metric), ("G20", imperial)):
        text = f"G0 Y25.4\nG92 X-10\nS700 F254 {units}\nT1 (line 4) G4 P[{key} + 100]"
        found = items(
            text,
            zero=(0.002, 0.0, 0.0),
            start=(0.005, 0.0, 0.0),
            g28_pose=(0.0127, 0.0, 0.0),
            g30_pose=(0.0, 0.0, 0.00254),
        )
        assert isinstance(found[-1], Event)
        assert found[-1].value == pytest.approx(100.0 + expected, abs=1e-11)


def test_path_modes() -> None:
    text = "F60 G1 X1\nG64 P.5 Q.25 X2\nX3 G64 P.5\nG64 X4\nG61.1 X5\nG20 G64 P1\nX6\nG61 X7"
    modes = [motion.path_mode for motion in motions(text) if isinstance(motion, Line)]
    assert modes == [
        PathMode("G61"),
        PathMode("G64", 0.0005, 0.00025),
        PathMode("G64", 0.0005, 0.0005),
        PathMode("G64"),
        PathMode("G61.1"),
        PathMode("G64", 0.0254, 0.0254),
        PathMode("G61"),
    ]
    (arc,) = motions("G64 P1 F60\nG3 I1")
    assert isinstance(arc, ArcFeed)
    assert arc.arcs[0].path_mode == PathMode("G64", 0.001, 0.001)


def test_neutral_states() -> None:
    assert ends_mm("G17 G21 G40 G49 G54 G80 G90 G94 G0 X1\nX2") == [(1, 0, 0), (2, 0, 0)]


def test_events_in_the_order_they_are_done() -> None:
    assert events("M9 M3 T4 M6 S900 G4 P.5 M1 F9\nM8 M4\nS1\nM5 M0\nM7\n(MSG, hello )\nM2\nM3") == [
        ("spindle_speed", 900.0),
        ("tool_select", 4.0),
        ("tool_change", 4.0),
        ("spindle_clockwise", 900.0),
        ("coolant_off", None),
        ("dwell", 0.5),
        ("optional_stop", None),
        ("spindle_counterclockwise", 900.0),
        ("flood_on", None),
        ("spindle_speed", 1.0),
        ("spindle_stop", None),
        ("program_stop", None),
        ("mist_on", None),
        ("message", None),
        ("program_end", None),
    ]


def test_events_know_where_on_the_path_they_happen() -> None:
    text = "F60 G1 X3 Y4 M3 S1\nM8 G3 X13 I5 Z1 M0\nG3 X13 Y4.00001 I5\n(msg,Now)M30"
    path = interpret(Program("p.ngc", text), start=ORIGIN, zero=ORIGIN, rapid=0.1)
    at = {event.kind: event.path_length for event in path.events}
    assert (at["spindle_speed"], at["spindle_clockwise"], at["flood_on"]) == (0.0, 0.0, path.starts[1])
    assert at["program_stop"] == path.starts[2]
    assert at["message"] == at["program_end"] == path.length
    assert [event["path_length_mm"] for event in canonical_events(path.events)][-1] == round(1e3 * path.length, 9)
    assert canonical_events(path.events)[-2]["text"] == "Now"


def test_elements_come_one_by_one() -> None:
    """What is wrong later on does not matter before it is reached, and nothing is kept."""
    text = "F60 G1\n#1=0\no1 while [1]\n#1=[#1+1]\nX#1\no1 endwhile"
    stream = read_elements(Program("p.ngc", text), start=ORIGIN, zero=ORIGIN, rapid=0.1)
    assert [next(stream).end[0] for _ in range(3)] == [0.001, 0.002, 0.003]
    stream = read_elements(Program("p.ngc", "G0 X1\nX2\nX#<_none>"), start=ORIGIN, zero=ORIGIN, rapid=0.1)
    assert [next(stream).line, next(stream).line] == [1, 2]
    with pytest.raises(ProgramError, match=r"^p\.ngc:3: parameter #<_none> was not set before: 'X#<_none>'$"):
        next(stream)


# --- arcs whose radii disagree, up to the tolerances of the peer


@pytest.mark.parametrize(
    ("block", "good"),
    [  # radii 10 and 10 + d: 0.0283 mm are allowed, 0.1 % of 10 mm are less
        ("X20.0282 I10", True),
        ("X20.0284 I10", False),
        ("X2002.0 I1000", True),  # radii 1000 and 1002: 0.1 % are 1.002
        ("X2001.0 I1000", True),
        ("X2002.1 I1000", False),
        ("X20.0025 R10", True),  # half the chord may exceed R by 0.00127 mm
        ("X20.0026 R10", False),
        ("X.0025 I.00126", False),  # no radius below that
        ("X.0026 I.0013", True),
    ],
)
def test_tolerances(block: str, good: bool) -> None:
    if block == "X2002.0 I1000":
        good = False  # 2 mm of 1002 mm are more than 0.1 %
    if good:
        motions(f"F60 G2 {block}")
    else:
        with pytest.raises(ProgramError, match=r"disagree|too small|radius is zero"):
            motions(f"F60 G2 {block}")


def test_tolerance_in_inches() -> None:
    motions("G20\nF60 G2 X2.0028 I1")  # 0.0028 inch = 0.071 mm
    with pytest.raises(ProgramError, match="disagree"):
        motions("G20\nF60 G2 X2.0029 I1")


@pytest.mark.parametrize(
    ("block", "turns"),
    [
        ("G3 X.001 I50", 1),  # radially off the start: all but a full turn
        ("G2 X.001 I50", 1),
        ("G3 X.02 I20 Z5", 1),
        ("G3 X10.02 Y10.02 I10 P3", 3),
        ("G2 X.02 I5 P4 Z1", 4),
        ("G3 X.015 Y.015 I5.01 J5", 1),
        ("G2 X.03 Y-.01 I5.01 J5", 1),
    ],
)
def test_arcs_that_no_circle_closes_are_run_close_to_the_programmed_one(block: str, turns: int) -> None:
    """Through both ends exactly, joined, tangent up to the disagreement, never further off than that."""
    (arc,) = motions(f"F60 {block}")
    assert isinstance(arc, ArcFeed)
    center, start, end = (complex(*point[:2]) for point in (arc.center, arc.start, arc.end))
    radii = abs(start - center), abs(end - center)
    disagreement = abs(radii[0] - radii[1])
    assert len(arc.arcs) > 1
    assert (arc.arcs[0].start, arc.arcs[-1].end) == (arc.start, arc.end)
    assert abs(arc.turns) == turns
    total = sum(part.sweep for part in arc.arcs)
    exact = math.copysign(1.0, arc.turns) * math.tau * turns
    missing = abs(exact) - abs(total)
    assert -1e-3 < missing < math.tau + 1e-3
    for part in arc.arcs:
        assert abs(part.sweep) <= math.pi * (1.0 + 1e-3)
        for step in range(21):
            radius = abs(complex(*part.position(part.length * step / 20)[:2]) - center)
            assert min(radii) - 0.5 * disagreement <= radius <= max(radii) + 0.5 * disagreement
    for before, after in pairwise(arc.arcs):
        assert before.end == after.start
        assert math.dist(before.tangent(before.length), after.tangent(0.0)) < 2.0 * disagreement / min(radii)


decimals = st.integers(-20_000, 20_000).map(lambda n: n / 1000)


@settings(derandomize=True, max_examples=120, deadline=None)
@given(
    st.integers(2_000, 90_000), st.floats(0.0, math.tau), st.floats(1e-3, math.tau), st.booleans(), st.integers(2, 4)
)
def test_arcs_as_a_cam_system_rounds_them_are_always_run(
    radius_um: int, angle: float, sweep: float, ccw: bool, places: int
) -> None:
    """With 2 to 4 decimals of a mm: accepted, sweep right but for rounding, nowhere off by more than rounding."""
    radius, direction = radius_um / 1000, 1.0 if ccw else -1.0
    rounding = 0.5 * 10.0**-places
    assume(2.0 * radius * math.sin(min(sweep, math.tau - sweep, math.pi) / 2.0) > 10.0 * rounding)
    start = [round(radius * f(angle), places) for f in (math.cos, math.sin)]
    end = [round(radius * f(angle + direction * sweep), places) for f in (math.cos, math.sin)]
    center = [round(-radius * f(angle), places) for f in (math.cos, math.sin)]
    text = f"G0 X{start[0]} Y{start[1]}\nF60 G{3 if ccw else 2} X{end[0]} Y{end[1]} I{center[0]} J{center[1]}"
    arc = motions(text)[-1]
    assert isinstance(arc, ArcFeed)
    assert sum(part.sweep for part in arc.arcs) == pytest.approx(direction * sweep, abs=10.0 * rounding / radius)
    assert arc.arcs[-1].end == (end[0] / 1000, end[1] / 1000, 0.0)
    for part in arc.arcs:
        for step in range(33):
            x, y, _ = part.position(part.length * step / 32)
            off = math.hypot(1e3 * x - start[0] - center[0], 1e3 * y - start[1] - center[1]) - radius
            assert abs(off) < 8.0 * rounding + 0.0051  # ARC_RADII, within which a circle counts as the programmed one


def test_a_helix_is_followed_by_the_contour_tracker_across_its_junctions() -> None:
    path = interpret(
        Program("p.ngc", "F60 G1 X10\nG3 X10 Y20 J10 Z3 P3\nG19 G2 Z23 K10 X-2\nG1 Z30"),
        start=ORIGIN,
        zero=ORIGIN,
        rapid=0.1,
    )
    tracker = ContourTracker()
    for index, (element, start) in enumerate(zip(path.elements, path.starts, strict=True)):
        tracker.add(index, element, start)
    assert [type(element) for element in path.elements] == [Line, Arc, Arc, Line]
    for index, element in enumerate(path.elements):
        for step in range(1, 200):
            s = element.length * step / 200
            error = tracker.step(element.position(s), min(index + 1, 3))
            assert error.segment == index
            assert error.magnitude < 1e-12
            assert error.path_length == pytest.approx(path.starts[index] + s, abs=1e-9)


# --- random programs


@st.composite
def moves(draw: st.DrawFn) -> tuple[str, list[tuple[Fraction, ...]]]:
    """A program of straight motions in changing units and distance modes, and its ends in mm, reckoned in fractions."""
    text, ends = ["F100 G1"], []
    position, origin = [Fraction(0)] * 3, [Fraction(0)] * 3
    unit, absolute = Fraction(1), True
    for _ in range(draw(st.integers(1, 25))):
        word = draw(st.sampled_from(["", "", "", "G20", "G21", "G90", "G91", "G92", "G92.1", "G53"]))
        unit = {"G20": Fraction("25.4"), "G21": Fraction(1)}.get(word, unit)
        absolute = {"G90": True, "G91": False}.get(word, absolute)
        axes = draw(st.lists(st.sampled_from(range(3)), min_size=1, unique=True))
        values = {axis: draw(st.integers(-99999, 99999)) for axis in axes}
        block = " ".join(f"{'XYZ'[axis]}{number / 1000:.3f}" for axis, number in values.items())
        text.append(word if word == "G92.1" else f"{word} {block}")
        if word == "G92.1":
            origin = [Fraction(0)] * 3
            continue
        for axis, number in values.items():
            length = Fraction(number, 1000) * unit
            if word == "G92":
                origin[axis] = position[axis] - length
            else:
                base = Fraction(0) if word == "G53" else origin[axis] if absolute else position[axis]
                position[axis] = base + length
        if word != "G92":
            ends.append(tuple(position))
    return "\n".join(text), ends


@settings(derandomize=True, max_examples=60, deadline=None)
@given(moves())
def test_random_motions_end_where_fractions_say(program: tuple[str, list[tuple[Fraction, ...]]]) -> None:
    text, ends = program
    found = [motion.end for motion in motions(text)]
    assert len(found) == len(ends)
    for end, expected in zip(found, ends, strict=True):
        assert end == pytest.approx([float(x / 1000) for x in expected], abs=1e-14)


SPELLED = (
    "%\nN10G17G21G90G64P0.5\nM3S100T1\nG0X1Y2Z3\nG1F60X-4.5\nG2X10Y10R20\nG91G3X2I1P2Z.5\nG4P.25\n#1=[2+ATAN[1]/[1]]"
    "\nG1X#1\nO1REPEAT[2]\nG1X[#1*2]\nO1ENDREPEAT\nM30\n%"
)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.randoms(use_true_random=False))
def test_blanks_case_and_comments_have_no_meaning(rng: random.Random) -> None:
    """Between any two characters of a block blanks may stand; between words and at ends comments."""
    lines = []
    for line in SPELLED.split("\n"):
        blanks = [rng.choice(("", "", " ", "\t")) for _ in line]
        spaced = "".join(b + rng.choice((c.lower(), c)) for b, c in zip(blanks, line, strict=True))
        if line != "%":
            spaced = rng.choice(("", "(a ; b) ")) + spaced + rng.choice(("", "(X1)", "; (G1 X[", " \t"))
        lines += [spaced, *rng.choice(((), ("",), ("(only this)",)))]
    plain, written = (
        [item._replace(line=0) if isinstance(item, Event) else (item.end, item.length) for item in items(text)]
        for text in (SPELLED, "\n".join(lines))
    )
    assert written == plain
