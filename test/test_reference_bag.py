"""The reference bag: what it tells must not change, whoever reads it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pkm_cnc.bag import read_run
from pkm_cnc.evaluation import evaluate

TOP = Path(__file__).resolve().parents[1]
BAG = TOP / "bags" / "reference"
FIGURES = json.loads((BAG / "evaluation.json").read_text(encoding="utf-8"))


def assert_equal(found: Any, recorded: Any) -> None:
    """The same keys, texts and whole numbers; figures, in um, mm or deg, within 1e-6."""
    assert type(found) is type(recorded)
    if isinstance(recorded, dict):
        assert list(found) == list(recorded)
        for key, value in recorded.items():
            assert_equal(found[key], value)
    elif isinstance(recorded, list):
        assert len(found) == len(recorded)
        for one, other in zip(found, recorded, strict=True):
            assert_equal(one, other)
    elif isinstance(recorded, float):
        assert found == pytest.approx(recorded, rel=0.0, abs=1e-6)
    else:
        assert found == recorded


def test_it_is_small() -> None:
    assert sum(path.stat().st_size for path in BAG.iterdir()) < 2_000_000


def test_it_evaluates_to_the_recorded_figures() -> None:
    assert_equal(json.loads(done("evaluate", BAG, "--json")), FIGURES)


def test_the_recorded_figures_are_those_of_the_star_test() -> None:
    (line,) = FIGURES["segments"]
    assert (line["kind"], line["heading_deg"], line["feed_mm_min"], line["below_feed"]) == ("line", 15.0, 6000.0, 0)
    # right of travel, and 3.3 times as far below the plane
    assert line["contour_error_um"]["mean"] == pytest.approx(-9.694, abs=0.001)
    assert line["contour_error_z_um"]["max_abs"] / 9.694 == pytest.approx(3.3, abs=0.02)


def test_its_program_made_again_gives_the_recorded_figures(tmp_path: Path) -> None:
    written = done("program", "star", "--machine", "tripod", "--headings", "15", "--feed", "6000")
    assert written == (BAG / "star.ngc").read_text(encoding="utf-8")
    done("simulate", BAG / "star.ngc", "--machine", "tripod", "--bag", tmp_path / "again")
    assert_equal(evaluate(read_run(tmp_path / "again")).to_json(), FIGURES)


def test_rosbags_alone_comes_to_the_same_mean() -> None:
    """With the .msg files of pkm_cnc_msgs and a formula of two lines, nothing else of the project."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in (TOP / "pkm_cnc_msgs" / "msg").glob("*.msg"):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"pkm_cnc_msgs/msg/{path.stem}"))
    messages: dict[str, list[Any]] = {}
    with AnyReader([BAG], default_typestore=store) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
            if hasattr(message, "cycle") and connection.topic != "/run_end":
                assert time == message.cycle * 1_000_000
        assert {connection.topic: connection.msgcount for connection in reader.connections if connection.msgcount} == {
            topic: len(content) for topic, content in messages.items()
        }
    assert len(messages["/tcp/state"]) == FIGURES["cycles"]

    left = []
    heading = math.radians(15.0)
    for setpoint, state in zip(messages["/tcp/setpoint"], messages["/tcp/state"], strict=True):
        x, y = state.position.x, state.position.y
        along = math.cos(heading) * x + math.sin(heading) * y
        if setpoint.segment == 1 and abs(along) <= 0.050:
            left.append(math.cos(heading) * y - math.sin(heading) * x)
    (line,) = FIGURES["segments"]
    # the end points of the program, rounded to 1 nm, turn and shift the line by that much
    assert 1e6 * np.mean(left) == pytest.approx(line["contour_error_um"]["mean"], abs=1e-3)
