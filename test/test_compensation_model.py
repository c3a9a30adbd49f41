"""What a calibrated or identified machine file says of a machine whose controller stays as it is."""

import numpy as np
import pytest

from pkm_cnc.compensation import compensate, judged, model_of, observe
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import Program

TRIPOD = load_setup("tripod")
LONGER = "geometry.strut_length_error=[15e-6, -10e-6, 5e-6]"
TILT = ("actual.tilt.about_y=9.6e-5", "actual.tilt.lever=1.0")
FASTER = ("u1.drive.kv=23.64", "drive.kv=22.0")
TCP = np.array([[0.03, -0.02, 0.0], [-0.1, 0.05, -0.01]])


def test_the_calibrated_geometry_is_the_machines_and_not_the_controllers():
    model = model_of(TRIPOD, load_setup("tripod", [LONGER, *TILT]))
    joints = TRIPOD.machine.inverse(TCP)
    np.testing.assert_array_equal(model.machine.inverse(TCP), joints)
    lengths = np.array([0.6 + 15e-6, 0.6 - 10e-6, 0.6 + 5e-6])
    level = model.true_tcp(joints) / (1.0 + 9.6e-5, 1.0, 1.0)
    for strut, azimuth in enumerate(np.radians((45.0, 165.0, 285.0))):  # the struts are as long as they were found
        centre = (0.513 - 0.150) * np.array([np.cos(azimuth), np.sin(azimuth)])
        height = joints[:, strut] - level[:, 2]
        spanned = np.sqrt(np.square(level[:, :2] - centre).sum(axis=1) + height**2)
        np.testing.assert_allclose(spanned, lengths[strut], atol=1e-12)


def test_what_the_machine_truly_is_counts_before_what_its_controller_believes():
    told = load_setup("tripod", [LONGER, "actual.geometry.strut_length_error=[1e-6, 2e-6, 3e-6]"])
    assert model_of(TRIPOD, told).actual.geometry.strut_length_error == (1e-6, 2e-6, 3e-6)


def test_a_controller_that_has_been_calibrated_is_not_calibrated_again():
    calibrated = load_setup("tripod", [LONGER])
    model = model_of(calibrated, load_setup("tripod", [LONGER, *FASTER]))
    assert model.actual is model.machine
    assert [parts.drive.kv for parts in model.axes.values()] == [23.64, 22.0, 22.0]


def test_the_controller_decides_the_motion():
    controller = load_setup("tripod", ["motion.acceleration=3.0", "limits.velocity=0.5", "program_zero=[0.01, 0, 0]"])
    model = model_of(controller, load_setup("tripod", [*FASTER, "u2.limits.velocity=0.1"]))
    assert (model.motion, model.program_zero) == (controller.motion, controller.program_zero)
    assert [parts.limits for parts in model.axes.values()] == [parts.limits for parts in controller.axes.values()]


@pytest.mark.parametrize(
    ("machine", "overrides", "words"),
    [
        ("bipod", [], "--model: it is of another machine: machine is bipod there and tripod here"),
        ("tripod", ["geometry.strut_length=0.61"], "geometry.strut_length is 0.61 there and 0.6 here"),
        ("tripod", ["servo_period=0.002"], "servo_period is 0.002 there and 0.001 here"),
    ],
)
def test_a_model_of_another_machine_is_refused(machine, overrides, words):
    with pytest.raises(InputError, match=words):
        compensate(TRIPOD, Program("p.ngc", "G1 X20 F3000\nM2\n"), model=load_setup(machine, overrides))


def test_a_program_compensated_by_a_calibrated_file_is_right_on_that_machine():
    actual = load_setup("tripod", [f"actual.{LONGER}", *TILT, *FASTER])
    program = Program("line.ngc", "G21 G90\nG0 X-40 Y10\nG1 X40 Y30 F5000\nM2\n")
    result = compensate(TRIPOD, program, model=load_setup("tripod", [LONGER, *TILT, *FASTER]))
    errors = []
    for one in (program, result.program):
        seen = observe(actual, one)
        errors.append(judged(seen.errors, result.toolpath.contour).largest)
    assert errors[0] > 20e-6
    assert errors[1] < 0.02 * errors[0]
