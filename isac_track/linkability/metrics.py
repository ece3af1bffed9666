"""Metrics and tests of linkage attacks: who is who across two pseudonymous releases.

A *search* holds the scores of P probes, the people of one release, against the gallery, the G
people of another; the *mate* of a probe is the same person. Everything here is a pure function of
scores and mates. Rank metrics ask where the mate stands among the gallery, score metrics how well
one threshold, or the score as evidence, tells mated from non-mated pairs.

Ties carry no information: rank metrics are expectations under a random order of equal scores, and
assignments are made in a random order of the columns. Where an attack's scores are all equal, every
metric is at chance.

Numba is imported, and its loops compiled, at the first shuffle, not before.

References
----------
Ranks: Grother and Phillips, CVPR 2004 (cumulative match characteristic). Likelihood ratios:
Bruemmer and du Preez, Computer Speech and Language 20, 2006 (Cllr). Hull: Fawcett and
Niculescu-Mizil, Machine Learning 68, 2007 (the ROC's hull is isotonic regression). D_sys:
Gomez-Barrero, Galbally, Rathgeb, Busch, IEEE TIFS 13(6), 2018. Residual risk: Giomi, Boenisch,
Wehmeyer, Tasnadi, PoPETs 2023(2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from scipy.optimize import isotonic_regression, linear_sum_assignment
from scipy.special import bdtrc, betaincinv, expit, gammaln, xlog1py, xlogy

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from isac_track.types import Floats, Ints

Outcome: TypeAlias = Literal["links", "no link detected", "attack too weak"]

MIN_EXPECTED = 10
"""A TPR at the FPR alpha needs 10 / alpha non-mated scores: ten above the threshold."""

LEVEL = 0.05
"""Of the tests."""

SLOPE_PENALTY = 1e-6
"""Of the squared slope per standard deviation of the score, where each class weighs 1: it keeps the
slope finite where the classes do not overlap, and otherwise changes nothing that matters."""


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


def _check_finite(scores: Floats) -> None:
    if scores.ndim != 2 or 0 in scores.shape:  # noqa: PLR2004
        raise ValueError(f"scores must have shape (P, G), neither 0, got {scores.shape}")
    if not np.isfinite(scores).all():
        raise ValueError("scores must be finite")


def _check_scores(scores: Floats, mate: Ints) -> None:
    _check_finite(scores)
    n_probes, n_gallery = scores.shape
    if mate.shape != (n_probes,) or mate.dtype.kind not in "iu":
        raise ValueError(f"mate must be integers of shape ({n_probes},), got {mate.shape}")
    mated = mate[mate != -1]
    if mated.size and not 0 <= mated.min() <= mated.max() < n_gallery:
        raise ValueError(f"mates must be columns, 0..{n_gallery - 1}, or -1 for none")
    if np.bincount(mated.astype(np.int64, copy=False)).max(initial=0) > 1:
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
    return expected_hit(*_standing(scores, mate), mate)


def reciprocal_rank(*, scores: Floats, mate: Ints) -> Floats:
    """Return the expected 1 / rank of each probe's mate, (P,); NaN for one without.

    Parameters and errors are those of `rank1`.
    """
    _check_scores(scores, mate)
    return expected_reciprocal(*_standing(scores, mate), mate, scores.shape[1])


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
    log_factorial = log_factorials(n_gallery)
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
    _check_finite(scores)
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
    chances = np.concatenate([chances_of(search) for search in searches])
    return float(chances.mean()) if chances.size else float("nan")


def residual_risk(*, success: float, control: float) -> float:
    """Return (success - control) / (1 - control): what an attack adds to its control.

    Negative where the attack is worse, 1 where it always succeeds, NaN where the control does.
    """
    return (success - control) / (1.0 - control) if control != 1.0 else float("nan")


def chances_of(search: Search) -> Floats:
    """Return 1 / G for every mated probe."""
    return np.full(int((search.mate >= 0).sum()), 1.0 / search.scores.shape[1])


def expected_hit(above: Ints, tied: Ints, mate: Ints) -> Floats:
    """Return `rank1` of mates with so many above and so many as high, themselves included."""
    hit = np.where(above == 0, 1.0 / tied, 0.0)
    hit[mate < 0] = np.nan
    return hit


def expected_reciprocal(above: Ints, tied: Ints, mate: Ints, n_gallery: int) -> Floats:
    """Return `reciprocal_rank` likewise; `n_gallery` is the largest there is."""
    harmonic = np.concatenate([[0.0], np.cumsum(1.0 / np.arange(1, n_gallery + 1))])
    expected: Floats = (harmonic[above + tied] - harmonic[above]) / tied
    expected[mate < 0] = np.nan
    return expected


def _standing(scores: Floats, mate: Ints) -> tuple[Ints, Ints]:
    """Return how many score above each probe's mate, and how many as high, itself included."""
    own = scores[np.arange(mate.size), mate][:, None]
    return (scores > own).sum(axis=1), (scores == own).sum(axis=1)


