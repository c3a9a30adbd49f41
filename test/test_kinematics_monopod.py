"""The Monopod against the triangle that its strut closes, and what a true geometry does to a controller's belief."""

import dataclasses
import math

import numpy as np
import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError, UnreachableError
from pkm_cnc.kinematics.monopod import Monopod
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulated_cycles

NOMINAL = Monopod(Monopod.Geometry())
ERRORS = {"inclination": 0.011, "tcp_offset": 0.004, "slider_offset": -0.006}
TRUE = Monopod(Monopod.Geometry(**ERRORS))


def points(machine, u, x):
    """Slider and TCP in the coordinates of the guides' crossing, by the angle of 90 deg + gamma between them."""
    geometry = machine.geometry
    angle = math.radians(90.0) + geometry.inclination
    slider = (u + geometry.slider_offset) * np.array((math.cos(angle), math.sin(angle)))
    return slider, np.array((x + geometry.tcp_offset, 0.0))


def test_perfect_geometry_is_pythagoras_to_the_last_bit():
    x = np.linspace(0.001, 0.599, 999)
    assert NOMINAL.inverse(x[:, None]).tolist() == [[math.sqrt(0.6 * 0.6 - value * value)] for value in x.tolist()]
    assert NOMINAL.strut_length == 0.6


@pytest.mark.parametrize("slider_side", ["above", "below"])
@pytest.mark.parametrize("tcp_side", ["right", "left"])
def test_the_strut_keeps_its_length_on_all_four_branches(slider_side, tcp_side):
    start = 0.3 if tcp_side == "right" else -0.3
    geometry = Monopod.Geometry(**ERRORS, start_x=start, slider_side=slider_side, tcp_side=tcp_side)
    machine = Monopod(geometry)
    sign_u, sign_x = (1 if slider_side == "above" else -1), (1 if tcp_side == "right" else -1)
    for x in sign_x * np.linspace(0.05, 0.55, 11):
        (u,) = machine.inverse([x])
        slider, tcp = points(machine, u, x)
        assert np.linalg.norm(slider - tcp) == pytest.approx(machine.strut_length, abs=1e-15)
        assert sign_u * u > 0.0
        assert machine.forward([u]) == pytest.approx([x], abs=1e-14)
        assert machine.forward_newton([u]) == pytest.approx([x], abs=1e-14)


def test_closure_at_the_start_point_gives_the_length():
    u0 = math.sqrt(0.6**2 - 0.3**2)
    slider, tcp = points(TRUE, u0, 0.3)
    assert TRUE.strut_length == pytest.approx(float(np.linalg.norm(slider - tcp)), abs=1e-15)
    assert TRUE.forward([u0]) == pytest.approx([0.3], abs=1e-15)
    elsewhere = Monopod(Monopod.Geometry(**ERRORS, start_x=0.4, start_u=0.45))
    assert elsewhere.forward([0.45]) == pytest.approx([0.4], abs=1e-15)


def test_a_given_length_is_used_as_it_is():
    machine = Monopod(Monopod.Geometry(closure="given", strut_length_error=0.002, start_x=5.0))
    assert machine.inverse([0.1])[0] == math.sqrt(0.602 * 0.602 - 0.1 * 0.1)


