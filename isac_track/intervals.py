"""Intervals: Wilson for a count, and the bootstrap over clusters (people) for everything else.

Of few clusters the bootstrap's are too narrow: there a jackknife takes its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, expit, logit, ndtri, stdtrit

from isac_track.rng import stream
from isac_track.types import Floats, Ints

CONFIDENCE = 0.95
FEW_CLUSTERS: Final = 40.0
"""Effective clusters below which an interval is the jackknife's: docs/metrics.md says why."""
LEAST_CLUSTERS: Final = 15.0
"""Effective clusters below which there is no interval, but an exact one of a count."""
FEWEST_EFFECTIVE: Final = 20  # Effective clusters below which nothing is decided.


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """A number with its interval, and the replicates that paired comparisons need."""

    value: float
    ci_low: float = np.nan
    ci_high: float = np.nan
    n: int = 0  # Clusters that contribute.
    replicates: Floats = field(default_factory=lambda: np.zeros(0))
    """(B,) bootstrap replicates; the same row of weights in every estimate of a run."""
    closed_error: float | None = None  # Standard error where it has a closed form.
    effective: float = (
        np.nan
    )  # Effective clusters, where their sizes are known: n^2 / sum m^2.

    @property
    def drawn(self) -> Floats:
        """(1 + B,) the estimate and its replicates."""
        return np.append(self.value, self.replicates)

    @property
    def standard_error(self) -> float:
        """Of the closed form, or of the replicates that are known; NaN without two."""
        if self.closed_error is not None:
            return self.closed_error
        drawn = self.replicates[np.isfinite(self.replicates)]
        return float(drawn.std(ddof=1)) if drawn.size > 1 else np.nan

    @property
    def n_effective(self) -> float:
        """Clusters of equal size that would tell as much; all of them where no size is known."""
        return self.effective if np.isfinite(self.effective) else float(self.n)


def estimate_of(values: Floats, *, n: int, effective: float = np.nan) -> Estimate:
    """Return the estimate that a number and its replicates, (1 + B,), of `n` clusters make.

    Replicates that are not finite are left out of the interval; of fewer than
    `LEAST_CLUSTERS` effective clusters, where they are known, there is none.
    """
    drawn, ends = values[1:], (np.nan, np.nan)
    if not effective < LEAST_CLUSTERS:
        ends = percentile_interval(drawn[np.isfinite(drawn)])
    return Estimate(float(values[0]), *ends, n, drawn, effective=effective)


def difference(a: Estimate, b: Estimate) -> Estimate:
    """Return a - b, paired: both have their replicates from the same rows of weights."""
    n_drawn = min(a.replicates.size, b.replicates.size)
    drawn = a.replicates[:n_drawn] - b.replicates[:n_drawn]
    return Estimate(
        a.value - b.value, *percentile_interval(drawn), min(a.n, b.n), drawn
    )


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


def exact_binomial(*, hits: int, n: int) -> tuple[float, float]:
    """Return the interval of a share that holds it at least as often as it says, at any n.

    Clopper and Pearson, Biometrika 26, 1934. ValueError as `wilson`.
    """
    if not (n > 0 and 0 <= hits <= n):
        raise ValueError(f"a share needs 0 <= hits <= n and n > 0, got {hits} of {n}")
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(hits, n - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, n - hits, 1.0 - tail)) if hits < n else 1.0
    return low, high


def jackknife_interval(
    values: Floats, *, effective: float, is_share: bool = True
) -> tuple[float, float]:
    """Return the interval of a number by the delete-one-cluster jackknife.

    With Student's t of one degree of freedom less than `effective` clusters; that of a
    share is one of its logit, and of exactly 0 or 1 Wilson's of so many. `values`, (1 +
    C,), are the number of all clusters, and without each in turn: what is no sum over
    clusters, such as the gallery of a rank, stays.

    Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11; Kish, Survey
    Sampling, 1965 (the effective number).
    """
    value, n = float(values[0]), values.size - 1
    if is_share and value in (0.0, 1.0):
        return wilson(hits=value * effective, n=effective)
    error = float(np.sqrt((n - 1.0) / n * ((values[1:] - value) ** 2).sum()))
    half = float(stdtrit(effective - 1.0, 0.5 + CONFIDENCE / 2.0)) * error
    if not is_share:
        return value - half, value + half
    centre, half = float(logit(value)), half / (value * (1.0 - value))
    return float(expit(centre - half)), float(expit(centre + half))


def cluster_weights(
    *, n_clusters: int, n_replicates: int, seed: int, of: Sequence[str] = ()
) -> Floats:
    """Return how often each cluster is drawn in each bootstrap replicate, (B, C).

    One matrix serves every metric and mechanism of a run, so that all comparisons are
    paired; `of` names what has draws of its own.
    """
    counts = _counts(n_clusters, n_replicates, seed, *of)
    return counts.astype(
        np.float64, order="F"
    )  # whoever reads some clusters has them in one piece


