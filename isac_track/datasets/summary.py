"""Statistics of tracks: how long, how fast, and how much of them stands still."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.datasets.rows import steps_within

if TYPE_CHECKING:
    from isac_track.types import Bools, Floats, Ints, Tracks

SLOW_MPS = 0.2
"""Slower steps than this are not walking."""
FROZEN_SHARE = 0.9
"""A track with at least this share of exactly-zero steps is nearly frozen: an annotation
that was left standing rather than a person, whose last position tells the whole walk."""
LONG_S = (12.0, 21.6)
"""Durations of interest: 21.6 s are the tracks that scenes are made of."""
_CLOCK_S = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class Summary:
    """Statistics per track of N tracks; a step is from one sample to the next."""

    samples: Ints
    """(N,)"""
    duration_s: Floats
    """(N,)"""
    speed_mean_mps: Floats
    """(N,) mean over time: length of the path over duration; NaN for a single sample."""
    speed_sd_mps: Floats
    """(N,) standard deviation over time of the step speed; NaN for a single sample."""
    slow_share: Floats
    """(N,) share of steps slower than `SLOW_MPS`; NaN for a single sample."""
    still_share: Floats
    """(N,) share of steps of exactly no length; NaN for a single sample."""
    n_groups: int
    """Clusters: people who walk together are one."""

    def __len__(self) -> int:
        return self.samples.size

    @property
    def frozen(self) -> Bools:
        """(N,) True for nearly frozen tracks: `still_share` is at least `FROZEN_SHARE`."""
        return self.still_share >= FROZEN_SHARE

    @property
    def total_still_share(self) -> float:
        """Share of exactly-zero steps among all steps; NaN without steps."""
        steps = self.samples - 1
        if not steps.any():
            return float("nan")
        return float(np.nansum(self.still_share * steps) / steps.sum())

    def n_lasting(self, duration_s: float) -> int:
        """Return how many tracks last at least this long."""
        # The clock rounds: 21.6 s at 25 frames a second is 540 frames.
        return int((self.duration_s >= duration_s - _CLOCK_S).sum())


def summarise(tracks: Tracks) -> Summary:
    """Return the statistics of every track."""
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    n_steps = np.maximum(last - first, 0)
    owner = np.repeat(np.arange(len(tracks)), n_steps)
    within = steps_within(tracks.offsets)
    length = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1)[within]
    lasting = np.diff(tracks.t)[within]
    speed = length / lasting

    def per_track(values: Floats | Bools) -> Floats:
        return np.bincount(owner, weights=values, minlength=len(tracks)).astype(np.float64)

    duration = tracks.t[last] - tracks.t[first]
    with np.errstate(invalid="ignore"):  # 0 / 0 of a single sample is NaN, as promised
        mean = per_track(length) / duration
        spread = (speed - mean[owner]) ** 2 * lasting
        deviation = np.sqrt(per_track(spread) / duration)
        slow = per_track(speed < SLOW_MPS) / n_steps
        still = per_track(length == 0) / n_steps
    return Summary(
        samples=n_steps + 1,
        duration_s=duration,
        speed_mean_mps=mean,
        speed_sd_mps=deviation,
        slow_share=slow,
        still_share=still,
        n_groups=len(set(tracks.group)),
    )
