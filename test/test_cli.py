"""The command line as a contract: what scripts give to it, and every key, type and unit that they get back."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import done, pkm, refused
from running import command

from pkm_cnc import __version__
from pkm_cnc.bag import read_run
from pkm_cnc.config import load_setup, machine_files

MACHINE = ("--machine", "tripod")


# --- program


def test_headings_are_accepted_after_a_space_and_after_an_equals_sign() -> None:
    plain = done("program", "star", *MACHINE)
    assert done("program", "star", *MACHINE, "--headings", "-15:105:15") == plain
    assert done("program", "star", *MACHINE, "--headings=-15:105:15") == plain
    assert done("program", "star", *MACHINE, "--headings", "-15,0,15,30,45,60,75,90,105") == plain
    assert done("program", "star", *MACHINE, "--headings=-15,0,15,30,45,60,75,90,105") == plain


def test_a_star_is_a_rapid_and_a_feed_per_heading_through_the_pivot(tmp_path: Path) -> None:
    arguments = ("--feed", "4500", "--headings", "-30,60", "--pivot", "-10", "20.5", "--length", "120")
    motion = _motion(tmp_path, done("program", "star", *MACHINE, *arguments))
    assert [entry["kind"] for entry in motion] == ["traverse", "feed"] * 2
    for heading, (rapid, feed) in zip((-30.0, 60.0), (motion[0:2], motion[2:4]), strict=True):
        x, y = 60.0 * math.cos(math.radians(heading)), 60.0 * math.sin(math.radians(heading))
        assert rapid["end_mm"] == pytest.approx([-10.0 - x, 20.5 - y, 0.0], abs=1e-6)
        assert feed["end_mm"] == pytest.approx([-10.0 + x, 20.5 + y, 0.0], abs=1e-6)
        assert feed["feed_mm_min"] == 4500.0


@pytest.mark.parametrize(("direction", "turns"), [("ccw", [1]), ("cw", [-1]), ("both", [1, -1])])
def test_a_circle_is_feed_in_overshoot_full_circle_overshoot_feed_out(
    tmp_path: Path, direction: str, turns: list[int]
) -> None:
    arguments = ("--feed", "2000", "--radius", "40", "--center", "-5", "7", "--direction", direction)
    text = done("program", "circle", *MACHINE, *arguments, "--overshoot", "90")
    motion = _motion(tmp_path, text)
    assert [entry["kind"] for entry in motion] == ["traverse", "feed", "arc", "arc", "arc", "feed"] * len(turns)
    for index, turn in enumerate(turns):
        feed_in, entry, circle, leave = motion[6 * index + 1 : 6 * index + 5]
        assert feed_in["end_mm"] == pytest.approx([-5.0, 7.0 - turn * 40.0, 0.0], abs=1e-6)
        assert entry["end_mm"] == circle["end_mm"] == pytest.approx([35.0, 7.0, 0.0], abs=1e-6)
        assert leave["end_mm"] == pytest.approx([-5.0, 7.0 + turn * 40.0, 0.0], abs=1e-6)
        for arc in (entry, circle, leave):
            assert arc["center_mm"] == pytest.approx([-5.0, 7.0, 0.0], abs=1e-6)
            assert (arc["turns"], arc["feed_mm_min"]) == (turn, 2000.0)


@pytest.mark.parametrize("contour", ["star", "circle"])
def test_a_program_goes_to_a_file_whole(tmp_path: Path, contour: str) -> None:
    path = tmp_path / "p.ngc"
    path.write_text("before")
    assert done("program", contour, *MACHINE, "-o", path) == ""
    assert path.read_text() == done("program", contour, *MACHINE)
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_and_a_device_are_written_into_and_not_replaced(tmp_path: Path) -> None:
    target, link = tmp_path / "target.ngc", tmp_path / "link.ngc"
    link.symlink_to(target)
    done("program", "star", *MACHINE, "-o", link)
    assert link.is_symlink()
    assert target.read_text() == done("program", "star", *MACHINE)
    null = tmp_path / "null"
    null.symlink_to("/dev/null")
    done("program", "star", *MACHINE, "-o", null)
    assert Path("/dev/null").is_char_device()


# --- check


def test_check_json_lists_every_motion_with_the_documented_keys_and_types(tmp_path: Path) -> None:
    text = "%\nN10 G21 G90 G17\n\nG0 X10 (rapid)\nG1 Y5 F600\nG3 X0 Y15 I-10 J0\nG2 X0 Y15 I0 J-5 F300\nM2\n%\n"
    motion = _motion(tmp_path, text)
    straight = {"kind": str, "line": int, "end_mm": [float] * 3, "feed_mm_min": float}
    arc = {**straight, "center_mm": [float] * 3, "turns": int, "plane": str}
    assert [_shape(entry) for entry in motion] == [straight, straight, arc, arc]
    rapid = load_setup("tripod").motion.rapid * 60e3
    assert motion == [
        {"kind": "traverse", "line": 4, "end_mm": [10.0, 0.0, 0.0], "feed_mm_min": pytest.approx(rapid)},
        {"kind": "feed", "line": 5, "end_mm": [10.0, 5.0, 0.0], "feed_mm_min": 600.0},
        {
            "kind": "arc",
            "line": 6,
            "end_mm": [0.0, 15.0, 0.0],
            "feed_mm_min": 600.0,
            "center_mm": [0.0, 5.0, 0.0],
            "turns": 1,
            "plane": "xy",
        },
        {
            "kind": "arc",
            "line": 7,
            "end_mm": [0.0, 15.0, 0.0],
            "feed_mm_min": 300.0,
            "center_mm": [0.0, 10.0, 0.0],
            "turns": -1,
            "plane": "xy",
        },
    ]


def test_check_lists_the_center_as_programmed(tmp_path: Path) -> None:
    """With three decimals it is not quite on the bisector of start and end; the arc runs about a point that is."""
    motion = _motion(tmp_path, "G0 X55.038 Y-59.286\nG3 X58.636 Y-62.782 I3.598 J.103 F600\n")
    assert motion[1]["center_mm"] == pytest.approx([58.636, -59.183, 0.0], abs=1e-9)


def test_check_speaks_in_the_programs_coordinates(tmp_path: Path) -> None:
    motion = _motion(tmp_path, "G1 X1 Y2 Z3 F100\n", "--set", "program_zero=[0.010, -0.020, 0.030]")
    assert motion[0]["end_mm"] == [1.0, 2.0, 3.0]


def test_check_lists_events_and_needs_no_motion(tmp_path: Path) -> None:
    program = _write(tmp_path, "S300 M3\nG4 P.5\n(MSG, look)\nM2\n")
    assert json.loads(done("check", program, *MACHINE, "--json")) == {
        "motion": [],
        "events": [
            {"kind": "spindle_speed", "line": 1, "path_length_mm": 0.0, "value": 300.0},
            {"kind": "spindle_clockwise", "line": 1, "path_length_mm": 0.0, "value": 300.0},
            {"kind": "dwell", "line": 2, "path_length_mm": 0.0, "value": 0.5},
            {"kind": "message", "line": 3, "path_length_mm": 0.0, "text": "look"},
            {"kind": "program_end", "line": 4, "path_length_mm": 0.0},
        ],
        "time_s": 0.5,
    }
    _, *events, verdict = done("check", program, *MACHINE).splitlines()
    assert [line.split() for line in events] == [
        *(["1", "spindle_speed", "300"], ["1", "spindle_clockwise", "300"], ["2", "dwell", "0.5"]),
        *(["3", "message:", "look"], ["4", "program_end"]),
    ]
    assert verdict.startswith("0 motions")


def test_check_as_a_table(tmp_path: Path) -> None:
    program = _write(tmp_path, "G1 X1 Y2 Z3 F100\n")
    header, row, verdict = done("check", program, *MACHINE).splitlines()
    assert header.split() == ["line", "motion", "x_mm", "y_mm", "z_mm", "feed_mm_min"]
    assert row.split() == ["1", "feed", "1.0000", "2.0000", "3.0000", "100.0"]
    assert verdict == "1 motions, 3.742 mm, 2.246 s: within workspace and travel"
    assert list(tmp_path.iterdir()) == [program]


def _motion(folder: Path, text: str, *options: str) -> list[dict[str, Any]]:
    printed = json.loads(done("check", _write(folder, text), *MACHINE, "--json", *options))
    assert list(printed) == ["motion", "events", "time_s"]
    motion: list[dict[str, Any]] = printed["motion"]
    return motion


def _write(folder: Path, text: str) -> Path:
    path = folder / "program.ngc"
    path.write_text(text)
    return path


# --- simulate and evaluate

CONTOUR = "G0 X-30 Y-10\nG1 X30 F6000\nG3 X40 Y0 I0 J10 F1200\nG1 X40 Y10 F1200 (pkm_cnc: not evaluated)\nM2\n"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bags `contour` (rapid, line, arc, line not evaluated) and `circle` (both directions), and nothing else."""
    folder = tmp_path_factory.mktemp("recorded")
    program = _write(folder, CONTOUR)
    machine = folder / "machine.yaml"
    shutil.copy(machine_files()["tripod"], machine)
    told = done("simulate", program, "--machine", machine, "--set", "drive.kv=25", "--bag", folder / "contour")
    assert told.startswith(f"bag {folder / 'contour'}: ")
    done("program", "circle", *MACHINE, "--radius", "5", "--feed", "1500", "-o", program)
    done("simulate", program, *MACHINE, "--bag", folder / "circle")
    program.unlink()
    machine.unlink()
    return folder


