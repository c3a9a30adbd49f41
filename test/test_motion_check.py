"""What is refused before anything moves, of what the planner adds to the programmed path or cannot know."""

from __future__ import annotations

import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import Program, ProgramSource


def test_a_drive_divided_by_frequency_is_checked_against_its_limits() -> None:
    """The planner takes the table to have all of x and y; what the Tripod truly has is known by setpoint."""
    overrides = ["geometry.divide=frequency", "u1.limits.acceleration=0.1"]
    program = Program("fast.ngc", "G1 X50 F6000\nX0\nM2\n")
    prepare(load_setup("hybrid", overrides[:1]), program)
    with pytest.raises(InputError, match=r"fast\.ngc:\d: u1 is over its limit at X\S+ .*u1\.limits\.acc") as caught:
        prepare(load_setup("hybrid", overrides), program)
    assert "\n" not in str(caught.value)


def test_a_curve_is_checked_along_its_length() -> None:
    """Between arcs a curve may bulge out of what they need: here out of a travel that ends at the arcs' own reach."""
    text = "G64 P0.5 Q0\nG17 G2 X10 Y0 I5 J0 F1000\nG2 X20 Y0 I5 J0\nM2\n"
    reach = 5e-3
    prepare(load_setup("cartesian", [f"travel.maximum={0.02 + 1e-6}"]), Program("arcs.ngc", text))
    with pytest.raises(InputError, match=r"arcs\.ngc:2: y leaves its travel"):
        prepare(load_setup("cartesian", [f"y.travel.maximum={reach - 1e-5}"]), Program("arcs.ngc", text))


@pytest.mark.parametrize("jerk", [0.0, 50.0])
def test_the_time_is_that_of_the_motion_and_its_dwells(jerk: float) -> None:
    """Two lines that reach their feed, a stop between: length / feed + feed / a (+ a / j), to the next cycle."""
    setup = load_setup("cartesian", [f"motion.jerk={jerk}", "motion.acceleration=2.0"])
    program = Program("dwell.ngc", "G1 X50 F6000\nG4 P1.5\nY30 F3000\nM2\n")
    ideal = 0.05 / 0.1 + 0.1 / 2.0 + 1.5 + 0.03 / 0.05 + 0.05 / 2.0 + (2.0 * 2.0 / jerk if jerk else 0.0)
    found = prepare(setup, program).time()
    assert ideal <= found + 1e-9 <= ideal + 2.0 * (0.001 if not jerk else 0.003)


def test_a_toolpath_that_is_read_already_is_checked_as_the_program_is() -> None:
    setup = load_setup("tripod")
    text = "G21 G90 G64 P0.1 F3000\nM3 S100\nG1 X10\nG4 P0.2\nG2 X20 Y-10 I0 J-10\nG1 Y{y} Z3\nM2\n"
    program = Program("known.ngc", text.format(y=-40))
    read, known = prepare(setup, program), prepare(setup, program, toolpath=prepare(setup, program).toolpath())
    assert (known.totals, known.box) == (read.totals, read.box)
    outside = Program("known.ngc", text.format(y=-900))
    toolpath = ProgramSource(
        outside, setup.start_pose, setup.program_zero, setup.motion.rapid, setup.program
    ).toolpath()
    with pytest.raises(InputError, match=r"known.ngc:6: outside the workspace") as by_toolpath:
        prepare(setup, outside, toolpath=toolpath)
    with pytest.raises(InputError) as by_program:
        prepare(setup, outside)
    assert str(by_toolpath.value) == str(by_program.value)
