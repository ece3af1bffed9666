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
    FALSE_POSITIVE_RATES,
    METRICS,
    SCORE_REPLICATES,
    Cells,
    Scale,
    score_scale,
)
from isac_track.linkability.scores import Calibration
from isac_track.linkability.significance import People, ShuffledRanks, rank_rows
from isac_track.types import Floats, Ints

RANK_METRICS = (
    "rank1",
    "rank1_assigned",
    "mrr",
    "chance",
    "rank1_g100",
    "false_link_rate",
)
"""Metrics that are means over probes: `ProbeRanks.values`."""
_FITTED = {"eer": 0.5, "cllr_min": 1.0}
"""Upper bounds of the metrics whose hull is fitted to the scores that it judges."""
_BINNED = ("d_sys", "d_sys_published")
"""Metrics that resampling biases once more, since it empties bins."""
_NO_SPREAD = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class ProbeRanks:
    """Rank of the mate of each of P probes: rank metrics are means over these.

    Attributes
    ----------
    above : Ints
        Candidates that score above the probe's mate, (P,); -1 if it has no mate.
    tied : Ints
        Candidates that score as high as the mate, itself included, (P,); 0 without a
        mate.
    chance : Floats
        Probability of rank 1 for a guess, (P,).
    companions : Ints
        Other candidates of the mate's cluster, (P, 3): all, those above, those tied.
    assigned : Ints
        Candidate assigned to the probe, (P,). 1: its mate. 0: another candidate. -1:
        nobody. 2: the probe is more probably alone, but its mate is the most probable
        of all candidates.
    cluster : Ints
        Cluster of the probe, (P,).
    n_gallery : int
        Candidates in the largest gallery.
    """

    above: Ints
    tied: Ints
    chance: Floats
    companions: Ints
    assigned: Ints
    cluster: Ints
    n_gallery: int

    def values(
        self, names: Collection[str] = RANK_METRICS
    ) -> dict[str, tuple[Floats, Ints]]:
        """Return the values of each metric and their clusters, (N,) each.

        The metric is the mean of its values. They are those of probes with a mate;
        `false_link_rate` has those of the other probes and is absent if there are none.
        """
        mated = self.above >= 0
        above, tied, cluster = self.above[mated], self.tied[mated], self.cluster[mated]
        chance, companions = self.chance[mated], self.companions[mated]
        mated_values: dict[str, Callable[[], Floats]] = {
            "rank1": lambda: ranks.expected_hit(above, tied),
            "rank1_assigned": lambda: (self.assigned[mated] > 0).astype(np.float64),
            "mrr": lambda: ranks.expected_reciprocal(above, tied, self.n_gallery),
            "chance": lambda: chance,
            # One NaN makes the mean NaN: the metric is then refused.
            "rank1_g100": lambda: ranks.first_among(
                ranks.among_strangers(above, tied, chance, companions)
            ),
        }
        metric_values = {
            name: (value(), cluster)
            for name, value in mated_values.items()
            if name in names
        }
        if "false_link_rate" in names and not mated.all():
            linked = (self.assigned[~mated] >= 0).astype(np.float64)
            metric_values["false_link_rate"] = linked, self.cluster[~mated]
        return metric_values

    def sums(
        self, n_clusters: int, names: Collection[str] = RANK_METRICS
    ) -> dict[str, tuple[Floats, Floats]]:
        """Return, by metric, the sum and the number of values by cluster, (C,) each."""
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
    """How well one attack links, over all of its searches.

    Attributes
    ----------
    estimates : dict of str to Estimate
        By metric, see `scorecard`; NaN where undefined or refused.
    probes : ProbeRanks
        Probes of all searches, one search after the other.
    p_value : float
        From `permutation_p`.
    p_value_low : float
        The other tail of the same shuffles: small if mates score low, an inverted link.
        Ties count in both tails.
    p_rank1 : float
        From `rank1_p`.
    n_probes : int
        Probes of all searches.
    n_mated : int
        Probes with a mate.
    gallery_sizes : tuple
        Smallest, largest, and mean size over searches.
    n_clusters : int
        Clusters with a mated probe.
    realised_fpr_1pct : float
        FPR at the threshold of the TPR, the mean over scales; NaN if that is refused.
    realised_fpr_01pct : float
        The same at an FPR of 0.1 %.
    d_sys_bins : int
        Bins of `d_sys`, the fewest over scales.
    is_inverted : bool
        AUC < 0.5: mates score low. D_sys ignores direction and may say linkable.
    minimum_detectable_rank1 : float
        Rank-1 rate that the test of rank 1 detects in 8 of 10 studies of this size.
    """

    estimates: dict[str, Estimate]
    probes: ProbeRanks
    p_value: float
    p_value_low: float
    p_rank1: float
    n_probes: int
    n_mated: int
    gallery_sizes: tuple[int, int, float]
    n_clusters: int
    realised_fpr_1pct: float = math.nan
    realised_fpr_01pct: float = math.nan
    d_sys_bins: int = 0
    is_inverted: bool = False
    minimum_detectable_rank1: float


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

    The metrics:

    - rank1, mrr: `rank1`, `reciprocal_rank`, the mean over mated probes
    - rank1_g100: `rank1_among`, without companions; NaN if a gallery is too small
    - rank1_assigned: share of mated probes that the assignment gives their mate
    - false_link_rate: share of probes without a mate that are assigned somebody
    - chance, residual_risk: `chance`, and `residual_risk` of rank1 against it
    - auc, eer, cllr, cllr_min: as the functions; cllr needs `calibration`
    - tpr_at_fpr_1pct, tpr_at_fpr_01pct: `tpr_at_fpr`; NaN if a search has few pairs
    - d_sys: `d_sys`
    - d_sys_corrected: `d_sys` less its mean under the shuffles of `permutation_p`
    - d_sys_published: `d_sys_published`, as its authors' program computes it

    Rank metrics pool the probes of all searches. Score metrics pool the scores within a
    scale, where the two people of a pair are of one search; over scales they are
    averaged, weighted by mated probes.

    Intervals resample clusters. Galleries of rank metrics stay as they are
    (`ratio_estimates`). A mated score weighs w, the number of times that its probe's
    cluster is drawn; a non-mated score weighs the product of its two clusters' w. Two
    people of one cluster who are no mates weigh w, not w^2: the pair is drawn as often
    as the cluster. No population holds a pair of a cluster with its own copy. Score
    metrics take the first `SCORE_REPLICATES` rows of `weights`.

    Most intervals are percentile intervals. Those of eer and cllr_min, read off a hull
    that is fitted to the scores, are basic intervals, 2 value - quantile (Davison and
    Hinkley, 1997, ch. 5.2). Those of d_sys are less the bias of resampling, mean -
    value. A metric that is bounded by 0 and 1 and does not vary over replicates (a
    perfect AUC) has Wilson's interval, with the clusters as the sample size. With few
    clusters all are as in `intervals.ratio_estimates`. Whether there is a link at all
    is for `p_value` to say.

    The clusters of `searches` are the columns of `weights`, (B, C) from
    `cluster_weights`. The `calibration` of each scale is fitted on other people;
    without it `cllr` is NaN. The `no_match_score` of each search is as in `assign`;
    without it every probe is assigned. `rng` draws, search by search, the order of
    columns for `assign`, then the shuffles as in `permutation_p`: `n_shuffles`, at
    least 999, serve `p_value`, `p_value_low` and `d_sys_corrected`.

    ValueError without a search, for too few shuffles, for clusters beyond `weights`, if
    these are no counts up to 255, if `calibration` lacks a scale, or if
    `no_match_score` is not as long as `searches`. So for a mate beyond the first 65,536
    candidates, or more than 65,535 clusters in a scale.

    Examples
    --------
    Twenty people, each of whom scores highest with their own mate:

    >>> import numpy as np
    >>> from isac_track.intervals import cluster_weights
    >>> from isac_track.linkability import Search, scorecard
    >>> people = np.arange(20)
    >>> card = scorecard(
    ...     [Search(np.eye(20), people, people, people)],
    ...     weights=cluster_weights(n_clusters=20, n_replicates=200, seed=0),
    ...     calibration=None,
    ...     no_match_score=None,
    ...     rng=np.random.default_rng(0),
    ... )
    >>> card.estimates["rank1"].value, round(card.estimates["chance"].value, 6)
    (1.0, 0.05)
    >>> card.p_value, card.n_mated
    (0.001, 20)
    """
    significance.check_searches(searches, n_shuffles)
    _check_options(searches, weights, calibration, no_match_score)
    people = [significance.searched_people(search) for search in searches]
    return scorecard_from_draws(
        searches,
        weights=weights,
        calibration=calibration,
        no_match_score=no_match_score,
        draws=draw(people, rng, n_shuffles),
    )


def _check_options(
    searches: Sequence[Search],
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Sequence[float] | None,
) -> None:
    """Raise ValueError unless these fit the searches: see `scorecard`."""
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


@dataclass(frozen=True, eq=False, slots=True)
class Drawn:
    """The random draws for one search of a scorecard."""

    people: People
    order: Ints  # (G,) order of the columns, for `assign`.
    columns: NDArray[np.uint16]  # (N, n_shuffles) from `shuffled_mates`.


@dataclass(frozen=True, eq=False, slots=True)
class _Ranking:
    """Ranks and assignments of all searches."""

    shuffled: ShuffledRanks
    assignments: Sequence[Ints]  # (P,) of each search: `ProbeRanks.assigned`.


def draw(
    people: Sequence[People], rng: np.random.Generator, n_shuffles: int
) -> tuple[Drawn, ...]:
    """Draw the random numbers of `scorecard` for searches of these people."""
    return tuple(
        Drawn(
            group,
            rng.permutation(significance.n_candidates(group)),
            significance.shuffled_mates(
                significance.mated_probes(group), rng, n_shuffles
            ),
        )
        for group in people
    )


def scorecard_from_draws(
    searches: Sequence[Search],
    *,
    weights: Floats,
    calibration: Mapping[int, Calibration] | None,
    no_match_score: Sequence[float] | None,
    draws: Sequence[Drawn],
    matched: Sequence[Floats] | None = None,
) -> Scorecard:
    """Return `scorecard` with its random numbers drawn already; nothing is checked.

    `matched` holds the probability of every pair of each search, (P, G), as from
    `open_matches`. With it every probe is assigned the most probable candidate instead
    of the candidate of `assign`.
    """
    n_shuffles = draws[0].columns.shape[1]
    cells: dict[int, Cells] = {}
    for scale in sorted({search.scale for search in searches}):
        trials = [
            (search, drawn.people)
            for search, drawn in zip(searches, draws, strict=True)
            if search.scale == scale
        ]
        cells[scale] = scales.cut_scores(trials, n_shuffles)
    ranking = _rank_searches(searches, cells, draws, no_match_score, matched)
    rank_fields = _rank_fields(searches, ranking)
    probes = rank_fields["probes"]
    sizes = np.bincount(probes.cluster[probes.above >= 0]).astype(np.float64)
    is_few = LEAST_CLUSTERS <= intervals.effective_clusters(sizes) < FEW_CLUSTERS
    without = tuple(np.flatnonzero(sizes).tolist()) if is_few else ()
    fitted = dict.fromkeys(cells) if calibration is None else calibration
    results = [
        score_scale(cut, weights, fitted[scale], without)
        for scale, cut in cells.items()
    ]
    values = scales.average_scales(results, n_searches=len(searches))
    estimates = _rank_estimates(probes, weights)
    estimates |= _score_estimates(results, values, sizes, n_without=len(without))
    return Scorecard(
        estimates=estimates,
        **rank_fields,
        realised_fpr_1pct=float(values["realised_fpr_1pct"][0]),
        realised_fpr_01pct=float(values["realised_fpr_01pct"][0]),
        d_sys_bins=min(result.n_bins for result in results),
        is_inverted=bool(estimates["auc"].value < 0.5),  # noqa: PLR2004 - chance
    )


def _rank_searches(
    searches: Sequence[Search],
    cells: Mapping[int, Cells],
    draws: Sequence[Drawn],
    no_match_score: Sequence[float] | None,
    matched: Sequence[Floats] | None,
) -> _Ranking:
    """Rank and assign the candidates of every search; add its scores to the cells."""
    null, observed = np.zeros(draws[0].columns.shape[1]), 0.0
    standings: list[Ints] = []
    assignments: list[Ints] = []
    least_scores: Sequence[float | None] = no_match_score or [None] * len(searches)
    for search, least, drawn in zip(searches, least_scores, draws, strict=True):
        cut = cells[search.scale]
        ranked = rank_rows(search.scores, search.mate, cut.breaks, cut.counts)
        if matched is None:
            columns = ranks.assign_in(drawn.order, search.scores, least)
            assigned = np.where(columns < 0, -1, columns == search.mate)
        else:
            best, is_alone = most_probable(drawn.order, matched[len(assignments)])
            is_mate = best == search.mate
            assigned = np.where(is_alone, np.where(is_mate, 2, -1), is_mate)
        observed += significance.add_shuffles(
            significance.mated_probes(drawn.people),
            drawn.columns,
            ranked.log_rank,
            cut.bins.take(ranked.cell),
            null,
            cut.null_bins,
        )
        cut.places.append(ranked.cell)
        standings.append(ranked.standing)
        assignments.append(assigned)
    return _Ranking(ShuffledRanks(observed, null, standings), assignments)


def rank_scorecard(
    searches: Sequence[Search],
    *,
    weights: Floats,
    rng: np.random.Generator,
    n_shuffles: int = 999,
) -> Scorecard:
    """Return a `scorecard` of scores that only rank the candidates within a row.

    Such are the scores where an attack scored few pairs of a gallery and the others
    were put below them. Metrics that need the score of every pair are refused (NaN):
    those of `METRICS`, d_sys_corrected, and those of the assignment. The tests of
    p_value and p_rank1 use ranks alone and hold as in `scorecard`.

    Parameters and errors are those of `scorecard`; the generator draws as in
    `permutation_p`.
    """
    significance.check_searches(searches, n_shuffles)
    shuffled = significance.shuffled_log_ranks(searches, rng, n_shuffles)
    nobody = [np.full(search.mate.size, -1) for search in searches]
    rank_fields = _rank_fields(searches, _Ranking(shuffled, nobody))
    unknown = np.full(min(len(weights), SCORE_REPLICATES), np.nan)
    refused = Estimate(math.nan, n=rank_fields["n_clusters"], replicates=unknown)
    estimates = _rank_estimates(rank_fields["probes"], weights)
    estimates |= dict.fromkeys((*METRICS, "d_sys_corrected"), refused)
    for name in estimates.keys() & {"rank1_assigned", "false_link_rate"}:
        nothing = np.full_like(estimates[name].replicates, np.nan)
        estimates[name] = Estimate(math.nan, n=estimates[name].n, replicates=nothing)
    return Scorecard(estimates=estimates, **rank_fields)


def _rank_fields(searches: Sequence[Search], ranking: _Ranking) -> dict[str, Any]:
    """Return the fields of a scorecard that follow from ranks."""
    sizes = [search.scores.shape[1] for search in searches]
    above, tied = np.concatenate(ranking.shuffled.standings).T
    probes = ProbeRanks(
        above=above,
        tied=tied,
        chance=np.repeat(
            1.0 / np.array(sizes), [search.mate.size for search in searches]
        ),
        companions=np.concatenate([_companions(search) for search in searches]),
        assigned=np.concatenate(ranking.assignments),
        cluster=np.concatenate([search.probe_cluster for search in searches]),
        n_gallery=max(sizes),
    )
    (hits, clusters), (chances, _) = probes.values(("rank1", "chance")).values()
    observed, null = ranking.shuffled.observed, ranking.shuffled.null
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
    """Count the companions of each probe's mate: see `ProbeRanks.companions`."""
    probe, column = significance.list_companions(significance.searched_people(search))
    own, theirs = search.scores[probe, search.mate[probe]], search.scores[probe, column]
    outcome = 3 * probe + (theirs > own) + 2 * (theirs == own)
    counts = np.bincount(outcome, minlength=3 * search.mate.size).reshape(-1, 3)
    counts[:, 0] += counts[:, 1] + counts[:, 2]
    return counts


