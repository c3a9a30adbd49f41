"""A few thousand of the programs that `make fuzz` reads by the million: read or refused, nothing else."""

import importlib.util
from itertools import islice
from pathlib import Path

TOOL = Path(__file__).resolve().parents[1] / "tools" / "fuzz.py"
_spec = importlib.util.spec_from_file_location("fuzz", TOOL)
assert _spec is not None
assert _spec.loader is not None
fuzz = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fuzz)


def test_programs_are_read_or_refused() -> None:
    outcomes = [fuzz.outcome(content) for content in islice(fuzz.programs(seed=7), 5000)]
    assert {outcome: outcomes.count(outcome) > 300 for outcome in outcomes} == {
        "read": True,
        "refused": True,
        "no text": True,
    }


def test_the_programs_they_are_made_from_are_good() -> None:
    assert {fuzz.outcome(seed) for seed in fuzz.SEEDS} == {"read"}