def test_simulate_makes_a_bag_folder(recorded: Path) -> None:
    assert sorted(path.name for path in (recorded / "contour").iterdir()) == ["contour_0.mcap", "metadata.yaml"]


SIGNED = {"mean": float, "std": float, "rms": float, "max_abs": float}
FIGURES = {
    "contour_error_um": SIGNED,
    "contour_error_z_um": SIGNED,
    "contour_error_3d_um": {"mean": float, "rms": float, "max": float},
    "tracking_error_mm": {"mean": float},
    "below_feed": int,
}
LINE = {"kind": str, "line": int, "heading_deg": float, "feed_mm_min": float, "length_mm": float, **FIGURES}
ARC = {
    "kind": str,
    "line": int,
    "direction": str,
    "radius_mm": float,
    "center_mm": [float, float],
    "feed_mm_min": float,
    "length_mm": float,
    **FIGURES,
}
CIRCLE = {
    "kind": str,
    "direction": str,
    "radius_mm": float,
    "center_mm": [float, float],
    "feed_mm_min": float,
    "radial_deviation_um": {"mean": float, "min": float, "max": float},
    "circularity_um": float,
    "extrema_deg": [float, float, float],
    "iso230_4": {"G_um": float, "F_max_um": float, "F_min_um": float},
}
PAIR = {"kind": str, "iso230_4": {"Gb_um": float, "D_um": float}}


