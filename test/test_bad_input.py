"""Bad input: the stated exit status, one line on stderr that says what is wrong and where, nothing left behind."""

from __future__ import annotations

import io
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import pytest
from command_line import done, pkm, refused
from mcap.writer import CompressionType, Writer
from running import COMMAND, TIMEOUT, command, environment

from pkm_cnc.config import machine_files

MACHINE = ("--machine", "tripod")
GOOD = "G0 X-5\nG1 X5 F3000\nM2\n"

# --- part programs: content, and what the line must say besides "program.ngc:<line>"

PROGRAMS: dict[str, tuple[bytes, list[str]]] = {
    "empty": (b"", ["program.ngc: contains no motion"]),
    "percent signs alone": (b"%\n%\n", ["program.ngc: contains no motion"]),
    "comments alone": (b"(nothing)\n; to do\nM2\n", ["program.ngc: contains no motion"]),
    "binary": (b"\x7fELF\x02\x01\x01\x00\xd0\xff" * 9, ["program.ngc: not a text file", "0xd0", "offset 8"]),
    "a zero byte": (b"G0 X1\n\0\n", ["program.ngc: not a text file", "0x00", "offset 6"]),
    "unknown G word": (b"G21\n\nG0 X1\nG41 X1\n", ["program.ngc:4", "G41", "not supported"]),
    "unknown M word": (b"M98 P1\n", ["program.ngc:1", "M98", "not supported"]),
    "unknown letter": (b"G0 X1\nA1\n", ["program.ngc:2", "A1", "not supported", "no axis A"]),
    "a parameter that was not set": (b"G0 X#<wide>\n", ["program.ngc:1", "#<wide>", "not set"]),
    "an expression without end": (b"G0 X[1+1\n", ["program.ngc:1", "without ']'"]),
    "a malformed number": (b"G0 X1.2.3\n", ["program.ngc:1", "X1.2.3"]),
    "a word without number": (b"G0 X Y1\n", ["program.ngc:1", "X"]),
    "an open comment": (b"G0 X1\nG0 X2 (rapid\n", ["program.ngc:2", "comment without ')'"]),
    "a word twice": (b"G0 X1 X2\n", ["program.ngc:1", "two X words"]),
    "no motion mode": (b"X1\n", ["program.ngc:1", "G0, G1, G2 or G3"]),
    "no feed": (b"G0 X1\nG1 X2\n", ["program.ngc:2", "feed", "G1 X2"]),
    "a feed of 0": (b"G1 X2 F0\n", ["program.ngc:1", "feed"]),
    "a negative feed": (b"G1 X2 F-5\n", ["program.ngc:1", "F-5", "negative"]),
    "arc radii that disagree": (
        b"G0 X0\nG2 X10 I6 J0 F100\n",
        ["program.ngc:2", "radii disagree", "6.000000 mm", "4.000000 mm", "2.000000 mm"],
    ),
    "an arc's radius too small": (b"G2 X10 R4 F100\n", ["program.ngc:1", "10.000000 mm", "8.000000 mm"]),
    "an arc without center": (b"G2 X10 F100\n", ["program.ngc:1", "center (I J)", "radius (R)"]),
    # column u2 at azimuth 165 deg and 363 mm: its strut of 600 mm must span 806.125 mm
    "an end point outside": (
        b"G0 X10\nG1 X450 Y0 F1000\n",
        ["program.ngc:2", "outside the workspace", "X450.000 Y0.000", "strut u2", "806.125 mm", "206.1 mm too far"],
    ),
    "a rapid that ends outside": (b"G0 X2000\n", ["program.ngc:1", "outside the workspace", "strut u2"]),
    # the workspace is convex: a line cannot leave and return, an arc can; here both of its ends are at (180, 0)
    "an arc that leaves the workspace between": (
        b"G0 X180\nG3 X180 Y0 I60 J0 F1000\n",
        ["program.ngc:2", "outside the workspace", "strut u2", "too far"],
    ),
    # a slider stands highest where the path passes its column nearest: half way, 263 mm from it, at 465 + 539.287 mm
    "a line that leaves the travel between": (
        b"G0 X141.421356\nG0 Z465\nG1 X0 Y141.421356 F3000\n",
        ["program.ngc:3", "u1 leaves its travel at X70.7", "1004.287 mm is 4.287 mm beyond 1000.000 mm"],
    ),
    "an end beyond the lower travel": (b"G1 Z-600 F900\n", ["program.ngc:1", "u1", "122.265 mm beyond 0.000 mm"]),
}


