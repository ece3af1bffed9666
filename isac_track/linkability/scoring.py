"""The scorecard of one linkage attack: every metric with its interval.

Numba is imported, and its loops compiled, at the first scorecard, not before.

References
----------
Pairs of resampled clusters: Snijders and Borgatti, Connections 22(2), 1999; Owen, Annals of Applied
Statistics 1(2), 2007. Intervals: Davison and Hinkley, Bootstrap Methods, 1997.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from isac_track.intervals import (
    Estimate,
    cluster_sums,
    percentile_interval,
    percentile_intervals,
    ratio_estimates,
    wilson,
)
from isac_track.linkability.ranks import (
    Search,
    assign,
    expected_hit,
    expected_reciprocal,
    residual_risk,
)
from isac_track.linkability.scores import (
    Calibration,
    default_bins,
    inner_edges,
    is_refused,
    linked_share,
)
from isac_track.linkability.significance import (
    add_shuffles,
    check_searches,
    import_loops,
    minimum_detectable_rank1,
    p_value_among,
    rank1_p,
    rank_rows,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from isac_track.types import Floats, Ints

SCORE_REPLICATES = 200
"""Bootstrap replicates of score metrics; one visits every pair, where a rank metric visits every
probe. The ends of a 95 % interval from 200 replicates have a standard error of 0.19 standard
deviations of the estimate (0.08 from 1,000)."""

_METRICS = ("auc", "eer", "cllr_min", "tpr_at_fpr_1pct", "tpr_at_fpr_01pct", "d_sys", "cllr")
_LEVELS = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
_COLUMNS = (
    *("auc", "eer", "cllr_min"),
    *("tpr_at_fpr_1pct", "realised_fpr_1pct", "tpr_at_fpr_01pct", "realised_fpr_01pct"),
)
"""What the loop over the ROCs writes."""
_FITTED = {"eer": 0.5, "cllr_min": 1.0}
"""Metrics whose hull is fitted to the very scores that it judges, and their upper bounds."""
_NO_SPREAD = 1e-12
_PAIRS_KEPT = 2**19
"""Of one scale; more would take more memory than they save time."""


@dataclass(frozen=True, eq=False, slots=True)
class ProbeRanks:
    """How each of P probes fared: what rank metrics are means of."""

    above: Ints
    """(P,) candidates that score above its mate; -1 without one"""
    tied: Ints
    """(P,) candidates that score as high as its mate, the mate included; 0 without one"""
    chance: Floats
    """(P,) of rank 1"""
    assigned: Ints
    """(P,) who is assigned to it: 1 its mate, 0 somebody else, -1 nobody"""
    cluster: Ints
    """(P,)"""
    n_gallery: int
    """Of the largest gallery."""

    def values(self) -> dict[str, tuple[Floats, Ints]]:
        """Return the values that each metric is the mean of, and their clusters, (N,) each.

        All are of probes with a mate, but `false_link_rate`, which is of the others.
        """
        mated = self.above >= 0
        above, tied, cluster = self.above[mated], self.tied[mated], self.cluster[mated]
        found = {
            "rank1": (expected_hit(above, tied), cluster),
            "rank1_assigned": ((self.assigned[mated] == 1).astype(np.float64), cluster),
            "mrr": (expected_reciprocal(above, tied, self.n_gallery), cluster),
            "chance": (self.chance[mated], cluster),
        }
        if not mated.all():
            linked = (self.assigned[~mated] >= 0).astype(np.float64)
            found["false_link_rate"] = linked, self.cluster[~mated]
        return found

    def sums(self, n_clusters: int) -> dict[str, tuple[Floats, Floats]]:
        """Return the sum and the number of each metric's values in each cluster, (C,) each."""
        return {
            name: (
                cluster_sums(values=values, cluster=cluster, n_clusters=n_clusters),
                np.bincount(cluster, minlength=n_clusters).astype(np.float64),
            )
            for name, (values, cluster) in self.values().items()
        }

    def replicates(
        self, weights: Floats, names: Collection[str] | None = None
    ) -> dict[str, Floats]:
        """Return the bootstrap replicates of each metric, (B,), as `scorecard` estimates it.

        Parameters
        ----------
        weights : (B, C)
            As there.
        names : collection of str, optional
            Of these metrics alone.
        """
        found = {}
        for name, sums in self.sums(weights.shape[1]).items():
            if names is not None and name not in names:
                continue
            drawn = weights @ np.stack(sums, axis=1)
            found[name] = np.full(len(weights), np.nan)
            np.divide(drawn[:, 0], drawn[:, 1], out=found[name], where=drawn[:, 1] > 0)
        return found


