"""Score metrics of one scale: the data's, and those of bootstrap replicates, all in one pass.

References
----------
Pairs of resampled clusters: Snijders and Borgatti, Connections 22(2), 1999; Owen,
Annals of Applied Statistics 1(2), 2007.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from isac_track.linkability import scores
from isac_track.linkability.ranks import Search
from isac_track.linkability.scores import Calibration
from isac_track.linkability.significance import People, import_loops, mated_probes
from isac_track.types import Floats, Ints

SCORE_REPLICATES = 200
"""Bootstrap replicates of score metrics; one visits every pair, where a rank metric visits every
probe. The ends of a 95 % interval from 200 replicates have a standard error of 0.19
standard deviations of the estimate (0.08 from 1,000)."""

LEVELS = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
METRICS = ("auc", "eer", "cllr_min", *LEVELS, "d_sys", "d_sys_published", "cllr")
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
"""What the loop over the scores writes."""
# Numbers that a vector instruction treats at most: replicates are a multiple of it.
_LANES = 16


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
    """The scores of one scale, cut where a metric can tell two apart.

    A replicate needs the weight of mated and of non-mated scores in each cell and
    nothing else.
    """

    breaks: Floats
    """Distinct mated scores and inner edges of the `d_sys` bins: cells are as in `rank_rows`."""
    bins: NDArray[np.uint8]  # `d_sys` bin of every cell.
    counts: Ints  # (cells, 2) non-mated and mated scores in each.
    null_bins: NDArray[np.uint16]  # (bins, n_shuffles) scores of shuffled mates.
    trials: Sequence[tuple[Search, People]]
    places: list[NDArray[np.int32]]  # The cell of every score, (P, G) each.


@dataclass(frozen=True, eq=False, slots=True)
class _Weighed:
    """The people of one scale, clusters 0..C - 1, and their weights: the same for every attack."""

    who: tuple[Ints, ...]
    """(S, 2) probes and candidates of each search; clusters of the former, of the latter; mates."""
    table: NDArray[np.uint8]
    """(C + 1, R or a few more) weights; replicate 0 weighs every cluster once: the data."""
    totals: Floats
    """(2, R or a few more) of all mated and of all non-mated scores."""
    rows: tuple[tuple[Floats, Floats], ...]
    """(P, R) of the probes of each search, and (G, R) of its candidates."""
    within: tuple[
        tuple[Ints, ...], ...
    ]  # Which pairs of each search are of one cluster.


@dataclass(frozen=True, slots=True)
class _Same:
    """Weights that nobody can write to, and that are the same only if they are one array."""

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
    mass: Floats  # (R,) of mated scores; 0 where a class has no weight.
    bias: float  # Mean `d_sys` under shuffled mates.
    n_mated: int
    n_non_mated: int
    n_bins: int


def cut_scores(trials: Sequence[tuple[Search, People]], n_shuffles: int) -> Cells:
    """Return the cells of the scores of one scale, as yet without a count or a place."""
    mated = [(search.scores, mated_probes(people)) for search, people in trials]
    own = np.concatenate([table[of.probes, of.mate] for table, of in mated])
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

    After the data and the replicates come those of the data without each of some
    clusters.
    """
    searches = tuple(people for _, people in cut.trials)
    # The next attack on the same people has the same weights.
    kept = _weighed.__wrapped__ if weights.flags.writeable else _weighed
    people = kept(searches, _Same(weights), without)
    loops, counts = import_loops(), cut.counts
    columns = np.empty((len(_COLUMNS), people.table.shape[1]))
    loops.read_scores(
        people.table,
        (*people.who, np.concatenate([cell.ravel() for cell in cut.places]), counts),
        cut.bins,
        people.totals,
        np.array([*LEVELS.values()]),
        columns,
    )

    n_non_mated, n_mated = counts.sum(axis=0).tolist()
    bias = math.nan
    if n_mated and n_non_mated:
        total = np.bincount(cut.bins, counts.sum(axis=1), minlength=len(cut.null_bins))
        null = np.empty(cut.null_bins.shape[1])
        loops.mean_shares(cut.null_bins, total.astype(np.int64), null)
        bias = float(null.mean())

    # Some replicates more are there for the loops alone.
    n_replicates = people.rows[0][0].shape[1]
    total_mated, total_non_mated = people.totals[:, :n_replicates]
    is_defined = (total_mated > 0) & (total_non_mated > 0)
    defined = np.where(is_defined, columns[:, :n_replicates], np.nan)
    values = {
        **dict(zip(_COLUMNS, defined, strict=True)),
        "cllr": np.full(n_replicates, np.nan),
    }
    if calibration is not None:
        mated_cost, non_mated_cost = _costs(people, cut.trials, calibration)
        with np.errstate(divide="ignore", invalid="ignore"):
            both = mated_cost / total_mated + non_mated_cost / total_non_mated
        values["cllr"] = np.where(is_defined, both / (2.0 * math.log(2.0)), np.nan)
    mass = np.where(is_defined, total_mated, 0.0)
    return Scale(values, mass, bias, n_mated, n_non_mated, cut.null_bins.shape[0])


