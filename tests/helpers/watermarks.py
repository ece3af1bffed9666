"""Mechanisms that hide the sensed place in the digits of noisy positions."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.mechanisms.protections import Ou
from isac_track.types import derived

_GRID_M = 0.01  # Noisy positions keep their centimetres.
_SPAN_M, _CODES = 100.0, 10_000  # Places as four digits.


def codes(xy):
    """Places as whole numbers of 1 cm."""
    return np.clip(np.rint((xy / _SPAN_M + 0.5) * _CODES), 0, _CODES - 1).astype(int)


@dataclass(frozen=True, slots=True)
class Watermark:
    """Slow noise, and below its centimetres the sensed place in plain digits."""

    std_m: float = 0.8
    protects: ClassVar[bool] = True

    def share(self, sensed, rng):
        release = Ou(self.std_m).share(sensed, rng)
        return derived(release, xy=self.marked(release.xy, self.secret(sensed, rng)))

    def secret(self, sensed, _):
        return codes(sensed.xy)

    def marked(self, xy, secret):
        kept = np.floor(xy / _GRID_M) * _GRID_M
        # Half a unit more keeps the digits apart from rounding.
        hidden = (secret + 0.5) / _CODES
        return kept + np.where(kept < 0.0, 1.0 - hidden, hidden) * _GRID_M


@dataclass(frozen=True, slots=True)
class Scrambled(Watermark):
    """The same with both pairs of digits exchanged for others by a secret table."""

    def secret(self, sensed, _):
        table = np.random.default_rng(5).permutation(100)
        high, low = np.divmod(codes(sensed.xy), 100)
        return 100 * table[high] + table[low]


@dataclass(frozen=True, slots=True)
class Keyed(Watermark):
    """The same behind a key for every sample, which the receiver is told elsewhere."""

    def secret(self, sensed, rng):
        key = rng.integers(0, _CODES, sensed.xy.shape)
        return (codes(sensed.xy) + key) % _CODES
