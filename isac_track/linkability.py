"""The scorecard of linkage attacks: who is who across two pseudonymous releases.

A *search* holds the scores of P probes, the people of one release, against the gallery, the G
people of another; the *mate* of a probe is the same person. Everything here is a pure function of
scores and mates. Rank metrics ask where the mate stands among the gallery, score metrics how well
one threshold, or the score as evidence, tells mated from non-mated pairs.

Ties carry no information: rank metrics are expectations under a random order of equal scores, and
assignments are made in a random order of the columns. Where an attack's scores are all equal, every
metric is at chance.

Numba is imported, and its loops compiled, at the first scorecard or shuffle, not before.

References
----------
Ranks: Grother and Phillips, CVPR 2004 (cumulative match characteristic). Likelihood ratios:
Bruemmer and du Preez, Computer Speech and Language 20, 2006 (Cllr). Hull: Fawcett and
Niculescu-Mizil, Machine Learning 68, 2007 (the ROC's hull is isotonic regression). D_sys:
Gomez-Barrero, Galbally, Rathgeb, Busch, IEEE TIFS 13(6), 2018. Residual risk: Giomi, Boenisch,
Wehmeyer, Tasnadi, PoPETs 2023(2). Pairs of resampled clusters: Snijders and Borgatti, Connections
22(2), 1999; Owen, Annals of Applied Statistics 1(2), 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from scipy.optimize import isotonic_regression, linear_sum_assignment
from scipy.special import bdtrc, betaincinv, expit, gammaln, xlog1py, xlogy

from isac_track.intervals import (
    Estimate,
    cluster_sums,
    percentile_interval,
    ratio_estimate,
    wilson,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isac_track.types import Bools, Floats, Ints

Outcome: TypeAlias = Literal["links", "no link detected", "attack too weak"]

SCORE_REPLICATES = 250
"""Bootstrap replicates of score metrics; one visits every pair, where a rank metric visits every
probe. The ends of a 95 % interval from 400 replicates have a standard error of 0.15 standard
deviations of the estimate (0.09 from 1,000)."""

MIN_EXPECTED = 10
"""A TPR at the FPR alpha needs 10 / alpha non-mated scores: ten above the threshold."""

LEVEL = 0.05
"""Of the tests."""

SLOPE_PENALTY = 1e-6
"""Of the squared slope per standard deviation of the score, where each class weighs 1: it keeps the
slope finite where the classes do not overlap, and otherwise changes nothing that matters."""

_LEVELS = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
_COLUMNS = ("auc", "eer", "cllr_min", "tpr_at_fpr_1pct", "", "tpr_at_fpr_01pct", "", "d_sys")
_FITTED = {"eer": 0.5, "cllr_min": 1.0}
"""Metrics whose hull is fitted to the very scores that it judges, and their upper bounds."""
_NO_SPREAD = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """Scores of P probes against one gallery of G releases.

    Raises
    ------
    ValueError
        If a shape is wrong, a score is not finite, a mate is no column or two probes share one, or
        a cluster is negative.
    """

    scores: Floats
    """(P, G) the higher, the rather the same person; finite."""
    mate: Ints
    """(P,) column of the probe's mate; -1 if it has none in this gallery (open set)."""
    probe_cluster: Ints
    """(P,) cluster (person or walking group) of each probe."""
    gallery_cluster: Ints
    """(G,)"""
    scale: int = 0
    """Searches of one scale come from one fitted attack: their scores compare."""

    def __post_init__(self) -> None:
        _check_scores(self.scores, self.mate)
        n_probes, n_gallery = self.scores.shape
        for name, cluster, n in (
            ("probe_cluster", self.probe_cluster, n_probes),
            ("gallery_cluster", self.gallery_cluster, n_gallery),
        ):
            if cluster.shape != (n,) or cluster.dtype.kind not in "iu":
                raise ValueError(f"{name} must be integers of shape ({n},), got {cluster.shape}")
            if cluster.min() < 0:
                raise ValueError(f"{name} must not be negative")


@dataclass(frozen=True, slots=True)
class Calibration:
    """Log-likelihood ratio = slope * score + intercept, in natural units (nats)."""

    slope: float
    """Not negative: a higher score never speaks against the same person."""
    intercept: float


@dataclass(frozen=True, eq=False, slots=True)
class Scorecard:
    """How well one attack links, over all of its searches."""

    estimates: dict[str, Estimate]
    """By metric; NaN where undefined or refused. See `scorecard`."""
    p_value: float
    """Of `permutation_p`."""
    p_rank1: float
    """Of `rank1_p`."""
    n_probes: int
    n_mated: int
    """Probes with a mate."""
    gallery_sizes: tuple[int, int, float]
    """Smallest, largest, and mean over searches."""
    n_clusters: int
    """Clusters with a mated probe."""
    realised_fpr_1pct: float
    realised_fpr_01pct: float
    """FPR at the operating points of the TPR, the mean over scales; NaN where that is refused."""
    d_sys_bins: int
    """The fewest over scales."""
    is_inverted: bool
    """AUC < 0.5: mates score low. D_sys, which ignores direction, may say linkable all the same."""
    minimum_detectable_rank1: float
    """What the test of rank 1 would find in 8 of 10 studies of this size."""


def _check_scores(scores: Floats, mate: Ints) -> None:
    if scores.ndim != 2 or 0 in scores.shape:  # noqa: PLR2004
        raise ValueError(f"scores must have shape (P, G), neither 0, got {scores.shape}")
    if not np.isfinite(scores).all():
        raise ValueError("scores must be finite")
    n_probes, n_gallery = scores.shape
    if mate.shape != (n_probes,) or mate.dtype.kind not in "iu":
        raise ValueError(f"mate must be integers of shape ({n_probes},), got {mate.shape}")
    mated = mate[mate != -1]
    if mated.size and not 0 <= mated.min() <= mated.max() < n_gallery:
        raise ValueError(f"mates must be columns, 0..{n_gallery - 1}, or -1 for none")
    if np.unique(mated).size != mated.size:
        raise ValueError("two probes must not share a mate")


