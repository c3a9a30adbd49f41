"""Random programs on several machines, planned and judged by positions alone, as `make fuzz` does by the thousand."""

from __future__ import annotations

import importlib.util
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError

TOOL = Path(__file__).resolve().parents[1] / "tools" / "fuzz_motion.py"
_spec = importlib.util.spec_from_file_location("fuzz_motion", TOOL)
assert _spec is not None
assert _spec.loader is not None
fuzz = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fuzz)

PLACES = fuzz.places()


@settings(derandomize=True, deadline=None, max_examples=32)
@given(st.sampled_from(PLACES), st.randoms(use_true_random=False))
def test_any_program_keeps_limits_ends_and_tolerance(place: Any, rng: random.Random) -> None:
    text = fuzz.program(rng, place)
    try:
        motion = fuzz.sent(place.setup, text)
    except InputError:
        reject()
    assert fuzz.faults(place.setup, *motion) == [], text


@pytest.mark.parametrize(
    ("limit", "name"),
    [
        ("motion.acceleration=0.5", "acceleration"),
        ("motion.jerk=30.0", "jerk"),
        ("limits.velocity=0.1", "drive velocity"),
        ("limits.acceleration=0.5", "drive acceleration"),
        ("limits.jerk=30.0", "drive jerk"),
    ],
)
def test_the_judge_sees_a_limit_that_is_exceeded(limit: str, name: str) -> None:
    """What was planned for some limits is too fast for lower ones."""
    overrides = (*fuzz.MOTION, *fuzz.SLOW_DRIVES, *fuzz.JERK)
    motion = fuzz.sent(load_setup("tripod", overrides), "G1 X20 Y215 F20000\nM2\n")
    assert fuzz.faults(load_setup("tripod", overrides), *motion) == []
    lower = "motion.centripetal_acceleration=0.1", limit
    found = fuzz.faults(load_setup("tripod", (*overrides, *lower)), *motion)
    assert any(fault.startswith(f"{name} uses") for fault in found), found


def test_the_judge_sees_a_path_that_is_left() -> None:
    setup = PLACES[0].setup
    toolpath, setpoints = fuzz.sent(setup, "G64 P0.1\nG1 X20 F5000\nY20\nX0\nM2\n")
    assert fuzz.faults(setup, toolpath, setpoints) == []
    exact, _ = fuzz.sent(setup, "G64 P0.05\nG1 X20 F5000\nY20\nX0\nM2\n")
    assert any("off the path" in fault or "is left by" in fault for fault in fuzz.faults(setup, exact, setpoints))
    assert any("not at rest" in fault for fault in fuzz.faults(setup, toolpath, setpoints[:-20]))
