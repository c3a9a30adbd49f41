"""Largest velocity gains of the Monopod against sampled loops that are solved by hand."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy import optimize, signal

from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.experiments import Lab, load_experiment, simulated
from pkm_cnc.experiments._axis import follow, steady_lag
from pkm_cnc.experiments.kv_max import stability_limit, tcp_overshoot, tcp_vibration, with_gain
from pkm_cnc.servo import position_loop

EXPERIMENT = load_experiment("kv-max")
T = 0.001
FIRST_ORDER = load_setup("monopod", ["drive.kind=first_order"])
CASCADE = load_setup("monopod")


def gear_ratio(x: float) -> float:
    return x / math.sqrt(0.36 - x * x)


def test_a_sampled_lag_is_followed_to_the_bit_of_its_recursion():
    setpoint, ripple = 1e-3 * np.sin(np.arange(50.0)), 1e-4 * np.cos(np.arange(50.0))
    response = follow(with_gain(FIRST_ORDER, 80.0), "u", setpoint, ripple=ripple)
    position = 0.0
    for k in range(50):
        assert response.position[k] == pytest.approx(position, abs=1e-18)
        position += 80.0 * T * (setpoint[k] - position - ripple[k])


def test_lag_of_a_sampled_first_order_loop():
    lag = steady_lag(with_gain(FIRST_ORDER, 25.0), "u")
    assert lag.mean == pytest.approx(1.0 / 25.0, rel=1e-9)
    assert lag.kappa == pytest.approx((1.0 - 25.0 * T) / (2.0 * 25.0**2), rel=1e-6)


def test_stability_limit_of_a_sampled_integrator():
    assert stability_limit(FIRST_ORDER, "u") == pytest.approx(2.0 / T, rel=1e-4)


def test_stability_limit_of_the_cascade_is_where_a_pole_leaves_the_unit_circle():
    numerator, denominator = position_loop(CASCADE.axes["u"].drive)
    opened = np.polysub(denominator, numerator)  # closed loop = K N / (D + K N)
    b, a, _ = signal.cont2discrete((np.array(numerator) / CASCADE.axes["u"].drive.kv, opened), T)

    def radius(kv: float) -> float:
        roots = np.roots(np.polyadd(a, kv * b[0]))
        return (
            float(np.abs(roots[np.abs(roots - 1.0) > 1e-3]).max()) - 1.0
        )  # without the slow poles, stable at any gain

    assert stability_limit(CASCADE, "u") == pytest.approx(optimize.brentq(radius, 600.0, 2000.0), rel=1e-4)


@pytest.mark.parametrize("x", [0.344, 0.52])
@pytest.mark.parametrize("kv", [40.0, 120.0])
def test_vibration_is_the_followed_ripple_over_the_gear_ratio(x, kv):
    frequency = 35.0
    gain = kv * T / abs(cmath.exp(1j * math.tau * frequency * T) - 1.0 + kv * T)
    measured = tcp_vibration(with_gain(FIRST_ORDER, kv), FIRST_ORDER.kinematics, x, 1e-6, frequency)
    assert measured == pytest.approx(1e-6 * gain / gear_ratio(x), rel=1e-3)


def test_overshoot_of_a_sampled_integrator_with_too_much_gain():
    """Velocity steps to v (1 - (1 - Kv T)^k): 50 % over for Kv T = 1.5."""
    assert tcp_overshoot(with_gain(FIRST_ORDER, 1500.0), FIRST_ORDER.kinematics, 0.4, 0.1) == pytest.approx(
        0.5, abs=2e-3
    )
    assert tcp_overshoot(with_gain(FIRST_ORDER, 50.0), FIRST_ORDER.kinematics, 0.4, 0.1) < 1e-3


def test_the_gains_found_keep_the_bounds():
    options = EXPERIMENT.options(positions=(344.0, 520.0))
    data = EXPERIMENT.run(Lab("monopod", ["drive.kind=first_order"], simulated), options).data
    gains = []
    for entry in data["positions"]:
        kv = entry["kv_max_vibration_per_s"]
        followed = kv * T / abs(cmath.exp(1j * math.tau * options.frequency * T) - 1.0 + kv * T)
        assert options.amplitude * followed / gear_ratio(1e-3 * entry["x_mm"]) == pytest.approx(
            options.vibration, rel=1e-3
        )
        assert entry["kv_max_overshoot_per_s"] == pytest.approx(1.05 / T, rel=2e-3)  # 1 - (1 - Kv T) = 1.05
        gains.append(kv)
    assert data["ratio_end_to_start_vibration"] == pytest.approx(gains[1] / gains[0])
    assert data["drive_stability_limit_per_s"] == pytest.approx(2.0 / T, rel=1e-4)
    assert data["drive_overshoot_kv_per_s"] == pytest.approx(1.05 / T, rel=1e-4)


def test_a_bound_that_no_gain_reaches_is_limited_by_stability():
    options = EXPERIMENT.options(positions=(400.0,), vibration=1e3)
    (entry,) = EXPERIMENT.run(Lab("monopod", ["drive.kind=first_order"], simulated), options).data["positions"]
    assert entry["vibration_limited_by_stability"]
    assert not entry["overshoot_limited_by_stability"]
    assert entry["kv_max_vibration_per_s"] == pytest.approx(2.0 / T, rel=1e-4)


@pytest.mark.parametrize(
    ("machine", "options", "words"),
    [
        ("tripod", {}, "kv-max: it is about the monopod"),
        ("monopod", {"positions": (590.0,)}, "positions, with the way of the step: 610 mm"),
        ("monopod", {"frequency": 500.0}, "frequency: 500 Hz is not below half the servo rate, 500 Hz"),
        ("monopod", {"positions": (400.0,), "vibration": 1e-4}, "vibration: 0.0001 um .* even with the gain 1 1/s"),
    ],
)
def test_what_cannot_be_answered_is_refused(machine, options, words):
    with pytest.raises(InputError, match=words):
        EXPERIMENT.run(Lab(machine, [], simulated), EXPERIMENT.options(**options))