@pytest.mark.parametrize("subcommand", ["check", "simulate", "run"])
@pytest.mark.parametrize("name", PROGRAMS)
def test_bad_programs(tmp_path: Path, name: str, subcommand: str) -> None:
    content, parts = PROGRAMS[name]
    program = tmp_path / "program.ngc"
    program.write_bytes(content)
    bag = [] if subcommand == "check" else ["--bag", tmp_path / "bag"]
    line = refused(subcommand, program, *MACHINE, *bag)
    for part in parts:
        assert part in line
    assert list(tmp_path.iterdir()) == [program]


def test_a_program_that_loops_for_ever(tmp_path: Path) -> None:
    program = tmp_path / "program.ngc"
    program.write_text("G1 F60\no1 while [1]\n  X1\n  X0\no1 endwhile\n")
    line = refused("check", program, *MACHINE, "--set", "program.block_limit=100")
    assert "has run 100 blocks more than it has lines (program.block_limit)" in line


def test_the_ends_of_the_lines_that_leave_between_are_good_themselves(tmp_path: Path) -> None:
    program = tmp_path / "program.ngc"
    for text in ("G0 X180\n", "G0 X141.421356\nG0 Z465\n", "G0 Y141.421356\nG0 Z465\n"):
        program.write_text(text)
        done("check", program, *MACHINE)


@pytest.mark.parametrize("subcommand", ["check", "simulate", "run"])
@pytest.mark.parametrize(("name", "reason"), [("missing.ngc", "No such file"), (".", "Is a directory")])
def test_programs_that_cannot_be_opened(tmp_path: Path, name: str, reason: str, subcommand: str) -> None:
    bag = [] if subcommand == "check" else ["--bag", tmp_path / "bag"]
    assert reason in refused(subcommand, tmp_path / name, *MACHINE, *bag)
    assert not list(tmp_path.iterdir())


# --- machine files and overrides

Change = Callable[[str], str]