@lru_cache(maxsize=8)
def _weighed(
    searches: tuple[People, ...], same: _Same, without: tuple[int, ...]
) -> _Weighed:
    arrays = [
        [np.frombuffer(each, dtype=np.int64) for each in search] for search in searches
    ]
    mate = np.concatenate([each for each, *_ in arrays])
    shapes = np.array([[one.size, two.size] for _, one, two in arrays])
    clusters = np.unique(np.concatenate([each for _, *both in arrays for each in both]))
    drawn = same.weights[:SCORE_REPLICATES, clusters].T
    others = clusters[:, None] != np.array(without)
    rows = np.column_stack([np.ones(clusters.size), drawn, others])
    table = np.zeros(
        (len(rows) + 1, -(-rows.shape[1] // _LANES) * _LANES), dtype=np.uint8
    )
    table[:-1, : rows.shape[1]], table[-1] = rows, 1
    if not np.array_equal(table[:-1, : rows.shape[1]], rows):
        raise ValueError("weights must be counts, 0 to 255")
    places = [[np.searchsorted(clusters, each) for each in both] for _, *both in arrays]
    own, other = (np.concatenate(each) for each in zip(*places, strict=True))
    weighed = tuple((rows[one], rows[two]) for one, two in places)
    within = tuple(np.nonzero(one[:, None] == two) for one, two in places)
    totals = np.zeros((2, table.shape[1]))
    for search, weights, alike in zip(searches, weighed, within, strict=True):
        mated, pairs = mated_probes(search), np.ones((len(weights[0]), len(weights[1])))
        pairs[mated.probes, mated.mate] = 0.0
        totals[0, : rows.shape[1]] += weights[0][mated.probes].sum(axis=0)
        totals[1, : rows.shape[1]] += _summed(pairs, *weights, alike)
    return _Weighed((shapes, own, other, mate), table, totals, weighed, within)


def _costs(
    people: _Weighed, trials: Sequence[tuple[Search, People]], calibration: Calibration
) -> tuple[Floats, Floats]:
    """Return the summed cost of either class as evidence, (R,) each, in nats."""
    own, between = np.zeros((2, people.rows[0][0].shape[1]))
    for (search, who), rows, within in zip(
        trials, people.rows, people.within, strict=True
    ):
        mated = mated_probes(who)
        mates = mated.probes, mated.mate
        llr = calibration.slope * search.scores + calibration.intercept
        own += scores.softplus(-llr[mates]) @ rows[0][mated.probes]
        costs = scores.softplus(llr)
        costs[mates] = 0.0
        between += _summed(costs, *rows, within)
    return own, between


def _summed(
    of_pairs: Floats, first: Floats, second: Floats, within: tuple[Ints, ...]
) -> Floats:
    """Return the weighted sum over non-mated pairs, (R,); `of_pairs`, (P, G), is overwritten."""
    # Within a cluster, a pair weighs no more than the probe.
    once = np.bincount(within[0], weights=of_pairs[within], minlength=len(first))
    of_pairs[within] = 0.0
    return np.asarray(once @ first + np.einsum("pr,pr->r", of_pairs @ second, first))


def over_scales(results: Sequence[Scale], *, n_searches: int) -> dict[str, Floats]:
    """Return the values of `Scale`: means, weighted by each replicate's mass of mated scores.

    NaN where no scale has both classes, and where a TPR is refused: on the non-mated
    pairs of one of `n_searches`, in the mean, since those of several are of the same
    few people again.
    """
    mass = np.stack([one.mass for one in results])[:, None]
    of_scales = np.stack([[*one.values.values()] for one in results])
    with np.errstate(invalid="ignore"):
        weighted = np.where(mass > 0, of_scales * mass, 0.0)
        mean = dict(
            zip(results[0].values, weighted.sum(axis=0) / mass.sum(axis=0), strict=True)
        )
    n_non_mated = sum(result.n_non_mated for result in results) / n_searches
    for name, alpha in LEVELS.items():
        if scores.is_refused(n_non_mated, alpha):
            mean[name][:] = mean[name.replace("tpr_at", "realised")][:] = np.nan
    return mean
