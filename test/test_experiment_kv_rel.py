"""The relative velocity gain of the Monopod against 4-16 and 4-17 as printed and against the law of linear drives."""

from __future__ import annotations

import functools

import mpmath
import numpy as np
import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Findings, Lab, load_experiment, simulated
from pkm_cnc.experiments._velocity_gain import closed_form

EXPERIMENT = load_experiment("kv-rel")
LENGTH, KV, PERIOD = 0.6, 50.0, 0.001


@functools.cache
def find(machine: str = "monopod", overrides: tuple[str, ...] = (), **options) -> Findings:
    few = {"feeds": (18000.0, 36000.0), "feed_forwards": (1.0,), "stations": (344.0,), "step_gains": (KV,)}
    return EXPERIMENT.run(Lab(machine, overrides, simulated), EXPERIMENT.options(**{**few, **options}))


@pytest.mark.parametrize("gamma", [0.0, 0.1, -0.3])
@pytest.mark.parametrize("delta", [0.02, -0.013, 1e-7])
def test_closed_form_is_that_of_the_thesis(gamma, delta):
    with mpmath.workdps(40):
        u_s, d = mpmath.mpf(0.41), mpmath.mpf(delta)
        length, sine, cosine = mpmath.mpf(LENGTH), mpmath.sin(gamma), mpmath.cos(gamma)
        root_s, root_a = (mpmath.sqrt(length**2 - u**2 * cosine**2) for u in (u_s, u_s - d))
        above = d * ((u_s - d) * cosine**2 + root_a * sine)
        expected = above / (root_a * (d * sine + root_a - root_s))
        if gamma == 0.0:
            root = mpmath.sqrt(length**2 - (u_s - d) ** 2)
            assert mpmath.almosteq(expected, d * (u_s - d) / (root * (root - mpmath.sqrt(length**2 - u_s**2))), 1e-30)
    assert float(closed_form(0.41, delta, LENGTH, gamma)) == pytest.approx(float(expected), rel=1e-14)


def test_closed_form_is_one_without_lag():
    assert float(closed_form(0.4, 0.0, LENGTH, 0.2)) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("overrides", [(), ("geometry.inclination=0.05", "geometry.slider_offset=0.001")])
def test_simulated_is_the_closed_form(overrides):
    for entry in find(overrides=overrides).data["passes"]:
        assert entry["simulated_less_closed_form_max_abs"] < 5e-5  # velocities by differences over two periods


def test_first_order_drives_follow_the_law():
    """Lag of the TCP v/Kv -+ kappa v^2 u''/u', and K_V-rel - 1 = +- Delta-x/2 u''/u' to the first order."""
    kappa = (1.0 - KV * PERIOD) / (2.0 * KV * KV)
    for entry in find(overrides=("drive.kind=first_order",), feeds=(6000.0, 18000.0)).data["passes"]:
        v, sign = entry["feed_mm_min"] / 60e3, 1.0 if entry["direction"] == "+x" else -1.0
        for place, x_mm in enumerate(entry["x_mm"]):
            x = 1e-3 * x_mm
            bend = 1.0 / x + x / (LENGTH**2 - x**2)  # u''/u' of u = sqrt(L^2 - x^2)
            lag = 1e-3 * entry["tracking_error_mm"][place]
            assert lag - v / KV == pytest.approx(-sign * kappa * v * v * bend, rel=0.05)
            assert entry["kv_rel_simulated"][place] - 1.0 == pytest.approx(0.5 * sign * lag * bend, rel=0.05)
            estimated = 1e-3 * entry["tracking_error_estimated_mm"][place]
            assert estimated - v / KV == pytest.approx(0.5 * sign * (v / KV) ** 2 * bend, rel=0.05)


def test_reversal_is_nearly_a_mirror_and_the_tcp_lags_more_in_minus_x():
    for entry in find().data["reversal"]:
        assert 1.0 < entry["mirror_error_percent"] < 5.0
        assert entry["tracking_error_higher_in_minus_x_everywhere"]
        plus, minus = (entry[f"tracking_error_estimated_mean_in_{side}_x_mm"] for side in ("plus", "minus"))
        assert plus > minus


def test_the_slider_is_slower_than_demanded_in_plus_x_and_faster_in_minus_x():
    forth, back = find().data["velocity"]
    assert forth["drive_slower_than_demanded_at_once_everywhere"]
    assert back["drive_faster_than_demanded_at_once_everywhere"]


def test_balanced_feed_forward_leaves_the_filters_delay():
    for entry in find().data["feed_forward"]:
        left = 1.0 if entry["velocity_feed_forward"] == 0.0 else (0.0005 + 0.00082) * KV
        assert entry["tracking_error_reduced_percent"] == pytest.approx(100.0 * (1.0 - left), abs=0.5)


def test_velocity_step_of_a_sampled_first_order_lag():
    (step,) = find(overrides=("drive.kind=first_order",)).data["velocity_steps"]
    assert step["rise_time_ms"] == pytest.approx(1e3 * np.log(9.0) / KV, rel=0.05)
    assert step["speed_at_end_mm_s"] == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("machine", "overrides", "options", "words"),
    [
        ("tripod", (), {}, "kv-rel: it is about the monopod"),
        ("monopod", (), {"begin": 300.0, "end": 350.0}, "a feed of 18000 mm/min is too fast between 300 and 350"),
        ("monopod", (), {"end": 610.0}, "begin and end: 610 mm: "),
        ("monopod", (), {"begin": 500.0, "end": 400.0}, "begin: 500 mm is not below end"),
        ("monopod", (), {"begin": 430.0}, "at 36000 mm/min the ways in"),
        ("monopod", ("geometry.tcp_side=left", "start_pose=[-0.3,0,0]", "geometry.start_x=-0.3"), {}, "TCP right"),
    ],
)
def test_what_cannot_be_answered_is_refused(machine, overrides, options, words):
    with pytest.raises(InputError, match=words):
        find(machine, overrides, **options)
