"""Rank metrics, and the assignment of all probes at once.

Ties carry no information: rank metrics are expectations under a random order of equal
scores, and assignments are made in a random order of the columns. `scores`, (P, G), and
`mate`, (P,), are as in `Search`, which lists the causes of a ValueError.

References
----------
Residual risk: Giomi, Boenisch, Wehmeyer, Tasnadi, PoPETs 2023(2).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from isac_track.types import Floats, Ints

GALLERY = 100
"""Candidates, the mate included, in the gallery of `rank1_among`.

The measure compares over recordings, whose galleries differ. A guess hits one time in
100.
"""
REACH = 10
"""Largest predicted gallery per measured gallery.

The second, smaller gallery of the prediction is as much smaller than the measured.
"""
FEWEST = 3  # Candidates in the smallest gallery that a rate is read from.
# Sweeps of Sinkhorn's scaling, and how near to 1 sums have to come.
_MOST_SWEEPS, _TOLERANCE = 100, 1e-6
_SWEEPS_BY_FACTORS: Final = 20  # Of these at a time, before a sweep of logarithms.
_LEAST_SUM: Final = 1e-250  # Smaller sums would leave the range of numbers.
_STEPS = 60  # Bisections for the scale of the gamma distribution.
_LOG_RANGE = np.log([1e-6, 1e9])  # Logarithms of its least and greatest value.


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """Scores of P probes against one gallery of G releases.

    Attributes
    ----------
    scores : Floats
        Scores, (P, G), higher for the same person; finite.
    mate : Ints
        Column of each probe's mate, (P,); -1 if it has none in this gallery (open set).
    probe_cluster : Ints
        Cluster (person or walking group) of each probe, (P,).
    gallery_cluster : Ints
        Cluster of each candidate, (G,).
    scale : int
        Searches of one scale come from one fitted attack: their scores compare.

    Raises
    ------
    ValueError
        If a shape is wrong, a score is not finite, a mate is no column or two probes
        share one, or a cluster is negative.
    """

    scores: Floats
    mate: Ints
    probe_cluster: Ints
    gallery_cluster: Ints
    scale: int = 0

    def __post_init__(self) -> None:
        _check_scores(self.scores, self.mate)
        for name, n in zip(
            ("probe_cluster", "gallery_cluster"), self.scores.shape, strict=True
        ):
            cluster = getattr(self, name)
            if cluster.shape != (n,) or cluster.dtype.kind not in "iu":
                raise ValueError(
                    f"{name} must be integers of shape ({n},), got {cluster.shape}"
                )
            if cluster.min() < 0:
                raise ValueError(f"{name} must not be negative")


def _check_finite(scores: Floats) -> None:
    if scores.ndim != 2 or 0 in scores.shape:  # noqa: PLR2004 - a matrix
        raise ValueError(
            f"scores must have shape (P, G), neither 0, got {scores.shape}"
        )
    if not np.isfinite(scores).all():
        raise ValueError("scores must be finite")


def _check_scores(scores: Floats, mate: Ints) -> None:
    _check_finite(scores)
    n_probes, n_gallery = scores.shape
    if mate.shape != (n_probes,) or mate.dtype.kind not in "iu":
        raise ValueError(
            f"mate must be integers of shape ({n_probes},), got {mate.shape}"
        )
    mated = mate[mate != -1]
    if mated.size and not 0 <= mated.min() <= mated.max() < n_gallery:
        raise ValueError(f"mates must be columns, 0..{n_gallery - 1}, or -1 for none")
    if np.bincount(mated.astype(np.int64, copy=False)).max(initial=0) > 1:
        raise ValueError("two probes must not share a mate")


def rank1(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected hit of each probe, (P,); NaN for a probe without a mate.

    It is 1 / t if the mate is among t candidates at the top, else 0. `scores` are
    (P, G), `mate` is (P,), and both raise as `Search`.

    Examples
    --------
    The first probe's mate is on top, the second's shares the top with another
    candidate, the third's is beaten:

    >>> import numpy as np
    >>> from isac_track.linkability import rank1
    >>> scores = np.array([[3.0, 1.0, 0.0], [0.0, 2.0, 2.0], [5.0, 0.0, 4.0]])
    >>> rank1(scores=scores, mate=np.array([0, 1, 2]))
    array([1. , 0.5, 0. ])
    """
    _check_scores(scores, mate)
    return np.where(mate < 0, np.nan, expected_hit(*standing(scores, mate)))