def test_the_controller_believes_what_the_true_machine_does_not_do():
    """Believed: the programmed x. True: the slider is where the controller put it, the triangle closes elsewhere."""
    errors = [f"actual.geometry.{name}={value}" for name, value in ERRORS.items()]
    setup = load_setup("monopod", errors)
    program = Program("out.ngc", "G21 G90\nG1 X303 F600\nM30\n")
    cycles = list(simulated_cycles(setup, prepare(setup, program)))
    first, last = cycles[0].tcp, cycles[-1].tcp
    assert (first.believed_x, first.x) == pytest.approx((0.3, 0.3), abs=1e-15)  # closure: both start at x0
    for cycle in (cycles[len(cycles) // 2], cycles[-1]):
        (state,) = cycle.states
        slider, _ = points(TRUE, state.position, 0.0)
        across = math.sqrt(TRUE.strut_length**2 - slider[1] ** 2)
        assert cycle.tcp.x == pytest.approx(slider[0] + across - ERRORS["tcp_offset"], abs=1e-14)
        assert cycle.tcp.believed_x == pytest.approx(math.sqrt(0.6**2 - state.position**2), abs=1e-14)
    assert abs(last.x - last.believed_x) > 10e-6


def test_dead_point_and_border_are_refused_with_the_distance():
    with pytest.raises(UnreachableError, match=r"^row 1: x: wrong assembly branch: the TCP is 3 mm left of the slider"):
        NOMINAL.inverse([[0.1], [-0.003]])
    with pytest.raises(UnreachableError, match=r"^strut u: the TCP is 5 mm too far from the slider's guide"):
        NOMINAL.inverse([0.605])
    with pytest.raises(UnreachableError, match=r"^slider u: the strut does not reach the x axis, it is 7 mm too short"):
        NOMINAL.forward([0.607])
    for forward in (NOMINAL.forward, NOMINAL.forward_newton):
        with pytest.raises(
            UnreachableError, match=r"^row 1: slider u: wrong assembly branch: it would be 200 mm below"
        ):
            forward([[0.3], [-0.2]])
    with pytest.raises(UnreachableError, match=r"^Newton's method does not lead from the guess -100\.000 mm"):
        NOMINAL.forward_newton([0.3], [-0.1])
    [near] = NOMINAL.violations([1e-10])
    assert near.reason.startswith("strut u: singular pose: dead point, gear ratio 1.67e-10")
    assert NOMINAL.violations([0.0])[0].axis == "x"


def test_gear_ratio_is_zero_at_the_dead_point_and_grows_to_the_border():
    """4-13 for gamma = 0: -x / u."""
    x = np.array([[1e-6], [0.3], [0.6 * math.sqrt(0.5)], [0.599999]])
    ratio = NOMINAL.jacobian(x)[:, 0, 0]
    assert ratio == pytest.approx(-x[:, 0] / np.sqrt(0.36 - x[:, 0] ** 2), rel=1e-12)
    assert ratio[2] == pytest.approx(-1.0, abs=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strut_length": 0.0}, r"geometry\.strut_length: 0\.0 m is not above 0\.0 m"),
        ({"strut_length": math.nan}, r"geometry\.strut_length: nan is not a finite number"),
        ({"strut_length": 0.3}, r"geometry\.start_x: 0\.3 m is not within geometry\.strut_length 0\.3 m"),
        ({"start_x": -0.2}, r"geometry\.start_x: -0\.2 m is not right of the dead point"),
        ({"start_u": -0.2}, r"geometry\.start_u: -0\.2 m is not above the TCP at the start point"),
        (
            {"strut_length_error": 0.01},
            r"geometry\.strut_length_error: 0\.01 m given, but with geometry\.closure: start",
        ),
        ({"closure": "given", "strut_length_error": -0.6}, r"geometry\.strut_length_error: -0\.6 m leaves nothing"),
        ({"closure": "open"}, r"geometry\.closure: 'open' is not one of start, given"),
        ({"inclination": 1.6}, r"geometry\.inclination: 1\.6 rad is over its maximum 1\.0 rad"),
    ],
)
def test_geometry_that_cannot_be_built_is_refused_with_its_key(changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Monopod(dataclasses.replace(Monopod.Geometry(), **changes))


def test_sketch_is_the_machine():
    (u,) = TRUE.inverse([0.42])
    lines = dict(TRUE.sketch([u], [0.42]))
    assert list(lines) == ["column u", "column x", "strut u"]
    slider, tcp = lines["strut u"]
    assert tcp.tolist() == [0.42, 0.0, 0.0]
    assert np.linalg.norm(slider - tcp) == pytest.approx(TRUE.strut_length, abs=1e-15)
    crossing, end = lines["column u"]
    assert crossing.tolist() == lines["column x"][0].tolist() == [-0.004, 0.0, 0.0]
    assert np.cross(end - crossing, slider - crossing) == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