def log_factorials(n: int) -> Floats:
    """Return log k! for 0..n, (n + 1,)."""
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
    if is_refused(non_mated.size, alpha):
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

    def against(parameters: Floats) -> Floats:
        nats: Floats = -sign * (parameters @ design)
        return nats

    def loss(parameters: Floats, nats: Floats) -> float:
        cost = mass @ np.logaddexp(0.0, nats)
        return float(cost + SLOPE_PENALTY / 2 * parameters[0] ** 2)

    parameters = np.zeros(2)
    nats = against(parameters)
    current = loss(parameters, nats)
    for _ in range(100):
        wrong = expit(nats)
        gradient = -design @ (mass * sign * wrong)
        gradient[0] += SLOPE_PENALTY * parameters[0]
        curvature = (design * (mass * wrong * (1 - wrong))) @ design.T
        # The intercept gets a little of it too, lest rounding make the matrix singular.
        curvature += np.diag([SLOPE_PENALTY, 1e-12])
        step = np.linalg.solve(curvature, gradient)
        length = 1.0
        while True:
            tried = parameters - length * step
            nats = against(tried)
            new = loss(tried, nats)
            if new <= current or length <= 1e-6:  # noqa: PLR2004
                break
            length /= 2
        if new > current:
            break
        parameters = tried
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
        n_bins = default_bins(mated.size)
    if n_bins < 1:
        raise ValueError(f"n_bins must be at least 1, got {n_bins}")
    low = min(float(mated.min()), float(non_mated.min()))
    high = max(float(mated.max()), float(non_mated.max()))
    edges = inner_edges(low, high, n_bins)
    p, q = (
        np.bincount(np.searchsorted(edges, x, side="right"), minlength=n_bins) / x.size
        for x in (mated, non_mated)
    )
    linked = p > q
    p, q = p[linked], q[linked]
    return float((p * (p - q) / (p + q)).sum()), n_bins


