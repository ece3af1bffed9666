"""What the fronts of the compiled loops are called with: contiguous, finite, of the right shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isac_track.types import Floats, Ints, check_offsets, within

MAX_REJECTIONS = 3
"""After so many rejected samples in a row the next is accepted whatever it says: a gate may
drop outliers, it may not lose a track."""


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """N tracks of M noisy positions in all, and how little is known before the first of each.

    That times increase and positions are finite is checked by the release that they come from.

    Raises
    ------
    ValueError
        If shapes disagree, a track is empty, or a variance or standard deviation is not positive.
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
        offsets = np.ascontiguousarray(self.offsets, dtype=np.int64)
        object.__setattr__(self, "offsets", offsets)
        check_offsets(offsets, len(self.t))
        for name, shape in (("t", ()), ("xy", (2,)), ("variance", ())):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != (len(self.t), *shape):
                raise ValueError(f"{name} must have shape {(len(self.t), *shape)}")
            object.__setattr__(self, name, array)
        if not within(self.variance, np.nextafter(0.0, 1.0), np.finfo(np.float64).max):
            raise ValueError("variance must be positive and finite")
        for std in self.prior_std:
            positive("prior_std", std)

    def __len__(self) -> int:
        """Return the number of tracks."""
        return self.offsets.size - 1

    def arrays(self, *n_states: int) -> tuple[Floats, Floats, Floats, Ints, Floats]:
        """Return what a compiled loop of that many states per axis takes, or raise ValueError."""
        if len(self.prior_std) not in n_states:
            numbers = " or ".join("two" if n == 2 else "three" for n in n_states)  # noqa: PLR2004
            raise ValueError(f"prior_std must have {numbers} numbers, got {len(self.prior_std)}")
        return self.t, self.xy, self.variance, self.offsets, np.square(self.prior_std)


def positive(name: str, value: float, *, finite: bool = True) -> float:
    """Return a positive number, or raise ValueError."""
    if not value > 0 or (finite and not np.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)