FILES: dict[str, tuple[Change, list[str]]] = {
    "not YAML": (lambda text: text + "\n  - [", ["not valid YAML"]),
    "a tab": (lambda text: text + "\n\t\tx: 1", ["not valid YAML"]),
    "an unknown tag": (lambda text: text + "\n    x: !!python/object:os.system 1", ["not valid YAML"]),
    "empty": (lambda text: "", ["/**", "ros__parameters"]),
    "a list": (lambda text: "- 1\n- 2\n", ["/**", "ros__parameters"]),
    "no ros__parameters": (lambda text: "/**:\n  machine: tripod\n", ["ros__parameters"]),
    "no machine": (lambda text: text.replace("machine: tripod", ""), ["machine"]),
    "an unknown machine": (lambda text: text.replace("machine: tripod", "machine: hexapod"), ["hexapod", "tripod"]),
    "an unknown key": (lambda text: text.replace("kv: 20.0", "kvv: 20.0"), ["drive.kvv", "unknown", "kv"]),
    "an unknown section": (lambda text: text.replace("drive:", "driver:"), ["driver.kind", "unknown", "drive"]),
    "an unknown key on top": (lambda text: text + "\n    tempo: 1\n", ["tempo", "unknown", "servo_period"]),
    "a text for a number": (lambda text: text.replace("kv: 20.0", "kv: fast"), ["drive.kv", "'fast'", "number"]),
    "nothing for a number": (lambda text: text.replace("kv: 20.0", "kv:"), ["drive.kv", "None", "number"]),
    "a truth for a number": (lambda text: text.replace("kv: 20.0", "kv: yes"), ["drive.kv", "True", "number"]),
    "a fraction for a count": (
        lambda text: re.sub("window: [0-9]+", "window: 8.5", text),
        ["graph.window", "8.5", "whole number"],
    ),
    "two numbers for three": (
        lambda text: re.sub(r"start_pose: \[.*\]", "start_pose: [0.0, 0.0]", text),
        ["start_pose", "2 numbers", "3 wanted"],
    ),
    "a text in a list": (
        lambda text: re.sub(r"start_pose: \[.*\]", "start_pose: [0.0, here, 0.0]", text),
        ["start_pose[1]", "'here'"],
    ),
    "not above its bound": (lambda text: text.replace("kv: 20.0", "kv: 0.0"), ["drive.kv", "0.0", "not above 0"]),
    "below its minimum": (
        lambda text: re.sub("window: [0-9]+", "window: 0", text),
        ["graph.window", "below its minimum 1"],
    ),
    "over its maximum": (
        lambda text: text.replace("servo_period: 0.001", "servo_period: 1.0"),
        ["servo_period", "over its maximum 0.1 s"],
    ),
    "not finite": (lambda text: text.replace("kv: 20.0", "kv: .inf"), ["drive.kv", "inf", "finite"]),
    "not one of the choices": (
        lambda text: text.replace("kind: cascade", "kind: magic"),
        ["drive.kind", "'magic'", "cascade, first_order"],
    ),
    "bounds of two keys": (
        lambda text: text.replace("minimum: 0.0", "minimum: 1.5"),
        ["travel.minimum: 1.5 m", "maximum of 1.0 m"],
    ),
    "struts too short": (
        lambda text: text.replace("strut_length: 0.600", "strut_length: 0.300"),
        ["geometry.strut_length", "0.3 m", "0.363 m"],
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_bad_machine_files(tmp_path: Path, name: str) -> None:
    change, parts = FILES[name]
    program, machine = tmp_path / "program.ngc", tmp_path / "machine.yaml"
    program.write_text(GOOD)
    good = machine_files()["tripod"].read_text(encoding="utf-8")
    machine.write_text(change(good))
    assert machine.read_text() != good
    line = refused("simulate", program, "--machine", machine, "--bag", tmp_path / "bag")
    assert str(machine) in line
    for part in parts:
        assert part in line
    assert sorted(tmp_path.iterdir()) == [machine, program]


@pytest.mark.parametrize(
    ("content", "reason"), [(None, "No such file"), (b"\xff\xfe\x00", "not a text file"), ("folder", "Is a directory")]
)
def test_machine_files_that_cannot_be_read(tmp_path: Path, content: Any, reason: str) -> None:
    machine = tmp_path / "machine.yaml"
    if isinstance(content, bytes):
        machine.write_bytes(content)
    elif content:
        machine.mkdir()
    line = refused("kinematics", "inverse", "--machine", machine, stdin="x_mm,y_mm,z_mm\n")
    assert str(machine) in line
    assert reason in line


def test_an_unknown_machine_name_is_answered_with_those_that_there_are() -> None:
    line = refused("kinematics", "inverse", "--machine", "hexapod", stdin="x_mm,y_mm,z_mm\n")
    assert "hexapod" in line
    assert "tripod" in line


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("drive.kv", ["--set drive.kv", "KEY=VALUE"]),
        ("=3", ["--set =3", "KEY=VALUE"]),
        ("", ["KEY=VALUE"]),
        ("drive.kv=", ["drive.kv", "None"]),
        ("drive.kv=[", ["--set drive.kv=[", "'['"]),
        ("drive.kv=25 1/s", ["drive.kv", "'25 1/s'", "not a number"]),
        ("drive.kv=-1", ["drive.kv", "-1.0 1/s", "not above 0.0 1/s"]),
        ("drive.kv=nan", ["drive.kv", "nan"]),
        ("drive.kv={a: 1}", ["drive.kv"]),
        ("drive.gain=1", ["drive.gain", "unknown"]),
        ("drive=1", ["drive", "unknown"]),
        ("u4.drive.kv=1", ["u4.drive.kv", "unknown", "u3.drive"]),
        ("u1.drive.kvv=1", ["u1.drive.kvv", "unknown"]),
        ("u1.drive.kv=0", ["u1.drive.kv", "not above"]),
        ("u1.geometry.base_radius=1", ["u1.geometry.base_radius", "unknown"]),
        ("machine=hexapod", ["hexapod", "tripod"]),
        ("machine=../../etc", ["../../etc"]),
        ("servo_period=0.00033333333333", ["servo_period", "nanoseconds"]),
    ],
)
def test_bad_overrides(tmp_path: Path, override: str, parts: list[str]) -> None:
    program = tmp_path / "program.ngc"
    program.write_text(GOOD)
    for subcommand, bag in (("check", []), ("simulate", ["--bag", tmp_path / "bag"])):
        line = refused(subcommand, program, *MACHINE, "--set", override, *bag)
        for part in parts:
            assert part in line
    assert list(tmp_path.iterdir()) == [program]


# --- contours