def _evaluated(bag: Path) -> dict[str, Any]:
    text = done("evaluate", bag, "--json")
    assert text.count("\n") == 1
    printed: dict[str, Any] = json.loads(text, parse_constant=_refuse)
    assert _shape({**printed, "segments": []}) == {
        "machine": str,
        "servo_period_s": float,
        "cycles": int,
        "segments": [],
    }
    return printed


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def _shape(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _shape(content) for key, content in value.items()}
    if isinstance(value, list):
        return [_shape(content) for content in value]
    return type(value)


def test_evaluate_json_of_lines_and_arcs(recorded: Path) -> None:
    """From the bag alone: part program and machine file are gone."""
    printed = _evaluated(recorded / "contour")
    assert (printed["machine"], printed["servo_period_s"]) == ("tripod", 0.001)
    assert printed["cycles"] == read_run(recorded / "contour").cycles()
    assert [_shape(segment) for segment in printed["segments"]] == [LINE, ARC]
    line, arc = printed["segments"]
    assert (line["kind"], line["line"], line["heading_deg"]) == ("line", 2, 0.0)
    assert (line["feed_mm_min"], line["length_mm"], line["below_feed"]) == (6000.0, 60.0, 0)
    assert (arc["kind"], arc["line"], arc["direction"], arc["radius_mm"]) == ("arc", 3, "ccw", 10.0)
    assert (arc["center_mm"], arc["feed_mm_min"]) == ([30.0, 0.0], 1200.0)
    assert arc["length_mm"] == pytest.approx(5.0 * math.pi, abs=1e-6)


