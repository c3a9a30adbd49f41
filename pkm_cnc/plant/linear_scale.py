"""The linear scale: resolution and noise."""

from __future__ import annotations

import math
import zlib
from statistics import NormalDist

from pkm_cnc.plant.plant_parameters import ScaleParameters

__all__ = ["LinearScale"]

_MASK = (1 << 64) - 1
_STANDARD = NormalDist()


class LinearScale:
    """Reads the slider of one axis, which its noise depends on by name, cycle by cycle."""

    def __init__(self, parameters: ScaleParameters, axis: str) -> None:
        self._resolution = parameters.resolution
        self._noise = parameters.noise
        self._key = _mixed(parameters.seed << 32 | zlib.crc32(axis.encode()))
        self._cycle = 0

    def read(self, position: float) -> float:
        """The reading of the next cycle with the slider at `position`, m.

        The nearest multiple of the resolution, of two equally near ones the upper.
        """
        if self._noise > 0.0:
            position += self._noise * normal(self._key, self._cycle)
            self._cycle += 1
        if self._resolution == 0.0:
            return position
        return math.floor(position / self._resolution + 0.5) * self._resolution


def normal(key: int, counter: int) -> float:
    """A standard normal number that depends on `key` and `counter` alone, not on what was asked for before."""
    bits = _mixed(key + counter * 0x9E3779B97F4A7C15)
    return _STANDARD.inv_cdf(((bits >> 11) + 0.5) * 2.0**-53)


def _mixed(number: int) -> int:
    """The finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014): neighbours become as good as independent."""
    number &= _MASK
    number = (number ^ number >> 30) * 0xBF58476D1CE4E5B9 & _MASK
    number = (number ^ number >> 27) * 0x94D049BB133111EB & _MASK
    return number ^ number >> 31