# ------------------------------------------------------------------------------------ ranks


def rank1(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected hit of each probe, (P,): 1 / t if its mate is among t at the top.

    NaN for a probe without a mate.

    Parameters
    ----------
    scores : (P, G)
    mate : (P,)
        As in `Search`.

    Raises
    ------
    ValueError
        As `Search`.
    """
    _check_scores(scores, mate)
    return _rank1(*_standing(scores, mate), mate)


def reciprocal_rank(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected 1 / rank of each probe's mate, (P,); NaN for one without.

    Parameters and errors are those of `rank1`.
    """
    _check_scores(scores, mate)
    return _reciprocal_rank(*_standing(scores, mate), mate, scores.shape[1])


def log_rank(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected -log(rank / G) of each probe's mate, (P,); NaN for one without.

    Zero at the bottom, log G at the top: every halving of the rank counts the same, in galleries of
    any size. The expectation is over a random order of ties, as in all rank metrics here; the
    logarithm of a mid-rank would rate a tie above what it is worth.

    Parameters and errors are those of `rank1`.
    """
    _check_scores(scores, mate)
    above, tied = _standing(scores, mate)
    n_gallery = scores.shape[1]
    log_factorial = _log_factorial(n_gallery)
    spread = log_factorial[above + tied] - log_factorial[above]
    expected: Floats = math.log(n_gallery) - spread / tied
    expected[mate < 0] = np.nan
    return expected


def mean_log_rank(searches: Sequence[Search]) -> float:
    """Return the mean `log_rank` over the mated probes of all searches; NaN without one."""
    values = np.concatenate([log_rank(scores=s.scores, mate=s.mate) for s in searches])
    values = values[~np.isnan(values)]
    return float(values.mean()) if values.size else float("nan")


def cmc(searches: Sequence[Search]) -> Floats:
    """Return the cumulative match characteristic, (K,): the expected share of ranks <= 1..K.

    Over the mated probes of all searches; K is the size of the smallest gallery. NaN without a
    mated probe.
    """
    k = np.arange(1, min(search.scores.shape[1] for search in searches) + 1)
    rows = []
    for search in searches:
        above, tied = _standing(search.scores, search.mate)
        hit = np.clip((k - above[:, None]) / tied[:, None], 0.0, 1.0)
        rows.append(hit[search.mate >= 0])
    hits = np.concatenate(rows)
    if not hits.size:
        return np.full(k.size, np.nan)
    curve: Floats = hits.mean(axis=0)
    return curve


def assign(
    *, scores: Floats, rng: np.random.Generator, no_match_score: float | None = None
) -> Ints:
    """Return the column assigned to each probe, (P,), at most one probe a column; -1 for none.

    The sum of the assigned scores is the largest there is. The columns are put in a random order
    first, so that ties cannot tell the mate by its place.

    Parameters
    ----------
    scores : (P, G)
    rng : Generator
        One permutation of G is drawn.
    no_match_score : float, optional
        What leaving a probe unassigned scores; a pair must score more. Default: every probe is
        assigned, as far as the gallery reaches.

    Raises
    ------
    ValueError
        If the scores have no shape (P, G) or are not finite.
    """
    _check_scores(scores, np.full(len(scores), -1))
    return _assign(scores, rng, no_match_score)


def _assign(scores: Floats, rng: np.random.Generator, no_match_score: float | None) -> Ints:
    order = rng.permutation(scores.shape[1])
    gain = scores[:, order]
    if no_match_score is not None:
        # As good as a column of its own for every probe, and half the matrix: a probe that would
        # be left alone may as well take a column where it gains nothing.
        gain = np.maximum(gain - no_match_score, 0.0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    assigned = np.full(scores.shape[0], -1)
    assigned[rows] = order[columns]
    if no_match_score is not None:
        assigned[rows[gain[rows, columns] <= 0.0]] = -1
    return assigned


def chance(searches: Sequence[Search]) -> float:
    """Return the expected rank-1 rate of guessing: the mean of 1 / G over mated probes."""
    chances = np.concatenate([_chances(search) for search in searches])
    return float(chances.mean()) if chances.size else float("nan")


def residual_risk(*, success: float, control: float) -> float:
    """Return (success - control) / (1 - control): what an attack adds to its control.

    Negative where the attack is worse, 1 where it always succeeds, NaN where the control does.
    """
    return (success - control) / (1.0 - control) if control != 1.0 else float("nan")


def _chances(search: Search) -> Floats:
    return np.full(int((search.mate >= 0).sum()), 1.0 / search.scores.shape[1])


def _rank1(above: Ints, tied: Ints, mate: Ints) -> Floats:
    hit = np.where(above == 0, 1.0 / tied, 0.0)
    hit[mate < 0] = np.nan
    return hit


def _reciprocal_rank(above: Ints, tied: Ints, mate: Ints, n_gallery: int) -> Floats:
    harmonic = np.concatenate([[0.0], np.cumsum(1.0 / np.arange(1, n_gallery + 1))])
    expected: Floats = (harmonic[above + tied] - harmonic[above]) / tied
    expected[mate < 0] = np.nan
    return expected


def _standing(scores: Floats, mate: Ints) -> tuple[Ints, Ints]:
    """Return how many score above each probe's mate, and how many as high, itself included."""
    own = scores[np.arange(mate.size), mate][:, None]
    return (scores > own).sum(axis=1), (scores == own).sum(axis=1)


def _log_factorial(n: int) -> Floats:
    return np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, n + 1)))])


# ----------------------------------------------------------------------------------- scores


