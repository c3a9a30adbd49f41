"""Networks: they learn a known map, keep to their training band, survive the disk, and know nothing of threads."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from pkm_cnc.errors import InputError
from pkm_cnc.identification import Network, train

PLACES = np.linspace(0.0, 1.0, 12)


def curves(a, b):
    """What is measured of the parameters a and b: a curve, mildly nonlinear in them."""
    return np.sin(np.outer(a, PLACES)) + 0.3 * np.outer(b, PLACES**2)


def taught(seed: int = 1) -> Network:
    generator = np.random.default_rng(5)
    a, b = generator.uniform(-0.5, 0.5, (2, 300))
    return train("ab", curves(a, b), {"a": a, "b": b}, trained_on={"a": "-0.5 to 0.5"}, seed=seed)


@pytest.fixture(scope="module")
def network() -> Network:
    return taught()


def test_it_recovers_what_made_the_curves(network):
    a, b = np.random.default_rng(6).uniform(-0.4, 0.4, (2, 100))
    np.testing.assert_allclose(network.estimate(curves(a, b)), np.stack((a, b), axis=1), atol=5e-3)


def test_equal_seeds_make_equal_networks_whatever_the_threads(network):
    with threadpool_limits(2):
        again = taught()
    assert all(np.array_equal(getattr(network, key), getattr(again, key)) for key in vars(network))
    assert not np.array_equal(network.hidden, taught(seed=2).hidden)


def test_a_saved_network_is_the_same_to_the_last_bit(network, tmp_path):
    network.save(tmp_path / "n.json")
    loaded = Network.load(tmp_path / "n.json")
    vectors = curves([0.1, -0.3], [0.2, 0.4])
    assert np.array_equal(loaded.estimate(vectors), network.estimate(vectors))
    assert loaded.trained_on == {"a": "-0.5 to 0.5"}
    assert loaded.outputs == ("a", "b")


def test_a_damaged_network_is_refused(network, tmp_path):
    network.save(tmp_path / "n.json")
    (tmp_path / "n.json").write_text((tmp_path / "n.json").read_text().replace('"center": [', '"center": ["a", '))
    with pytest.raises(InputError, match="damaged"):
        Network.load(tmp_path / "n.json")


@pytest.mark.parametrize(("content", "words"), [("{}", "not a network"), ("#", "not the JSON"), (None, "No such file")])
def test_what_is_no_network_is_refused(tmp_path, content, words):
    if content is not None:
        (tmp_path / "n.json").write_text(content)
    with pytest.raises(InputError, match=words):
        Network.load(tmp_path / "n.json")


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        (curves([1.0], [0.0])[0], "vector 0 is outside the training band.*trained on a -0.5 to 0.5"),
        (curves([0.1], [0.1])[0] + 0.05 * np.cos(20.0 * PLACES), "outside the training band|shape that no training"),
        (np.full(12, np.nan), "vector 0 holds what is no finite number"),
        (np.zeros(11), "11 inputs given, 12 trained"),
    ],
)
def test_what_is_unlike_the_training_is_refused(network, vector, words):
    with pytest.raises(InputError, match=words):
        network.estimate(vector)


def test_the_shape_counts_even_where_every_component_is_within_its_band():
    a = np.random.default_rng(5).uniform(-0.5, 0.5, 300)
    line = train("a", np.outer(a, PLACES), {"a": a}, trained_on={}, seed=1)
    across = np.where(PLACES > 0.5, 1.0, -PLACES[PLACES > 0.5].sum() / PLACES[PLACES <= 0.5].sum())
    across -= PLACES * (across @ PLACES) / (PLACES @ PLACES)
    with pytest.raises(InputError, match="a shape that no training vector has"):
        line.estimate(0.01 * across)


def test_noise_of_the_measurement_is_not_taken_for_a_sign_of_a_parameter():
    generator = np.random.default_rng(7)
    a = generator.uniform(-0.5, 0.5, 300)
    vectors = curves(a, 0.0 * a) + generator.normal(0.0, 0.01, (300, len(PLACES)))
    assert train("a", vectors, {"a": a}, trained_on={}, seed=1, noise=0.01).components.shape[1] == 1


def test_training_vectors_must_be_numbers_and_vary():
    with pytest.raises(InputError, match="do not vary"):
        train("n", np.ones((10, 3)), {"a": np.arange(10.0)}, trained_on={}, seed=1)
    with pytest.raises(InputError, match="no finite number"):
        train("n", np.full((10, 3), np.nan), {"a": np.arange(10.0)}, trained_on={}, seed=1)