@lru_cache(maxsize=2)  # of thousands of clusters half a second to draw
def _counts(
    n_clusters: int, n_replicates: int, seed: int, *of: str
) -> NDArray[np.uint8]:
    rng, p = stream(seed, "bootstrap", *of), np.full(n_clusters, 1.0 / n_clusters)
    # Counts are 1 on average: never hundreds.
    return np.array(
        [rng.multinomial(n_clusters, p).astype(np.uint8) for _ in range(n_replicates)]
    )


def cluster_sums(*, values: Floats, cluster: Ints, n_clusters: int) -> Floats:
    """Return the sum of `values`, (R,), within each cluster, (C,)."""
    return np.asarray(
        np.bincount(cluster, weights=values, minlength=n_clusters).astype(np.float64)
    )


def effective_clusters(sizes: Floats) -> float:
    """Return n^2 / sum m^2 of clusters of m each, (C,), n in all: their number if all are equal."""
    squares = float(sizes @ sizes)
    return float(sizes.sum()) ** 2 / squares if squares > 0 else 0.0


def ratio_estimates(
    *, numerator: Floats, denominator: Floats, weights: Floats, is_share: Sequence[bool]
) -> list[Estimate]:
    """Return sum(numerator) / sum(denominator) of each row with its clustered interval.

    It is the percentile interval of whole clusters drawn with replacement (Davison and
    Hinkley, 1997, ch. 3.8). A share of exactly 0 or 1 has no spread to resample; its
    interval is Wilson's with the clusters as the sample size. Of fewer than
    `FEW_CLUSTERS` effective clusters it is the jackknife's, and not below 0 where no
    numerator is; below `LEAST_CLUSTERS` there is none (NaN), but the exact one of a
    count: a share of which every cluster has as many trials and one outcome of them.
    Where the denominator is 0 over all clusters there is no number either.

    `numerator` and `denominator`, (K, C), are sums within each cluster: hits and trials
    (then the ratio `is_share`, 0..1), or a sum and a count; `weights`, (B, C), are from
    `cluster_weights`.
    """
    # Rows in succession often have one denominator.
    is_new = np.append([True], (denominator[1:] != denominator[:-1]).any(axis=1))
    place = np.cumsum(is_new) - 1
    drawn = np.concatenate([numerator, denominator[is_new]]) @ weights.T
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (numerator.sum(axis=1) / denominator.sum(axis=1)).tolist()
        replicates: Floats = drawn[: len(place)] / drawn[len(place) :][place]
    effective = [effective_clusters(one) for one in denominator[is_new]]
    n_clusters, found = (denominator > 0).sum(axis=1).tolist(), []
    for row, (low, high) in enumerate(percentile_intervals(replicates).T.tolist()):
        value, n, few = values[row], n_clusters[row], effective[place[row]]
        ends = low, high
        if few < FEW_CLUSTERS:
            sums = numerator[row], denominator[row]
            ends = _interval_of_few(*sums, effective=few, is_share=is_share[row])
        elif is_share[row] and value in (0.0, 1.0):
            ends = wilson(hits=value * n, n=n)
        found.append(Estimate(value, *ends, n, replicates[row], effective=few))
    return found


def _interval_of_few(
    numerator: Floats, denominator: Floats, *, effective: float, is_share: bool
) -> tuple[float, float]:
    there = denominator > 0
    hits, trials = numerator[there], denominator[there]
    if effective >= LEAST_CLUSTERS:
        rest, of = (sums.sum() - np.append(0.0, sums) for sums in (hits, trials))
        low, high = jackknife_interval(
            rest / of, effective=effective, is_share=is_share
        )
        return (low if hits.min() < 0.0 else max(0.0, low)), high
    is_count = (trials == trials[:1]).all() and np.isin(hits, (0.0, *trials[:1])).all()
    if is_share and is_count and hits.size:
        return exact_binomial(hits=int((hits > 0).sum()), n=hits.size)
    return np.nan, np.nan


def percentile_interval(replicates: Floats) -> tuple[float, float]:
    """Return the percentile interval of bootstrap replicates; empty ones (NaN) are left out."""
    low, high = percentile_intervals(replicates[None])
    return float(low[0]), float(high[0])


def percentile_intervals(replicates: Floats) -> Floats:
    """Return the ends of the percentile interval of each row of replicates, (K, B) -> (2, K).

    The quantiles are numpy's, which takes several times as long for so few numbers.
    NaN, which sorts last, is left out; a row without a number has no interval.
    """
    if not replicates.size:
        return np.full((2, len(replicates)), np.nan)
    last = np.maximum(replicates.shape[1] - 1 - np.isnan(replicates).sum(axis=1), 0)
    tail = (1.0 - CONFIDENCE) / 2.0
    place = np.array([[tail], [1.0 - tail]]) * last
    below = place.astype(np.int64)
    both = np.stack([below, np.minimum(below + 1, last)])
    a, b = np.partition(replicates, np.unique(both), axis=1)[
        np.arange(len(replicates)), both
    ]
    part, step = place - below, b - a
    # From the nearer of the two, as numpy does it.
    return np.asarray(np.where(part < 0.5, a + step * part, b - step * (1.0 - part)))  # noqa: PLR2004 - half way