def auc(*, mated: Floats, non_mated: Floats) -> float:
    """Return the share of pairs in which the mated score is higher; ties count half.

    Parameters
    ----------
    mated, non_mated : (M,), (N,)
        Scores of either class.

    Raises
    ------
    ValueError
        If a class is empty or a score is not finite.
    """
    _check_classes(mated, non_mated)
    ordered = np.sort(non_mated)
    below = np.searchsorted(ordered, mated, side="left")
    not_above = np.searchsorted(ordered, mated, side="right")
    return float((below + not_above).sum() / (2.0 * mated.size * non_mated.size))


def roc_hull(*, mated: Floats, non_mated: Floats) -> tuple[Floats, Floats]:
    """Return FPR and TPR, (H,) each, on the convex hull of the ROC, from (0, 0) to (1, 1).

    Parameters and errors are those of `auc`.
    """
    true, false = _hull_steps(mated, non_mated)
    return (
        np.concatenate([[0.0], np.cumsum(false)]),
        np.concatenate([[0.0], np.cumsum(true)]),
    )


def eer(*, mated: Floats, non_mated: Floats) -> float:
    """Return the equal error rate on the ROC's convex hull, 0..0.5: there 1 - TPR = FPR.

    The hull is what an attacker attains who may toss a coin between two thresholds.

    Parameters and errors are those of `auc`.
    """
    fpr, tpr = roc_hull(mated=mated, non_mated=non_mated)
    gap = tpr + fpr - 1.0  # rises from -1 to 1
    end = int(np.argmax(gap >= 0.0))
    step = gap[end - 1] / (gap[end - 1] - gap[end])
    return float(fpr[end - 1] + step * (fpr[end] - fpr[end - 1]))


def tpr_at_fpr(*, mated: Floats, non_mated: Floats, alpha: float) -> tuple[float, float]:
    """Return the largest TPR of a threshold with FPR <= alpha, and the FPR of that threshold.

    Of the thresholds with that TPR it is the highest: the lowest mated score that it accepts.

    Parameters
    ----------
    mated, non_mated : (M,), (N,)
    alpha : float
        In (0, 1).

    Returns
    -------
    (float, float)
        NaN twice for fewer than 10 / alpha non-mated scores (`MIN_EXPECTED`).

    Raises
    ------
    ValueError
        As `auc`, and for alpha out of range.
    """
    _check_classes(mated, non_mated)
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must lie in (0, 1), got {alpha}")
    if _is_refused(non_mated.size, alpha):
        return float("nan"), float("nan")
    thresholds = np.unique(mated)
    fpr = 1.0 - np.searchsorted(np.sort(non_mated), thresholds, side="left") / non_mated.size
    allowed = np.flatnonzero(fpr <= alpha + 1e-12)
    if not allowed.size:
        return 0.0, 0.0
    best = allowed[0]
    return float((mated >= thresholds[best]).mean()), float(fpr[best])


def fit_calibration(*, mated: Floats, non_mated: Floats) -> Calibration:
    """Return the calibration of scores as log-likelihood ratios, by logistic regression.

    Both classes weigh the same in all, which is prior odds of 1. A score that speaks against the
    same person gets the slope 0, and so does one that is constant: then every LLR is 0, which is no
    evidence. Classes that do not overlap get a steep, finite slope (`SLOPE_PENALTY`).

    Parameters
    ----------
    mated, non_mated : (M,), (N,)
        Of people other than those whom the calibration is to judge.

    Raises
    ------
    ValueError
        As `auc`.

    References
    ----------
    Bruemmer and du Preez, Computer Speech and Language 20, 2006.
    """
    _check_classes(mated, non_mated)
    scores = np.concatenate([mated, non_mated])
    centre, spread = float(scores.mean()), float(scores.std())
    if not spread > 0:
        return Calibration(0.0, 0.0)
    design = np.stack([(scores - centre) / spread, np.ones(scores.size)])
    sign = np.repeat([1.0, -1.0], [mated.size, non_mated.size])
    mass = np.repeat([1.0 / mated.size, 1.0 / non_mated.size], [mated.size, non_mated.size])

    def loss(parameters: Floats) -> float:
        cost = mass @ np.logaddexp(0.0, -sign * (parameters @ design))
        return float(cost + SLOPE_PENALTY / 2 * parameters[0] ** 2)

    parameters = np.zeros(2)
    current = loss(parameters)
    for _ in range(100):
        wrong = expit(-sign * (parameters @ design))
        gradient = -design @ (mass * sign * wrong)
        gradient[0] += SLOPE_PENALTY * parameters[0]
        curvature = (design * (mass * wrong * (1 - wrong))) @ design.T
        # The intercept gets a little of it too, lest rounding make the matrix singular.
        curvature += np.diag([SLOPE_PENALTY, 1e-12])
        step = np.linalg.solve(curvature, gradient)
        length = 1.0
        while (new := loss(parameters - length * step)) > current and length > 1e-6:  # noqa: PLR2004
            length /= 2
        if new > current:
            break
        parameters -= length * step
        converged = current - new < 1e-14  # noqa: PLR2004
        current = new
        if converged:
            break
    if parameters[0] <= 0:
        return Calibration(0.0, 0.0)
    slope = float(parameters[0]) / spread
    return Calibration(slope, float(parameters[1]) - slope * centre)


def cllr(*, llr_mated: Floats, llr_non_mated: Floats) -> float:
    """Return the cost of log-likelihood ratios (nats in) as evidence, in bits.

    0 for a perfect attack, 1 for one that says nothing (every LLR 0), more for one that misleads.

    Raises
    ------
    ValueError
        As `auc`.

    References
    ----------
    Bruemmer and du Preez, Computer Speech and Language 20, 2006, eq. of C_llr.
    """
    _check_classes(llr_mated, llr_non_mated)
    cost = np.logaddexp(0.0, -llr_mated).mean() + np.logaddexp(0.0, llr_non_mated).mean()
    return float(cost) / (2.0 * math.log(2.0))


