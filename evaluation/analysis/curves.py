"""Misses against false alarms: the whole curve of a predictor, beside the paper's one point.

A robot may act on the predicted separation (a conflict below d) or on the probability of a
conflict (above p). Either score gives a curve over its threshold. Thresholds are at most
`N_BINS` quantiles of the score over all scenes, and counts per cluster and bin are all that the
bootstrap needs, so that its cost does not grow with the scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Bools, Floats, Ints

N_BINS = 100


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """Rates over K thresholds, strictest first; row 0 is the estimate, the others replicates."""

    missed: Floats
    """(1 + B, K) missed-conflict rate, from 1 down to 0"""
    false_alarm: Floats
    """(1 + B, K) false-alarm rate, from 0 up to 1"""

    def areas(self) -> Floats:
        """Return the area under missed over false-alarm rate, (1 + B,): 0 perfect, 0.5 chance."""
        width = np.diff(self.false_alarm, axis=1)
        area: Floats = (width * 0.5 * (self.missed[:, 1:] + self.missed[:, :-1])).sum(axis=1)
        return area

    def missed_at(self, false_alarm: Floats) -> Floats:
        """Return the missed rate at a false-alarm rate of each row, (1 + B,), interpolated.

        Where a threshold jumps over several scenes the robot may draw lots between its two
        sides: linear interpolation is what it can reach.
        """
        rows = np.arange(self.missed.shape[0])
        # Of several thresholds with this very rate the most sensitive one.
        right = (self.false_alarm <= false_alarm[:, None]).sum(axis=1)
        right = np.clip(right, 1, self.missed.shape[1] - 1)
        low, high = self.false_alarm[rows, right - 1], self.false_alarm[rows, right]
        share = np.zeros_like(low)
        np.divide(false_alarm - low, high - low, out=share, where=high > low)
        left = self.missed[rows, right - 1]
        reached: Floats = left + share * (self.missed[rows, right] - left)
        return reached


def curve(*, score: Floats, conflict: Bools, cluster: Ints, weights: Floats) -> Curve | None:
    """Return the curve of a score with its bootstrap replicates; None without both labels.

    Parameters
    ----------
    score : (S,)
        Higher means that a conflict is likelier.
    conflict : (S,) bool
    cluster : (S,) int
        Row of the scene's cluster in `weights`.
    weights : (B, C)
        From `intervals.cluster_weights`.

    Raises
    ------
    ValueError
        If a score is NaN.
    """
    if np.isnan(score).any():
        raise ValueError("a score is NaN")
    if conflict.all() or not conflict.any():
        return None
    distinct = np.unique(score)
    if distinct.size > N_BINS:
        distinct = np.unique(np.quantile(score, np.linspace(0, 1, N_BINS), method="lower"))
    # Bin 0 holds the highest scores; a scene counts as soon as the threshold reaches its bin.
    bins = distinct.size - np.searchsorted(distinct, score, side="right")
    n_clusters = weights.shape[1]
    counts = np.zeros((2, n_clusters, distinct.size))
    np.add.at(counts, (conflict.astype(int), cluster, bins), 1.0)
    everyone = np.concatenate([np.ones((1, n_clusters)), weights])
    alarms, hits = (np.cumsum(everyone @ part, axis=1) for part in counts)
    start = np.zeros((everyone.shape[0], 1))
    with np.errstate(invalid="ignore"):  # a replicate without a label has no rate: NaN
        missed = 1.0 - np.concatenate([start, hits / hits[:, -1:]], axis=1)
        false_alarm = np.concatenate([start, alarms / alarms[:, -1:]], axis=1)
    return Curve(missed=missed, false_alarm=false_alarm)
