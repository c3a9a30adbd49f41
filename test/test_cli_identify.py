"""pkm_cnc identify: from bags to a machine file, and what it refuses."""

import contextlib
import dataclasses
import io
import json

import numpy as np
import pytest

from pkm_cnc.bag import BagWriter, read_run
from pkm_cnc.check import prepare
from pkm_cnc.cli import main
from pkm_cnc.config import load_setup
from pkm_cnc.contour import circle_program, star_program
from pkm_cnc.errors import InputError
from pkm_cnc.identification import ContourData, Network, drive_run, drive_unknowns, fit_drives_by_networks
from pkm_cnc.program import read_program
from pkm_cnc.servo import DriveParameters, equivalent_delay
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import recorded_topics


def record(folder, name, text, machine="tripod", *overrides):
    """A bag of the program `text`."""
    setup = load_setup(machine, overrides)
    path = folder / f"{name}.ngc"
    path.write_text(text)
    program = read_program(str(path))
    with BagWriter(str(folder / name), recorded_topics(tuple(setup.axes))) as bag:
        simulate(setup, program, prepare(setup, program), bag)
    return str(folder / name)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """A star and circles at 6000 mm/min on a machine with Kv 23.64 1/s in place of 20."""
    folder = tmp_path_factory.mktemp("identify")
    star = star_program(6000.0, [15.0, 75.0, 130.0], (0.0, 0.0), 120.0)
    circle = circle_program(
        feed_mm_min=6000.0,
        radius_mm=50.0,
        center_mm=(0.0, 0.0),
        direction="both",
        overshoot_deg=60.0,
        acceleration_mm_s2=2000.0,
    )
    programs = {"star": star, "circle": circle}
    return [record(folder, name, text, "tripod", "drive.kv=23.64") for name, text in programs.items()]


