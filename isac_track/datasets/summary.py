"""Statistics of tracks: how long, how fast, and how much of them stands still."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.datasets.recording import steps_within

if TYPE_CHECKING:
    from pandas import DataFrame

    from isac_track.types import Bools, Floats, Tracks

SLOW_MPS = 0.2
"""Slower steps than this are not walking."""
FROZEN_SHARE = 0.9
"""A track with at least this share of exactly-zero steps is nearly frozen: an annotation
that was left standing rather than a person, whose last position tells the whole walk."""
_CLOCK_S = 1e-9


def summarise(tracks: Tracks) -> DataFrame:
    """Return the statistics of every track; a step is from one sample to the next.

    Returns
    -------
    DataFrame
        N rows of `steps`, their number; `duration_s`; `speed_mean_mps`, the length of the path
        over the duration; `speed_sd_mps`, the standard deviation over time of the step speed;
        `slow_share` and `still_share`, the shares of steps slower than `SLOW_MPS` and of exactly
        no length (all four NaN for a single sample); and `frozen`, nearly frozen tracks.
    """
    import pandas as pd  # noqa: PLC0415 - `--help` stays quick

    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    steps = last - first
    owner = np.repeat(np.arange(len(tracks)), steps)
    within = steps_within(tracks.offsets)
    length = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1)[within]
    lasting = np.diff(tracks.t)[within]
    speed = length / lasting

    def per_track(values: Floats | Bools) -> Floats:
        return np.bincount(owner, weights=values, minlength=len(tracks)).astype(np.float64)

    duration = tracks.t[last] - tracks.t[first]
    with np.errstate(invalid="ignore"):  # 0 / 0 of a single sample is NaN, as promised
        mean = per_track(length) / duration
        summary = {
            "steps": steps,
            "duration_s": duration,
            "speed_mean_mps": mean,
            "speed_sd_mps": np.sqrt(per_track((speed - mean[owner]) ** 2 * lasting) / duration),
            "slow_share": per_track(speed < SLOW_MPS) / steps,
            "still_share": per_track(length == 0) / steps,
        }
    return pd.DataFrame(summary | {"frozen": summary["still_share"] >= FROZEN_SHARE})


def still_share(summary: DataFrame) -> float:
    """Return the share of exactly-zero steps among all steps; NaN without steps."""
    n_steps = summary["steps"].sum()
    return float((summary["still_share"] * summary["steps"]).sum() / n_steps) if n_steps else np.nan


def n_lasting(summary: DataFrame, duration_s: float) -> int:
    """Return how many tracks last at least this long."""
    # The clock rounds: 21.6 s at 25 frames a second is 540 frames.
    return int((summary["duration_s"] >= duration_s - _CLOCK_S).sum())