@dataclass(frozen=True, eq=False, slots=True)
class Scorecard:
    """How well one attack links, over all of its searches."""

    estimates: dict[str, Estimate]
    """By metric; NaN where undefined or refused. See `scorecard`."""
    probes: ProbeRanks
    """Of all searches, one after the other."""
    p_value: float
    """Of `permutation_p`."""
    p_value_low: float
    """Of the same shuffles' other tail, ties counted in both: mates score low. A link, inverted."""
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


@dataclass(frozen=True, eq=False, slots=True)
class _Cells:
    """The scores of one scale, cut where a metric can tell two apart.

    Break points are the distinct mated scores and the inner edges of the D_sys bins; cell 2 k + 1
    is the k-th break point, cell 2 k the gap below it. A replicate needs the weight of mated and
    of non-mated scores in each cell and nothing else.
    """

    breaks: Floats
    bins: NDArray[np.uint8]
    """`d_sys` bin of every cell."""
    null_bins: Floats
    """(n_shuffles, bins) scores of shuffled mates."""


@dataclass(frozen=True, eq=False, slots=True)
class _Trial:
    """What one search gives beside its scores."""

    search: Search
    cell: Ints
    """(P, G) of every score."""
    standing: Ints
    """(P, 2) `above` and `tied` of `ProbeRanks`."""
    assigned: Ints
    """(P,) as there."""


@dataclass(frozen=True, eq=False, slots=True)
class _Pairs:
    """All L pairs of a probe and a candidate of one scale, whose clusters are 0..C - 1.

    They are those of every attack on the same searches.
    """

    first: Ints
    """(L,) cluster of the probe."""
    second: Ints
    """(L,) of the candidate; C, which always weighs 1, where a pair weighs no more than `first`."""
    mates: Ints
    """Which of them are a probe and its mate."""
    rows: Floats
    """(C + 1, R) weights; replicate 0 weighs every cluster once: the data."""
    tables: NDArray[np.float32]
    """(chunks, C + 1, lanes) the same as the loops want them."""


@dataclass(frozen=True, slots=True)
class _Same:
    """Weights that nobody can write to, and that are the same only if they are one array."""

    weights: Floats

    def __hash__(self) -> int:
        return id(self.weights)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.weights is self.weights


@dataclass(frozen=True, eq=False, slots=True)
class _Scale:
    """Score metrics of one scale."""

    values: dict[str, Floats]
    """(R,) by metric, and the FPR of each TPR; first the data, then the replicates."""
    mass: Floats
    """(R,) of mated scores; 0 where a class has no weight."""
    bias: float
    """Mean `d_sys` under shuffled mates."""
    n_mated: int
    n_non_mated: int
    n_bins: int