CONTOURS = [
    (["star", "--headings", "north"], "headings: 'north'"),
    (["star", "--headings", ""], "headings: ''"),
    (["star", "--headings", "0:90"], "headings: '0:90'"),
    (["star", "--headings", "0:90:0"], "step of 0"),
    (["star", "--headings", "0:90:-10"], "step of -10"),
    (["star", "--headings", "0:90:1e-9"], "3600"),
    (["star", "--headings", "nan,0"], "headings: 'nan,0'"),
    (["star", "--feed", "0"], "feed_mm_min: 0.0"),
    (["star", "--feed", "nan"], "feed_mm_min: nan"),
    (["star", "--length", "-1"], "length_mm: -1.0"),
    (["star", "--pivot", "nan", "0"], "pivot_mm: nan, 0.0"),
    (["circle", "--center", "0", "inf"], "center_mm: 0.0, inf"),
    (["circle", "--feed", "-1"], "feed_mm_min: -1.0"),
    (["circle", "--radius", "0"], "radius_mm: 0.0"),
    (["circle", "--overshoot", "360"], "overshoot_deg: 360.0"),
    (["circle", "--direction", "up"], "'up'"),
    (["star", "--feed", "fast"], "'fast'"),
    (["square"], "'square'"),
]


@pytest.mark.parametrize(("arguments", "part"), CONTOURS, ids=[" ".join(row[0]) for row in CONTOURS])
def test_bad_contours_leave_the_file_as_it_was(tmp_path: Path, arguments: list[str], part: str) -> None:
    path = tmp_path / "program.ngc"
    path.write_text("before")
    assert part in refused("program", arguments[0], *MACHINE, *arguments[1:], "-o", path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "arguments",
    [[], ["frobnicate"], ["program"], ["check"], ["check", "a.ngc"], ["run", "a.ngc", "--machine", "tripod"]],
    ids=" ".join,
)
def test_incomplete_commands(arguments: list[str]) -> None:
    assert "--help" in refused(*arguments)


# --- kinematics' CSV


@pytest.mark.parametrize(
    ("stdin", "parts"),
    [
        ("", ["stdin:1", "x_mm,y_mm,z_mm"]),
        ("u1_mm,u2_mm,u3_mm\n1,2,3\n", ["stdin:1", "u1_mm,u2_mm,u3_mm", "x_mm,y_mm,z_mm"]),
        ("x_mm,y_mm,z_mm\n1,2,3\n1,2\n", ["stdin:3", "2 values", "3 expected"]),
        ("x_mm,y_mm,z_mm\n1,2,three\n", ["stdin:2", "'three'"]),
        ("x_mm,y_mm,z_mm\n1,2,\0\n", ["stdin:2"]),
        (f"x_mm,y_mm,z_mm\n1,2,{'3' * 200_000}\n", ["stdin:2", "131072"]),
    ],
    ids=["empty", "columns", "too few", "no number", "a zero byte", "a huge field"],
)
def test_bad_csv(stdin: str, parts: list[str]) -> None:
    result = pkm("kinematics", "inverse", *MACHINE, stdin=stdin)
    assert result.code == 2
    (line,) = result.err.splitlines()
    for part in parts:
        assert part in line


# --- places: root may write anywhere, so what cannot be written lies below a plain file, in /proc, or on a full device


@pytest.mark.parametrize("subcommand", ["simulate", "run"])
@pytest.mark.parametrize("kind", ["folder", "file", "below a file", "in /proc"])
def test_bags_that_cannot_be_made(tmp_path: Path, kind: str, subcommand: str) -> None:
    program = tmp_path / "program.ngc"
    program.write_text(GOOD)
    bag = {"folder": tmp_path / "bag", "file": program, "below a file": program / "bag", "in /proc": Path("/proc/bag")}
    if kind == "folder":
        bag[kind].mkdir()
    if subcommand == "run" and kind in ("below a file", "in /proc"):
        result = command(subcommand, program, *MACHINE, "--bag", bag[kind])
        assert (result.returncode, result.stdout, result.stderr.count("\n")) == (2, "", 1)
        line = result.stderr
    else:
        line = refused(subcommand, program, *MACHINE, "--bag", bag[kind])
    assert f"bag {bag[kind]}" in line
    assert ("exists already" if kind in ("folder", "file") else "cannot be created") in line
    assert program.read_text() == GOOD
    assert [path for path in tmp_path.rglob("*") if path not in (program, bag[kind])] == []


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("program.ngc/below", "Not a directory"),
        ("missing/p.ngc", "No such file or directory"),
        (".", "Is a directory"),
        ("/dev/full", "No space left on device"),
        ("/proc/p.ngc", "No such file or directory"),
    ],
)
def test_programs_that_cannot_be_written(tmp_path: Path, place: str, reason: str) -> None:
    file = tmp_path / "program.ngc"
    file.write_text("before")
    line = refused("program", "star", *MACHINE, "-o", tmp_path / place)
    assert str(tmp_path / place) in line
    assert reason in line
    assert file.read_text() == "before"
    assert list(tmp_path.iterdir()) == [file]
    assert not Path("/dev/full").is_file()


