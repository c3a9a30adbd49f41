"""The compensated program as a text: what it carries, how near it keeps to the corrected contour, how it keeps time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.compensation.correction import Correction, spans_of
from pkm_cnc.compensation.writer import DECIMALS, compensated_program
from pkm_cnc.errors import InputError
from pkm_cnc.motion import MotionParameters
from pkm_cnc.program import Program, carried_original, carry_original, interpret, with_reference
from pkm_cnc.records import TcpSetpoint

ORIGIN = (0.0, 0.0, 0.0)
ZERO = (0.01, -0.02, 0.03)
READING = {"start": ORIGIN, "zero": ZERO, "rapid": 0.2}
TEXT = """(a test: {braces})
G21 G90 G17 M3 S1200
G0 X10 Y5 Z-30
G1 X60 Y20 F3000 (pkm_cnc: not evaluated)
G4 P0.5
G2 X60 Y-20 I0 J-20
(MSG, half way)
G18 G3 X40 Z-30 I-10 K0
G17 G1 X10 Y-20 Z-35
M5
M2
"""
ROUNDING = 0.5e-3 * 10.0**-DECIMALS * math.sqrt(3.0)


def compensated(text=TEXT, size=50e-6, tolerance=1e-8):
    """A program with a wavy correction of `size`, its contour, and the correction."""
    program = Program("part.ngc", text)
    contour = interpret(program, **READING)
    spans = spans_of(contour, MotionParameters(wait_in_position=True), 20.0, 2e-3)
    s = np.linspace(0.0, contour.length, 3000)
    waves = size * np.stack([np.sin(s / 8e-3), np.cos(s / 9e-3), np.sin(s / 7e-3 + 1.0)], axis=1)
    tangents = np.array([tangent(contour, place) for place in s])
    waves -= (waves * tangents).sum(axis=1)[:, None] * tangents
    correction = Correction.fitted(spans, s, waves)
    written = compensated_program(program, items(contour), correction, zero=ZERO, tolerance=tolerance)
    return Program("out.ngc", written), contour, correction


def items(contour):
    events = list(contour.events)
    for element, start in zip(contour.elements, contour.starts, strict=True):
        while events and events[0].path_length <= start:
            yield events.pop(0)
        yield element
    yield from events


def place_of(contour, s):
    index = max(int(np.searchsorted(contour.starts, s, side="right")) - 1, 0)
    return contour.elements[index], s - contour.starts[index]


def tangent(contour, s):
    element, place = place_of(contour, s)
    return element.tangent(place)


def without_comments(text):
    return "\n".join(line for line in text.splitlines() if not line.startswith("(pkm_cnc"))


def test_it_carries_the_original_whose_contour_counts():
    program, contour, _ = compensated()
    toolpath = interpret(program, **READING)
    assert toolpath.contour.elements == contour.elements
    assert carried_original(program).text.splitlines()[1:] == TEXT.splitlines()[1:]
    assert [event[:2] + event[3:] for event in toolpath.events] != []
    kinds = [event.kind for event in toolpath.events if event.kind != "contour_element"]
    assert kinds == [event.kind for event in contour.events]


def test_a_machine_that_ignores_comments_moves_alike():
    program, _, _ = compensated()
    bare = interpret(Program("bare.ngc", without_comments(program.text)), **READING)
    whole = interpret(program, **READING)
    assert bare.original is None
    assert [(one.start, one.end, one.feed, one.length) for one in bare] == [
        (one.start, one.end, one.feed, one.length) for one in whole
    ]


def test_every_motion_has_the_line_of_the_original():
    program, contour, _ = compensated()
    toolpath = interpret(program, **READING)
    for line in program.text.splitlines():
        if line.startswith("N"):
            number = int(line[1:].split()[0])
            assert number in {element.line for element in contour.elements}
    owners = [contour.elements[place.segment].line for place in toolpath.places]
    lines = [int(program.text.splitlines()[one.line - 1][1:].split()[0]) for one in toolpath]
    assert owners == lines


@pytest.mark.parametrize("tolerance", [1e-8, 1e-6])
def test_the_written_path_keeps_the_tolerance(tolerance):
    program, contour, correction = compensated(tolerance=tolerance)
    toolpath = interpret(program, **READING)
    worst = 0.0
    for element, place in zip(toolpath.elements, toolpath.places, strict=True):
        if contour.elements[place.segment].traverse:
            continue
        for part in (0.0, 0.25, 0.5, 1.0):
            s = place.path_length + place.rate * part * element.length
            for _ in range(3):  # to the nearest place of the curve
                exact, direction = on_curve(contour, correction, np.array([s - 1e-7, s, s + 1e-7]))
                missed = np.array(element.position(part * element.length)) - exact
                s += missed @ direction
            worst = max(worst, float(np.linalg.norm(missed)))
    assert worst < 1.05 * tolerance + ROUNDING + 2e-10
    assert worst > 0.2 * tolerance  # no more pieces than needed


def on_curve(contour, correction, s):
    """The corrected contour at the middle one of `s`, and its direction."""
    points = np.array([(lambda at: at[0].position(at[1]))(place_of(contour, place)) for place in s]) + correction.at(s)
    direction = points[2] - points[0]
    return points[1], direction / np.linalg.norm(direction)


def test_the_mean_distance_is_zero():
    program, contour, correction = compensated(tolerance=1e-6)
    toolpath = interpret(program, **READING)
    normals = []
    for element, place in zip(toolpath.elements, toolpath.places, strict=True):
        if place.segment != 1:  # a line of the original
            continue
        for part in np.linspace(0.025, 0.975, 20):
            s = place.path_length + place.rate * part * element.length
            exact, _ = on_curve(contour, correction, np.array([s - 1e-7, s, s + 1e-7]))
            bend = correction.at(np.array([s]), 2)[0]
            missed = np.array(element.position(part * element.length)) - exact
            normals.append((missed @ bend / np.linalg.norm(bend), element.length))
    missed, lengths = np.array(normals).T
    assert np.abs(missed).max() > 0.3e-6
    assert abs((missed * lengths).sum() / lengths.sum()) < 0.02e-6


def test_every_element_takes_the_time_that_it_took():
    program, contour, _ = compensated()
    toolpath = interpret(program, **READING)
    time = np.zeros(len(contour.elements))
    for element, place in zip(toolpath.elements, toolpath.places, strict=True):
        time[place.segment] += element.length / element.feed
    wanted = [element.length / element.feed for element in contour.elements]
    np.testing.assert_allclose(time, wanted, rtol=1e-7)


def test_without_a_correction_the_motion_is_the_original():
    program = Program("part.ngc", TEXT)
    contour = interpret(program, **READING)
    spans = spans_of(contour, MotionParameters(), 20.0, 2e-3)
    text = compensated_program(program, items(contour), Correction.none(spans), zero=ZERO, tolerance=1e-8)
    again = interpret(Program("out.ngc", text), **READING)
    assert len(again.elements) == len(contour.elements)
    for one, other in zip(again, contour, strict=True):
        np.testing.assert_allclose([one.start, one.end], [other.start, other.end], atol=1e-10)
        assert one.length == pytest.approx(other.length, abs=1e-9)
        assert type(one) is type(other)


def test_path_modes_stay_at_the_ends_of_elements_and_lines_are_not_joined():
    program, contour, _ = compensated("G64 P0.02 Q0.01\nG1 X30 F3000\nY20\nG61.1 X0\nM2\n")
    toolpath = interpret(program, **READING)
    for element, after in zip(toolpath.places, [*toolpath.places[1:], None], strict=True):
        mode = toolpath.elements[toolpath.places.index(element)].path_mode
        last = after is None or after.segment != element.segment
        wanted = contour.elements[element.segment].path_mode.code if last else "G61"
        assert mode.code == wanted
        assert not mode.naive_cam


def test_marks_that_do_not_fit_are_refused():
    program, _, _ = compensated()
    changed = Program("out.ngc", program.text.replace("(pkm_cnc element: 2)", "(pkm_cnc element: 3)"))
    with pytest.raises(InputError, match=r"out\.ngc: its element comments do not go through"):
        interpret(changed, **READING)


def test_a_correction_as_steep_as_a_wall_is_refused():
    with pytest.raises(InputError, match=r"part\.ngc:4: the correction.*too steep"):
        compensated(size=5e-3)


def test_a_reference_is_carried_behind_and_leads_by_length():
    run = with_reference(Program("a.ngc", "G1 X100 F1000\nX200\nM2\n"), Program("b.ngc", "G1 X50 F1000\nX200\nM2\n"))
    toolpath = interpret(run, start=ORIGIN, zero=ORIGIN, rapid=0.2)
    assert [element.line for element in toolpath] == [1, 2]
    rests = (0.0,) * 9
    for motion, path_length, segment in ((0, 0.0, 0), (0, 0.04, 0), (0, 0.08, 1), (1, 0.1, 1), (1, 0.2, 1)):
        on_contour = toolpath.on_contour(TcpSetpoint(*rests, path_length, 0.1, motion, 0))
        assert (on_contour.segment, on_contour.path_length) == (segment, pytest.approx(path_length))
    assert toolpath.contour.elements[0].length == pytest.approx(0.05)


@settings(derandomize=True, max_examples=50)
@given(st.text(alphabet="GXY0123456789.- #[]<>=%;M()abc", max_size=60).filter(lambda text: "\n" not in text))
def test_any_line_without_braces_comes_back(text):
    program = Program("p", f"{text}\nG1 X1 F1\n")
    carried = carried_original(Program("p", "\n".join(carry_original(program))))
    assert [line.strip() for line in carried.text.splitlines()] == [line.strip() for line in program.text.splitlines()]
