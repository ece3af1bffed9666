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
from typing import TYPE_CHECKING

import numpy as np

from isac_track.intervals import (
    Estimate,
    cluster_sums,
    percentile_interval,
    ratio_estimate,
    wilson,
)
from isac_track.linkability.ranks import (
    assign,
    chances_of,
    expected_hit,
    expected_reciprocal,
    log_factorials,
    residual_risk,
)
from isac_track.linkability.scores import default_bins, inner_edges, is_refused, linked_share
from isac_track.linkability.significance import (
    add_shuffles,
    check_searches,
    import_loops,
    minimum_detectable_rank1,
    p_value_among,
    rank1_p,
    rank_rows,
    shuffling_room,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from isac_track.linkability.ranks import Search
    from isac_track.linkability.scores import Calibration
    from isac_track.linkability.significance import RankedScores
    from isac_track.types import Floats, Ints

SCORE_REPLICATES = 200
"""Bootstrap replicates of score metrics; one visits every pair, where a rank metric visits every
probe. The ends of a 95 % interval from 200 replicates have a standard error of 0.19 standard
deviations of the estimate (0.08 from 1,000)."""

_LEVELS = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
_COLUMNS = {
    "auc": 2,
    "eer": 3,
    "cllr_min": 4,
    "tpr_at_fpr_1pct": 5,
    "tpr_at_fpr_01pct": 7,
    "d_sys": 9,
    "cllr": 10,
}
"""Of `_Scale`; behind a TPR is its FPR."""
_FITTED = {"eer": 0.5, "cllr_min": 1.0}
"""Metrics whose hull is fitted to the very scores that it judges, and their upper bounds."""
_NO_SPREAD = 1e-12


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
        mate = np.zeros_like(above)
        found = {
            "rank1": expected_hit(above, tied, mate),
            "rank1_assigned": (self.assigned[mated] == 1).astype(np.float64),
            "mrr": expected_reciprocal(above, tied, mate, self.n_gallery),
            "chance": self.chance[mated],
        }
        both = {name: (values, cluster) for name, values in found.items()}
        if not mated.all():
            linked = (self.assigned[~mated] >= 0).astype(np.float64)
            both["false_link_rate"] = linked, self.cluster[~mated]
        return both

    def replicates(self, weights: Floats) -> dict[str, Floats]:
        """Return the bootstrap replicates of each metric, (B,), as `scorecard` estimates it.

        Parameters
        ----------
        weights : (B, C)
            As there.
        """
        found = {}
        for name, (values, cluster) in self.values().items():
            sums = [
                cluster_sums(values=one, cluster=cluster, n_clusters=weights.shape[1])
                for one in (values, np.ones(cluster.size))
            ]
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
class _Trial:
    """What one search gives beside its scores."""

    scores: Floats
    """(P, G) contiguous"""
    mate: Ints
    scale: int
    probe_cluster: Ints
    """Renumbered: 0..C - 1 are the clusters that occur in its scale."""
    gallery_cluster: Ints
    ranks: RankedScores
    probes: Ints
    """(M,) those with a mate."""
    assigned: Ints


@dataclass(frozen=True, eq=False, slots=True)
class _Cells:
    """The cells of one scale, as `_loops` has them, and what falls into them."""

    breaks: Floats
    bins: NDArray[np.uint8]
    """`d_sys` bin of every cell."""
    clusters: Ints
    """(C,) those that occur, ascending."""
    null_bins: Floats
    """(n_shuffles, bins) scores of shuffled mates."""


@dataclass(frozen=True, eq=False, slots=True)
class _Scale:
    """Score metrics of one scale."""

    columns: Floats
    """(R, 11) as the loop writes them, then `cllr`; row 0 is the data, the others replicates."""
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
    _check(searches, weights, calibration, no_match_score)
    cells = {
        scale: _cut([search for search in searches if search.scale == scale], n_shuffles)
        for scale in sorted({search.scale for search in searches})
    }
    trials, (p_value, p_value_low) = _trials(searches, cells, no_match_score, rng, n_shuffles)
    results = [
        _score_scale(
            [trial for trial in trials if trial.scale == scale],
            cut,
            weights[:SCORE_REPLICATES],
            calibration[scale] if calibration is not None else None,
        )
        for scale, cut in cells.items()
    ]
    over_scales = _over_scales(results)
    probes = _probe_ranks(searches, trials)
    hits, mated_clusters = probes.values()["rank1"]
    chances = np.concatenate([chances_of(search) for search in searches])
    sizes = [search.scores.shape[1] for search in searches]
    n_clusters = int(np.unique(mated_clusters).size)
    estimates = _rank_estimates(probes, weights)
    estimates |= _score_estimates(results, over_scales, n_clusters)
    n_mated = hits.size
    return Scorecard(
        estimates=estimates,
        probes=probes,
        p_value=p_value,
        p_value_low=p_value_low,
        p_rank1=rank1_p(hits=hits, chance=chances),
        n_probes=probes.above.size,
        n_mated=n_mated,
        gallery_sizes=(min(sizes), max(sizes), sum(sizes) / len(sizes)),
        n_clusters=n_clusters,
        realised_fpr_1pct=float(over_scales[0, _COLUMNS["tpr_at_fpr_1pct"] + 1]),
        realised_fpr_01pct=float(over_scales[0, _COLUMNS["tpr_at_fpr_01pct"] + 1]),
        d_sys_bins=min(result.n_bins for result in results),
        is_inverted=bool(estimates["auc"].value < 0.5),  # noqa: PLR2004
        minimum_detectable_rank1=minimum_detectable_rank1(
            n=n_mated, chance=float(chances.mean()) if n_mated else 1.0
        ),
    )


def _check(
    searches: Sequence[Search],
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Sequence[float] | None,
) -> None:
    missing = {search.scale for search in searches}.difference(calibration or ())
    if calibration is not None and missing:
        raise ValueError(f"calibration lacks the scales {sorted(missing)}")
    if no_match_score is not None and len(no_match_score) != len(searches):
        raise ValueError(
            f"no_match_score must be one a search, {len(searches)}, got {len(no_match_score)}"
        )
    last = max(int(max(s.probe_cluster.max(), s.gallery_cluster.max())) for s in searches)
    if weights.ndim != 2 or last >= weights.shape[1]:  # noqa: PLR2004
        raise ValueError(f"weights must be (B, C), C > {last}, got {weights.shape}")


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
    occurring = [c for s in searches for c in (s.probe_cluster, s.gallery_cluster)]
    return _Cells(
        breaks, bins, np.unique(np.concatenate(occurring)), np.zeros((n_shuffles, n_bins))
    )


def _trials(
    searches: Sequence[Search],
    cells: Mapping[int, _Cells],
    no_match_score: Sequence[float] | None,
    rng: np.random.Generator,
    n_shuffles: int,
) -> tuple[list[_Trial], tuple[float, float]]:
    """Return what the searches give, and the p-values of both tails; fill `null_bins`."""
    log_factorial = log_factorials(max(search.scores.shape[1] for search in searches))
    room = shuffling_room(searches, n_shuffles)
    no_match: Sequence[float | None] = (
        no_match_score if no_match_score is not None else [None] * len(searches)
    )
    null, observed = np.zeros(n_shuffles), 0.0
    trials = []
    for search, least in zip(searches, no_match, strict=True):
        cut = cells[search.scale]
        ranks = rank_rows(search, cut.breaks, log_factorial)
        assigned = assign(scores=search.scores, rng=rng, no_match_score=least)
        observed += add_shuffles(search, ranks, cut.bins, rng, room, null, cut.null_bins)
        trials.append(
            _Trial(
                scores=np.ascontiguousarray(search.scores, dtype=np.float64),
                mate=np.ascontiguousarray(search.mate, dtype=np.int64),
                scale=search.scale,
                probe_cluster=np.searchsorted(cut.clusters, search.probe_cluster),
                gallery_cluster=np.searchsorted(cut.clusters, search.gallery_cluster),
                ranks=ranks,
                probes=np.flatnonzero(search.mate >= 0),
                assigned=assigned,
            )
        )
    return trials, (p_value_among(observed, null), p_value_among(-observed, -null))


def _tables(weights: Floats) -> tuple[NDArray[np.float32], Floats]:
    """Return the weights as the loop wants them, (chunks, C + 1, lanes), and as rows, (C, R).

    Replicate 0 weighs every cluster once: the data. The loop's last cluster always weighs 1. Counts
    are exact in 32 bits.
    """
    lanes = import_loops().LANES
    n_replicates, n_clusters = 1 + weights.shape[0], weights.shape[1]
    n_chunks = -(-n_replicates // lanes)
    padded = np.ones((n_clusters + 1, n_chunks * lanes))
    padded[:-1, 1:n_replicates] = weights.T
    tables = padded.reshape(-1, n_chunks, lanes).transpose(1, 0, 2)
    return np.ascontiguousarray(tables, dtype=np.float32), padded[:-1, :n_replicates]


def _score_scale(
    trials: Sequence[_Trial], cut: _Cells, weights: Floats, calibration: Calibration | None
) -> _Scale:
    """Return the score metrics of one scale."""
    mated_cell = np.concatenate([t.ranks.standing[t.probes, 2] for t in trials])
    counts = np.sum([trial.ranks.counts for trial in trials], axis=0)
    n_bins = cut.null_bins.shape[1]
    n_mated, n_non_mated = mated_cell.size, int(counts.sum())
    bias = math.nan
    if n_mated and n_non_mated:
        total_bins = np.bincount(cut.bins, weights=counts, minlength=n_bins)
        total_bins += np.bincount(cut.bins[mated_cell], minlength=n_bins)
        null, others = cut.null_bins / n_mated, (total_bins - cut.null_bins) / n_non_mated
        bias = float(linked_share(null, others).mean())

    tables, rows = _tables(weights[:, cut.clusters])
    columns = _replicates(trials, counts, mated_cell, cut.bins, tables)[: rows.shape[1]]
    columns[:, _COLUMNS["cllr"]] = _cllr_rows(trials, columns, rows, calibration)
    return _Scale(columns, bias, n_mated, n_non_mated, n_bins)


def _replicates(
    trials: Sequence[_Trial],
    counts: Ints,
    mated_cell: Ints,
    bins: NDArray[np.uint8],
    tables: NDArray[np.float32],
) -> Floats:
    """Return what the loop of that name writes, with the chunks' empty rows at the end."""
    loops = import_loops()
    stops = np.cumsum(counts)
    place = stops - counts
    first = np.empty(stops[-1], dtype=np.int64)
    second = np.empty_like(first)
    for trial in trials:
        loops.fill_cells(
            trial.ranks.cell,
            trial.mate,
            trial.probe_cluster,
            trial.gallery_cluster,
            tables.shape[1] - 1,
            place,
            first,
            second,
        )
    occupied = counts > 0
    occupied[mated_cell] = True
    number = np.cumsum(occupied) - 1
    columns = np.empty((tables.shape[0] * loops.LANES, loops.COLUMNS))
    loops.replicates(
        tables,
        np.concatenate([[0], stops[occupied]]),
        first,
        second,
        number[mated_cell],
        np.concatenate([trial.probe_cluster[trial.probes] for trial in trials]),
        bins[occupied].astype(np.int64),
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
    n_clusters = len(rows)
    between, mated = np.zeros((n_clusters, n_clusters)), np.zeros(n_clusters)
    for trial in trials:
        mate, probes = trial.mate, trial.probes
        llr = calibration.slope * trial.scores + calibration.intercept
        # log(1 + LR), in a way that does not overflow and that numpy computes several at a time.
        costs = np.log1p(np.exp(-np.abs(llr)))
        costs += np.maximum(llr, 0.0)
        costs[probes, mate[probes]] = 0.0
        pair = n_clusters * trial.probe_cluster[:, None] + trial.gallery_cluster
        sums = np.bincount(pair.ravel(), weights=costs.ravel(), minlength=n_clusters**2)
        between += sums.reshape(between.shape)
        mated += np.bincount(
            trial.probe_cluster[probes],
            weights=np.logaddexp(0.0, -llr[probes, mate[probes]]),
            minlength=mated.size,
        )
    within = between.diagonal().copy()
    np.fill_diagonal(between, 0.0)
    non_mated = np.einsum("cr,cr->r", between @ rows, rows) + within @ rows
    defined = (columns[:, 0] > 0) & (columns[:, 1] > 0)
    both = (mated @ rows)[defined] / columns[defined, 0]
    both += non_mated[defined] / columns[defined, 1]
    values[defined] = both / (2.0 * math.log(2.0))
    return values


def _over_scales(results: Sequence[_Scale]) -> Floats:
    """Return columns of `_Scale`: means, weighted by each replicate's mass of mated scores.

    NaN where no scale has both classes, and where a TPR is refused.
    """
    total = np.zeros(results[0].columns.shape)
    mass = np.zeros((len(total), 1))
    for result in results:
        weight = np.where(result.columns[:, 1] > 0, result.columns[:, 0], 0.0)[:, None]
        total += np.where(weight > 0, result.columns, 0.0) * weight
        mass += weight
    mean = np.full(total.shape, np.nan)
    np.divide(total, mass, out=mean, where=mass > 0)
    n_non_mated = sum(result.n_non_mated for result in results)
    for name, alpha in _LEVELS.items():
        if is_refused(n_non_mated, alpha):
            mean[:, _COLUMNS[name] : _COLUMNS[name] + 2] = np.nan
    return mean


def _probe_ranks(searches: Sequence[Search], trials: Sequence[_Trial]) -> ProbeRanks:
    mate = np.concatenate([search.mate for search in searches])
    standing = np.concatenate([trial.ranks.standing for trial in trials])
    assigned = np.concatenate([trial.assigned for trial in trials])
    sizes = np.array([search.scores.shape[1] for search in searches])
    return ProbeRanks(
        above=np.where(mate < 0, -1, standing[:, 0]),
        tied=np.where(mate < 0, 0, standing[:, 1]),
        chance=np.repeat(1.0 / sizes, [len(search.mate) for search in searches]),
        assigned=np.where(assigned < 0, -1, assigned == mate),
        cluster=np.concatenate([search.probe_cluster for search in searches]),
        n_gallery=int(sizes.max()),
    )


def _rank_estimates(probes: ProbeRanks, weights: Floats) -> dict[str, Estimate]:
    """Return the estimates of rank metrics."""
    estimates = {
        # All are shares but the chance, which is known.
        name: _mean(values, cluster, weights, is_share=name != "chance")
        for name, (values, cluster) in probes.values().items()
    }
    estimates["residual_risk"] = _residual_risk_estimate(estimates["rank1"], estimates["chance"])
    return estimates


def _mean(values: Floats, cluster: Ints, weights: Floats, *, is_share: bool) -> Estimate:
    numerator, denominator = (
        cluster_sums(values=of, cluster=cluster, n_clusters=weights.shape[1])
        for of in (values, np.ones(cluster.size))
    )
    return ratio_estimate(
        numerator=numerator, denominator=denominator, weights=weights, is_share=is_share
    )


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


def _score_estimates(results: Sequence[_Scale], over_scales: Floats, n: int) -> dict[str, Estimate]:
    """Return the estimates of score metrics; `n` clusters have a mated probe."""
    estimates = {}
    for name, column in _COLUMNS.items():
        value, replicates = float(over_scales[0, column]), over_scales[1:, column].copy()
        low, high = math.nan, math.nan
        if n > 1 and not math.isnan(value):
            low, high = _interval(name, value, replicates, n)
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


def _interval(name: str, value: float, replicates: Floats, n: int) -> tuple[float, float]:
    """Return the ends of a score metric's interval."""
    spread = np.abs(replicates - value)
    is_constant = not (spread > _NO_SPREAD).any()
    is_extreme = name in _LEVELS and value in {0.0, 1.0}
    if name != "cllr" and (is_constant or is_extreme):
        low, high = wilson(hits=min(max(value, 0.0), 1.0) * n, n=n)
        return low, min(high, _FITTED.get(name, 1.0))
    low, high = percentile_interval(replicates)
    if name in _FITTED:
        return max(0.0, 2 * value - high), min(_FITTED[name], 2 * value - low)
    return low, high