def test_evaluate_json_has_the_units_of_its_keys(recorded: Path) -> None:
    line = _evaluated(recorded / "contour")["segments"][0]
    assert line["tracking_error_mm"]["mean"] == pytest.approx(100.0 / 25.0, rel=0.02)  # v / Kv in mm
    plane, up, space = (line[f"contour_error{part}_um"] for part in ("", "_z", "_3d"))
    assert 1.0 < plane["max_abs"] < 20.0
    assert 10.0 < up["max_abs"] < 40.0
    assert up["mean"] < 0.0
    for part in (plane, up):
        assert abs(part["mean"]) <= part["rms"] <= part["max_abs"]
        assert part["rms"] == pytest.approx(math.hypot(part["mean"], part["std"]))
    assert space["rms"] == pytest.approx(math.hypot(plane["rms"], up["rms"]), rel=1e-6)
    assert space["mean"] <= space["rms"] <= space["max"]


def test_evaluate_json_of_circles(recorded: Path) -> None:
    printed = _evaluated(recorded / "circle")
    assert [_shape(segment) for segment in printed["segments"]] == [CIRCLE, CIRCLE, PAIR]
    *circles, pair = printed["segments"]
    for circle, direction in zip(circles, ("ccw", "cw"), strict=True):
        assert (circle["kind"], circle["direction"]) == ("circle", direction)
        assert (circle["radius_mm"], circle["center_mm"], circle["feed_mm_min"]) == (5.0, [0.0, 0.0], 1500.0)
        deviation, iso = circle["radial_deviation_um"], circle["iso230_4"]
        # a lag of 1/(1 + s/20) shrinks what turns at 25/5 rad/s; the sampled cascade has a little less of it
        assert deviation["mean"] == pytest.approx(5000.0 * (1.0 - 1.0 / math.hypot(1.0, 5.0 / 20.0)), rel=0.06)
        assert circle["circularity_um"] == pytest.approx(deviation["max"] - deviation["min"])
        assert (iso["F_max_um"], iso["F_min_um"]) == (-deviation["min"], -deviation["max"])
        assert iso["G_um"] == pytest.approx(circle["circularity_um"], rel=1e-3)  # its centre is the programmed one
        assert all(0.0 <= angle < 360.0 for angle in circle["extrema_deg"])
    assert pair["kind"] == "circle_pair"
    assert pair["iso230_4"]["D_um"] == pytest.approx(-circles[0]["radial_deviation_um"]["mean"], rel=1e-3)
    assert pair["iso230_4"]["Gb_um"] >= 0.999999 * max(circle["iso230_4"]["G_um"] for circle in circles)


def test_evaluate_as_a_table_carries_units(recorded: Path) -> None:
    table = done("evaluate", recorded / "contour")
    for unit in ("deg", "mm_min", "mm", "um"):
        assert f"_{unit}" in table
    assert "6000" in table


def test_evaluate_writes_a_page_and_names_it(recorded: Path, tmp_path: Path) -> None:
    result = pkm("evaluate", recorded / "contour", "--json", "--report", tmp_path / "report")
    assert result.code == 0
    json.loads(result.out)
    assert result.err == f"report {tmp_path / 'report' / 'index.html'}\n"
    files = sorted((tmp_path / "report").iterdir())
    assert [path.name for path in files] == ["contour_error.png", "contour_error.svg", "data.json", "index.html"]
    assert json.loads(files[2].read_text(encoding="utf-8")) == json.loads(result.out)
    assert shlex.join(["pkm_cnc", "evaluate", str(recorded / "contour")]) in files[3].read_text(encoding="utf-8")