def _into(stdout: IO[str], *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    run = [*COMMAND, *arguments]
    return subprocess.run(
        run, env=environment(), stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=TIMEOUT, **options
    )


def test_csv_that_is_no_text(tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_bytes(b"x_mm,y_mm,z_mm\n\xff\xfe,2,3\n")
    with rows.open("rb") as source:
        result = command("kinematics", "inverse", *MACHINE, stdin=source)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)


def test_a_full_device_behind_standard_output() -> None:
    with open("/dev/full", "w") as full:
        result = _into(full, "program", "star", *MACHINE)
    assert result.returncode == 1
    assert result.stderr == "pkm_cnc: standard output: No space left on device\n"


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("x_mm,y_mm,z_mm\n" + "1,2,3\n" * 5000)
    read, write = os.pipe()
    os.close(read)
    with rows.open() as source, os.fdopen(write, "w") as gone:
        result = _into(gone, "kinematics", "inverse", *MACHINE, stdin=source)
    assert result.stderr == ""


# --- what is no bag


def _foreign(**options: Any) -> bytes:
    """An MCAP file of somebody else: a ROS text, a type nobody knows, and JSON without a schema."""
    file = io.BytesIO()
    writer = Writer(file, **options)
    writer.start()
    known = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    unknown = writer.register_schema("foo_msgs/msg/Bar", "ros2msg", b"int32 a")
    for topic, encoding, schema, data in (
        ("/chatter", "cdr", known, b"\0\1\0\0\2\0\0\0a\0"),
        ("/bar", "cdr", unknown, b"\0\1\0\0\1\0\0\0"),
        ("/free", "json", 0, b"{}"),
    ):
        channel = writer.register_channel(topic, encoding, schema)
        writer.add_message(channel, log_time=0, data=data, publish_time=0)
    writer.finish()
    return file.getvalue()


BAGS: dict[str, dict[str, bytes]] = {
    "empty folder": {},
    "no bag": {"notes.txt": b"hello"},
    "not MCAP": {"a_0.mcap": b"hello"},
    "an empty file": {"a_0.mcap": b""},
    "another rosbag": {"a_0.db3": b"SQLite format 3\0", "metadata.yaml": b"rosbag2_bagfile_information: {}\n"},
    "foreign MCAP": {"a_0.mcap": _foreign(compression=CompressionType.ZSTD)},
    "foreign MCAP with LZ4": {"a_0.mcap": _foreign(compression=CompressionType.LZ4)},
    "foreign MCAP, not compressed": {"a_0.mcap": _foreign(compression=CompressionType.NONE)},
    "foreign MCAP without chunks": {"a_0.mcap": _foreign(use_chunking=False)},
    "MCAP without a message": {"a_0.mcap": _foreign()[:60]},
}


@pytest.mark.parametrize("name", BAGS)
def test_what_is_no_bag_of_ours(tmp_path: Path, name: str) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for file, content in BAGS[name].items():
        (bag / file).write_bytes(content)
    line = refused("evaluate", bag, "--json", "--report", tmp_path / "report")
    assert f"bag {bag}" in line
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("place", ["missing", "program.ngc", "program.ngc/below"])
def test_where_there_is_no_bag(tmp_path: Path, place: str) -> None:
    (tmp_path / "program.ngc").write_text(GOOD)
    assert f"bag {tmp_path / place}" in refused("evaluate", tmp_path / place)


def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    program, bag = tmp_path / "program.ngc", tmp_path / "bag"
    program.write_text(GOOD)
    done("simulate", program, *MACHINE, "--bag", bag)
    result = pkm("evaluate", bag, "--report", program / "report")
    assert result.code == 2
    (line,) = result.err.splitlines()
    assert str(program / "report") in line
