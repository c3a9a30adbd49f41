"""The circle experiment against analytic struts, known harmonics and the law."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

from pkm_cnc.config import load_setup
from pkm_cnc.contour import circle_path
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated
from pkm_cnc.experiments._circles import harmonics, polar_panel
from pkm_cnc.experiments._struts import strut_angles
from pkm_cnc.program import Arc


@functools.cache
def findings(machine: str = "tripod", center: tuple[float, ...] = (0.0, 0.0)) -> Findings:
    circle = load_experiment("circle")
    options = circle.options(radii=(40.0,), feeds=(3000.0,), center=center)
    return circle.run(Lab(machine, (), simulated), options)


def one(machine: str = "tripod") -> dict[str, Any]:
    (circle,) = findings(machine).to_json()["circles"]
    return circle


@pytest.mark.parametrize("machine", ["tripod", "bipod"])
def test_the_deviation_is_the_laws_all_around(machine: str) -> None:
    """The next term goes with (v / (R Kv))^2 = 0.004, and the tool is turned by v / (R Kv) = 3.6 deg at most."""
    circle = one(machine)
    panel = next(figure for figure in findings(machine).figures if figure.name == "circle-drives").panels[0]
    curve = next(curve for curve in panel.curves if curve.name == "counter-clockwise")
    simulated_um = np.interp(circle["angle_deg"], curve.x, curve.y, period=360.0)
    assert np.abs(simulated_um - np.array(circle["law_um"])).max() < 0.02 * max(circle["law_um"])


def test_drives_move_as_their_jacobian_says() -> None:
    """At the actual angle: the tool, too, runs around at the feed."""
    circle, machine = one(), load_setup("tripod").machine
    angle = np.radians(circle["angle_deg"])
    still = np.zeros_like(angle)
    tcp = 0.040 * np.stack([np.cos(angle), np.sin(angle), still], axis=1)
    velocity = 50.0 * np.stack([-np.sin(angle), np.cos(angle), still], axis=1)
    expected = (machine.jacobian(tcp) * velocity[:, None, :]).sum(axis=-1)
    found = np.stack([circle["drive_velocity_mm_s"][axis] for axis in ("u1", "u2", "u3")], axis=1)
    assert found == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_strut_angles_of_the_tripod() -> None:
    machine = load_setup("tripod").actual
    tcp = np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.02]])
    angles = strut_angles(machine, machine.inverse(tcp), tcp)
    assert list(angles) == ["u1", "u2", "u3"]
    for axis, azimuth in zip(angles, (45.0, 165.0, 285.0), strict=True):
        foot = 0.363 * np.array([math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))])
        span = np.hypot(*(tcp[:, :2] - foot).T)
        assert angles[axis] == pytest.approx(np.degrees(np.arccos(span / 0.600)), abs=1e-9)


def test_a_machine_without_struts_has_no_strut_angles() -> None:
    machine, tcp = load_setup("cartesian").actual, np.array([[0.1, 0.2, 0.0], [0.0, 0.1, 0.1]])
    assert strut_angles(machine, machine.inverse(tcp), tcp) == {}


def test_harmonics_of_a_known_deviation() -> None:
    arc = Arc(1, (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), 0.05, False, True, (0.0, 0.0, 0.0), math.tau)
    angle = np.linspace(0.0, math.tau, 20_000, endpoint=False)
    radius = 0.1 - 1e-6 * (5.0 + 3.0 * np.cos(3.0 * angle - 0.7) + 0.5 * np.cos(8.0 * angle + 1.0))
    found = harmonics(circle_path(arc, np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)))
    expected = np.zeros(13)
    expected[[0, 3, 8]] = 5.0, 3.0, 0.5
    assert found["amplitude_um"] == pytest.approx(expected, abs=1e-4)
    assert found["phase_deg"][[3, 8]] == pytest.approx(np.degrees([0.7, -1.0]), abs=0.01)
    panel = polar_panel(
        {"ccw": circle_path(arc, np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))}, ""
    )
    assert "magnified 5000:1" in panel.title
    drawn = np.hypot(panel.curves[1].x, panel.curves[1].y)
    assert drawn.min() == pytest.approx(100.0 - 5000.0 * 1e3 * (0.1 - radius.min()), abs=0.01)


def test_harmonics_and_iso_230_4_of_both_directions() -> None:
    circle = one()
    for direction in ("ccw", "cw"):
        report = circle[direction]
        spectrum = report["harmonics"]
        assert spectrum["amplitude_um"][0] == pytest.approx(report["radial_deviation_um"]["mean"], rel=1e-12)
        assert int(np.argmax(spectrum["amplitude_um"][1:])) + 1 == 3
        assert report["circularity_um"] == pytest.approx(2.0 * spectrum["amplitude_um"][3], rel=0.02)
    assert circle["pair"]["D_um"] == pytest.approx(-circle["ccw"]["radial_deviation_um"]["mean"], abs=0.01)


def test_every_centre_has_its_picture_and_definitions_are_printed() -> None:
    found = findings(center=(0.0, 0.0, 20.0, -10.0))
    polar = next(figure for figure in found.figures if figure.name == "circle-polar")
    assert len(polar.panels) == 2
    assert all(word in " ".join(found.remarks) for word in ("G(b)", "F_max", "circularity", "D, mean"))


def test_a_machine_in_x_only_is_refused() -> None:
    with pytest.raises(InputError, match="experiment circle"):
        findings("monopod")
