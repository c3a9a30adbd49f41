"""Small neural networks that estimate parameters from what was measured: trained, saved, fed within their band.

The fitting is scikit-learn's MLPRegressor (one hidden layer of tanh, L-BFGS). Round it stands what an estimate needs:
inputs are projected on the principal components of the training vectors and scaled, so neighbouring measurements that
say the same count once; the result does not depend on the number of threads; and a vector unlike those of the training
is refused, because a network answers anything, and outside of its training with nonsense.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from pkm_cnc.errors import InputError

__all__ = ["Network", "train"]

Array = NDArray[np.float64]

HIDDEN = 10
"""Neurons of the hidden layer: what 300 vectors of three parameters can still determine."""
ITERATIONS = 500
"""Longest training, iterations of L-BFGS."""
TOLERANCE = 1e-9
"""1. Training ends when an iteration gains less, of a loss in units of the outputs' variance."""
ROUNDING = 1e-7
"""1. Principal components below this share of the largest are rounding."""
NOISE = 1.1
"""1. Principal components below this many times the largest that noise alone would show are noise. Of n vectors of p
inputs that is 1 + sqrt(p/n) standard deviations of the noise (Marchenko, Pastur 1967)."""
FOREIGN = 3.0
"""1. How much further than any training vector an input may be from the space of the components."""