def rank1_among(
    *, above: Ints, tied: Ints, candidates: Ints, gallery: int = GALLERY
) -> Floats:
    """Return the rate at which each mate comes first among random candidates, (P,).

    Exact over all galleries that hold the mate and gallery - 1 of the N - 1 others: C(N
    - 1 - m, gallery - 1) / C(N - 1, gallery - 1) with m others at or above the mate,
    the mean over the places that a tie leaves it. `above`, `tied` and `candidates`,
    (P,), are the numbers of candidates above the mate, as high (the mate included), and
    in all. NaN where there are fewer candidates than `gallery`.
    """
    first: Floats = np.full(above.shape, np.nan)
    for n in np.unique(candidates[candidates >= gallery]).tolist():
        is_size, sums = candidates == n, _sums_passed_over(n, gallery)
        first[is_size] = (sums[(above + tied)[is_size]] - sums[above[is_size]]) / tied[
            is_size
        ]
    return first


# The same for every attack on a task; the 257th makes the oldest go.
@lru_cache(maxsize=256)
def _sums_passed_over(n: int, gallery: int) -> Floats:
    """Return the chance to pass over m others, summed over values below m, (n + 1,).

    A random gallery passes over m others if it holds none of them; m is 0..n.
    """
    # Given that it passes over m - 1 others, it passes over the m-th with this chance.
    left = np.arange(n - 1.0, 0.0, -1.0)
    passed = np.cumprod(np.append(1.0, np.maximum(left - (gallery - 1), 0.0) / left))
    return np.append(0.0, np.cumsum(passed))


