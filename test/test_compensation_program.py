"""The compensated program as a text: what it carries, how near it keeps to the corrected contour, how it keeps time."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.compensation.correction import Correction, spans_of
from pkm_cnc.compensation.writer import DECIMALS, compensated_program
from pkm_cnc.errors import InputError
from pkm_cnc.motion import Interpolator, MotionParameters
from pkm_cnc.program import (
    Program,
    ProgramParameters,
    ProgramSource,
    carried_original,
    carry_original,
    with_reference,
)
from pkm_cnc.records import CMD_RESUME, CMD_SINGLE_BLOCK, STATE_HELD, Command

ORIGIN = (0.0, 0.0, 0.0)
ZERO = (0.01, -0.02, 0.03)
READING = {"start": ORIGIN, "zero": ZERO, "rapid": 0.2, "parameters": ProgramParameters()}
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
    contour = ProgramSource(program, **READING).toolpath()
    spans = spans_of(contour, MotionParameters(wait_in_position=True), 20.0, 0.8)
    s = np.linspace(0.0, contour.length, 3000)
    waves = size * np.stack([np.sin(s / 8e-3), np.cos(s / 9e-3), np.sin(s / 7e-3 + 1.0)], axis=1)
    tangents = np.array([tangent(contour, place) for place in s])
    waves -= (waves * tangents).sum(axis=1)[:, None] * tangents
    for span in spans:
        inside = (span.begin <= s) & (s <= span.end)
        waves[inside] *= (
            np.clip(np.minimum(s[inside] - span.begin, span.end - s[inside]) / 6e-3, 0.0, 1.0)[:, None] ** 3
        )
    correction = Correction.fitted(spans, s, waves)
    written = compensated_program(program, contour.items(), correction, zero=ZERO, tolerance=tolerance)
    return Program("out.ngc", written), contour, correction


def place_of(contour, s):
    index = max(int(np.searchsorted(contour.starts, s, side="right")) - 1, 0)
    return contour.elements[index], s - contour.starts[index]


def tangent(contour, s):
    element, place = place_of(contour, s)
    return element.tangent(place)


class Where(NamedTuple):
    segment: int
    path_length: float
    rate: float


def placed(toolpath, contour):
    """The motions of a compensated program with where they belong, by the comments before them."""
    number = {element: index for index, element in enumerate(contour.elements)}
    for element in toolpath:
        (place,) = element.places
        segment = number[place.element]
        yield element, Where(segment, contour.starts[segment] + place.offset, place.rate)


def without_comments(text):
    return "\n".join(line for line in text.splitlines() if not line.startswith("(pkm_cnc"))


def test_it_carries_the_original_whose_contour_counts():
    program, contour, _ = compensated()
    toolpath = ProgramSource(program, **READING).toolpath()
    assert toolpath.contour.elements == contour.elements
    assert carried_original(program).text.splitlines()[1:] == TEXT.splitlines()[1:]
    assert [event.kind for event in toolpath.events] == [event.kind for event in contour.events]


def test_a_machine_that_ignores_comments_moves_alike():
    program, _, _ = compensated()
    bare = ProgramSource(Program("bare.ngc", without_comments(program.text)), **READING).toolpath()
    whole = ProgramSource(program, **READING).toolpath()
    assert not any(element.places for element in bare)
    assert [(one.start, one.end, one.feed, one.length) for one in bare] == [
        (one.start, one.end, one.feed, one.length) for one in whole
    ]


def test_every_motion_has_the_line_of_the_original():
    program, contour, _ = compensated()
    toolpath = ProgramSource(program, **READING).toolpath()
    written = [int(line[1:].split()[0]) for line in program.text.splitlines() if line.startswith("N")]
    assert [element.line for element in toolpath] == written
    assert [element.places[0].element.line for element in toolpath] == written
    assert sorted(set(written)) == sorted({element.line for element in contour.elements})


def test_it_begins_at_a_line_of_the_original():
    program, contour, _ = compensated()
    arc = next(index for index, element in enumerate(contour.elements) if element.line == 6)
    toolpath = ProgramSource(program, **READING, from_line=6).toolpath()
    rapid, first, *_ = toolpath
    assert (rapid.traverse, first.line) == (True, 6)
    assert math.dist(first.start, contour.elements[arc].start) < 50e-6
    assert [element.line for element in toolpath.contour] == [6, *(one.line for one in contour.elements[arc:])]
    assert toolpath.contour.length == pytest.approx(rapid.length + contour.length - contour.starts[arc])


def test_a_single_block_is_one_of_the_original():
    program, contour, _ = compensated("G64 P0.1\nF3000\nG1 X30\nX60 Y1\nX90 Y4\nM2\n")
    toolpath = ProgramSource(program, **READING).toolpath()
    interpolator = Interpolator(toolpath, MotionParameters(), 0.001)
    interpolator.command(Command(CMD_SINGLE_BLOCK, 1.0))
    held = []
    while not interpolator.finished:
        setpoint = interpolator.step()
        if interpolator.state == STATE_HELD:
            held.append(setpoint.path_length)
            assert interpolator.command(Command(CMD_RESUME)) == ""
    assert held == pytest.approx(contour.starts[1:], abs=1.1e-4)


@pytest.mark.parametrize("tolerance", [1e-8, 1e-6])
def test_the_written_path_keeps_the_tolerance(tolerance):
    program, contour, correction = compensated(tolerance=tolerance)
    toolpath = ProgramSource(program, **READING).toolpath()
    worst = 0.0
    for element, place in placed(toolpath, contour):
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
    toolpath = ProgramSource(program, **READING).toolpath()
    normals = []
    for element, place in placed(toolpath, contour):
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
    toolpath = ProgramSource(program, **READING).toolpath()
    time = np.zeros(len(contour.elements))
    for element, place in placed(toolpath, contour):
        time[place.segment] += element.length / element.feed
    wanted = [element.length / element.feed for element in contour.elements]
    np.testing.assert_allclose(time, wanted, rtol=1e-7)


def test_without_a_correction_the_motion_is_the_original():
    program = Program("part.ngc", TEXT)
    contour = ProgramSource(program, **READING).toolpath()
    spans = spans_of(contour, MotionParameters(), 20.0, 0.25)
    text = compensated_program(program, contour.items(), Correction.none(spans), zero=ZERO, tolerance=1e-8)
    again = ProgramSource(Program("out.ngc", text), **READING).toolpath()
    assert len(again.elements) == len(contour.elements)
    for one, other in zip(again, contour, strict=True):
        np.testing.assert_allclose([one.start, one.end], [other.start, other.end], atol=1e-10)
        assert one.length == pytest.approx(other.length, abs=1e-9)
        assert type(one) is type(other)


def test_path_modes_stay_at_the_ends_of_elements_and_lines_are_not_joined():
    program, contour, _ = compensated("G64 P0.02 Q0.01\nG1 X30 F3000\nY20\nG61.1 X0\nM2\n")
    toolpath = ProgramSource(program, **READING).toolpath()
    motions = list(placed(toolpath, contour))
    for (element, place), after in zip(motions, [*(where for _, where in motions[1:]), None], strict=True):
        last = after is None or after.segment != place.segment
        assert element.path_mode.code == (contour.elements[place.segment].path_mode.code if last else "G61")
        assert not element.path_mode.naive_cam


def test_marks_that_do_not_fit_are_refused():
    program, _, _ = compensated()
    changed = Program("out.ngc", program.text.replace("(pkm_cnc element: 2)", "(pkm_cnc element: 3)"))
    with pytest.raises(InputError, match=r"out\.ngc: its element comments do not go through"):
        list(ProgramSource(changed, **READING).items())


def test_a_correction_as_steep_as_a_wall_is_refused():
    with pytest.raises(InputError, match=r"part\.ngc:4: the correction.*too steep"):
        compensated(size=5e-3)


def test_a_reference_is_carried_behind_and_leads_by_length():
    run = with_reference(Program("a.ngc", "G1 X100 F1000\nX200\nM2\n"), Program("b.ngc", "G1 X50 F1000\nX200\nM2\n"))
    toolpath = ProgramSource(run, ORIGIN, ORIGIN, 0.2, ProgramParameters()).toolpath()
    assert [element.line for element in toolpath] == [1, 2]
    assert [element.length for element in toolpath.contour] == pytest.approx([0.05, 0.15])
    interpolator = Interpolator(toolpath, MotionParameters(), 0.001)
    segments = []
    while not interpolator.finished:
        setpoint = interpolator.step()
        segments += interpolator.take_segments()
        assert setpoint.path_length == pytest.approx(setpoint.x, abs=1e-12)
        assert setpoint.segment == (0 if setpoint.x < 0.05 else 1)
    assert [(number, element.line, begin) for number, element, begin in segments] == [(0, 1, 0.0), (1, 2, 0.05)]


@settings(derandomize=True, max_examples=50)
@given(st.text(alphabet="GXY0123456789.- #[]<>=%;M()abc", max_size=60).filter(lambda text: "\n" not in text))
def test_any_line_without_braces_comes_back(text):
    program = Program("p", f"{text}\nG1 X1 F1\n")
    carried = carried_original(Program("p", "\n".join(carry_original(program))))
    assert [line.strip() for line in carried.text.splitlines()] == [line.strip() for line in program.text.splitlines()]