# --- kinematics

POSES = [(0.0, 0.0, 0.0), (100.0, -50.0, 20.0), (-99.99999999999999, 1e-7, 300.0), (1 / 3, 2 / 3, -1 / 7)]


def test_kinematics_round_trip_with_17_digits() -> None:
    rows = [",".join(f"{value:.17g}" for value in pose) for pose in POSES]
    joints = done("kinematics", "inverse", *MACHINE, stdin="\n".join(["x_mm,y_mm,z_mm", *rows, ""]))
    header, *lines = joints.splitlines()
    assert header == "u1_mm,u2_mm,u3_mm"
    machine = load_setup("tripod").machine
    for line, pose in zip(lines, POSES, strict=True):
        cells = line.split(",")
        assert cells == [f"{float(cell):.17g}" for cell in cells]
        exact = [1e3 * value for value in machine.inverse([value / 1e3 for value in pose])]
        assert [float(cell) for cell in cells] == exact
    header, *lines = done("kinematics", "forward", *MACHINE, stdin=joints).splitlines()
    assert header == "x_mm,y_mm,z_mm"
    for line, pose in zip(lines, POSES, strict=True):
        assert [float(cell) for cell in line.split(",")] == pytest.approx(pose, abs=1e-9)


def test_kinematics_knows_geometry_only() -> None:
    """A slider at 1.4 m is beyond its travel: nothing to kinematics, refused by check."""
    high = done("kinematics", "inverse", *MACHINE, stdin="x_mm,y_mm,z_mm\n0,0,900\n")
    assert float(high.splitlines()[1].split(",")[0]) > 1300.0


@pytest.mark.parametrize(
    ("direction", "header", "good", "bad"),
    [
        ("inverse", "x_mm,y_mm,z_mm", "1,2,3", "900,0,0"),
        ("inverse", "x_mm,y_mm,z_mm", "1,2,3", "nan,0,0"),
        ("inverse", "x_mm,y_mm,z_mm", "1,2,3", "inf,0,0"),
        ("forward", "u1_mm,u2_mm,u3_mm", "470,480,490", "0,900,0"),
        ("forward", "u1_mm,u2_mm,u3_mm", "470,480,490", "0,0,5000"),
    ],
)
def test_a_row_that_cannot_be_reached_gets_nan_and_a_warning_with_its_line(
    direction: str, header: str, good: str, bad: str
) -> None:
    result = pkm("kinematics", direction, *MACHINE, stdin=f"{header}\n{good}\n\n{bad}\n{good}\n")
    assert result.code == 0
    _, before, middle, after = result.out.splitlines()
    assert middle == "nan,nan,nan"
    assert before == after
    assert "nan" not in before
    (warning,) = result.err.splitlines()
    assert warning.startswith("pkm_cnc: stdin:4: ")


def test_kinematics_warns_of_the_strut_and_how_far() -> None:
    warning = pkm("kinematics", "inverse", *MACHINE, stdin="x_mm,y_mm,z_mm\n0,-700,0\n").err
    # column u1 at azimuth 45 deg, span to (0, -700): hypot(363 cos 45, 363 sin 45 + 700) - 600
    excess = math.hypot(363.0 * math.sqrt(0.5), 363.0 * math.sqrt(0.5) + 700.0) - 600.0
    assert "strut u1" in warning
    assert f"{excess:.1f}" in warning


# --- parameters


def test_a_machine_is_named_or_given_by_its_path() -> None:
    rows = "x_mm,y_mm,z_mm\n1,2,3\n"
    named = done("kinematics", "inverse", *MACHINE, stdin=rows)
    assert done("kinematics", "inverse", "--machine", machine_files()["tripod"], stdin=rows) == named