def identify(*arguments):
    """Exit status, standard output and standard error of the command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(["identify", *map(str, arguments)])
    return status, out.getvalue(), err.getvalue()


CORNERS = "%\nG21 G90\nG1 X60 Y20 Z-20 F6000\nG1 X-40 Y50 Z0\nG1 X0 Y-40 Z20\nG1 X0 Y0 Z0\nM30\n%\n"


def test_a_machine_with_friction_is_identified_in_what_is_linear(tmp_path):
    """Its drives are late by their dead time besides the velocity loop; what friction leaves is told as a deviation."""
    bag, out = record(tmp_path, "corners", CORNERS, "tripod_real"), tmp_path / "found.yaml"
    status, _, errors = identify("--machine", "tripod_real", "--bag", bag, "-o", out)
    assert (status, errors) == (0, "")
    found = load_setup(str(out))
    for axis, parts in found.axes.items():
        assert found.imperfect(axis) in ("", "drive.dead_time")
        assert parts.drive.kv == pytest.approx(20.0, rel=0.02)
        late = equivalent_delay(parts.drive) + parts.drive.dead_time
        assert late == pytest.approx(equivalent_delay(DriveParameters()) + 0.001, rel=0.1)


def test_a_calibrated_machine_explains_bags_of_before(tmp_path):
    errors_of_struts = "geometry.strut_length_error=[200.0e-6,-100.0e-6,50.0e-6]"
    circle = circle_program(
        feed_mm_min=6000.0,
        radius_mm=60.0,
        center_mm=(0.0, 0.0),
        direction="both",
        overshoot_deg=60.0,
        acceleration_mm_s2=2000.0,
    )
    bag = record(tmp_path, "circle", circle, "tripod", "drive.kv=23.64", f"actual.{errors_of_struts}")
    out = tmp_path / "found.yaml"
    for believed in (errors_of_struts, f"actual.{errors_of_struts}"):
        arguments = ["--machine", "tripod", "--set", believed, "--bag", bag, "--data", "contour", "-o", out]
        assert identify(*arguments)[0] == 0
        found = load_setup(str(out))
        assert [parts.drive.kv for parts in found.axes.values()] == pytest.approx([23.64] * 3, rel=1e-6)


@pytest.mark.parametrize("data", ["axis", "contour"])
def test_kv_is_found_without_noise(bags, tmp_path, data):
    out = tmp_path / "found.yaml"
    status, text, errors = identify("--machine", "tripod", "--bag", *bags, "--data", data, "-o", out)
    assert (status, errors) == (0, "")
    found = load_setup(str(out))
    assert [parts.drive.kv for parts in found.axes.values()] == pytest.approx([23.64] * 3, rel=1e-6)
    assert "left alone" in text
    assert "change_um_per_step" in text
    assert "after_um" in text


def test_networks_find_kv_from_contour_errors(bags):
    setup = load_setup("tripod")
    data = ContourData([drive_run(read_run(bag), setup) for bag in bags])
    unknowns = [one for one in drive_unknowns(setup) if one.name == "kv"]
    fit, _ = fit_drives_by_networks(setup, unknowns, data, vectors=60)
    assert fit.values == pytest.approx([23.64] * 3, rel=0.01)


def test_networks_by_the_command(tmp_path):
    text = "%\nG21 G90\n" + "G1 X60 Y30 Z20 F6000\nG1 X0 Y0 Z0\n" * 2 + "M30\n%\n"
    bag = record(tmp_path, "all_axes", text, "cartesian", "drive.kv=23.64", "drive.kind=first_order")
    arguments = ["--machine", "cartesian", "--set", "drive.kind=first_order", "--bag", bag, "--method", "nn"]
    out = tmp_path / "found.yaml"
    status, text, errors = identify(*arguments, "-o", out, "--report", tmp_path / "report")
    assert (status, errors) == (0, "")
    assert "spread (95 %)" in text
    assert Network.load(tmp_path / "report" / "network-x.json").trained_on
    found = load_setup(str(out))
    assert [parts.drive.kv for parts in found.axes.values()] == pytest.approx([23.64] * 3, rel=0.01)


def test_report(bags, tmp_path):
    folder = tmp_path / "report"
    status, text, _ = identify(
        "--machine", "tripod", "--bag", bags[0], "-o", tmp_path / "found.yaml", "--report", folder
    )
    assert status == 0
    assert str(folder / "index.html") in text
    data = json.loads((folder / "data.json").read_text())
    assert {fit["data"] for fit in data["fits"]} == {"u1", "u2", "u3"}
    assert (folder / "frequency_response.svg").is_file()


def test_a_bag_of_another_machine_is_refused(bags, tmp_path):
    for arguments, words in (
        (["--machine", "cartesian"], "recorded on a tripod, the machine is a cartesian"),
        (["--machine", "tripod", "--set", "geometry.strut_length=0.61"], "recorded on another machine: geometry."),
        (["--machine", "tripod", "--set", "servo_period=0.002"], "recorded on another machine: servo_period"),
    ):
        status, _, errors = identify(*arguments, "--bag", bags[0], "-o", tmp_path / "found.yaml")
        assert status == 2
        assert words in errors
        assert errors.count("\n") == 1
    assert not (tmp_path / "found.yaml").exists()


def test_a_drive_that_does_not_move_is_named(tmp_path):
    bag = record(tmp_path, "along_x", "%\nG21 G90\nG1 X50 F6000\nG1 X0\nM30\n%\n", "cartesian")
    status, _, errors = identify("--machine", "cartesian", "--bag", bag, "-o", tmp_path / "found.yaml")
    assert status == 2
    assert "y.drive.kv: y does not move" in errors


def test_contour_errors_of_lines_alone_on_a_serial_machine_do_not_tell_kv(tmp_path):
    """Equal drives keep a line whatever their gain."""
    bag = record(tmp_path, "along_x", "%\nG21 G90\nG1 X50 F6000\nG1 X0\nM30\n%\n", "cartesian")
    status, _, errors = identify("--machine", "cartesian", "--bag", bag, "--data", "contour", "-o", tmp_path / "f.yaml")
    assert status == 2
    assert "too little motion to tell" in errors
    assert errors.count("\n") == 1


def test_a_negative_seed_is_refused(bags, tmp_path):
    status, _, errors = identify("--machine", "tripod", "--bag", bags[0], "--seed", "-1", "-o", tmp_path / "f.yaml")
    assert (status, errors) == (2, "pkm_cnc: --seed: -1 is below its minimum 0\n")


def changed(run, topic, name, cycles, value):
    rows = run.servo[topic].copy()
    rows[name][cycles] = value
    return dataclasses.replace(run, servo={**run.servo, topic: rows})


def test_records_that_tell_nothing_are_refused(bags):
    setup, run = load_setup("tripod"), read_run(bags[0])
    for damaged, words in (
        (changed(run, "u2/actual", "position", 17, np.nan), "u2/actual: position of cycle 17 is nan"),
        (changed(run, "u1/setpoint", "velocity", 3, np.inf), "u1/setpoint: velocity of cycle 3 is inf"),
        (changed(run, "u3/actual", "position", slice(None), 0.4), "u3/actual is constant, 400 mm, while its setpoint"),
        (
            dataclasses.replace(run, servo={key: rows for key, rows in run.servo.items() if key != "u1/setpoint"}),
            "it holds no u1/setpoint",
        ),
    ):
        with pytest.raises(InputError, match=words):
            drive_run(damaged, setup)
