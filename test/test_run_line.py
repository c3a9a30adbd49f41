"""The line on the terminal while the graph runs."""

from __future__ import annotations

import os
import pty
import re
import signal
from pathlib import Path

import pytest
from running import LONG, TIMEOUT, started

from pkm_cnc.cli.progress import RunLine
from pkm_cnc.messages import message, serialize
from pkm_cnc.records import STATE_HELD, STATE_READY, STATE_RUNNING, ContourError
from pkm_cnc.topics import STATUS, topics

CODEC = topics(())["contour_error"].codec


def line_of(magnitudes: list[float], **status: object) -> str:
    line = RunLine(servo_period=0.001)
    for cycle, magnitude in enumerate(magnitudes):
        line.take("contour_error", CODEC.pack(cycle, 0, ContourError(0.0, 0.0, 0.0, 0.0, 0.0, magnitude, 0.0, 0)))
    line.take(STATUS, serialize(message("pkm_cnc_msgs/msg/ControllerStatus", **status)))
    return line.text()


def test_it_tells_state_place_feed_and_the_worst_contour_error_so_far() -> None:
    text = line_of(
        [1e-6, 33.4e-6, 2e-6],
        state=STATE_RUNNING,
        line=12,
        block="G1  X60 Y20",
        path_position=0.0625,
        path_length=0.25,
        feed=0.1,
    )
    assert text == "running; 25 %; 6000 mm/min; worst contour error 33.4 um; line 12: G1 X60 Y20"


@pytest.mark.parametrize(("state", "service"), [(STATE_READY, "start"), (STATE_HELD, "resume")])
def test_it_tells_the_operator_what_to_call(state: int, service: str) -> None:
    assert f"go on with: ros2 service call /interpolator/{service} std_srvs/srv/Trigger" in line_of([], state=state)


def test_it_tells_that_an_override_of_zero_is_waited_for() -> None:
    standing = {"state": STATE_RUNNING, "rapid_override": 1.0}
    assert "go on with: ros2 param set /interpolator feed_override 1.0;" in line_of([], **standing)
    assert "go on" not in line_of([], **standing, feed=0.01)


def test_an_unknown_length_has_no_percentage() -> None:
    assert "%" not in line_of([], state=STATE_RUNNING, path_length=float("nan"))


def read_until(terminal: int, pattern: str) -> str:
    """What comes from the terminal until the pattern is in it, or until its other end is closed."""
    text = ""
    while not re.search(pattern, text):
        try:
            text += os.read(terminal, 65536).decode()
        except OSError:
            break
    return text


@pytest.mark.parametrize("processes", ["one", "each"])
def test_on_a_terminal_it_is_drawn_and_wiped_at_the_end(ros_domain: int, tmp_path: Path, processes: str) -> None:
    """A run too long to end before the line is there, stopped when it is."""
    (tmp_path / "long.ngc").write_text(LONG)
    terminal, stderr = pty.openpty()
    arguments = ("run", tmp_path / "long.ngc", "--machine", "tripod", "--bag", tmp_path / "bag")
    with started(*arguments, "--processes", processes, stderr=stderr) as process:
        os.close(stderr)
        drawn = r"\r\x1b\[Krunning; \d+ %; \d+ mm/min; worst contour error \d+\.\d um"
        assert re.search(drawn, read_until(terminal, drawn))
        process.send_signal(signal.SIGINT)
        text = read_until(terminal, "never")
        assert process.wait(TIMEOUT) == 1
    os.close(terminal)
    assert re.search(r"\r\x1b\[Kpkm_cnc: [^\r]*SIGINT\r\n$", text)