def scorecard(
    searches: Sequence[Search],
    *,
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Sequence[float] | None,
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
    | d_sys, d_sys_corrected | `d_sys`, and less its mean under `permutation_p`'s shuffles |

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
    no_match_score : sequence of float, or None
        As in `assign`, one a search. Without it every probe is assigned.
    rng : Generator
        Draws, search by search, the order of columns for `assign`, then what `permutation_p` does.
    n_shuffles : int, optional
        At least 999; for `p_value`, `p_value_low` and `d_sys_corrected`.

    Raises
    ------
    ValueError
        Without a search, for too few shuffles, for clusters beyond `weights`, if `calibration`
        lacks a scale, or if `no_match_score` is not as long as `searches`.
    """
    check_searches(searches, n_shuffles)
    scales = sorted({search.scale for search in searches})
    if calibration is not None and not calibration.keys() >= set(scales):
        raise ValueError(f"calibration lacks the scales {sorted(set(scales) - set(calibration))}")
    if no_match_score is not None and len(no_match_score) != len(searches):
        raise ValueError(
            f"no_match_score must be one a search, {len(searches)}, got {len(no_match_score)}"
        )
    last = max(int(max(s.probe_cluster.max(), s.gallery_cluster.max())) for s in searches)
    if weights.ndim != 2 or last >= weights.shape[1]:  # noqa: PLR2004
        raise ValueError(f"weights must be (B, C), C > {last}, got {weights.shape}")
    cells = {
        scale: _cut([search for search in searches if search.scale == scale], n_shuffles)
        for scale in scales
    }
    null, observed = np.zeros(n_shuffles), 0.0
    trials = []
    no_match: Sequence[float | None] = no_match_score or [None] * len(searches)
    for search, least in zip(searches, no_match, strict=True):
        cut = cells[search.scale]
        log_rank, cell, standing = rank_rows(search, cut.breaks)
        assigned = assign(scores=search.scores, rng=rng, no_match_score=least)
        observed += add_shuffles(search, log_rank, cut.bins[cell], rng, null, cut.null_bins)
        assigned = np.where(assigned < 0, -1, assigned == search.mate)
        trials.append(_Trial(search, cell, standing, assigned))
    results = [
        _score_scale(
            [trial for trial in trials if trial.search.scale == scale],
            cut,
            weights,
            calibration[scale] if calibration is not None else None,
        )
        for scale, cut in cells.items()
    ]
    sizes = [search.scores.shape[1] for search in searches]
    above, tied = np.concatenate([trial.standing for trial in trials]).T
    probes = ProbeRanks(
        above=above,
        tied=tied,
        chance=np.repeat(1.0 / np.array(sizes), [search.mate.size for search in searches]),
        assigned=np.concatenate([trial.assigned for trial in trials]),
        cluster=np.concatenate([search.probe_cluster for search in searches]),
        n_gallery=max(sizes),
    )
    hits, mated_clusters = probes.values()["rank1"]
    chances, _ = probes.values()["chance"]
    n_clusters = int(np.unique(mated_clusters).size)
    values = _over_scales(results)
    estimates = _rank_estimates(probes, weights) | _score_estimates(results, values, n_clusters)
    return Scorecard(
        estimates=estimates,
        probes=probes,
        p_value=p_value_among(observed, null),
        p_value_low=p_value_among(-observed, -null),
        p_rank1=rank1_p(hits=hits, chance=chances),
        n_probes=probes.above.size,
        n_mated=hits.size,
        gallery_sizes=(min(sizes), max(sizes), sum(sizes) / len(sizes)),
        n_clusters=n_clusters,
        realised_fpr_1pct=float(values["realised_fpr_1pct"][0]),
        realised_fpr_01pct=float(values["realised_fpr_01pct"][0]),
        d_sys_bins=min(result.n_bins for result in results),
        is_inverted=bool(estimates["auc"].value < 0.5),  # noqa: PLR2004
        minimum_detectable_rank1=minimum_detectable_rank1(
            n=hits.size, chance=float(chances.mean()) if hits.size else 1.0
        ),
    )


def _cut(searches: Sequence[Search], n_shuffles: int) -> _Cells:
    """Return the cells of the scores of one scale."""
    mated = np.concatenate([s.scores[s.mate >= 0, s.mate[s.mate >= 0]] for s in searches])
    n_bins = default_bins(mated.size)
    edges = inner_edges(
        min(float(search.scores.min()) for search in searches),
        max(float(search.scores.max()) for search in searches),
        n_bins,
    )
    breaks = np.unique(np.concatenate([mated, edges]))
    bins = np.zeros(2 * breaks.size + 1, dtype=np.uint8)
    bins[1::2] = np.searchsorted(edges, breaks, side="right")
    bins[2::2] = bins[1::2]
    return _Cells(breaks, bins, np.zeros((n_shuffles, n_bins)))


def _score_scale(
    trials: Sequence[_Trial], cut: _Cells, weights: Floats, calibration: Calibration | None
) -> _Scale:
    """Return the score metrics of one scale."""
    searches = tuple(
        tuple(
            each.astype(np.int64).tobytes() for each in (s.mate, s.probe_cluster, s.gallery_cluster)
        )
        for s in (trial.search for trial in trials)
    )
    cell = np.concatenate([trial.cell.ravel() for trial in trials])
    scores = np.concatenate([trial.search.scores.ravel() for trial in trials], dtype=np.float64)
    # The next attack on the same people has the same pairs.
    is_kept = not weights.flags.writeable and cell.size <= _PAIRS_KEPT
    pairs = (_pairs if is_kept else _pairs.__wrapped__)(searches, _Same(weights))
    mated, non_mated, bins = _masses(pairs, cell, cut.bins)
    total_mated, total_non_mated = mated.sum(axis=1), non_mated.sum(axis=1)
    is_defined = (total_mated > 0) & (total_non_mated > 0)

    n_bins = cut.null_bins.shape[1]
    n_mated = pairs.mates.size
    n_non_mated = cell.size - n_mated
    bias = math.nan
    if n_mated and n_non_mated:
        counts = np.bincount(cell, minlength=cut.bins.size)
        total_bins = np.bincount(cut.bins, weights=counts, minlength=n_bins)
        null, others = cut.null_bins / n_mated, (total_bins - cut.null_bins) / n_non_mated
        bias = float(linked_share(null, others).mean())

    values = {"cllr": np.full(is_defined.size, np.nan)}
    with np.errstate(divide="ignore", invalid="ignore"):
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        p, q = (np.add.reduceat(mass, starts, axis=1) for mass in (mated, non_mated))
        values["d_sys"] = linked_share(p / total_mated[:, None], q / total_non_mated[:, None])
        if calibration is not None:
            mated_cost, non_mated_cost = _costs(pairs, scores, calibration)
            both = mated_cost / total_mated + non_mated_cost / total_non_mated
            values["cllr"] = both / (2.0 * math.log(2.0))
    columns = np.empty((is_defined.size, 7))
    import_loops().read_rocs(mated, non_mated, np.array(list(_LEVELS.values())), columns)
    values |= dict(zip(_COLUMNS, columns.T, strict=True))
    values = {name: np.where(is_defined, of, np.nan) for name, of in values.items()}
    mass = np.where(is_defined, total_mated, 0.0)
    return _Scale(values, mass, bias, n_mated, n_non_mated, n_bins)


@lru_cache(maxsize=8)
def _pairs(searches: tuple[tuple[bytes, ...], ...], same: _Same) -> _Pairs:
    """Return the pairs of searches, given mates and clusters of each as bytes: they are hashed."""
    arrays = [[np.frombuffer(each, dtype=np.int64) for each in search] for search in searches]
    clusters = np.unique(np.concatenate([each for _, *both in arrays for each in both]))
    first, second, is_mate = [], [], []
    for mate, probe_cluster, gallery_cluster in arrays:
        own, other = (np.searchsorted(clusters, of) for of in (probe_cluster, gallery_cluster))
        mates = mate[:, None] == np.arange(other.size)
        first.append(np.repeat(own, other.size))
        second.append(np.where(mates | (own[:, None] == other), clusters.size, other).ravel())
        is_mate.append(mates.ravel())
    rows = np.ones((clusters.size + 1, 1 + SCORE_REPLICATES))
    rows = rows[:, : 1 + len(same.weights)]
    rows[:-1, 1:] = same.weights[:SCORE_REPLICATES, clusters].T
    lanes = import_loops().LANES
    padded = np.zeros((len(rows), -(-rows.shape[1] // lanes) * lanes), dtype=np.float32)
    padded[:, : rows.shape[1]] = rows  # counts, exact in 32 bits
    tables = padded.reshape(len(rows), -1, lanes).transpose(1, 0, 2)
    own, other = np.concatenate(first), np.concatenate(second)
    mates = np.flatnonzero(np.concatenate(is_mate))
    return _Pairs(own, other, mates, rows, np.ascontiguousarray(tables))


def _masses(pairs: _Pairs, cell: Ints, bins: NDArray[np.uint8]) -> tuple[Floats, Floats, Ints]:
    """Return the weight of either class in each cell that holds a score, (R, K), and its bin."""
    loops, n_replicates = import_loops(), pairs.rows.shape[1]
    is_occupied = np.bincount(cell, minlength=bins.size) > 0
    key = (2 * np.cumsum(is_occupied) - 2)[cell]
    key[pairs.mates] += 1
    out = np.empty((2, len(pairs.tables) * loops.LANES, int(is_occupied.sum())))
    loops.weigh(pairs.tables, key, pairs.first, pairs.second, out)
    non_mated, mated = out[:, :n_replicates]
    return mated, non_mated, bins[is_occupied].astype(np.int64)


def _costs(pairs: _Pairs, scores: Floats, calibration: Calibration) -> tuple[Floats, Floats]:
    """Return the summed cost of either class as evidence, (R,) each, in nats."""
    llr = calibration.slope * scores + calibration.intercept
    rows, n, own = pairs.rows, len(pairs.rows), pairs.first[pairs.mates]
    mated = np.bincount(own, weights=np.logaddexp(0.0, -llr[pairs.mates]), minlength=n)
    # log(1 + LR), in a way that does not overflow and that numpy computes several at a time.
    costs = np.log1p(np.exp(-np.abs(llr)))
    costs += np.maximum(llr, 0.0)
    costs[pairs.mates] = 0.0
    between = np.bincount(n * pairs.first + pairs.second, weights=costs, minlength=n**2)
    return mated @ rows, np.einsum("cr,cr->r", between.reshape(n, n) @ rows, rows)


def _over_scales(results: Sequence[_Scale]) -> dict[str, Floats]:
    """Return the values of `_Scale`: means, weighted by each replicate's mass of mated scores.

    NaN where no scale has both classes, and where a TPR is refused.
    """
    mass = np.stack([one.mass for one in results])
    mean: dict[str, Floats] = {}
    for name in results[0].values:
        of_scale = np.where(mass > 0, [one.values[name] for one in results], 0.0)
        with np.errstate(invalid="ignore"):
            mean[name] = (of_scale * mass).sum(axis=0) / mass.sum(axis=0)
    n_non_mated = sum(result.n_non_mated for result in results)
    for name, alpha in _LEVELS.items():
        if is_refused(n_non_mated, alpha):
            mean[name][:] = mean[name.replace("tpr_at", "realised")][:] = np.nan
    return mean


def _rank_estimates(probes: ProbeRanks, weights: Floats) -> dict[str, Estimate]:
    """Return the estimates of rank metrics; all are shares but the chance, which is known."""
    sums = probes.sums(weights.shape[1])
    numerator, denominator = np.stack([*sums.values()], axis=1)
    is_share = [name != "chance" for name in sums]
    found = ratio_estimates(
        numerator=numerator, denominator=denominator, weights=weights, is_share=is_share
    )
    estimates = dict(zip(sums, found, strict=True))
    estimates["residual_risk"] = _residual_risk_estimate(estimates["rank1"], estimates["chance"])
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


def _score_estimates(
    results: Sequence[_Scale], values: dict[str, Floats], n: int
) -> dict[str, Estimate]:
    """Return the estimates of score metrics; `n` clusters have a mated probe."""
    drawn = np.stack([values[name][1:] for name in _METRICS])
    estimates = {}
    for name, replicates, ends in zip(_METRICS, drawn, percentile_intervals(drawn).T, strict=True):
        value, low, high = float(values[name][0]), math.nan, math.nan
        if n > 1 and not math.isnan(value):
            low, high = _interval(name, value, replicates, ends.tolist(), n)
        estimates[name] = Estimate(value, low, high, n, replicates)

    linked = estimates["d_sys"]
    defined = [r for r in results if r.n_mated and r.n_non_mated]
    n_mated = sum(r.n_mated for r in defined)
    bias = sum(r.n_mated * r.bias for r in defined) / n_mated if defined else math.nan
    estimates["d_sys_corrected"] = Estimate(
        value=linked.value - bias,
        ci_low=linked.ci_low - bias,
        ci_high=linked.ci_high - bias,
        n=linked.n,
        replicates=linked.replicates - bias,
    )
    return estimates


def _interval(
    name: str, value: float, replicates: Floats, ends: Sequence[float], n: int
) -> tuple[float, float]:
    """Return the ends of a score metric's interval, given those of its percentile interval."""
    is_constant = not (np.abs(replicates - value) > _NO_SPREAD).any()
    is_extreme = name in _LEVELS and value in {0.0, 1.0}
    low, high = ends
    if name != "cllr" and (is_constant or is_extreme):
        low, high = wilson(hits=min(max(value, 0.0), 1.0) * n, n=n)
        high = min(high, _FITTED.get(name, 1.0))
    elif name in _FITTED:
        low, high = max(0.0, 2 * value - high), min(_FITTED[name], 2 * value - low)
    return low, high
