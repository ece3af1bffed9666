"""Intervals: Wilson for a count, and the bootstrap over clusters (people) for everything else."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from isac_track.rng import stream

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """A number with its interval, and the replicates that paired comparisons need."""

    value: float
    ci_low: float = np.nan
    ci_high: float = np.nan
    n: int = 0
    """Clusters that contribute."""
    replicates: Floats = field(default_factory=lambda: np.zeros(0))
    """(B,) bootstrap replicates; the same row of weights in every estimate of a run."""
    closed_error: float | None = None
    """Standard error where it has a closed form."""

    @property
    def standard_error(self) -> float:
        """Of the closed form, or of the replicates that are known; NaN without two."""
        if self.closed_error is not None:
            return self.closed_error
        drawn = self.replicates[np.isfinite(self.replicates)]
        return float(drawn.std(ddof=1)) if drawn.size > 1 else np.nan


def estimate_of(values: Floats, *, n: int) -> Estimate:
    """Return the estimate that a number and its replicates, (1 + B,), of `n` clusters make.

    Replicates that are not finite are left out of the interval.
    """
    drawn = values[1:]
    return Estimate(float(values[0]), *percentile_interval(drawn[np.isfinite(drawn)]), n, drawn)


def difference(a: Estimate, b: Estimate) -> Estimate:
    """Return a - b, paired: both have their replicates from the same rows of weights."""
    n_drawn = min(a.replicates.size, b.replicates.size)
    drawn = a.replicates[:n_drawn] - b.replicates[:n_drawn]
    return Estimate(a.value - b.value, *percentile_interval(drawn), min(a.n, b.n), drawn)


def wilson(*, hits: float, n: float) -> tuple[float, float]:
    """Return the Wilson score interval of a share (Wilson, JASA 1927).

    ValueError unless ``0 <= hits <= n`` and n is positive.
    """
    if not (n > 0 and 0 <= hits <= n):
        raise ValueError(f"a share needs 0 <= hits <= n and n > 0, got {hits} of {n}")
    z2 = ndtri(0.5 + CONFIDENCE / 2) ** 2
    share = hits / n
    centre = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = np.sqrt(share * (1 - share) * z2 / n + (z2 / (2 * n)) ** 2) / (1 + z2 / n)
    # The ends are exact at 0 and 1, where rounding would leave them a hair inside.
    low = 0.0 if hits == 0 else float(centre - half)
    high = 1.0 if hits == n else float(centre + half)
    return low, high


def cluster_weights(*, n_clusters: int, n_replicates: int, seed: int) -> Floats:
    """Return how often each cluster is drawn in each bootstrap replicate, (B, C).

    One matrix serves every metric and mechanism of a run, so that all comparisons are paired.
    """
    rng = stream(seed, "bootstrap")
    counts = rng.multinomial(n_clusters, np.full(n_clusters, 1.0 / n_clusters), n_replicates)
    return counts.astype(np.float64)


def cluster_sums(*, values: Floats, cluster: Ints, n_clusters: int) -> Floats:
    """Return the sum of `values`, (R,), within each cluster, (C,)."""
    sums: Floats = np.bincount(cluster, weights=values, minlength=n_clusters).astype(np.float64)
    return sums


def ratio_estimate(
    *, numerator: Floats, denominator: Floats, weights: Floats, is_share: bool = False
) -> Estimate:
    """Return sum(numerator) / sum(denominator) with its clustered percentile interval.

    Whole clusters are drawn with replacement (Davison and Hinkley, 1997, ch. 3.8). A share
    of exactly 0 or 1 has no spread to resample; its interval is Wilson's with the clusters
    as the sample size. With fewer than two clusters there is no interval (NaN).

    Parameters
    ----------
    numerator, denominator : (C,)
        Sums within each cluster: hits and trials, or a sum and a count.
    weights : (B, C)
        From `cluster_weights`.
    is_share : bool
        Whether the ratio is a share of trials, 0..1.

    Returns
    -------
    Estimate
        All NaN where the denominator is 0 over all clusters.
    """
    n = int((denominator > 0).sum())
    drawn = weights @ denominator
    replicates: Floats = np.full(weights.shape[0], np.nan)
    np.divide(weights @ numerator, drawn, out=replicates, where=drawn > 0)
    value = float(numerator.sum()) / float(denominator.sum()) if n else np.nan
    low, high = np.nan, np.nan
    if n > 1 and is_share and value in (0.0, 1.0):
        low, high = wilson(hits=value * n, n=n)
    elif n > 1:
        low, high = percentile_interval(replicates)
    return Estimate(value, low, high, n, replicates)


def percentile_interval(replicates: Floats) -> tuple[float, float]:
    """Return the percentile interval of bootstrap replicates; empty ones (NaN) are left out."""
    there = replicates[~np.isnan(replicates)]
    if not there.size:
        return np.nan, np.nan
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(there, [tail, 1.0 - tail])
    return float(low), float(high)
