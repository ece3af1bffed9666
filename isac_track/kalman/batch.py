"""What the fronts of the compiled loops are called with: contiguous, finite, of the right shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.types import check_offsets, check_times

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

MAX_REJECTIONS = 3
"""After so many rejected samples in a row the next is accepted whatever it says: a gate may
drop outliers, it may not lose a track."""


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """N tracks of M noisy positions in all, and how little is known before the first of each.

    Raises
    ------
    ValueError
        If shapes disagree, a number is not finite, a track is empty, times do not increase, or a
        variance or standard deviation is not positive.
    """

    t: Floats
    """(M,) s, strictly increasing within a track."""
    xy: Floats
    """(M, 2) m"""
    variance: Floats
    """(M,) m^2, of the measurement, per axis."""
    offsets: Ints
    """(N + 1,) track i owns the samples ``offsets[i]:offsets[i + 1]``; none is empty."""
    prior_std: tuple[float, ...]
    """m around the first sample, m/s and, of acceleration, m/s^2 around rest, per axis and
    independent: the state at the time of that sample, which is then measured like any other."""

    def __post_init__(self) -> None:
        t, offsets = ragged_times(self.t, self.offsets)
        checked = {
            "t": t,
            "offsets": offsets,
            "xy": floats("xy", self.xy, (t.size, 2)),
            "variance": floats("variance", self.variance, t.shape),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not (self.variance > 0).all():
            raise ValueError("variance must be positive")
        for std in self.prior_std:
            positive("prior_std", std)

    def __len__(self) -> int:
        """Return the number of tracks."""
        return self.offsets.size - 1


def ragged_times(t: Floats, offsets: Ints) -> tuple[Floats, Ints]:
    """Return times and offsets as contiguous arrays, or raise ValueError."""
    offsets = np.ascontiguousarray(offsets)
    if offsets.ndim != 1 or offsets.dtype.kind not in "iu":
        raise ValueError("offsets must be a one-dimensional array of integers")
    offsets = offsets.astype(np.int64, copy=False)
    t = np.ascontiguousarray(t, dtype=np.float64)
    if t.ndim != 1:
        raise ValueError(f"t must have shape (M,), got {t.shape}")
    check_offsets(offsets, t.size)
    check_times(t, offsets)
    return t, offsets


def floats(name: str, value: Floats, shape: tuple[int, ...]) -> Floats:
    """Return a contiguous array of finite numbers of that shape, or raise ValueError."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return array


def positive(name: str, value: float, *, finite: bool = True) -> float:
    """Return a positive number, or raise ValueError."""
    if not value > 0 or (finite and not np.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)