def reciprocal_rank(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected 1 / rank of each probe's mate, (P,); NaN without a mate.

    `scores` are (P, G), `mate` is (P,); both raise as `Search`.
    """
    _check_scores(scores, mate)
    expected = expected_reciprocal(*standing(scores, mate), scores.shape[1])
    return np.where(mate < 0, np.nan, expected)


def log_rank(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected -log(rank / G) of each mate, (P,); NaN without a mate.

    Zero at the bottom, log G at the top: every halving of the rank counts the same, in
    galleries of any size. The logarithm of a mid-rank would rate a tie above what it is
    worth. `scores` are (P, G), `mate` is (P,); both raise as `Search`. It is in nats.
    """
    _check_scores(scores, mate)
    (above, tied), n_gallery = standing(scores, mate), scores.shape[1]
    log_factorial = log_factorials(n_gallery)
    spread = log_factorial[above + tied] - log_factorial[above]
    return np.where(mate < 0, np.nan, math.log(n_gallery) - spread / tied)


def mean_log_rank(searches: Sequence[Search]) -> float:
    """Return the mean `log_rank` over all mated probes, in nats; NaN without any."""
    values = np.concatenate([log_rank(scores=s.scores, mate=s.mate) for s in searches])
    values = values[~np.isnan(values)]
    return float(values.mean()) if values.size else float("nan")


def assign(
    *, scores: Floats, rng: np.random.Generator, no_match_score: float | None = None
) -> Ints:
    """Return the column assigned to each probe, (P,), or -1; each column at most once.

    The sum of the assigned scores is the largest possible. One permutation from `rng`
    first puts the columns in a random order, so that ties cannot reveal the mate by its
    place. An assigned pair must score more than `no_match_score`, the score of an
    unassigned probe. Without it every probe is assigned, as far as the gallery reaches.
    ValueError unless `scores`, (P, G), are a matrix of finite numbers.

    Examples
    --------
    Both probes score highest with the first candidate. Together they do better:

    >>> import numpy as np
    >>> from isac_track.linkability import assign
    >>> scores = np.array([[5.0, 4.0], [5.0, 0.0]])
    >>> assign(scores=scores, rng=np.random.default_rng(0))
    array([1, 0])
    """
    _check_finite(scores)
    return assign_in(rng.permutation(scores.shape[1]), scores, no_match_score)


def assign_in(order: Ints, scores: Floats, no_match_score: float | None) -> Ints:
    """Assign finite scores with the columns in this order: see `assign`."""
    from isac_track.linkability import _loops  # noqa: PLC0415 - numba is heavy

    gain = scores[:, order]
    if no_match_score is not None:
        # Equivalent to a column of its own for every probe, with half the matrix: a
        # probe that would stay unassigned may take a column where it gains nothing.
        gain = np.maximum(gain - no_match_score, 0.0)
    is_tall = gain.shape[0] > gain.shape[1]
    columns = np.empty(min(gain.shape), dtype=np.int64)
    _loops.assign(np.negative(gain.T if is_tall else gain, order="C"), columns)
    rows = np.arange(columns.size)
    if is_tall:
        rows, columns = columns, rows
    assigned = np.full(scores.shape[0], -1)
    assigned[rows] = order[columns]
    if no_match_score is not None:
        assigned[rows[gain[rows, columns] <= 0.0]] = -1
    return assigned


def log_sum_exp(values: Floats, *, axis: int) -> Floats:
    """Return log(sum(exp(values))) along an axis, which stays with length 1.

    `values` are finite real numbers, not empty. scipy's `logsumexp` takes four times as
    long on the small matrices here: it provides for complex, infinite and empty input.
    """
    largest = values.max(axis=axis, keepdims=True)
    total = np.exp(values - largest).sum(axis=axis, keepdims=True)
    return np.asarray(np.log(total) + largest)


def soft_matches(scores: Floats) -> Floats:
    """Return the log probability of every pair if each probe has its own mate, (N, N).

    Scores are log likelihood ratios; a matching is as likely as the product of its
    pairs' ratios. Exact probabilities take permanents: Sinkhorn's scaling (Annals of
    Mathematical Statistics 35, 1964) approximates them. Rows and columns of exp(scores)
    are divided by their sums in turn until these are 1, to 1e-6, or 100 times.
    ValueError unless scores are (N, N) and finite.
    """
    _check_finite(scores)
    if scores.shape[0] != scores.shape[1]:
        raise ValueError(f"as many candidates as probes are needed, got {scores.shape}")
    log_p, n_sweeps, is_scaled = scores, 0, False
    while n_sweeps < _MOST_SWEEPS and not is_scaled:
        row_sums = log_sum_exp(log_p, axis=1)
        log_p = log_p - row_sums
        log_p -= log_sum_exp(log_p, axis=0)
        n_sweeps += 1
        is_scaled = bool(np.abs(row_sums).max() < _TOLERANCE)
        if not is_scaled:
            most = min(_SWEEPS_BY_FACTORS, _MOST_SWEEPS - n_sweeps)
            scaled = _scaled_by_factors(log_p, most=most)
            log_p, is_scaled = scaled.log_p, scaled.is_scaled
            n_sweeps += scaled.n_sweeps
    return log_p


@dataclass(frozen=True, eq=False, slots=True)
class _Scaled:
    """A matrix whose rows and columns were scaled."""

    log_p: Floats  # (N, N)
    n_sweeps: int
    is_scaled: bool  # Whether the sums of rows were 1.


def _scaled_by_factors(log_p: Floats, *, most: int) -> _Scaled:
    """Scale a matrix by factors of rows and columns, in at most `most` sweeps.

    Factors take a fraction of the time of logarithms of sums. The sweeps stop before a
    sum leaves the range of numbers: the caller's next sweep is of logarithms.
    """
    p = np.exp(log_p)
    rows, columns = np.ones(len(p)), np.ones(len(p))
    n_sweeps, is_scaled = 0, False
    while n_sweeps < most and not is_scaled:
        by_rows = p @ columns
        if by_rows.min() < _LEAST_SUM:
            break
        next_rows = 1.0 / by_rows
        by_columns = next_rows @ p
        if by_columns.min() < _LEAST_SUM:
            break
        is_scaled = bool(np.abs(np.log(rows * by_rows)).max() < _TOLERANCE)
        rows, columns = next_rows, 1.0 / by_columns
        n_sweeps += 1
    scaled = log_p + np.log(rows)[:, None] + np.log(columns)
    return _Scaled(scaled, n_sweeps, is_scaled)


def chance(searches: Sequence[Search]) -> float:
    """Return the expected rank-1 rate of guessing: mean of 1 / G over mated probes.

    NaN without a mated probe.
    """
    counts = np.array([(search.mate >= 0).sum() for search in searches])
    sizes = np.array([search.scores.shape[1] for search in searches])
    return (
        float(np.average(1.0 / sizes, weights=counts)) if counts.any() else float("nan")
    )


def residual_risk(*, success: float, control: float) -> float:
    """Return (success - control) / (1 - control), the attack's gain over its control.

    Negative where the attack is worse, 1 where it always succeeds, NaN where the
    control always succeeds. Both are rates, 0..1. Giomi, Boenisch, Wehmeyer, Tasnadi,
    PoPETs 2023(2).

    >>> from isac_track.linkability import residual_risk
    >>> residual_risk(success=0.75, control=0.5)
    0.5
    """
    return (success - control) / (1.0 - control) if control != 1.0 else float("nan")


def expected_hit(above: Ints, tied: Ints) -> Floats:
    """Return `rank1` given the candidates above the mate and those as high, (P,)."""
    return np.where(above == 0, 1.0 / tied, 0.0)


def among_strangers(above: Ints, tied: Ints, chance: Floats, companions: Ints) -> Ints:
    """Count the strangers above each mate, as high, and in all, (3, P).

    Strangers are candidates other than companions. The arguments are the fields of
    `ProbeRanks`. The mate counts among those as high and in all.
    """
    along, along_above, along_tied = companions.T
    candidates = np.rint(1.0 / chance).astype(np.int64) - along
    return np.stack([above - along_above, tied - along_tied, candidates])


def first_among(strangers: Ints, gallery: int = GALLERY) -> Floats:
    """Return `rank1_among`, (P,), from the counts of `among_strangers`."""
    above, tied, candidates = strangers
    return rank1_among(above=above, tied=tied, candidates=candidates, gallery=gallery)


def expected_reciprocal(above: Ints, tied: Ints, n_gallery: int) -> Floats:
    """Return `reciprocal_rank` from such counts; `n_gallery` is the largest gallery."""
    harmonic = np.append(0.0, np.cumsum(1.0 / np.arange(1, n_gallery + 1)))
    return np.asarray((harmonic[above + tied] - harmonic[above]) / tied)


# As above.
@lru_cache(maxsize=256)
def log_factorials(n: int) -> Floats:
    """Return log k! for 0..n, (n + 1,)."""
    return np.append(0.0, np.cumsum(np.log(np.arange(1, n + 1))))


def standing(scores: Floats, mate: Ints) -> tuple[Ints, Ints]:
    """Count candidates above each probe's mate, and those as high, itself included.

    (P,) each, without meaning for a probe without a mate.
    """
    own = scores[np.arange(mate.size), mate][:, None]
    return (scores > own).sum(axis=1), (scores == own).sum(axis=1)


def predicted_rank1(
    *, small: Floats, large: Floats, sizes: tuple[int, int], gallery: int
) -> Floats:
    """Predict rank 1 in a larger `gallery` from two rates, (B,), at two `sizes`.

    With p_i the share of impostors ahead of a probe's mate, a share r(G) = mean of (1 -
    p_i)^(G - 1) of probes find their mate first among G candidates. In a larger gallery
    somebody may be ahead of a mate that nobody is ahead of in the measured gallery. So
    the p_i have a gamma distribution here: r(G) = (1 + (G - 1) / b)^-a, through the two
    rates. It is 1 where the larger has no failure, 0 where it has no hit. ValueError
    unless 2 <= sizes[0] < sizes[1] <= gallery.
    """
    if not 2 <= sizes[0] < sizes[1] <= gallery:  # noqa: PLR2004 - a mate and an impostor
        raise ValueError(f"galleries must grow from 2, got {sizes} and {gallery}")
    first, second = (float(size - 1) for size in sizes)
    wanted = float(gallery - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.clip(large, 0.0, 1.0))
        steepness = np.nan_to_num(
            logs / np.log(np.clip(small, 0.0, 1.0)), nan=1.0, posinf=np.inf
        )
    # The ratio of both logarithms grows with b, from 1 to that of the galleries.
    low, high = np.full(large.shape, _LOG_RANGE[0]), np.full(large.shape, _LOG_RANGE[1])
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        scale = np.exp(middle)
        below = np.log1p(second / scale) < steepness * np.log1p(first / scale)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    scale = np.exp(0.5 * (low + high))
    rate = np.exp(logs * (np.log1p(wanted / scale) / np.log1p(second / scale)))
    return np.asarray(np.where(np.isnan(large) | np.isnan(small), np.nan, rate))


def reach(measured: int) -> int:
    """Return the largest gallery to predict from a measured gallery; 0 for none.

    At most `REACH` times as large, and such that a step of the same ratio fits within
    the measured gallery: from galleries of `FEWEST` and more.
    """
    most = min(REACH * measured, measured * measured // (REACH * FEWEST))
    return most if most > measured else 0
