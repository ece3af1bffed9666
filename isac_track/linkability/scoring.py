"""The scorecard of one linkage attack: every metric with its interval."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isac_track import intervals
from isac_track.intervals import FEW_CLUSTERS, LEAST_CLUSTERS, Estimate
from isac_track.linkability import ranks, scales, significance
from isac_track.linkability.matches import most_probable
from isac_track.linkability.ranks import Search
from isac_track.linkability.scales import (
    LEVELS,
    METRICS,
    SCORE_REPLICATES,
    Scale,
    score_scale,
)
from isac_track.linkability.scores import Calibration
from isac_track.linkability.significance import People, rank_rows
from isac_track.types import Floats, Ints

RANK_METRICS = (
    "rank1",
    "rank1_assigned",
    "mrr",
    "chance",
    "rank1_g100",
    "false_link_rate",
)
"""Means over probes: `ProbeRanks.values`."""
_FITTED = {"eer": 0.5, "cllr_min": 1.0}
"""Metrics whose hull is fitted to the very scores that it judges, and their upper bounds."""
_BINNED = ("d_sys", "d_sys_published")
"""Metrics that a resample, whose bins are emptier, biases once more."""
_NO_SPREAD = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class ProbeRanks:
    """How each of P probes fared: what rank metrics are means of."""

    above: Ints  # (P,) candidates that score above its mate; -1 without one
    # (P,) candidates that score as high as its mate, the mate included; 0 without one
    tied: Ints
    chance: Floats  # (P,) of rank 1
    companions: Ints
    """(P, 3) candidates of its cluster beside its mate: how many, and of these above and as high"""
    assigned: Ints
    """(P,) who is assigned to it: 1 its mate, 0 somebody else, -1 nobody; 2 its mate, if anybody:
    it is rather alone, but of all candidates its mate is the most probable"""
    cluster: Ints  # (P,)
    n_gallery: int  # Of the largest gallery.

    def values(
        self, names: Collection[str] = RANK_METRICS
    ) -> dict[str, tuple[Floats, Ints]]:
        """Return the values that some metrics are the means of, and their clusters, (N,) each.

        All are of probes with a mate, but `false_link_rate`, which is of the others, if
        there are any.
        """
        mated = self.above >= 0
        above, tied, cluster = self.above[mated], self.tied[mated], self.cluster[mated]
        chance, companions = self.chance[mated], self.companions[mated]
        of_mated: dict[str, Callable[[], Floats]] = {
            "rank1": lambda: ranks.expected_hit(above, tied),
            "rank1_assigned": lambda: (self.assigned[mated] > 0).astype(np.float64),
            "mrr": lambda: ranks.expected_reciprocal(above, tied, self.n_gallery),
            "chance": lambda: chance,
            # NaN for one is NaN for all: refused.
            "rank1_g100": lambda: ranks.first_among(
                ranks.among_strangers(above, tied, chance, companions)
            ),
        }
        found = {
            name: (value(), cluster)
            for name, value in of_mated.items()
            if name in names
        }
        if "false_link_rate" in names and not mated.all():
            linked = (self.assigned[~mated] >= 0).astype(np.float64)
            found["false_link_rate"] = linked, self.cluster[~mated]
        return found

    def sums(
        self, n_clusters: int, names: Collection[str] = RANK_METRICS
    ) -> dict[str, tuple[Floats, Floats]]:
        """Return the sum and the number of some metrics' values in each cluster, (C,) each."""
        return {
            name: (
                intervals.cluster_sums(
                    values=values, cluster=cluster, n_clusters=n_clusters
                ),
                np.bincount(cluster, minlength=n_clusters).astype(np.float64),
            )
            for name, (values, cluster) in self.values(names).items()
        }


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scorecard:
    """How well one attack links, over all of its searches."""

    estimates: dict[
        str, Estimate
    ]  # By metric; NaN where undefined or refused. See `scorecard`.
    probes: ProbeRanks  # Of all searches, one after the other.
    p_value: float  # Of `permutation_p`.
    p_value_low: float
    """Of the same shuffles' other tail, ties counted in both: mates score low. A link, inverted."""
    p_rank1: float  # Of `rank1_p`.
    n_probes: int
    n_mated: int  # Probes with a mate.
    gallery_sizes: tuple[int, int, float]  # Smallest, largest, and mean over searches.
    n_clusters: int  # Clusters with a mated probe.
    realised_fpr_1pct: float = math.nan
    realised_fpr_01pct: float = math.nan
    """FPR at the operating points of the TPR, the mean over scales; NaN where that is refused."""
    d_sys_bins: int = 0  # The fewest over scales.
    is_inverted: bool = False
    """AUC < 0.5: mates score low. D_sys, which ignores direction, may say linkable all the same."""
    minimum_detectable_rank1: float
    """What the test of rank 1 would find in 8 of 10 studies of this size."""


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
    | rank1_g100 | `rank1_among`, without companions; refused if one mated probe has too few |
    | rank1_assigned | share of mated probes to which the matching of all gives their mate |
    | false_link_rate | share of probes without a mate that get somebody; only if there are any |
    | chance, residual_risk | `chance`, and `residual_risk` of rank1 against it |
    | auc, eer, cllr, cllr_min | as the functions; cllr needs `calibration` |
    | tpr_at_fpr_1pct, tpr_at_fpr_01pct | `tpr_at_fpr`; refused by the pairs that a search has |
    | d_sys, d_sys_corrected | `d_sys`, and less its mean under `permutation_p`'s shuffles |
    | d_sys_published | `d_sys_published`: as its authors' program computes it |

    Rank metrics pool the probes of all searches. Score metrics pool the scores within a
    scale, a non-mated pair being of one search; over scales they are averaged, weighted
    by mated probes.

    Intervals resample clusters. Galleries of rank metrics stay as they are
    (`ratio_estimates`). A mated score weighs w, how often its probe's cluster is drawn,
    a non-mated score the product of its two clusters' w. Two people of one cluster who
    are no mates weigh w, not w^2: the pair is drawn as often as the cluster, and a pair
    of a cluster with its own copy is not one that any population holds. Score metrics
    take the first `SCORE_REPLICATES` rows of `weights`.

    Intervals are percentile intervals, but those of eer and cllr_min, read off a hull
    that is fitted to the scores, basic ones, 2 value - quantile (Davison and Hinkley,
    1997, ch. 5.2), and those of d_sys less what resampling adds, mean - value: what
    such a study gives on average. A metric that is bounded by 0 and 1 and does not vary
    over replicates (a perfect AUC) has Wilson's, with the clusters as the sample size;
    of few clusters all are as in `intervals.ratio_estimates`. How often they hold the
    truth: docs/metrics.md. Whether there is a link at all is for `p_value` to say.

    The clusters of `searches` are the columns of `weights`, (B, C) from
    `cluster_weights`. The `calibration` of each scale is fitted on other people;
    without it `cllr` is NaN. The `no_match_score` of each search is as in `assign`;
    without it every probe is assigned. `rng` draws, search by search, the order of
    columns for `assign`, then what `permutation_p` does: `n_shuffles`, at least 999,
    are for `p_value`, `p_value_low` and `d_sys_corrected`.

    ValueError without a search, for too few shuffles, for clusters beyond `weights`, if
    these are no counts up to 255, if `calibration` lacks a scale, or if
    `no_match_score` is not as long as `searches`.
    """
    significance.check_searches(searches, n_shuffles)
    fitted = {search.scale for search in searches}
    if calibration is not None and not calibration.keys() >= fitted:
        raise ValueError(
            f"calibration lacks the scales {sorted(fitted - set(calibration))}"
        )
    if no_match_score is not None and len(no_match_score) != len(searches):
        numbers = f"{len(searches)}, got {len(no_match_score)}"
        raise ValueError(f"no_match_score must be one a search, {numbers}")
    last = max(
        int(max(s.probe_cluster.max(), s.gallery_cluster.max())) for s in searches
    )
    if weights.ndim != 2 or last >= weights.shape[1]:  # noqa: PLR2004 - a matrix
        raise ValueError(f"weights must be (B, C), C > {last}, got {weights.shape}")
    return scorecard_of(
        searches,
        weights=weights,
        calibration=calibration,
        no_match_score=no_match_score,
        draws=draw(
            [significance.people_of(search) for search in searches], rng, n_shuffles
        ),
    )


@dataclass(frozen=True, eq=False, slots=True)
class Drawn:
    """What is drawn for one search of a scorecard."""

    people: People
    order: Ints  # (G,) columns, for `assign`
    columns: NDArray[np.uint16]  # (N, n_shuffles) `shuffled_mates`


def draw(
    people: Sequence[People], rng: np.random.Generator, n_shuffles: int
) -> tuple[Drawn, ...]:
    """Return what `scorecard` draws for searches of these people."""
    return tuple(
        Drawn(
            one,
            rng.permutation(significance.n_candidates(one)),
            significance.shuffled_mates(
                significance.mated_probes(one), rng, n_shuffles
            ),
        )
        for one in people
    )


def scorecard_of(
    searches: Sequence[Search],
    *,
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Sequence[float] | None,
    draws: Sequence[Drawn],
    matched: Sequence[Floats] | None = None,
) -> Scorecard:
    """Return `scorecard` of what is drawn already; nothing is checked.

    `matched` are of each search how probable its pairs are, (P, G), as from
    `open_matches`: every probe is then assigned the most probable candidate instead of
    the one of `assign`.
    """
    n_shuffles = draws[0].columns.shape[1]
    trials = [
        (search, drawn.people) for search, drawn in zip(searches, draws, strict=True)
    ]
    cells = {
        scale: scales.cut_scores(
            [one for one in trials if one[0].scale == scale], n_shuffles
        )
        for scale in sorted({search.scale for search in searches})
    }
    null, observed = np.zeros(n_shuffles), 0.0
    standings: list[Ints] = []
    assignments: list[Ints] = []
    no_match: Sequence[float | None] = no_match_score or [None] * len(searches)
    for search, least, drawn in zip(searches, no_match, draws, strict=True):
        cut = cells[search.scale]
        log_rank, cell, standing = rank_rows(
            search.scores, search.mate, cut.breaks, cut.counts
        )
        if matched is None:
            columns = ranks.assign_in(drawn.order, search.scores, least)
            assigned = np.where(columns < 0, -1, columns == search.mate)
        else:
            best, is_alone = most_probable(drawn.order, matched[len(assignments)])
            is_mate = best == search.mate
            assigned = np.where(is_alone, np.where(is_mate, 2, -1), is_mate)
        shuffled = significance.mated_probes(drawn.people), drawn.columns
        of_score = cut.bins.take(cell)
        observed += significance.add_shuffles(
            *shuffled, log_rank, of_score, null, cut.null_bins
        )
        cut.places.append(cell)
        standings.append(standing)
        assignments.append(assigned)
    of_ranks = _of_ranks(searches, standings, assignments, observed, null)
    probes = of_ranks["probes"]
    sizes = np.bincount(probes.cluster[probes.above >= 0]).astype(np.float64)
    is_few = LEAST_CLUSTERS <= intervals.effective_clusters(sizes) < FEW_CLUSTERS
    without = tuple(np.flatnonzero(sizes).tolist()) if is_few else ()
    fitted = dict.fromkeys(cells) if calibration is None else calibration
    results = [
        score_scale(cut, weights, fitted[scale], without)
        for scale, cut in cells.items()
    ]
    values = scales.over_scales(results, n_searches=len(searches))
    estimates = _rank_estimates(probes, weights)
    estimates |= _score_estimates(results, values, sizes, n_without=len(without))
    return Scorecard(
        estimates=estimates,
        **of_ranks,
        realised_fpr_1pct=float(values["realised_fpr_1pct"][0]),
        realised_fpr_01pct=float(values["realised_fpr_01pct"][0]),
        d_sys_bins=min(result.n_bins for result in results),
        is_inverted=bool(estimates["auc"].value < 0.5),  # noqa: PLR2004 - chance
    )


def rank_scorecard(
    searches: Sequence[Search],
    *,
    weights: Floats,
    rng: np.random.Generator,
    n_shuffles: int = 999,
) -> Scorecard:
    """Return a `scorecard` of scores that rank candidates and say no more, in any two rows.

    So it is where few pairs of a gallery were scored and the others put below them.
    Metrics that need the score of every pair are refused (NaN): those of `METRICS`,
    d_sys_corrected, and what is assigned. The tests of p_value and p_rank1 ask for
    ranks alone and hold as they do there.

    Parameters and errors are those of `scorecard`; the generator draws what
    `permutation_p` does.
    """
    significance.check_searches(searches, n_shuffles)
    observed, null, standings = significance.shuffled_log_ranks(
        searches, rng, n_shuffles
    )
    nobody = [np.full(search.mate.size, -1) for search in searches]
    of_ranks = _of_ranks(searches, standings, nobody, observed, null)
    unknown = np.full(min(len(weights), SCORE_REPLICATES), np.nan)
    refused = Estimate(math.nan, n=of_ranks["n_clusters"], replicates=unknown)
    estimates = _rank_estimates(of_ranks["probes"], weights)
    estimates |= dict.fromkeys((*METRICS, "d_sys_corrected"), refused)
    for name in estimates.keys() & {"rank1_assigned", "false_link_rate"}:
        nothing = np.full_like(estimates[name].replicates, np.nan)
        estimates[name] = Estimate(math.nan, n=estimates[name].n, replicates=nothing)
    return Scorecard(estimates=estimates, **of_ranks)


def _of_ranks(
    searches: Sequence[Search],
    standings: Sequence[Ints],
    assignments: Sequence[Ints],
    observed: float,
    null: Floats,
) -> dict[str, Any]:
    """Return the fields of a scorecard that follow from ranks, and from those of shuffled mates."""
    sizes = [search.scores.shape[1] for search in searches]
    above, tied = np.concatenate(standings).T
    probes = ProbeRanks(
        above=above,
        tied=tied,
        chance=np.repeat(
            1.0 / np.array(sizes), [search.mate.size for search in searches]
        ),
        companions=np.concatenate([_companions(search) for search in searches]),
        assigned=np.concatenate(assignments),
        cluster=np.concatenate([search.probe_cluster for search in searches]),
        n_gallery=max(sizes),
    )
    (hits, clusters), (chances, _) = probes.values(("rank1", "chance")).values()
    return {
        "probes": probes,
        "p_value": significance.p_value_among(observed, null),
        "p_value_low": significance.p_value_among(-observed, -null),
        "p_rank1": significance.rank1_p(hits=hits, chance=chances),
        "n_probes": above.size,
        "n_mated": hits.size,
        "gallery_sizes": (min(sizes), max(sizes), sum(sizes) / len(sizes)),
        "n_clusters": np.count_nonzero(np.bincount(clusters)),
        "minimum_detectable_rank1": significance.minimum_detectable_rank1(
            n=hits.size, chance=float(chances.mean()) if hits.size else 1.0
        ),
    }


def _companions(search: Search) -> Ints:
    """Return `ProbeRanks.companions` of a search."""
    probe, column = significance.companions_of(significance.people_of(search))
    own, theirs = search.scores[probe, search.mate[probe]], search.scores[probe, column]
    which = 3 * probe + (theirs > own) + 2 * (theirs == own)
    found = np.bincount(which, minlength=3 * search.mate.size).reshape(-1, 3)
    found[:, 0] += found[:, 1] + found[:, 2]
    return found


def _rank_estimates(probes: ProbeRanks, weights: Floats) -> dict[str, Estimate]:
    """Return the estimates of rank metrics; all are shares but the chance, which is known."""
    sums = probes.sums(weights.shape[1])
    numerator, denominator = np.stack([*sums.values()], axis=1)
    is_share = [name != "chance" for name in sums]
    found = intervals.ratio_estimates(
        numerator=numerator, denominator=denominator, weights=weights, is_share=is_share
    )
    estimates = dict(zip(sums, found, strict=True))
    known = estimates["chance"]
    if known.n > 1 and known.effective < FEW_CLUSTERS:  # however few they are
        estimates["chance"] = intervals.estimate_of(known.drawn, n=known.n)
    estimates["residual_risk"] = _residual_risk(estimates["rank1"], estimates["chance"])
    return estimates


def _residual_risk(success: Estimate, control: Estimate) -> Estimate:
    value, low, high = (
        ranks.residual_risk(success=one, control=control.value)
        for one in (success.value, success.ci_low, success.ci_high)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        replicates = (success.replicates - control.replicates) / (
            1.0 - control.replicates
        )
    replicates[control.replicates == 1.0] = np.nan
    # The share's own ends, where it has no percentiles; guessing's chance is known.
    if not (success.effective < FEW_CLUSTERS or success.value in {0.0, 1.0}):
        low, high = intervals.percentile_interval(replicates)
    return Estimate(value, low, high, success.n, replicates)


def _score_estimates(
    results: Sequence[Scale],
    values: dict[str, Floats],
    sizes: Floats,
    *,
    n_without: int,
) -> dict[str, Estimate]:
    """Return the estimates of score metrics; of very few clusters they have no interval.

    `sizes`, (C,), are of the clusters; the last `n_without` values are those without
    each of them.
    """
    n, effective = int((sizes > 0).sum()), intervals.effective_clusters(sizes)
    every = np.stack([values[name] for name in METRICS])
    drawn, without_each = np.split(
        every[:, 1:], [every.shape[1] - 1 - n_without], axis=1
    )
    ends, estimates = intervals.percentile_intervals(drawn).T.tolist(), {}
    for place, (name, replicates) in enumerate(zip(METRICS, drawn, strict=True)):
        value, low, high = float(every[place, 0]), math.nan, math.nan
        if n_without:
            left, is_share = np.append(value, without_each[place]), name != "cllr"
            ends[place] = intervals.jackknife_interval(
                left, effective=effective, is_share=is_share
            )
        if effective >= LEAST_CLUSTERS and not math.isnan(value):
            low, high = _interval(
                name, value, replicates, ends[place], n, is_few=n_without > 0
            )
        estimates[name] = Estimate(value, low, high, n, replicates)

    linked = estimates["d_sys"]
    defined = [r for r in results if r.n_mated and r.n_non_mated]
    n_mated = sum(r.n_mated for r in defined)
    bias = sum(r.n_mated * r.bias for r in defined) / n_mated if defined else math.nan
    value, low, high = (
        one - bias for one in (linked.value, linked.ci_low, linked.ci_high)
    )
    estimates["d_sys_corrected"] = Estimate(
        value, low, high, linked.n, linked.replicates - bias
    )
    return estimates


def _interval(
    name: str,
    value: float,
    replicates: Floats,
    ends: Sequence[float],
    n: int,
    *,
    is_few: bool,
) -> tuple[float, float]:
    """Return a score metric's interval, given percentiles or, of few clusters, the jackknife's."""
    is_constant = not (np.abs(replicates - value) > _NO_SPREAD).any()
    is_extreme = name in LEVELS and value in {0.0, 1.0}
    most = _FITTED.get(name, 1.0)
    low, high = ends
    if name != "cllr" and (is_constant or is_extreme):
        low, high = intervals.wilson(hits=min(max(value, 0.0), 1.0) * n, n=n)
        high = min(high, most)
    elif name in _FITTED and not is_few:
        low, high = max(0.0, 2 * value - high), min(most, 2 * value - low)
    elif name in (_FITTED if is_few else _BINNED):
        bias = float(replicates[~np.isnan(replicates)].mean()) - value
        low, high = max(0.0, low - bias), min(most, high - bias)
    return low, high