def cllr_min(*, mated: Floats, non_mated: Floats) -> float:
    """Return `cllr` after the best monotone calibration of these very scores, 0..1 bits.

    Parameters and errors are those of `auc`. It is optimistic: the calibration has seen the answer.
    """
    true, false = _hull_steps(mated, non_mated)
    both = true + false
    return float((xlogy(both, both) - xlogy(true, true) - xlogy(false, false)).sum()) / (
        2.0 * math.log(2.0)
    )


def d_sys(*, mated: Floats, non_mated: Floats, n_bins: int | None = None) -> tuple[float, int]:
    """Return the system's linkability D_sys, 0..1, and the number of bins.

    With the likelihood ratio LR(s) = p(s | mated) / p(s | non-mated) of histograms over the joint
    range, D(s) = 2 LR / (1 + LR) - 1 where LR > 1 and 0 elsewhere; D_sys is the mean of D over
    mated scores. It lies between TV / 2 and TV, the total variation of the two histograms: p D is
    (p - q) p / (p + q), and p / (p + q) lies between 1/2 and 1 where p > q. It ignores direction,
    and is biased upwards where scores are few.

    Parameters
    ----------
    mated, non_mated : (M,), (N,)
    n_bins : int, optional
        Default: one a ten mated scores, at least 1, at most 100.

    Raises
    ------
    ValueError
        As `auc`, and for `n_bins` below 1.

    References
    ----------
    Gomez-Barrero, Galbally, Rathgeb, Busch, IEEE TIFS 13(6), 2018, with prior odds of 1.
    """
    _check_classes(mated, non_mated)
    if n_bins is None:
        n_bins = _n_bins(mated.size)
    if n_bins < 1:
        raise ValueError(f"n_bins must be at least 1, got {n_bins}")
    low = min(float(mated.min()), float(non_mated.min()))
    high = max(float(mated.max()), float(non_mated.max()))
    edges = _inner_edges(low, high, n_bins)
    p, q = (
        np.bincount(np.searchsorted(edges, x, side="right"), minlength=n_bins) / x.size
        for x in (mated, non_mated)
    )
    linked = p > q
    p, q = p[linked], q[linked]
    return float((p * (p - q) / (p + q)).sum()), n_bins


