"""Confidence intervals: Wilson for counts, the cluster bootstrap for everything else.

A cluster is a group of people who walk together. With few clusters the bootstrap's
intervals are too narrow; there the jackknife takes its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, expit, logit, ndtri, stdtrit

from isac_track.renamed import renamed
from isac_track.rng import stream
from isac_track.types import Floats, Ints

__all__ = ["CONFIDENCE", "FEWEST_EFFECTIVE", "FEW_CLUSTERS", "LEAST_CLUSTERS"]
__all__ += ["Estimate", "cluster_sums", "cluster_weights", "difference"]
__all__ += ["effective_clusters", "estimate_from_replicates", "exact_binomial"]
__all__ += ["jackknife_interval", "percentile_interval", "percentile_intervals"]
__all__ += ["ratio_estimates", "wilson"]

CONFIDENCE = 0.95
"""Nominal coverage of every interval."""
FEW_CLUSTERS: Final = 40.0
"""Below this number of effective clusters the jackknife is used."""
LEAST_CLUSTERS: Final = 15.0
"""Below this number of effective clusters only a count has an interval, the exact."""
FEWEST_EFFECTIVE: Final = 20
"""Least number of effective clusters for a decision."""


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """A number with its interval, and the replicates that paired comparisons need.

    Attributes
    ----------
    value : float
        The number; NaN where it is undefined.
    ci_low : float
        Lower end of its 95 % interval, in the unit of the number, or NaN.
    ci_high : float
        Upper end of the interval.
    n : int
        Clusters that contribute.
    replicates : Floats
        Bootstrap replicates, (B,), in the unit of the number. All of a run come from
        one set of weights.
    closed_error : float or None
        Standard error where it has a closed form.
    effective : float
        Effective clusters, n^2 / sum m^2; NaN where their sizes are not known.
    """

    value: float
    ci_low: float = np.nan
    ci_high: float = np.nan
    n: int = 0
    replicates: Floats = field(default_factory=lambda: np.zeros(0))
    closed_error: float | None = None
    effective: float = np.nan

    @property
    def drawn(self) -> Floats:
        """The estimate and its replicates, (1 + B,)."""
        return np.append(self.value, self.replicates)

    @property
    def standard_error(self) -> float:
        """Standard error in closed form, or of at least two replicates, or NaN."""
        if self.closed_error is not None:
            return self.closed_error
        drawn = self.replicates[np.isfinite(self.replicates)]
        return float(drawn.std(ddof=1)) if drawn.size > 1 else np.nan

    @property
    def n_effective(self) -> float:
        """Number of equal clusters that tell as much; `n` where sizes are not known."""
        return self.effective if np.isfinite(self.effective) else float(self.n)


def estimate_from_replicates(
    values: Floats, *, n: int, effective: float = np.nan
) -> Estimate:
    """Build an estimate from a number and its bootstrap replicates, (1 + B,).

    `n` clusters contribute. Replicates that are not finite are left out of the
    interval. Below `LEAST_CLUSTERS` effective clusters, where they are known, there is
    no interval.
    """
    drawn, ends = values[1:], (np.nan, np.nan)
    if not effective < LEAST_CLUSTERS:
        ends = percentile_interval(drawn[np.isfinite(drawn)])
    return Estimate(float(values[0]), *ends, n, drawn, effective=effective)


def difference(a: Estimate, b: Estimate) -> Estimate:
    """Return a - b, paired: both have replicates from the same rows of weights.

    The interval is that of percentiles, as of `estimate_from_replicates`; `n` is the
    smaller of both, and so are the effective clusters.

    Examples
    --------
    >>> import numpy as np
    >>> from isac_track.intervals import Estimate, difference
    >>> a = Estimate(0.5, n=40, replicates=np.array([0.4, 0.5, 0.6]))
    >>> b = Estimate(0.3, n=30, replicates=np.array([0.2, 0.3, 0.4]))
    >>> gap = difference(a, b)
    >>> round(gap.value, 6), round(gap.ci_low, 6), round(gap.ci_high, 6), gap.n
    (0.2, 0.2, 0.2, 30)
    """
    n_drawn = min(a.replicates.size, b.replicates.size)
    values = a.drawn[: n_drawn + 1] - b.drawn[: n_drawn + 1]
    effective = float(np.fmin(a.effective, b.effective))
    return estimate_from_replicates(values, n=min(a.n, b.n), effective=effective)


def wilson(*, hits: float, n: float) -> tuple[float, float]:
    """Return the Wilson score interval of a share (Wilson, JASA 1927).

    ValueError unless ``0 <= hits <= n`` and n is positive.

    Examples
    --------
    >>> from isac_track.intervals import wilson
    >>> low, high = wilson(hits=5, n=10)
    >>> round(low, 3), round(high, 3)
    (0.237, 0.763)
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
    """Return the exact interval of a share: its coverage is at least nominal at any n.

    Clopper and Pearson, Biometrika 26, 1934. ValueError as in `wilson`.

    Examples
    --------
    Without a hit the upper end is 1 - 0.025^(1/n):

    >>> from isac_track.intervals import exact_binomial
    >>> low, high = exact_binomial(hits=0, n=10)
    >>> low, round(high, 4)
    (0.0, 0.3085)
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

    It uses Student's t with `effective` - 1 degrees of freedom. A share is transformed
    to its logit; a share of exactly 0 or 1 has Wilson's interval of `effective` trials.
    `values`, (1 + C,), are the number from all clusters, then without each cluster in
    turn. Whatever is no sum over clusters, such as the gallery of a rank, stays whole.

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
    *,
    n_clusters: int,
    n_replicates: int,
    seed: int,
    stream_names: Sequence[str] = (),
) -> Floats:
    """Return how often each cluster is drawn in each bootstrap replicate, (B, C).

    B is `n_replicates`, C is `n_clusters`; each row sums to C. One matrix serves every
    metric and mechanism of a run, so that all comparisons are paired. With
    `stream_names` the draws come from a random stream of that name.
    """
    counts = _draw_counts(n_clusters, n_replicates, seed, *stream_names)
    # Column by column: a caller that reads some clusters finds them in one piece.
    return counts.astype(np.float64, order="F")


# The last two matrices stay for the life of the process: to draw thousands of
# clusters takes half a second.
@lru_cache(maxsize=2)
def _draw_counts(
    n_clusters: int, n_replicates: int, seed: int, *stream_names: str
) -> NDArray[np.uint8]:
    rng = stream(seed, "bootstrap", *stream_names)
    p = np.full(n_clusters, 1.0 / n_clusters)
    # A count is 1 on average and never reaches hundreds: eight bits hold it.
    return np.array(
        [rng.multinomial(n_clusters, p).astype(np.uint8) for _ in range(n_replicates)]
    )


def cluster_sums(*, values: Floats, cluster: Ints, n_clusters: int) -> Floats:
    """Return the sum of `values`, (R,), within each cluster, (C,).

    `cluster`, (R,), is the cluster of each value, from 0 to C - 1.
    """
    return np.asarray(
        np.bincount(cluster, weights=values, minlength=n_clusters).astype(np.float64)
    )


def effective_clusters(sizes: Floats) -> float:
    """Return n^2 / sum m^2 for clusters of sizes m, (C,), with n their sum.

    Kish, Survey Sampling, 1965. 0 without any member.

    Examples
    --------
    Ten equal clusters count as ten; nine small beside a large cluster as fewer:

    >>> import numpy as np
    >>> from isac_track.intervals import effective_clusters
    >>> effective_clusters(np.full(10, 3.0))
    10.0
    >>> round(effective_clusters(np.array([9.0] + [1.0] * 9)), 2)
    3.6
    """
    squares = float(sizes @ sizes)
    return float(sizes.sum()) ** 2 / squares if squares > 0 else 0.0


def ratio_estimates(
    *, numerator: Floats, denominator: Floats, weights: Floats, is_share: Sequence[bool]
) -> list[Estimate]:
    """Return sum(numerator) / sum(denominator) of each row with its clustered interval.

    The interval is that of percentiles, with whole clusters drawn with replacement
    (Davison and Hinkley, 1997, ch. 3.8). There are three exceptions:

    - A share of exactly 0 or 1 has no spread to resample. Its interval is Wilson's,
      with the clusters as the sample size.
    - Below `FEW_CLUSTERS` effective clusters the interval is the jackknife's. It does
      not reach below 0 unless a numerator does.
    - Below `LEAST_CLUSTERS` only a count has an interval, which is exact. A count is a
      share where all clusters have equally many trials, and the trials of a cluster
      have the same outcome.
      Otherwise the ends are NaN.

    Where the denominator is 0 over all clusters there is no number either.

    `numerator` and `denominator`, (K, C), are sums within each cluster: hits and trials
    (then the ratio `is_share`, 0..1), or a sum and a count; `weights`, (B, C), are from
    `cluster_weights`. Returns K estimates in the unit of the ratio.

    Examples
    --------
    Fifty people with ten trials each; half of them hit always, the others never:

    >>> import numpy as np
    >>> from isac_track.intervals import cluster_weights, ratio_estimates
    >>> hits = np.where(np.arange(50) < 25, 10.0, 0.0)
    >>> (rate,) = ratio_estimates(
    ...     numerator=hits[None],
    ...     denominator=np.full((1, 50), 10.0),
    ...     weights=cluster_weights(n_clusters=50, n_replicates=1000, seed=0),
    ...     is_share=[True],
    ... )
    >>> rate.value, rate.n, rate.n_effective
    (0.5, 50, 50.0)
    >>> bool(0.3 < rate.ci_low < 0.42 and 0.58 < rate.ci_high < 0.7)
    True
    """
    # Rows in succession often have one denominator.
    is_new = np.append([True], (denominator[1:] != denominator[:-1]).any(axis=1))
    place = np.cumsum(is_new) - 1
    drawn = np.concatenate([numerator, denominator[is_new]]) @ weights.T
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (numerator.sum(axis=1) / denominator.sum(axis=1)).tolist()
        replicates: Floats = drawn[: len(place)] / drawn[len(place) :][place]
    effective = [effective_clusters(sizes) for sizes in denominator[is_new]]
    n_clusters = (denominator > 0).sum(axis=1).tolist()
    estimates: list[Estimate] = []
    for row, (low, high) in enumerate(percentile_intervals(replicates).T.tolist()):
        value, n, few = values[row], n_clusters[row], effective[place[row]]
        ends = low, high
        if few < FEW_CLUSTERS:
            ends = _small_sample_interval(
                numerator[row],
                denominator[row],
                effective=few,
                is_share=is_share[row],
            )
        elif is_share[row] and value in (0.0, 1.0):
            ends = wilson(hits=value * n, n=n)
        estimates.append(Estimate(value, *ends, n, replicates[row], effective=few))
    return estimates


def _small_sample_interval(
    numerator: Floats, denominator: Floats, *, effective: float, is_share: bool
) -> tuple[float, float]:
    """Return the jackknife's interval, or the exact of a count, or NaN."""
    contributes = denominator > 0
    hits, trials = numerator[contributes], denominator[contributes]
    if effective >= LEAST_CLUSTERS:
        # In all clusters, then without each in turn.
        hits_left = hits.sum() - np.append(0.0, hits)
        trials_left = trials.sum() - np.append(0.0, trials)
        low, high = jackknife_interval(
            hits_left / trials_left, effective=effective, is_share=is_share
        )
        return (low if hits.min() < 0.0 else max(0.0, low)), high
    is_count = (trials == trials[:1]).all() and np.isin(hits, (0.0, *trials[:1])).all()
    if is_share and is_count and hits.size:
        return exact_binomial(hits=int((hits > 0).sum()), n=hits.size)
    return np.nan, np.nan