@dataclass(frozen=True)
class Network:
    """A trained network: p inputs -> k scaled principal components -> h neurons (tanh) -> q outputs.

    `name` is what errors call it; `outputs` (q) the names of what it estimates; `trained_on` says in words or numbers,
    for the reader, what it was trained on. What it computes is in `estimate`; `low` and `high` (k,) bound the training
    vectors' components, `off` is the training's largest distance from their space.
    """

    name: str
    outputs: tuple[str, ...]
    trained_on: dict[str, Any]
    center: Array
    """(p,) mean of the training vectors."""
    components: Array
    """(p, k) principal components, each divided by its standard deviation in training."""
    low: Array
    high: Array
    off: float
    hidden: Array
    """(k, h) weights of the hidden layer."""
    hidden_bias: Array
    last: Array
    """(h, q) weights of the output layer, in the outputs' units."""
    last_bias: Array

    def estimate(self, inputs: ArrayLike) -> Array:
        """Outputs (n, q) of the measured vectors `inputs` (n, p), in the units of training.

        Raises InputError naming row and band for a vector outside of what the network was trained on.
        """
        vectors = np.atleast_2d(np.asarray(inputs, dtype=float))
        if vectors.shape[1] != len(self.center):
            raise InputError(f"{self._called()}: {vectors.shape[1]} inputs given, {len(self.center)} trained")
        with threadpool_limits(1):
            scaled = self._scaled(vectors)
            return np.asarray(np.tanh(scaled @ self.hidden + self.hidden_bias) @ self.last + self.last_bias)

    def _scaled(self, vectors: Array) -> Array:
        if not np.isfinite(vectors).all():
            row = int(np.flatnonzero(~np.isfinite(vectors).all(axis=1))[0])
            raise InputError(f"{self._called()}: vector {row} holds what is no finite number")
        scaled = (vectors - self.center) @ self.components
        outside = (scaled < self.low) | (scaled > self.high)
        if outside.any():
            row, component = (int(place) for place in np.argwhere(outside)[0])
            raise InputError(
                f"{self._called()}: vector {row} is outside the training band: component {component + 1} is "
                f"{scaled[row, component]:.3g}, trained on {self.low[component]:.3g} to {self.high[component]:.3g}; "
                f"widen the band of training ({self._training()})"
            )
        distance = _distance(vectors - self.center, scaled, self.components)
        if (distance > self.off).any():
            row = int(np.argmax(distance))
            raise InputError(
                f"{self._called()}: vector {row} has a shape that no training vector has: {distance[row]:.3g} off "
                f"their space, {self.off:.3g} allowed; what was measured is not what was trained ({self._training()})"
            )
        return np.asarray(scaled)

    def _called(self) -> str:
        return f"network {self.name}"

    def _training(self) -> str:
        return "trained on " + ", ".join(f"{key} {value}" for key, value in self.trained_on.items())

    def save(self, path: Path | str) -> None:
        """Write the network, with what it was trained on, as JSON. Raises InputError if it cannot be written."""
        content = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(self).items()}
        try:
            Path(path).write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"network {path} cannot be written: {error.strerror}") from None

    @classmethod
    def load(cls, path: Path | str) -> Network:
        """The network that `save` wrote, equal to the last bit. Raises InputError for what is no such file."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"network {path} cannot be read: {error.strerror}") from None
        except ValueError:
            raise InputError(f"network {path}: not the JSON of a network") from None
        names = {field.name for field in dataclasses.fields(cls)}
        if not isinstance(content, dict) or set(content) != names:
            raise InputError(f"network {path}: not a network; its keys must be {', '.join(sorted(names))}")
        try:
            arrays = names - {"name", "outputs", "trained_on", "off"}
            content |= {key: np.array(content[key], dtype=float) for key in arrays}
            return cls(**{**content, "outputs": tuple(content["outputs"]), "off": float(content["off"])})
        except (TypeError, ValueError):
            raise InputError(f"network {path}: damaged: a weight is no number") from None


def train(
    name: str,
    inputs: ArrayLike,
    outputs: dict[str, ArrayLike],
    *,
    trained_on: dict[str, Any],
    seed: int,
    noise: float = 0.0,
    hidden: int = HIDDEN,
) -> Network:
    """Train on the vectors `inputs` (n, p) and what they came from: `outputs`, name -> values (n,).

    `noise` is the standard deviation of one measured input, in its unit: components that vary less are left out (the
    training vectors should carry it too). `seed` draws the first weights; equal arguments give an equal network.
    Raises InputError for vectors that are not finite or do not vary.
    """
    vectors = np.asarray(inputs, dtype=float)
    targets = np.stack([np.asarray(values, dtype=float) for values in outputs.values()], axis=1)
    if not (np.isfinite(vectors).all() and np.isfinite(targets).all()):
        raise InputError(f"network {name}: a training vector holds what is no finite number")
    with threadpool_limits(1):
        center, middle, spread = vectors.mean(axis=0), targets.mean(axis=0), targets.std(axis=0)
        components = _components(vectors - center, noise)
        if not (components.shape[1] and (spread > 0.0).all()):
            raise InputError(f"network {name}: the training vectors do not vary")
        scaled = (vectors - center) @ components
        regressor = MLPRegressor(
            hidden_layer_sizes=(hidden,),
            activation="tanh",
            solver="lbfgs",
            alpha=0.0,
            max_iter=ITERATIONS,
            max_fun=10 * ITERATIONS,
            tol=TOLERANCE,
            random_state=seed,
        )
        wanted = (targets - middle) / spread
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # ITERATIONS are meant as an end
            regressor.fit(scaled, wanted if len(outputs) > 1 else wanted[:, 0])  # a single column is refused
        distance = _distance(vectors - center, scaled, components)
    return Network(
        name=name,
        outputs=tuple(outputs),
        trained_on=dict(trained_on),
        center=center,
        components=components,
        low=scaled.min(axis=0),
        high=scaled.max(axis=0),
        off=FOREIGN * max(float(distance.max()), ROUNDING * float(np.sqrt((vectors - center).var(axis=0).sum()))),
        hidden=np.ascontiguousarray(regressor.coefs_[0]),
        hidden_bias=regressor.intercepts_[0],
        last=np.ascontiguousarray(regressor.coefs_[1] * spread),
        last_bias=regressor.intercepts_[1] * spread + middle,
    )


def _components(centered: Array, noise: float) -> Array:
    """Principal components (p, k) of vectors (n, p), scaled to unit variance: those above noise and rounding."""
    _, singular, directions = np.linalg.svd(centered, full_matrices=False)
    deviations = singular / np.sqrt(len(centered))
    edge = noise * (1.0 + np.sqrt(centered.shape[1] / len(centered)))
    kept = deviations > max(NOISE * edge, ROUNDING * deviations[0])
    return np.ascontiguousarray((directions[kept] / deviations[kept, None]).T)


def _distance(centered: Array, scaled: Array, components: Array) -> Array:
    """How far vectors (n, p) are from the space of the components, (n,)."""
    lengths = np.square(components).sum(axis=0)
    return np.asarray(np.linalg.norm(centered - scaled @ (components / lengths).T, axis=1))
