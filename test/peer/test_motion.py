"""Real part programs are run with limits of jerk: on a Cartesian machine wide enough, simulated without a fault."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from motion import moved, used

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import read_program
from pkm_cnc.records import PHASE_END
from pkm_cnc.simulation import simulated_cycles

WIDE = "travel.minimum=-20.0", "travel.maximum=20.0"
SMOOTH = load_setup("cartesian", (*WIDE, "motion.jerk=100.0", "limits.jerk=120.0", "limits.acceleration=5.0"))
LONGEST, BEGINNING = 100.0, 10.0
"""s of machine time. Of a program that takes longer than the first, the second is run."""


def test_planned_and_simulated_with_limits_of_jerk(program: Path) -> None:
    content = read_program(program)
    if program.name.startswith(("bad-arc", "no-feed-rate", "fractional-linenumbers")):
        with pytest.raises(InputError):  # refused by the peer too, or without motion
            prepare(SMOOTH, content)
        return
    checked = prepare(SMOOTH, content)
    toolpath, time = checked.toolpath(), checked.time()
    assert time >= sum(element.length / element.feed for element in toolpath.elements) * (1.0 - 1e-9)
    cycles = simulated_cycles(SMOOTH, checked)
    if time > LONGEST:
        count = round(BEGINNING / SMOOTH.servo_period)
        assert sum(1 for _ in itertools.islice(cycles, count)) == count
        return
    ran = list(cycles)
    assert ran[-1].setpoint.phase == PHASE_END
    assert max(used(SMOOTH, moved(SMOOTH, toolpath.elements, SMOOTH.motion), SMOOTH.motion).values()) < 1.001
    assert time * 0.999 <= len(ran) * SMOOTH.servo_period <= time * 1.1 + 2.0
