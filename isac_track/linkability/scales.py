"""Score metrics of one scale: the data's, and those of bootstrap replicates, all in one pass.

References
----------
Pairs of resampled clusters: Snijders and Borgatti, Connections 22(2), 1999; Owen, Annals of Applied
Statistics 1(2), 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from isac_track.linkability.scores import (
    Calibration,
    default_bins,
    inner_edges,
    is_refused,
    linked_share,
)
from isac_track.linkability.significance import import_loops

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from isac_track.linkability.ranks import Search
    from isac_track.types import Floats, Ints

SCORE_REPLICATES = 200
"""Bootstrap replicates of score metrics; one visits every pair, where a rank metric visits every
probe. The ends of a 95 % interval from 200 replicates have a standard error of 0.19 standard
deviations of the estimate (0.08 from 1,000)."""

METRICS = ("auc", "eer", "cllr_min", "tpr_at_fpr_1pct", "tpr_at_fpr_01pct", "d_sys", "cllr")
LEVELS = {"tpr_at_fpr_1pct": 0.01, "tpr_at_fpr_01pct": 0.001}
_COLUMNS = (
    *("auc", "eer", "cllr_min"),
    *("tpr_at_fpr_1pct", "realised_fpr_1pct", "tpr_at_fpr_01pct", "realised_fpr_01pct"),
)
"""What the loop over the ROCs writes."""
_PAIRS_KEPT = 2**19
"""Of one scale; more would take more memory than they save time."""


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
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
class Scale:
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


def cut_scores(searches: Sequence[Search], n_shuffles: int) -> Cells:
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
    return Cells(breaks, bins, np.zeros((n_shuffles, n_bins)))


def score_scale(
    trials: Sequence[tuple[Search, Ints]],
    cut: Cells,
    weights: Floats,
    calibration: Calibration | None,
) -> Scale:
    """Return the score metrics of one scale: of searches, with the cell of every score, (P, G)."""
    searches = tuple(
        tuple(
            each.astype(np.int64).tobytes() for each in (s.mate, s.probe_cluster, s.gallery_cluster)
        )
        for s, _ in trials
    )
    cell = np.concatenate([cell.ravel() for _, cell in trials])
    scores = np.concatenate([search.scores.ravel() for search, _ in trials], dtype=np.float64)
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
    import_loops().read_rocs(mated, non_mated, np.array(list(LEVELS.values())), columns)
    values |= dict(zip(_COLUMNS, columns.T, strict=True))
    values = {name: np.where(is_defined, of, np.nan) for name, of in values.items()}
    mass = np.where(is_defined, total_mated, 0.0)
    return Scale(values, mass, bias, n_mated, n_non_mated, n_bins)


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


def over_scales(results: Sequence[Scale]) -> dict[str, Floats]:
    """Return the values of `Scale`: means, weighted by each replicate's mass of mated scores.

    NaN where no scale has both classes, and where a TPR is refused.
    """
    mass = np.stack([one.mass for one in results])
    mean: dict[str, Floats] = {}
    for name in results[0].values:
        of_scale = np.where(mass > 0, [one.values[name] for one in results], 0.0)
        with np.errstate(invalid="ignore"):
            mean[name] = (of_scale * mass).sum(axis=0) / mass.sum(axis=0)
    n_non_mated = sum(result.n_non_mated for result in results)
    for name, alpha in LEVELS.items():
        if is_refused(n_non_mated, alpha):
            mean[name][:] = mean[name.replace("tpr_at", "realised")][:] = np.nan
    return mean