def percentile_interval(replicates: Floats) -> tuple[float, float]:
    """Return the percentile interval of bootstrap replicates, (B,); NaN is left out."""
    low, high = percentile_intervals(replicates[None])
    return float(low[0]), float(high[0])


def percentile_intervals(replicates: Floats) -> Floats:
    """Return the ends of each row's percentile interval, (K, B) -> (2, K).

    The quantiles equal those of `np.quantile`, which takes several times as long for
    so few numbers. NaN, which sorts last, is left out; a row without a number has no
    interval.
    """
    if not replicates.size:
        return np.full((2, len(replicates)), np.nan)
    last = np.maximum(replicates.shape[1] - 1 - np.isnan(replicates).sum(axis=1), 0)
    tail = (1.0 - CONFIDENCE) / 2.0
    place = np.array([[tail], [1.0 - tail]]) * last
    below = place.astype(np.int64)
    neighbours = np.stack([below, np.minimum(below + 1, last)])
    partitioned = np.partition(replicates, np.unique(neighbours), axis=1)
    a, b = partitioned[np.arange(len(replicates)), neighbours]
    part, step = place - below, b - a
    # Interpolate from the nearer of the two, as numpy does.
    return np.asarray(np.where(part < 0.5, a + step * part, b - step * (1.0 - part)))  # noqa: PLR2004 - half way


if not TYPE_CHECKING:  # type checkers are to know the names that are
    __getattr__ = renamed(__name__, {"estimate_of": "estimate_from_replicates"})
