"""Score metrics of one scale: of searches whose scores compare, from one fitted attack.

An attack is fitted anew for each fold of people. Scores of two fits do not compare, so
that searches of two fits are of two scales. The metrics of a scale are computed for the
data and all bootstrap replicates in one pass, and then averaged over scales.

References
----------
Pairs of resampled clusters: Snijders and Borgatti, Connections 22(2), 1999; Owen,
Annals of Applied Statistics 1(2), 2007.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from isac_track.linkability import scores
from isac_track.linkability.ranks import Search
from isac_track.linkability.scores import Calibration
from isac_track.linkability.significance import People, import_loops, mated_probes
from isac_track.types import Floats, Ints

SCORE_REPLICATES = 200
"""Bootstrap replicates of score metrics.

Each visits every pair, where a replicate of a rank metric visits every probe. The ends
of a 95 % interval from 200 replicates have a standard error of 0.19 standard deviations
of the estimate (0.08 from 1,000).
"""

FALSE_POSITIVE_RATES = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
"""Largest false-positive rate of each TPR."""
METRICS = (
    "auc",
    "eer",
    "cllr_min",
    *FALSE_POSITIVE_RATES,
    "d_sys",
    "d_sys_published",
    "cllr",
)
_COLUMNS = (
    "d_sys",
    "d_sys_published",
    "auc",
    "eer",
    "cllr_min",
    "tpr_at_fpr_1pct",
    "realised_fpr_1pct",
    "tpr_at_fpr_01pct",
    "realised_fpr_01pct",
)
"""Rows that the loop `read_scores` writes."""
# Most numbers that a vector instruction treats: replicates are a multiple of it.
_LANES = 16
# The loops name a row of the table of weights in 16 bits; the last row holds ones.
_MOST_CLUSTERS = 2**16 - 1


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
    """The scores of one scale, cut where a metric can tell two apart.

    A replicate needs the weight of mated and of non-mated scores in each cell and
    nothing else. `cut_scores` makes the cells before any search is ranked. Then
    `scoring` ranks search after search, and thereby fills three arrays in place:
    `rank_rows` adds to `counts`, `add_shuffles` to `null_bins`, and `places` gets the
    cells of each search. `score_scale` reads them all.
    """

    breaks: Floats
    """Distinct mated scores and inner edges of `d_sys` bins: see `rank_rows`."""
    bins: NDArray[np.uint8]  # (cells,) `d_sys` bin of every cell.
    counts: Ints  # (cells, 2) non-mated and mated scores in each.
    null_bins: NDArray[np.uint16]  # (bins, n_shuffles) scores of shuffled mates.
    trials: Sequence[tuple[Search, People]]
    places: list[NDArray[np.int32]]  # The cell of every score, (P, G) for each search.


class _SearchedClusters(NamedTuple):
    """All S searches of one scale as the loop `read_scores` takes them, in this order.

    Arrays of probes and candidates hold those of the first search first.
    """

    shapes: Ints  # (S, 2) numbers of probes and candidates of each search.
    probe_clusters: Ints
    candidate_clusters: Ints
    mates: Ints  # Column of each probe's mate in its search; -1 without.


@dataclass(frozen=True, eq=False, slots=True)
class _Weighed:
    """Weights of the clusters 0..C - 1 of one scale: the same for every attack."""

    searches: _SearchedClusters
    table: NDArray[np.uint8]
    """(C + 1, R or a few more) weights; replicate 0 is the data: every weight is 1."""
    totals: Floats
    """(2, R or a few more) weights of all mated and of all non-mated scores."""
    rows: tuple[tuple[Floats, Floats], ...]
    """(P, R) weights of the probes of each search, and (G, R) of its candidates."""
    # Probes and candidates of the pairs within a cluster, for each search.
    within: tuple[tuple[Ints, ...], ...]


@dataclass(frozen=True, slots=True)
class _Same:
    """Read-only weights, hashed and compared by identity as the key of a cache."""

    weights: Floats

    def __hash__(self) -> int:
        return id(self.weights)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.weights is self.weights


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """Score metrics of one scale."""

    values: dict[str, Floats]
    """(R,) by metric, and the FPR of each TPR; first the data, then the replicates."""
    mass: Floats  # (R,) weight of mated scores; 0 where either class has no weight.
    bias: float  # Mean `d_sys` under shuffled mates.
    n_mated: int
    n_non_mated: int
    n_bins: int


def cut_scores(trials: Sequence[tuple[Search, People]], n_shuffles: int) -> Cells:
    """Cut the scores of one scale into cells, as yet without counts and places."""
    mated = [(search.scores, mated_probes(people)) for search, people in trials]
    own = np.concatenate([table[chosen.probes, chosen.mate] for table, chosen in mated])
    n_bins = scores.default_bins(own.size)
    ends = [(float(table.min()), float(table.max())) for table, _ in mated]
    edges = scores.inner_edges(min(ends)[0], max(high for _, high in ends), n_bins)
    breaks = np.unique(np.concatenate([own, edges]))
    bins = np.zeros(2 * breaks.size + 1, dtype=np.uint8)
    bins[1::2] = np.searchsorted(edges, breaks, side="right")
    bins[2::2] = bins[1::2]
    counts = np.zeros((bins.size, 2), dtype=np.int64)
    null_bins = np.zeros((n_bins, n_shuffles), dtype=np.uint16)
    return Cells(breaks, bins, counts, null_bins, trials, [])


def score_scale(
    cut: Cells,
    weights: Floats,
    calibration: Calibration | None,
    without: tuple[int, ...],
) -> Scale:
    """Return the score metrics of one scale.

    After the data and the replicates come the data without each of the clusters
    `without`.
    """
    searches = tuple(people for _, people in cut.trials)
    # The next attack on the same people has the same weights: they are cached, unless
    # somebody may still write to them.
    weigh = _weigh_clusters.__wrapped__ if weights.flags.writeable else _weigh_clusters
    weighing = weigh(searches, _Same(weights), without)
    loops, counts = import_loops(), cut.counts
    cells = np.concatenate([cell.ravel() for cell in cut.places])
    columns = np.empty((len(_COLUMNS), weighing.table.shape[1]))
    loops.read_scores(
        weighing.table,
        (*weighing.searches, cells, counts),
        cut.bins,
        weighing.totals,
        np.array([*FALSE_POSITIVE_RATES.values()]),
        columns,
    )

    n_non_mated, n_mated = counts.sum(axis=0).tolist()
    bias = math.nan
    if n_mated and n_non_mated:
        total = np.bincount(cut.bins, counts.sum(axis=1), minlength=len(cut.null_bins))
        null = np.empty(cut.null_bins.shape[1])
        loops.mean_shares(cut.null_bins, total.astype(np.int64), null)
        bias = float(null.mean())

    # A few further replicates only fill up the vector instructions.
    n_replicates = weighing.rows[0][0].shape[1]
    total_mated, total_non_mated = weighing.totals[:, :n_replicates]
    is_defined = (total_mated > 0) & (total_non_mated > 0)
    defined = np.where(is_defined, columns[:, :n_replicates], np.nan)
    values = {
        **dict(zip(_COLUMNS, defined, strict=True)),
        "cllr": np.full(n_replicates, np.nan),
    }
    if calibration is not None:
        mated_cost, non_mated_cost = _costs(weighing, cut.trials, calibration)
        with np.errstate(divide="ignore", invalid="ignore"):
            cost = mated_cost / total_mated + non_mated_cost / total_non_mated
        values["cllr"] = np.where(is_defined, cost / (2.0 * math.log(2.0)), np.nan)
    mass = np.where(is_defined, total_mated, 0.0)
    return Scale(values, mass, bias, n_mated, n_non_mated, cut.null_bins.shape[0])


# Of the newest searches, which a task's attacks share; the ninth makes the oldest go.
@lru_cache(maxsize=8)
def _weigh_clusters(
    searches: tuple[People, ...], same: _Same, without: tuple[int, ...]
) -> _Weighed:
    """Return the weights of all pairs of these searches."""
    arrays = [
        [np.frombuffer(array, dtype=np.int64) for array in search]
        for search in searches
    ]
    mate = np.concatenate([mates for mates, _, _ in arrays])
    shapes = np.array([[probes.size, others.size] for _, probes, others in arrays])
    clusters = np.unique(
        np.concatenate([array for _, *pair in arrays for array in pair])
    )
    if clusters.size > _MOST_CLUSTERS:
        limit = f"{_MOST_CLUSTERS:,} clusters"
        raise ValueError(f"a scale may have at most {limit}, got {clusters.size:,}")
    drawn = same.weights[:SCORE_REPLICATES, clusters].T
    is_left = clusters[:, None] != np.array(without)
    rows = np.column_stack([np.ones(clusters.size), drawn, is_left])
    n_weights = rows.shape[1]
    n_padded = -(-n_weights // _LANES) * _LANES
    table = np.zeros((len(rows) + 1, n_padded), dtype=np.uint8)
    table[:-1, :n_weights], table[-1] = rows, 1
    if not np.array_equal(table[:-1, :n_weights], rows):
        raise ValueError("weights must be counts, 0 to 255")
    places = [
        (np.searchsorted(clusters, probes), np.searchsorted(clusters, others))
        for _, probes, others in arrays
    ]
    weighed = tuple((rows[probes], rows[others]) for probes, others in places)
    within = tuple(np.nonzero(probes[:, None] == others) for probes, others in places)
    totals = np.zeros((2, n_padded))
    for search, weights, same_cluster in zip(searches, weighed, within, strict=True):
        mated, pairs = mated_probes(search), np.ones((len(weights[0]), len(weights[1])))
        pairs[mated.probes, mated.mate] = 0.0
        totals[0, :n_weights] += weights[0][mated.probes].sum(axis=0)
        totals[1, :n_weights] += _summed(pairs, *weights, same_cluster)
    first = np.concatenate([probes for probes, _ in places])
    second = np.concatenate([others for _, others in places])
    searched = _SearchedClusters(shapes, first, second, mate)
    return _Weighed(searched, table, totals, weighed, within)


def _costs(
    weighing: _Weighed,
    trials: Sequence[tuple[Search, People]],
    calibration: Calibration,
) -> tuple[Floats, Floats]:
    """Return the summed cost of each class as evidence, (R,) each, in nats."""
    mated_cost, non_mated_cost = np.zeros((2, weighing.rows[0][0].shape[1]))
    for (search, people), rows, within in zip(
        trials, weighing.rows, weighing.within, strict=True
    ):
        mated = mated_probes(people)
        mates = mated.probes, mated.mate
        llr = calibration.slope * search.scores + calibration.intercept
        mated_cost += scores.softplus(-llr[mates]) @ rows[0][mated.probes]
        costs = scores.softplus(llr)
        costs[mates] = 0.0
        non_mated_cost += _summed(costs, *rows, within)
    return mated_cost, non_mated_cost


def _summed(
    pair_values: Floats, first: Floats, second: Floats, within: tuple[Ints, ...]
) -> Floats:
    """Return the weighted sum over non-mated pairs, (R,); overwrites `pair_values`.

    `pair_values` are (P, G), the weights `first` and `second` (P, R) and (G, R).
    """
    # Within a cluster, a pair weighs no more than the probe: both of its people come
    # with the same draw of the cluster, which a product of weights would count twice.
    cluster_sums = np.bincount(
        within[0], weights=pair_values[within], minlength=len(first)
    )
    pair_values[within] = 0.0
    return np.asarray(
        cluster_sums @ first + np.einsum("pr,pr->r", pair_values @ second, first)
    )


def average_scales(results: Sequence[Scale], *, n_searches: int) -> dict[str, Floats]:
    """Return the mean of each metric in `Scale.values` over scales, (R,) each.

    In each replicate a scale counts by the weight of its mated scores there,
    `Scale.mass`. The mean is NaN where no scale has both mated and non-mated scores.

    A TPR, and the FPR that it was reached at, is NaN as a whole where there are too few
    non-mated pairs for its false-positive rate (`is_refused`). Their number is the mean
    over the `n_searches`: several searches have the same few people, so that the sum
    would promise too much.
    """
    mass = np.stack([result.mass for result in results])[:, None]
    scale_values = np.stack([list(result.values.values()) for result in results])
    with np.errstate(invalid="ignore"):
        weighted = np.where(mass > 0, scale_values * mass, 0.0)
        mean = dict(
            zip(results[0].values, weighted.sum(axis=0) / mass.sum(axis=0), strict=True)
        )
    n_non_mated = sum(result.n_non_mated for result in results) / n_searches
    for name, rate in FALSE_POSITIVE_RATES.items():
        if scores.is_refused(n_non_mated, rate):
            mean[name][:] = mean[name.replace("tpr_at", "realised")][:] = np.nan
    return mean