def default_bins(n_mated: int) -> int:
    """Return the number of bins of `d_sys`."""
    return max(1, min(n_mated // 10, 100))


def inner_edges(low: float, high: float, n_bins: int) -> Floats:
    """Return the edges between the bins of `d_sys`."""
    return np.linspace(low, high, n_bins + 1)[1:-1]


def is_refused(n_non_mated: int, alpha: float) -> bool:
    """Tell whether non-mated scores are too few for `tpr_at_fpr`."""
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


def permutation_p(
    *, searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int = 999
) -> float:
    """Return the one-sided p-value of `mean_log_rank` against random mates.

    (1 + #{shuffled >= observed}) / (1 + n_shuffles), which is valid for any number of shuffles.
    1 without a mated probe.

    People of one walking group resemble each other within a release, linked or not: mates that are
    shuffled one by one break the groups up, vary too little, and reject far too often. So in each
    search whole clusters of mated probes are permuted among those with equally many, and members
    freely within each: a mated probe gets the mate of some member of the cluster that its own is
    mapped to. A cluster of a size that no other has is mapped to itself; its members are permuted.
    With one probe a cluster this is a uniform permutation of the mates. Columns that are nobody's
    mate are never drawn.

    The test has its level where, under the null, equally large clusters of one release may be
    exchanged, and so may the members of each, without a change in the law of the scores; nothing
    is asked of the resemblance within a cluster. Rare sizes cost power, not validity. Searches are
    shuffled independently of each other: no two may be of the same two releases.

    Parameters
    ----------
    searches : sequence of Search
    rng : Generator
        Search by search, a shuffle draws one uniform number for each mated probe, less one for
        each size of a cluster.
    n_shuffles : int, optional
        At least 999.

    Raises
    ------
    ValueError
        Without a search or for too few shuffles.

    References
    ----------
    p-value: Phipson and Smyth, Statistical Applications in Genetics and Molecular Biology 9(1),
    2010. Blocks permuted whole and within: Winkler, Webster, Vidaurre, Nichols, Smith, NeuroImage
    123, 2015 (multi-level block permutation).
    """
    check_searches(searches, n_shuffles)
    null, nowhere = np.zeros(n_shuffles), np.zeros((n_shuffles, 1))
    one_bin = np.zeros(1, dtype=np.uint8)
    room = shuffling_room(searches, n_shuffles)
    log_factorial = log_factorials(max(search.scores.shape[1] for search in searches))
    observed = 0.0
    for search in searches:
        ranks = rank_rows(search, np.empty(0), log_factorial)
        observed += add_shuffles(search, ranks, one_bin, rng, room, null, nowhere)
    return p_value_among(observed, null)


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


def p_value_among(observed: float, null: Floats) -> float:
    """Return the one-sided p-value of a sum among those of shuffles."""
    # Sums of the same numbers in another order may differ by rounding; they are ties.
    return (1 + int((null >= observed - 1e-9).sum())) / (1 + null.size)


def check_searches(searches: Sequence[Search], n_shuffles: int) -> None:
    """Raise ValueError without a search or for too few shuffles."""
    if not searches:
        raise ValueError("at least one search is needed")
    if n_shuffles < 999:  # noqa: PLR2004
        raise ValueError(f"n_shuffles must be at least 999, got {n_shuffles}")


# -------------------------------------------------------------------- what the loops have to say


@dataclass(frozen=True, eq=False, slots=True)
class RankedScores:
    """What the loop over the ranks of a search writes."""

    log_rank: Floats
    """(P, G) `log_rank` of every column were it the mate."""
    cell: Ints
    """(P, G) cell of every score; 2 k + 1 is the k-th break point, 2 k the gap below it."""
    standing: Ints
    """(P, 3) how many stand above the mate, how many as high, and its cell; 0, 1, 0 without one."""
    counts: Ints
    """Non-mated scores of each cell."""


def rank_rows(search: Search, breaks: Floats, log_factorial: Floats) -> RankedScores:
    """Return ranks and cells of all scores of a search."""
    scores = np.ascontiguousarray(search.scores, dtype=np.float64)
    ranks = RankedScores(
        log_rank=np.empty(scores.shape),
        cell=np.empty(scores.shape, dtype=np.int64),
        standing=np.tile(np.array([0, 1, 0]), (scores.shape[0], 1)),
        counts=np.zeros(2 * breaks.size + 1, dtype=np.int64),
    )
    import_loops().rank_rows(
        scores,
        np.argsort(scores, axis=1),
        breaks,
        log_factorial,
        np.ascontiguousarray(search.mate, dtype=np.int64),
        ranks.log_rank,
        ranks.cell,
        ranks.standing,
        ranks.counts,
    )
    return ranks


def shuffling_room(searches: Sequence[Search], n_shuffles: int) -> Floats:
    """Return memory for the uniform numbers of any one of the searches."""
    return np.empty(n_shuffles * max(search.mate.size for search in searches))


def add_shuffles(
    search: Search,
    ranks: RankedScores,
    bins: NDArray[np.uint8],
    rng: np.random.Generator,
    room: Floats,
    null: Floats,
    null_bins: Floats,
) -> float:
    """Return the sum of `log_rank` over mated probes; add those of shuffled mates to `null`, (n,).

    To `null_bins`, (n, bins), are added the shuffles' mated scores; `bins` gives each cell's.
    """
    probes = np.flatnonzero(search.mate >= 0)
    clusters = search.probe_cluster[probes]
    _, place, counts = np.unique(clusters, return_inverse=True, return_counts=True)
    probes = probes[np.lexsort((place, counts[place]))]
    mate = search.mate[probes].astype(np.int64)
    n_of_size = np.bincount(counts)
    sizes = np.flatnonzero(n_of_size)
    n_alike = n_of_size[sizes]

    n_shuffles, n_drawn = null.size, probes.size - sizes.size
    uniform = room[: n_shuffles * n_drawn].reshape(n_shuffles, n_drawn)
    rng.random(out=uniform)
    if sizes.size and sizes[0] == 1:
        # Permuting clusters of one is permuting the members of one cluster, which is faster.
        sizes[0], n_alike[0] = n_alike[0], 1
    log_rank_of, score_bin = ranks.log_rank[probes], bins[ranks.cell[probes]]
    import_loops().shuffle(uniform, sizes, n_alike, mate, log_rank_of, score_bin, null, null_bins)
    return float(log_rank_of[np.arange(mate.size), mate].sum())


def import_loops() -> Any:  # noqa: ANN401 - a module of compiled functions, which have no types
    """Return the compiled loops; the first call imports numba."""
    return import_module("isac_track.linkability._loops")