def _rank_estimates(probes: ProbeRanks, weights: Floats) -> dict[str, Estimate]:
    """Return the estimates of rank metrics: all are shares, except the known chance."""
    sums = probes.sums(weights.shape[1])
    numerator, denominator = np.stack([*sums.values()], axis=1)
    is_share = [name != "chance" for name in sums]
    metric_estimates = intervals.ratio_estimates(
        numerator=numerator, denominator=denominator, weights=weights, is_share=is_share
    )
    estimates = dict(zip(sums, metric_estimates, strict=True))
    known = estimates["chance"]
    # The chance is known: it has an interval however few the clusters are.
    if known.n > 1 and known.effective < FEW_CLUSTERS:
        estimates["chance"] = intervals.estimate_from_replicates(known.drawn, n=known.n)
    estimates["residual_risk"] = _residual_risk(estimates["rank1"], estimates["chance"])
    return estimates


def _residual_risk(success: Estimate, control: Estimate) -> Estimate:
    """Return the estimate of `residual_risk` from those of rank 1 and of chance."""
    value, low, high = (
        ranks.residual_risk(success=rate, control=control.value)
        for rate in (success.value, success.ci_low, success.ci_high)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        replicates = (success.replicates - control.replicates) / (
            1.0 - control.replicates
        )
    replicates[control.replicates == 1.0] = np.nan
    # Where the share has no percentiles, its own ends serve: the chance is known.
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
    """Return the estimates of score metrics; with very few clusters, without interval.

    `sizes`, (C,), are those of the clusters; the last `n_without` values leave out one
    cluster each.
    """
    n, effective = int((sizes > 0).sum()), intervals.effective_clusters(sizes)
    all_values = np.stack([values[name] for name in METRICS])
    drawn, without_each = np.split(
        all_values[:, 1:], [all_values.shape[1] - 1 - n_without], axis=1
    )
    ends, estimates = intervals.percentile_intervals(drawn).T.tolist(), {}
    for place, (name, replicates) in enumerate(zip(METRICS, drawn, strict=True)):
        value, low, high = float(all_values[place, 0]), math.nan, math.nan
        if n_without:
            jackknifed, is_share = np.append(value, without_each[place]), name != "cllr"
            ends[place] = intervals.jackknife_interval(
                jackknifed, effective=effective, is_share=is_share
            )
        if effective >= LEAST_CLUSTERS and not math.isnan(value):
            low, high = _interval(
                name, value, replicates, ends[place], n, is_few=n_without > 0
            )
        estimates[name] = Estimate(value, low, high, n, replicates)

    estimates["d_sys_corrected"] = _corrected_d_sys(estimates["d_sys"], results)
    return estimates


def _corrected_d_sys(linked: Estimate, results: Sequence[Scale]) -> Estimate:
    """Return `d_sys` less its mean under shuffled mates, weighted by mated scores."""
    defined = [r for r in results if r.n_mated and r.n_non_mated]
    n_mated = sum(r.n_mated for r in defined)
    bias = sum(r.n_mated * r.bias for r in defined) / n_mated if defined else math.nan
    return Estimate(
        linked.value - bias,
        linked.ci_low - bias,
        linked.ci_high - bias,
        linked.n,
        linked.replicates - bias,
    )


def _interval(
    name: str,
    value: float,
    replicates: Floats,
    ends: Sequence[float],
    n: int,
    *,
    is_few: bool,
) -> tuple[float, float]:
    """Return a score metric's interval from percentiles or, if few, the jackknife's."""
    is_constant = not (np.abs(replicates - value) > _NO_SPREAD).any()
    is_extreme = name in FALSE_POSITIVE_RATES and value in {0.0, 1.0}
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