def test_set_reaches_all_drives_or_one_and_the_one_wins(tmp_path: Path) -> None:
    """Straight up all three sliders move as the TCP does: each lags by v / Kv."""
    program = _write(tmp_path, "G1 Z60 F3000\n")
    one, all_drives = "u2.drive.kv=25", "drive.kv=40"
    for number, options in enumerate([(one,), (all_drives,), (one, all_drives), (all_drives, one)]):
        bag = tmp_path / f"bag{number}"
        done("simulate", program, *MACHINE, "--bag", bag, *(word for option in options for word in ("--set", option)))
        lags = [abs(read_run(bag).servo[f"{axis}/command"]["tracking_error"][700]) for axis in ("u1", "u2", "u3")]
        others = 0.050 / (40.0 if all_drives in options else 20.0)
        own = 0.050 / 25.0 if one in options else others
        assert lags == pytest.approx([others, own, others], rel=1e-5)


def test_set_takes_numbers_as_people_write_them() -> None:
    rows = "x_mm,y_mm,z_mm\n0,0,0\n"
    expected = math.sqrt(700.0**2 - 363.0**2)
    for text in ("0.7", "7e-1", " 0.7", "+0.7"):
        printed = done("kinematics", "inverse", *MACHINE, "--set", f"geometry.strut_length={text}", stdin=rows)
        assert float(printed.splitlines()[1].split(",")[0]) == pytest.approx(expected, abs=1e-9)


# --- help, versions, exit codes

OPTIONS = {
    ("program", "star"): ["--machine", "--set", "--feed", "--headings", "--pivot", "--length", "-o"],
    ("program", "circle"): [
        *("--machine", "--set", "--feed", "--radius", "--center", "--direction", "--overshoot", "-o"),
    ],
    ("check",): ["PROGRAM", "--machine", "--set", "--json"],
    ("run",): ["PROGRAM", "--machine", "--set", "--bag", "--pacing", "--processes"],
    ("simulate",): ["PROGRAM", "--machine", "--set", "--bag"],
    ("evaluate",): ["BAG", "--json", "--report"],
    ("kinematics",): ["inverse", "forward", "--machine", "--set"],
}


@pytest.mark.parametrize("subcommand", OPTIONS, ids=" ".join)
def test_help_is_complete(subcommand: tuple[str, ...]) -> None:
    text = done(*subcommand, "--help")
    described = text.partition("options:")[0].partition("positional arguments:")[2] + text.partition("options:")[2]
    assert text.startswith(f"usage: pkm_cnc {' '.join(subcommand)} ")
    for option in OPTIONS[subcommand]:
        assert option in described, f"{option} is not described"


def test_help_names_every_subcommand_and_the_exit_status() -> None:
    text = done("--help")
    for subcommand in OPTIONS:
        assert f"\n    {subcommand[0]} " in text or f"\n    {subcommand[0]}\n" in text
    assert "Exit status: 0" in text
    assert done("--version").strip() == f"pkm_cnc {__version__}"


def test_a_fault_while_running_is_exit_1_and_its_bag_still_evaluates(tmp_path: Path) -> None:
    program, bag = _write(tmp_path, "G1 X50 F6000\n"), tmp_path / "bag"
    limit = "drive.following_error_limit=0.001"
    line = refused("simulate", program, *MACHINE, "--set", limit, "--bag", bag, code=1)
    assert "u2: following error" in line
    assert "limit of 1 mm" in line
    result = pkm("evaluate", bag, "--json")
    assert result.code == 0
    assert json.loads(result.out)["cycles"] > 10
    assert "did not complete" in result.err
    assert "following error" in result.err


def test_as_a_process_bad_input_is_exit_2_and_one_line() -> None:
    done_ = command("check", "missing.ngc", *MACHINE)
    assert (done_.returncode, done_.stdout) == (2, "")
    assert done_.stderr == "pkm_cnc: part program missing.ngc: No such file or directory\n"


def test_as_a_process_in_a_pipe() -> None:
    program = command("program", "star", *MACHINE, "--headings", "-15,0")
    assert (program.returncode, program.stderr) == (0, "")
    checked = command("check", "/dev/stdin", *MACHINE, "--json", input=program.stdout)
    assert (checked.returncode, checked.stderr) == (0, "")
    assert len(json.loads(checked.stdout)["motion"]) == 4
