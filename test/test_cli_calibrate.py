"""pkm_cnc calibrate: from a bag or a table to a machine file, and one line for what cannot be used."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import done, refused
from running import environment

from pkm_cnc.identification import Network

ACTUAL = ("--set", "actual.geometry.inclination=0.002", "--set", "actual.geometry.tcp_offset=0.0005")
PROGRAM = "G0 X300\nG1 X500 F30000\nX300\nM2\n"


def recorded(folder: Path, machine: str, *overrides: str, program: str = PROGRAM) -> Path:
    (folder / "program.ngc").write_text(program)
    done("simulate", folder / "program.ngc", "--machine", machine, *overrides, "--bag", folder / "bag")
    return folder / "bag"


def table(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text("\n".join([header, *(",".join(f"{value:.12g}" for value in row) for row in rows)]) + "\n")
    return path


def monopod_rows() -> np.ndarray:
    """u, x in mm of a Monopod whose slider is 0.4 mm further than its scale says: x from 4-5..4-8, gamma = dx = 0."""
    u = np.linspace(320.0, 519.0, 15)
    square = (math.sqrt(600.0**2 - 300.0**2) + 0.4) ** 2 + 300.0**2
    return np.column_stack((u, np.sqrt(square - (u + 0.4) ** 2)))


def geometry(path: Path) -> dict[str, float]:
    return yaml.safe_load(path.read_text())["/**"]["ros__parameters"]["geometry"]


def test_a_bag_tells_what_the_machine_truly_is_and_the_file_runs(tmp_path):
    bag = recorded(tmp_path, "monopod", *ACTUAL)
    out = done("calibrate", "--machine", "monopod", *ACTUAL, "--bag", bag, "-o", tmp_path / "out.yaml")
    assert "rank 3 of 3 unknowns" in out
    found = geometry(tmp_path / "out.yaml")
    assert found["inclination"] == pytest.approx(0.002, rel=1e-6)
    assert found["tcp_offset"] == pytest.approx(0.0005, rel=1e-6)
    comments = [line for line in (tmp_path / "out.yaml").read_text().splitlines() if line.startswith("#")]
    assert comments[0] == "# Calibrated by least-squares from bag."
    assert any("geometry.inclination 0.002 +- " in line for line in comments)
    again = done("calibrate", "--machine", tmp_path / "out.yaml", "--bag", bag, "-o", tmp_path / "again.yaml")
    before = next(line for line in again.splitlines() if line.startswith("before")).split()
    assert max(map(float, before[1:])) < 1e-6


def test_networks_and_a_report(tmp_path):
    rows = table(tmp_path / "m.csv", "u_mm,x_mm", monopod_rows())
    words = ("calibrate", "--machine", "monopod", "--measurements", rows, "--method", "nn", "--seed", 3)
    out = done(*words, "-o", tmp_path / "out.yaml", "--report", tmp_path / "report")
    assert "Deviation over the iterations" in out
    assert geometry(tmp_path / "out.yaml")["slider_offset"] == pytest.approx(0.4e-3, rel=0.01)
    data = json.loads((tmp_path / "report" / "data.json").read_text())
    assert data["method"] == "nn"
    assert data["rank"] == 3
    assert (tmp_path / "report" / "deviation.svg").is_file()
    networks = [Network.load(tmp_path / "report" / f"network-{number}.json") for number in (1, 2, 3)]
    assert [network.name.rpartition(".")[2] for network in networks] == ["inclination", "tcp_offset", "slider_offset"]
    assert networks[0].trained_on["geometry.inclination_rad"] == "-0.003 to 0.003"
    first = (tmp_path / "out.yaml").read_text()
    done(*words, "-o", tmp_path / "out.yaml")
    assert (tmp_path / "out.yaml").read_text() == first


def test_units_and_order_of_columns_are_the_header_s(tmp_path):
    rows = monopod_rows()
    plain = table(tmp_path / "a.csv", "u_mm,x_mm", rows)
    other = table(tmp_path / "b.csv", "x_um, u_m", np.column_stack((1e3 * rows[:, 1], 1e-3 * rows[:, 0])))
    found = []
    for path in (plain, other):
        done("calibrate", "--machine", "monopod", "--measurements", path, "-o", tmp_path / "out.yaml")
        found.append(geometry(tmp_path / "out.yaml")["slider_offset"])
    assert found == pytest.approx([0.4e-3, 0.4e-3], rel=1e-5)


def test_a_positioning_test_is_judged_before_and_after(tmp_path):
    rows = monopod_rows()[::-1]
    targets = np.sqrt(600.0**2 - rows[:, 0] ** 2)
    cycle = np.concatenate((np.arange(15), np.arange(15)[::-1]))
    cycle = np.concatenate((cycle, cycle))
    values = np.column_stack((rows[cycle], targets[cycle]))
    path = table(tmp_path / "m.csv", "u_mm,x_mm,target_x_mm", values)
    out = done("calibrate", "--machine", "monopod", "--measurements", path, "-o", tmp_path / "out.yaml")
    line = next(line for line in out.splitlines() if line.startswith("  position deviation P_a")).split()
    assert float(line[-2]) == pytest.approx(1e3 * np.ptp(rows[:, 1] - targets), rel=1e-4)
    assert float(line[-1]) == pytest.approx(0.0, abs=1e-3)


def test_a_ball_bar_circle_names_what_it_cannot_tell(tmp_path):
    angle = np.radians(np.arange(0.0, 360.0, 10.0))
    azimuth = np.radians([45.0, 165.0, 285.0])
    apart = 100.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)[:, None, :] - 363.0 * np.stack(
        (np.cos(azimuth), np.sin(azimuth)), axis=1
    )
    joints = np.sqrt(600.0**2 - (apart**2).sum(axis=2))
    center = np.full_like(joints, math.sqrt(600.0**2 - 363.0**2))
    header = "u1_mm,u2_mm,u3_mm,center_u1_mm,center_u2_mm,center_u3_mm,radius_mm"
    path = table(tmp_path / "c.csv", header, np.column_stack((joints, center, 100.02 + 0.0 * angle)))
    out = done("calibrate", "--machine", "tripod", "--measurements", path, "-o", tmp_path / "out.yaml")
    assert "rank 8 of 12 unknowns" in out
    assert out.count("not observable, left alone") == 4


BAD = {
    "u,x_mm\n1,2\n": "m.csv:1: column 'u' has no unit; call it u_mm, u_um or u_m",
    "u_mm,x_inch\n1,2\n": "m.csv:1: column 'x_inch' has no unit",
    "u_mm,y_mm\n1,2\n": "m.csv:1: columns u, y; wanted are, each with its unit, u, x or",
    "u_mm,u_um,x_mm\n1,2,3\n": "m.csv:1: column u is there twice",
    "u_mm,x_mm\n1,nan\n": "m.csv:2: x_mm: nan is not a finite number",
    "u_mm,x_mm\n1,2\n1,a\n": "m.csv:3: x_mm: 'a' is not a number",
    "u_mm,x_mm\n1\n": "m.csv:2: 1 values, 2 expected",
    "u_mm,x_mm\n": "m.csv: no rows",
    "": "m.csv: no rows",
    "u_mm,x_mm\n500,300\n500,400\n500,500\n500,510\n": "u constant in all 4 rows",
    "u_mm,x_mm\n500,300\n501,302\n502,304\n503,304\n": "x moves by 4 mm, at least 10 mm are needed",
    "u_mm,x_mm\n900,300\n901,400\n902,304\n903,304\n": "the measurements do not fit the machine",
    "u_mm,x_mm\n500,320\n510,310\n": "2 measured values for 2 observable parameters",
    "\xff": "not a CSV file",
}


@pytest.mark.parametrize("content", BAD)
def test_bad_tables_are_refused_in_one_line(tmp_path, content):
    (tmp_path / "m.csv").write_bytes(content.encode("latin-1"))
    line = refused(
        "calibrate", "--machine", "monopod", "--measurements", tmp_path / "m.csv", "-o", tmp_path / "out.yaml"
    )
    assert BAD[content] in line
    assert not (tmp_path / "out.yaml").exists()


def test_a_bag_of_another_machine_is_refused(tmp_path):
    bag = recorded(tmp_path, "monopod")
    out = ("--bag", bag, "-o", tmp_path / "out.yaml")
    assert "recorded on a monopod, the machine is a bipod" in refused("calibrate", "--machine", "bipod", *out)
    longer = refused("calibrate", "--machine", "monopod", "--set", "geometry.strut_length=0.61", *out)
    assert "recorded on another machine: geometry.strut_length is 0.6 there, 0.61 here" in longer


def test_a_bag_with_too_little_motion_says_which_is_missing(tmp_path):
    bag = recorded(tmp_path, "tripod", program="G1 Y0 F3000\nX40\nM2\n")
    line = refused("calibrate", "--machine", "tripod", "--bag", bag, "-o", tmp_path / "out.yaml")
    assert "too little motion: y moves by 0.00" in line


def test_no_other_command_waits_for_the_networks():
    code = (
        "import sys, pkm_cnc.cli.command; print([name for name in ('sklearn', 'scipy.stats') if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"


def test_arguments(tmp_path):
    assert "No such file" in refused(
        "calibrate", "--machine", "monopod", "--measurements", tmp_path / "no.csv", "-o", tmp_path / "o.yaml"
    )
    rows = table(tmp_path / "m.csv", "u_mm,x_mm", monopod_rows())
    words = ("calibrate", "--machine", "monopod", "--measurements", rows)
    assert "cannot be written" in refused(*words, "-o", tmp_path / "no" / "o.yaml")
    assert "--seed: -1" in refused(*words, "-o", tmp_path / "o.yaml", "--seed=-1")


def test_a_tilt_is_found_from_a_bag_and_compensated_from_the_file(tmp_path):
    """The controller keeps its kinematics; the machine is neither as drawn nor level."""
    program = "G21 G90\nG0 X-40 Y-40\nG1 X40 Y40 F3000\nG0 X40 Y-40\nG1 X-40 Y40 F3000\nG0 X0 Y50\nG1 Y-50\nG1 Z5\nM2\n"
    actual = ["actual.geometry.strut_length_error=[1.5e-5,-1e-5,5e-6]", "actual.tilt.about_y=0.0008"]
    sets = [part for text in (*actual, "actual.tilt.lever=0.12") for part in ("--set", text)]
    bag = recorded(tmp_path, "tripod", *sets, program=program)
    said = done("calibrate", "--machine", "tripod", "--tilt", "--bag", bag, "-o", tmp_path / "out.yaml")
    assert "rank 14 of 14 unknowns" in said
    parameters = yaml.safe_load((tmp_path / "out.yaml").read_text())["/**"]["ros__parameters"]
    assert parameters["actual"]["tilt"]["about_y"] == pytest.approx(0.12 * 0.0008, rel=1e-6)
    part = tmp_path / "part.ngc"
    part.write_text("G21 G90\nG0 X-30 Y20\nG1 X30 Y-10 F2000\nM2\n")
    model = ("--model", tmp_path / "out.yaml", "-o", tmp_path / "new.ngc")
    done("compensate", part, "--machine", "tripod", *model)
    errors = []
    for name in ("part.ngc", "new.ngc"):
        done("simulate", tmp_path / name, "--machine", "tripod", *sets, "--bag", tmp_path / f"{name}.bag")
        (line,) = json.loads(done("evaluate", tmp_path / f"{name}.bag", "--json"))["segments"]
        errors.append(line["contour_error_3d_um"]["max"])
    assert errors[0] > 5.0
    assert errors[1] < 0.05 * errors[0]


def test_a_tilt_of_a_machine_in_the_plane_is_refused(tmp_path):
    rows = table(tmp_path / "b.csv", "u1_mm,u2_mm,x_mm,y_mm", np.arange(40.0).reshape(10, 4))
    out = ("-o", tmp_path / "out.yaml")
    line = refused("calibrate", "--machine", "bipod", "--tilt", "--measurements", rows, *out)
    assert "a tilt is estimated on a machine that moves in x, y, z" in line