def _n_bins(n_mated: int) -> int:
    return max(1, min(n_mated // 10, 100))


def _inner_edges(low: float, high: float, n_bins: int) -> Floats:
    return np.linspace(low, high, n_bins + 1)[1:-1]


def _is_refused(n_non_mated: int, alpha: float) -> bool:
    return n_non_mated * alpha < MIN_EXPECTED * (1 - 1e-12)


def _check_classes(mated: Floats, non_mated: Floats) -> None:
    for name, scores in (("mated", mated), ("non-mated", non_mated)):
        if scores.ndim != 1 or not scores.size:
            raise ValueError(f"{name} scores must have shape (N,), N > 0, got {scores.shape}")
        if not np.isfinite(scores).all():
            raise ValueError(f"{name} scores must be finite")


def _hull_steps(mated: Floats, non_mated: Floats) -> tuple[Floats, Floats]:
    """Return the steps in TPR and in FPR along the hull of the ROC, from the highest score."""
    _check_classes(mated, non_mated)
    distinct, place = np.unique(np.concatenate([mated, non_mated]), return_inverse=True)
    true = np.bincount(place[: mated.size], minlength=distinct.size) / mated.size
    false = np.bincount(place[mated.size :], minlength=distinct.size) / non_mated.size
    both = true + false
    starts = isotonic_regression(true / both, weights=both).blocks[:-1]
    return np.add.reduceat(true, starts)[::-1], np.add.reduceat(false, starts)[::-1]


# ------------------------------------------------------------------------------------ tests


def shuffled_mates(*, search: Search, rng: np.random.Generator, n: int) -> Ints:
    """Return n sets of random mates, (n, P): distinct columns, uniform; -1 where there is none.

    One uniform number a set and mated probe is drawn.
    """
    probes = np.flatnonzero(search.mate >= 0)
    mates = np.full((n, search.mate.size), -1)
    uniform = rng.random((n, probes.size))
    _loops().draw_mates(uniform, probes, search.scores.shape[1], mates)
    return mates


def permutation_p(
    *, searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int = 999
) -> float:
    """Return the one-sided p-value of `mean_log_rank` against random mates.

    (1 + #{shuffled >= observed}) / (1 + n_shuffles), which is valid for any number of shuffles,
    where under the null every set of distinct mates is as likely as any other, whatever the scores.
    1 without a mated probe.

    Parameters
    ----------
    searches : sequence of Search
    rng : Generator
        As for `shuffled_mates`, search by search.
    n_shuffles : int, optional
        At least 999.

    Raises
    ------
    ValueError
        Without a search or for too few shuffles.

    References
    ----------
    Phipson and Smyth, Statistical Applications in Genetics and Molecular Biology 9(1), 2010.
    """
    _check_searches(searches, n_shuffles)
    null, observed = np.zeros(n_shuffles), 0.0
    for search in searches:
        scores = np.ascontiguousarray(search.scores, dtype=np.float64)
        ranks, cells = _ranks_and_cells(scores, np.empty(0))
        mates = shuffled_mates(search=search, rng=rng, n=n_shuffles)
        _loops().shuffled(
            mates, ranks, cells, np.zeros(1, dtype=np.int64), null, np.zeros((n_shuffles, 1))
        )
        observed += _mates_of(ranks, search.mate).sum()
    return _p_value(float(observed), null)


def rank1_p(*, hits: Floats, chance: Floats) -> float:
    """Return the p-value of so many hits at rank 1 or more, if all are guesses.

    Exact for independent probes: binomial where all have one chance, else Poisson-binomial. A
    fraction of a hit, left by ties, does not count: the sum is rounded down. 1 without a probe.

    Parameters
    ----------
    hits : (N,)
        From `rank1`, mated probes only.
    chance : (N,)
        Chance of each, 1 / G.

    Raises
    ------
    ValueError
        If shapes differ, or a hit or a chance lies outside of 0..1.
    """
    if hits.shape != chance.shape or hits.ndim != 1:
        raise ValueError(
            f"hits and chance must have one shape (N,), got {hits.shape}, {chance.shape}"
        )
    both = np.concatenate([hits, chance])
    if not ((both >= 0) & (both <= 1)).all():
        raise ValueError("hits and chance must lie in 0..1")
    # Three thirds are a hit, whatever rounding made of them.
    n_hits = math.floor(float(hits.sum()) + 1e-9)
    if n_hits == 0:
        return 1.0
    values, counts = np.unique(chance, return_counts=True)
    if values.size == 1:
        return float(bdtrc(n_hits - 1, hits.size, values[0]))
    law = np.ones(1)
    for value, count in zip(values, counts, strict=True):
        law = np.convolve(law, _binomial(int(count), float(value)))
    return min(1.0, float(law[n_hits:].sum()))


def minimum_detectable_rank1(
    *, n: int, chance: float, alpha: float = LEVEL, power: float = 0.8
) -> float:
    """Return the smallest rank-1 rate that the exact binomial test finds with this power.

    Infinity where no rate does: not even n hits of n are significant.

    Parameters
    ----------
    n : int
        Mated probes, taken as independent.
    chance : float
        Rank-1 rate of guessing, 0..1.
    alpha, power : float
        In (0, 1).

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    if n < 0 or not 0 <= chance <= 1 or not 0 < alpha < 1 or not 0 < power < 1:
        raise ValueError(
            "need n >= 0, chance in 0..1 and alpha and power in (0, 1), got "
            f"{n}, {chance}, {alpha}, {power}"
        )
    significant = np.flatnonzero(bdtrc(np.arange(n), n, chance) <= alpha)
    if not significant.size:
        return math.inf
    hits = int(significant[0]) + 1
    # P(hits or more of n) is the regularised incomplete beta function of the rate.
    return float(betaincinv(hits, n - hits + 1, power))


def outcome(*, p_value: float, ceiling_p_value: float, level: float = LEVEL) -> Outcome:
    """Return what a test says, given the same attack's p-value on unperturbed tracks.

    An attack that cannot link even those says nothing of a mechanism by failing.

    Raises
    ------
    ValueError
        If a p-value is not in 0..1.
    """
    for p in (p_value, ceiling_p_value):
        if not 0 <= p <= 1:
            raise ValueError(f"a p-value lies in 0..1, got {p}")
    if p_value <= level:
        return "links"
    return "attack too weak" if ceiling_p_value > level else "no link detected"


def _binomial(n: int, p: float) -> Floats:
    k = np.arange(n + 1)
    log_choose = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    law: Floats = np.exp(log_choose + xlogy(k, p) + xlog1py(n - k, -p))
    return law


def _p_value(observed: float, null: Floats) -> float:
    # Sums of the same numbers in another order may differ by rounding; they are ties.
    return (1 + int((null >= observed - 1e-9).sum())) / (1 + null.size)


def _check_searches(searches: Sequence[Search], n_shuffles: int) -> None:
    if not searches:
        raise ValueError("at least one search is needed")
    if n_shuffles < 999:  # noqa: PLR2004
        raise ValueError(f"n_shuffles must be at least 999, got {n_shuffles}")


# -------------------------------------------------------------------------------- scorecard


@dataclass(frozen=True, eq=False, slots=True)
class _Trial:
    """What one search gives beside its scores."""

    scores: Floats
    """(P, G) contiguous"""
    mate: Ints
    probe_cluster: Ints
    """Renumbered: 0..C - 1 are the clusters that occur."""
    gallery_cluster: Ints
    scale: int
    hit: Floats
    reciprocal: Floats
    assigned: Ints
    mates: Ints
    """(n_shuffles, P)"""


@dataclass(frozen=True, eq=False, slots=True)
class _Scale:
    """Score metrics of one scale."""

    columns: Floats
    """(R, 10) as the loop writes them; row 0 is the data, the others are replicates."""
    cllr: Floats
    """(R,)"""
    null_d_sys: Floats
    """(n_shuffles,)"""
    n_mated: int
    n_non_mated: int
    n_bins: int


def scorecard(
    searches: Sequence[Search],
    *,
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Mapping[int, float] | None,
    rng: np.random.Generator,
    n_shuffles: int = 999,
) -> Scorecard:
    """Return every metric of one attack with its interval.

    | metric | what it is |
    |---|---|
    | rank1, mrr | `rank1`, `reciprocal_rank`: mean over mated probes |
    | rank1_assigned | share of mated probes to which `assign` gives their mate |
    | false_link_rate | share of probes without a mate that get somebody; only if there are any |
    | chance, residual_risk | `chance`, and `residual_risk` of rank1 against it |
    | auc, eer, cllr, cllr_min | as the functions; cllr needs `calibration` |
    | tpr_at_fpr_1pct, tpr_at_fpr_01pct | `tpr_at_fpr`; refused on all non-mated pairs together |
    | d_sys, d_sys_corrected | `d_sys`, and less its mean under shuffled mates |

    Rank metrics pool the probes of all searches. Score metrics pool the scores within a scale, a
    non-mated pair being of one search; over scales they are averaged, weighted by mated probes.

    Intervals resample clusters. For rank metrics the galleries stay as they are (`ratio_estimate`).
    A mated score weighs w, how often its probe's cluster is drawn, a non-mated score the product of
    its two clusters' w. Two people of one cluster who are no mates weigh w, not w^2: the pair is
    drawn as often as the cluster, and a pair of a cluster with its own copy is not one that any
    population holds. Score metrics take the first `SCORE_REPLICATES` rows of `weights`.

    Intervals are percentile intervals, but those of eer and cllr_min basic ones, 2 value - quantile
    (Davison and Hinkley, 1997, ch. 5.2). Both are read off a hull that is fitted to the scores, and
    come out too low; replicates come out lower still, and a percentile interval would miss twice.

    Away from chance, intervals at 95 % of 40 clusters hold the population's value in 92 to 95 % of
    studies, those of eer and cllr_min in 89 to 91 %, that of the TPR in 97 % (the tests measure
    it). At chance, where eer, cllr_min and d_sys are at their bounds, and for an AUC near 1, they
    hold it far less often: whether there is a link at all is for `p_value` to say.

    A metric that is bounded by 0 and 1 and does not vary over replicates (a perfect AUC) has
    Wilson's interval, with the clusters as the sample size: of all variables in 0..1 a mean of 0 or
    1 says least about a coin. With fewer than two clusters there is no interval.

    Parameters
    ----------
    searches : sequence of Search
        At least one.
    weights : (B, C)
        From `cluster_weights`; the clusters of `searches` are its columns.
    calibration : mapping of scale to Calibration, or None
        Fitted on other people. Without it `cllr` is NaN.
    no_match_score : mapping of scale to float, or None
        As in `assign`. Without it every probe is assigned.
    rng : Generator
        Draws, search by search, the order of columns for `assign`, then `shuffled_mates`.
    n_shuffles : int, optional
        At least 999; for `permutation_p` and `d_sys_corrected`.

    Raises
    ------
    ValueError
        Without a search, for too few shuffles, for clusters beyond `weights`, or if a mapping lacks
        a scale.
    """
    _check_searches(searches, n_shuffles)
    _check_scales(searches, calibration, no_match_score)
    used = _used_clusters(searches, weights)
    trials = [
        _trial(search, used, no_match_score, rng=rng, n_shuffles=n_shuffles) for search in searches
    ]
    scales = sorted({search.scale for search in searches})
    tables, rows = _tables(weights[:SCORE_REPLICATES, used])
    null, observed = np.zeros(n_shuffles), 0.0
    results = []
    for scale in scales:
        group = [trial for trial in trials if trial.scale == scale]
        calibrated = calibration[scale] if calibration is not None else None
        result, log_ranks = _score_scale(group, tables, rows, calibrated, null)
        results.append(result)
        observed += log_ranks

    has_mate = np.concatenate([trial.mate >= 0 for trial in trials])
    clusters = np.concatenate([search.probe_cluster for search in searches])
    n_clusters = int(np.unique(clusters[has_mate]).size)
    chances = np.concatenate([_chances(search) for search in searches])
    hits = np.concatenate([trial.hit for trial in trials])[has_mate]
    estimates = _rank_estimates(trials, clusters, chances, weights)
    estimates |= _score_estimates(results, n_clusters)
    n_mated = int(has_mate.sum())
    sizes = [search.scores.shape[1] for search in searches]
    return Scorecard(
        estimates=estimates,
        p_value=_p_value(observed, null),
        p_rank1=rank1_p(hits=hits, chance=chances),
        n_probes=has_mate.size,
        n_mated=n_mated,
        gallery_sizes=(min(sizes), max(sizes), sum(sizes) / len(sizes)),
        n_clusters=n_clusters,
        realised_fpr_1pct=_realised(results, 6, 0.01),
        realised_fpr_01pct=_realised(results, 8, 0.001),
        d_sys_bins=min(result.n_bins for result in results),
        is_inverted=bool(estimates["auc"].value < 0.5),  # noqa: PLR2004
        minimum_detectable_rank1=minimum_detectable_rank1(
            n=n_mated, chance=float(chances.mean()) if n_mated else 1.0
        ),
    )


def _check_scales(
    searches: Sequence[Search],
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Mapping[int, float] | None,
) -> None:
    for name, mapping in (("calibration", calibration), ("no_match_score", no_match_score)):
        missing = {search.scale for search in searches}.difference(
            mapping if mapping is not None else {search.scale for search in searches}
        )
        if missing:
            raise ValueError(f"{name} lacks the scales {sorted(missing)}")


def _used_clusters(searches: Sequence[Search], weights: Floats) -> Ints:
    used = np.unique(
        np.concatenate([np.concatenate([s.probe_cluster, s.gallery_cluster]) for s in searches])
    )
    if weights.ndim != 2 or used[-1] >= weights.shape[1]:  # noqa: PLR2004
        raise ValueError(f"weights must be (B, C), C > {used[-1]}, got {weights.shape}")
    return used.astype(np.int64, copy=False)


def _trial(
    search: Search,
    used: Ints,
    no_match_score: Mapping[int, float] | None,
    *,
    rng: np.random.Generator,
    n_shuffles: int,
) -> _Trial:
    scores = np.ascontiguousarray(search.scores, dtype=np.float64)
    mate = np.ascontiguousarray(search.mate, dtype=np.int64)
    above, tied = _standing(scores, mate)
    no_match = no_match_score[search.scale] if no_match_score is not None else None
    return _Trial(
        scores=scores,
        mate=mate,
        probe_cluster=np.searchsorted(used, search.probe_cluster),
        gallery_cluster=np.searchsorted(used, search.gallery_cluster),
        scale=search.scale,
        hit=_rank1(above, tied, mate),
        reciprocal=_reciprocal_rank(above, tied, mate, scores.shape[1]),
        assigned=_assign(scores, rng, no_match),
        mates=shuffled_mates(search=search, rng=rng, n=n_shuffles),
    )


def _tables(weights: Floats) -> tuple[Floats, Floats]:
    """Return the weights as the loop wants them, (chunks, C + 1, lanes), and as rows, (C, R).

    Replicate 0 weighs every cluster once: the data. The loop's last cluster always weighs 1.
    """
    lanes = _loops().LANES
    n_replicates, n_clusters = 1 + weights.shape[0], weights.shape[1]
    n_chunks = -(-n_replicates // lanes)
    padded = np.ones((n_chunks * lanes, n_clusters + 1))
    padded[1:n_replicates, :-1] = weights
    tables = padded.reshape(n_chunks, lanes, -1).transpose(0, 2, 1)
    return np.ascontiguousarray(tables), np.ascontiguousarray(padded[:n_replicates, :-1].T)


def _score_scale(
    trials: Sequence[_Trial],
    tables: Floats,
    rows: Floats,
    calibration: Calibration | None,
    null: Floats,
) -> tuple[_Scale, float]:
    """Return the score metrics of one scale, and the sum of its log-ranks; add those of `null`."""
    loops = _loops()
    mated = np.concatenate([_mates_of(t.scores, t.mate) for t in trials])
    n_bins = _n_bins(mated.size)
    edges = _inner_edges(
        min(float(t.scores.min()) for t in trials),
        max(float(t.scores.max()) for t in trials),
        n_bins,
    )
    breaks = np.unique(np.concatenate([mated, edges]))
    bins = np.zeros(2 * breaks.size + 1, dtype=np.int64)
    bins[1::2] = np.searchsorted(edges, breaks, side="right")
    bins[2::2] = bins[1::2]

    counts = np.zeros(bins.size, dtype=np.int64)
    null_bins = np.zeros((null.size, n_bins))
    log_ranks = 0.0
    cells = []
    for trial in trials:
        ranks, cell = _ranks_and_cells(trial.scores, breaks)
        cells.append(cell)
        loops.count_cells(cell, trial.mate, counts)
        loops.shuffled(trial.mates, ranks, cell, bins, null, null_bins)
        log_ranks += float(_mates_of(ranks, trial.mate).sum())
    n_non_mated = int(counts.sum())

    mated_cells = np.concatenate(
        [_mates_of(cell, t.mate) for cell, t in zip(cells, trials, strict=True)]
    )
    total_bins = np.bincount(bins, weights=counts, minlength=n_bins)
    total_bins += np.bincount(bins[mated_cells], minlength=n_bins)
    null_d_sys = np.full(null.size, np.nan)
    if mated.size and n_non_mated:
        loops.linked_shares(null_bins, total_bins, null_d_sys)

    columns = _replicates(trials, cells, counts, mated_cells, bins, tables)
    return _Scale(
        columns=columns[: rows.shape[1]],
        cllr=_cllr_rows(trials, columns[: rows.shape[1]], rows, calibration),
        null_d_sys=null_d_sys,
        n_mated=mated.size,
        n_non_mated=n_non_mated,
        n_bins=n_bins,
    ), log_ranks


def _replicates(
    trials: Sequence[_Trial],
    cells: Sequence[Ints],
    counts: Ints,
    mated_cells: Ints,
    bins: Ints,
    tables: Floats,
) -> Floats:
    """Return what the loop of that name writes, with the chunks' empty rows at the end."""
    loops = _loops()
    stops = np.cumsum(counts)
    place = stops - counts
    first = np.empty(stops[-1], dtype=np.int64)
    second = np.empty_like(first)
    for trial, cell in zip(trials, cells, strict=True):
        loops.fill_cells(
            cell,
            trial.mate,
            trial.probe_cluster,
            trial.gallery_cluster,
            tables.shape[1] - 1,
            place,
            first,
            second,
        )
    occupied = counts > 0
    occupied[mated_cells] = True
    number = np.cumsum(occupied) - 1
    columns = np.empty((tables.shape[0] * loops.LANES, loops.COLUMNS))
    loops.replicates(
        tables,
        np.concatenate([[0], stops[occupied]]),
        first,
        second,
        number[mated_cells],
        _mated_clusters(trials),
        bins[occupied],
        *_LEVELS.values(),
        columns,
    )
    return columns


def _cllr_rows(
    trials: Sequence[_Trial], columns: Floats, rows: Floats, calibration: Calibration | None
) -> Floats:
    """Return `cllr` of every replicate, (R,)."""
    values = np.full(rows.shape[1], np.nan)
    if calibration is None:
        return values
    slope, intercept = calibration.slope, calibration.intercept
    non_mated_cost = np.zeros(rows.shape[1])
    for trial in trials:
        costs, within = np.empty(trial.scores.shape), np.empty(trial.mate.size)
        clusters = trial.probe_cluster, trial.gallery_cluster
        _loops().pair_costs(trial.scores, slope, intercept, trial.mate, *clusters, costs, within)
        of_probe = costs @ rows[trial.gallery_cluster]
        of_probe += within[:, None]
        non_mated_cost += np.einsum("pr,pr->r", of_probe, rows[trial.probe_cluster])
    mated = np.concatenate([_mates_of(t.scores, t.mate) for t in trials])
    mated_cost = np.bincount(
        _mated_clusters(trials),
        weights=np.logaddexp(0.0, -(slope * mated + intercept)),
        minlength=rows.shape[0],
    )
    defined = (columns[:, 0] > 0) & (columns[:, 1] > 0)
    both = (mated_cost @ rows)[defined] / columns[defined, 0]
    both += non_mated_cost[defined] / columns[defined, 1]
    values[defined] = both / (2.0 * math.log(2.0))
    return values


def _rank_estimates(
    trials: Sequence[_Trial], clusters: Ints, chances: Floats, weights: Floats
) -> dict[str, Estimate]:
    mate = np.concatenate([trial.mate for trial in trials])
    assigned = np.concatenate([trial.assigned for trial in trials])
    n_clusters = weights.shape[1]

    def mean(values: Floats, among: Bools, *, is_share: bool = True) -> Estimate:
        cluster = clusters[among]
        return ratio_estimate(
            numerator=cluster_sums(values=values, cluster=cluster, n_clusters=n_clusters),
            denominator=cluster_sums(
                values=np.ones(cluster.size), cluster=cluster, n_clusters=n_clusters
            ),
            weights=weights,
            is_share=is_share,
        )

    mated = mate >= 0
    hit = np.concatenate([trial.hit for trial in trials])[mated]
    reciprocal = np.concatenate([trial.reciprocal for trial in trials])[mated]
    success, control = mean(hit, mated), mean(chances, mated, is_share=False)
    estimates = {
        "rank1": success,
        "rank1_assigned": mean((assigned == mate)[mated].astype(np.float64), mated),
        "mrr": mean(reciprocal, mated),
        "chance": control,
        "residual_risk": _residual_risk_estimate(success, control),
    }
    if not mated.all():
        linked = (assigned[~mated] >= 0).astype(np.float64)
        estimates["false_link_rate"] = mean(linked, ~mated)
    return estimates


def _residual_risk_estimate(success: Estimate, control: Estimate) -> Estimate:
    value = residual_risk(success=success.value, control=control.value)
    replicates = np.full(success.replicates.size, np.nan)
    possible = control.replicates < 1.0
    np.divide(
        success.replicates - control.replicates,
        1.0 - control.replicates,
        out=replicates,
        where=possible,
    )
    if success.value in {0.0, 1.0}:
        # Wilson's ends for the share; guessing's chance is known.
        low, high = (
            residual_risk(success=end, control=control.value)
            for end in (success.ci_low, success.ci_high)
        )
    elif success.n < 2 or math.isnan(value):  # noqa: PLR2004
        low, high = math.nan, math.nan
    else:
        low, high = percentile_interval(replicates)
    return Estimate(value, low, high, success.n, replicates)


def _score_estimates(results: Sequence[_Scale], n_clusters: int) -> dict[str, Estimate]:
    estimates = {}
    n_non_mated = sum(result.n_non_mated for result in results)
    for column, name in enumerate(_COLUMNS, start=2):
        if name in _LEVELS and _is_refused(n_non_mated, _LEVELS[name]):
            values = np.full(results[0].cllr.size, np.nan)
        elif name:
            values = _over_scales(results, [r.columns[:, column] for r in results])
        else:
            continue
        estimates[name] = _estimate(name, values, n_clusters)
    values = _over_scales(results, [result.cllr for result in results])
    estimates["cllr"] = _estimate("cllr", values, n_clusters)

    linked = estimates["d_sys"]
    defined = [r for r in results if r.n_mated and r.n_non_mated]
    n_mated = sum(r.n_mated for r in defined)
    bias = (
        sum(r.n_mated * float(r.null_d_sys.mean()) for r in defined) / n_mated
        if defined
        else math.nan
    )
    estimates["d_sys_corrected"] = Estimate(
        value=linked.value - bias,
        ci_low=linked.ci_low - bias,
        ci_high=linked.ci_high - bias,
        n=linked.n,
        replicates=linked.replicates - bias,
    )
    return estimates


def _estimate(name: str, values: Floats, n: int) -> Estimate:
    """Return the estimate from the value of the data and, after it, those of replicates."""
    value, replicates = float(values[0]), values[1:].copy()
    if n < 2 or math.isnan(value):  # noqa: PLR2004
        return Estimate(value, math.nan, math.nan, n, replicates)
    spread = np.abs(replicates - value)
    is_constant = not (spread[~np.isnan(spread)] > _NO_SPREAD).any()
    is_extreme = name in _LEVELS and value in {0.0, 1.0}
    if name != "cllr" and (is_constant or is_extreme):
        low, high = wilson(hits=min(max(value, 0.0), 1.0) * n, n=n)
        return Estimate(value, low, min(high, _FITTED.get(name, 1.0)), n, replicates)
    low, high = percentile_interval(replicates)
    if name in _FITTED:
        low, high = max(0.0, 2 * value - high), min(_FITTED[name], 2 * value - low)
    return Estimate(value, low, high, n, replicates)


def _over_scales(results: Sequence[_Scale], values: Sequence[Floats]) -> Floats:
    """Return the mean over scales, weighted by each replicate's mass of mated scores."""
    total, mass = np.zeros(values[0].size), np.zeros(values[0].size)
    for result, value in zip(results, values, strict=True):
        weight = np.where(result.columns[:, 1] > 0, result.columns[:, 0], 0.0)
        total += np.where(weight > 0, value, 0.0) * weight
        mass += weight
    mean: Floats = np.full(total.size, np.nan)
    np.divide(total, mass, out=mean, where=mass > 0)
    return mean


def _realised(results: Sequence[_Scale], column: int, alpha: float) -> float:
    if _is_refused(sum(result.n_non_mated for result in results), alpha):
        return math.nan
    return float(_over_scales(results, [r.columns[:, column] for r in results])[0])


def _mates_of(table: Any, mate: Ints) -> Any:  # noqa: ANN401 - floats or ints, as they come
    probes = np.flatnonzero(mate >= 0)
    return table[probes, mate[probes]]


def _mated_clusters(trials: Sequence[_Trial]) -> Ints:
    return np.concatenate([t.probe_cluster[t.mate >= 0] for t in trials])


def _ranks_and_cells(scores: Floats, breaks: Floats) -> tuple[Floats, Ints]:
    """Return `log_rank` of every column were it the mate, and the cell of every score, (P, G)."""
    ranks, cells = np.empty(scores.shape), np.empty(scores.shape, dtype=np.int64)
    order = np.argsort(scores, axis=1)
    _loops().rank_rows(scores, order, breaks, _log_factorial(scores.shape[1]), ranks, cells)
    return ranks, cells


def _loops() -> Any:  # noqa: ANN401 - a module of compiled functions, which have no types
    return import_module("isac_track._linkability_loops")
