"""Is there a link at all? Tests against guessing and against shuffled mates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, betaincinv, gammaln, xlog1py, xlogy

from isac_track.linkability.ranks import Search, log_factorials
from isac_track.types import Floats, Ints, stretches

Outcome: TypeAlias = Literal["links", "no link detected", "attack too weak"]
"""Finding of a test of linkage, as `outcome` returns it."""
LEVEL = 0.05
"""Significance level of the tests."""
# Scores that are ranked at a time: those of thousands of people take 400 MB at once.
_SCORES_AT_ONCE = 2**20
# Column of the last candidate that shuffles can name: they keep columns in 16 bits.
_LAST_COLUMN = 2**16 - 1
# Bits of a double that a number in single precision leaves unused.
_SPARE_BITS = 2**29 - 1


class People(NamedTuple):
    """Mates and clusters of a search, as bytes of 64-bit integers: these are hashed."""

    mate: bytes
    probe_cluster: bytes
    gallery_cluster: bytes


@dataclass(frozen=True, eq=False, slots=True)
class Mated:
    """The N probes of a search that have a mate."""

    probes: Ints  # (N,) cluster by cluster, those of the smallest first
    mate: Ints  # (N,) their columns
    sizes: Ints  # (A,) of clusters, ascending
    n_clusters: Ints  # (A,) number of clusters of each size


def permutation_p(
    *, searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int = 999
) -> float:
    """Return the one-sided p-value of `mean_log_rank` against random mates.

    (1 + #{shuffled >= observed}) / (1 + n_shuffles), which is valid for any number of
    shuffles. 1 without a mated probe.

    People of one walking group resemble each other within a release, linked or not. If
    mates were shuffled individually, the statistic would vary too little, and the test
    would reject far too often. So in each search whole clusters of mated probes are
    permuted among clusters with as many, and members freely within each: a mated probe
    gets the mate of some member of the cluster that its own is mapped to. With one
    probe a cluster this is a uniform permutation of the mates. A candidate who is
    nobody's mate is never drawn.

    The test has its level where, under the null, equally large clusters of one release
    may be exchanged, and so may the members of each, without a change in the law of the
    scores. Rare sizes cost power, not validity. Of several searches no two may be of
    the same two releases.

    Search by search, a shuffle draws one uniform number for each mated probe, less one
    for each size of a cluster. ValueError without a search, for fewer than 999
    shuffles, or for a mate beyond the first 65,536 candidates.

    References
    ----------
    p-value: Phipson and Smyth, Statistical Applications in Genetics and Molecular
    Biology 9(1), 2010. Blocks permuted whole and within: Winkler, Webster, Vidaurre,
    Nichols, Smith, NeuroImage 123, 2015 (multi-level block permutation).
    """
    check_searches(searches, n_shuffles)
    shuffled = shuffled_log_ranks(searches, rng, n_shuffles)
    return p_value_among(shuffled.observed, shuffled.null)


@dataclass(frozen=True, eq=False, slots=True)
class ShuffledRanks:
    """The test statistic of mates and of shuffled mates, with the ranks behind it."""

    observed: float  # Sum of `log_rank` over mates.
    null: Floats  # (n_shuffles,) the same sums over shuffled mates.
    standings: Sequence[Ints]  # (P, 2) of each search, as in `RankedRows`.


def shuffled_log_ranks(
    searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int
) -> ShuffledRanks:
    """Rank all searches, and shuffle their mates as `permutation_p` does.

    The loops also count scores in cells and bins, for score metrics. Those are not
    wanted here: without a break all scores lie in one cell, which is one bin.
    """
    observed, null, standings = 0.0, np.zeros(n_shuffles), []
    no_breaks, unused_counts = np.empty(0), np.zeros((1, 2), dtype=np.int64)
    unused_bins = np.zeros((1, n_shuffles), dtype=np.uint16)
    for search in searches:
        mated = mated_probes(searched_people(search))
        columns, parts = shuffled_mates(mated, rng, n_shuffles), []
        n_at_once = max(1, _SCORES_AT_ONCE // search.scores.shape[1])
        for first in range(0, search.mate.size, n_at_once):
            rows = slice(first, first + n_at_once)
            scores, mate = search.scores[rows], search.mate[rows]
            ranked = rank_rows(scores, mate, no_breaks, unused_counts)
            in_part = np.flatnonzero(
                (mated.probes >= first) & (mated.probes < first + mate.size)
            )
            part = replace(
                mated, probes=mated.probes[in_part] - first, mate=mated.mate[in_part]
            )
            only_bin = ranked.cell.astype(np.uint8)
            observed += add_shuffles(
                part, columns[in_part], ranked.log_rank, only_bin, null, unused_bins
            )
            parts.append(ranked.standing)
        standings.append(np.concatenate(parts))
    return ShuffledRanks(observed, null, standings)


def rank1_p(*, hits: Floats, chance: Floats) -> float:
    """Return the p-value of at least as many hits at rank 1, if all are guesses.

    Exact for independent probes: binomial where all have one chance, else
    Poisson-binomial. A fraction of a hit, left by ties, does not count: the sum is
    rounded down. 1 without a probe.

    `hits`, (N,), are from `rank1`, mated probes only, and `chance`, (N,), is that of
    each, 1 / G. ValueError if shapes differ, or a hit or a chance lies outside of 0..1.

    Examples
    --------
    At least one hit of two probes that guess right in one of ten: 1 - 0.9^2.

    >>> import numpy as np
    >>> from isac_track.linkability import rank1_p
    >>> p = rank1_p(hits=np.array([1.0, 0.0]), chance=np.array([0.1, 0.1]))
    >>> round(p, 6)
    0.19
    """
    if hits.shape != chance.shape or hits.ndim != 1:
        shapes = f"{hits.shape}, {chance.shape}"
        raise ValueError(f"hits and chance must have one shape (N,), got {shapes}")
    shares = np.concatenate([hits, chance])
    if not ((shares >= 0) & (shares <= 1)).all():
        raise ValueError("hits and chance must lie in 0..1")
    # Three thirds are a hit, whatever rounding made of them.
    n_hits = math.floor(float(hits.sum()) + 1e-9)
    if n_hits == 0:
        return 1.0
    return float(_tail_probabilities(chance.astype(np.float64).tobytes())[n_hits])


# For further attacks on the same people; the 65th makes the oldest go.
@lru_cache(maxsize=64)
def _tail_probabilities(chance: bytes) -> Floats:
    """Return the probability of at least 0..N hits, (N + 1,)."""
    values, counts = np.unique(np.frombuffer(chance), return_counts=True)
    if values.size == 1:
        return np.append(1.0, bdtrc(np.arange(counts[0]), counts[0], values[0]))
    law = np.ones(1)
    for p, n in zip(values, counts, strict=True):
        k = np.arange(n + 1)
        log_choose = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
        law = np.convolve(law, np.exp(log_choose + xlogy(k, p) + xlog1py(n - k, -p)))
    return np.minimum(1.0, np.cumsum(law[::-1])[::-1])


def minimum_detectable_rank1(*, n: int, chance: float) -> float:
    """Return the smallest rank-1 rate that the exact binomial test detects in 80 %.

    The test is at `LEVEL`, of `n` independent mated probes that guess right at the rate
    `chance`. Infinity where not even n hits of n are significant. ValueError if a
    number is out of range.
    """
    if n < 0 or not 0 <= chance <= 1:
        raise ValueError(f"need n >= 0 and chance in 0..1, got {n} and {chance}")
    significant = np.flatnonzero(bdtrc(np.arange(n), n, chance) <= LEVEL)
    if not significant.size:
        return math.inf
    hits = int(significant[0]) + 1
    # P(hits or more of n) is the regularised incomplete beta function of the rate.
    return float(betaincinv(hits, n - hits + 1, 0.8))


def outcome(*, p_value: float, ceiling_p_value: float) -> Outcome:
    """Return the finding of a test at `LEVEL`, given the p-value on unperturbed tracks.

    An attack that cannot link even unperturbed tracks shows nothing about a mechanism
    when it fails. ValueError if a p-value is not in 0..1.

    >>> from isac_track.linkability import outcome
    >>> outcome(p_value=0.3, ceiling_p_value=0.001)
    'no link detected'
    >>> outcome(p_value=0.3, ceiling_p_value=0.4)
    'attack too weak'
    """
    for p in (p_value, ceiling_p_value):
        if not 0 <= p <= 1:
            raise ValueError(f"a p-value lies in 0..1, got {p}")
    if p_value <= LEVEL:
        return "links"
    return "attack too weak" if ceiling_p_value > LEVEL else "no link detected"


def p_value_among(observed: float, null: Floats) -> float:
    """Return the one-sided p-value of a sum among those of shuffles."""
    # Sums of the same numbers in another order may differ by rounding; they are ties.
    return (1 + int((null >= observed - 1e-9).sum())) / (1 + null.size)


def check_searches(searches: Sequence[Search], n_shuffles: int) -> None:
    """Raise ValueError without a search or for too few shuffles."""
    if not searches:
        raise ValueError("at least one search is needed")
    if n_shuffles < 999:  # noqa: PLR2004 - p-values to a thousandth
        raise ValueError(f"n_shuffles must be at least 999, got {n_shuffles}")


def searched_people(search: Search) -> People:
    """Return the people of a search: equal for two searches of the same people."""
    return People(
        search.mate.astype(np.int64).tobytes(),
        search.probe_cluster.astype(np.int64).tobytes(),
        search.gallery_cluster.astype(np.int64).tobytes(),
    )


def n_candidates(people: People) -> int:
    """Return the size of the gallery."""
    return len(people.gallery_cluster) // np.dtype(np.int64).itemsize


# Of the searches that a task's attacks share; as above.
@lru_cache(maxsize=64)
def mated_probes(people: People) -> Mated:
    """Return the probes that have a mate."""
    mate = np.frombuffer(people.mate, dtype=np.int64)
    cluster = np.frombuffer(people.probe_cluster, dtype=np.int64)
    probes = np.flatnonzero(mate >= 0)
    _, place, counts = np.unique(
        cluster[probes], return_inverse=True, return_counts=True
    )
    probes = probes[np.lexsort((place, counts[place]))]
    return Mated(probes, mate[probes], *np.unique(counts, return_counts=True))


# As above.
@lru_cache(maxsize=64)
def list_companions(people: People) -> tuple[Ints, Ints]:
    """List the other members of each mate's cluster: probes and columns, (n,) each."""
    mate, probes, gallery = (np.frombuffer(array, dtype=np.int64) for array in people)
    order = np.argsort(gallery, kind="stable")
    first = np.searchsorted(gallery[order], probes, side="left")
    last = np.searchsorted(gallery[order], probes, side="right")
    probe = np.repeat(np.arange(mate.size), last - first)
    column = order[stretches(first, last - first)[0]]
    others = (mate[probe] >= 0) & (mate[probe] != column)
    return probe[others], column[others]


@dataclass(frozen=True, eq=False, slots=True)
class RankedRows:
    """Ranks of the G candidates of each of P probes."""

    log_rank: Floats  # (P, G) of every column as if it were the mate.
    # (P, G) cell of every score: 2 k + 1 is the k-th break, 2 k the gap below it.
    cell: NDArray[np.int32]
    # (P, 2) candidates above the mate and as high; -1 and 0 without a mate.
    standing: Ints


def rank_rows(scores: Floats, mate: Ints, breaks: Floats, counts: Ints) -> RankedRows:
    """Rank all candidates of each probe.

    The `breaks` ascend. The non-mated and the mated scores in each cell are added to
    `counts`, (cells, 2).
    """
    scores = np.ascontiguousarray(scores, dtype=np.float64)
    log_rank, cell = np.empty(scores.shape), np.empty(scores.shape, dtype=np.int32)
    standing = np.tile([-1, 0], (len(scores), 1))
    import_loops().rank_rows(
        scores,
        _ascending(scores),
        breaks,
        log_factorials(scores.shape[1]),
        np.ascontiguousarray(mate, dtype=np.int64),
        (log_rank, cell, standing, counts),
    )
    return RankedRows(log_rank, cell, standing)


def _ascending(scores: Floats) -> Ints:
    """Return the columns of each row, (P, G), from the lowest score to the highest."""
    bits = scores.view(np.int64)
    if (bits & _SPARE_BITS).any():
        return np.argsort(scores, axis=1)
    # Scores of single precision leave room for their own column: plain numbers sort
    # faster than an argsort.
    packed = (bits | np.arange(scores.shape[1])).view(np.float64)
    packed.sort(axis=1)
    return np.asarray(packed.view(np.int64) & _SPARE_BITS)


def shuffled_mates(
    mated: Mated, rng: np.random.Generator, n: int
) -> NDArray[np.uint16]:
    """Draw the column of the mate that each of N probes gets in n shuffles, (N, n).

    As in `permutation_p`. Columns are kept in 16 bits: the shuffles of a search take a
    quarter of the memory that they would as 64-bit integers. ValueError for a mate
    beyond the first 65,536 candidates.
    """
    last = int(mated.mate.max(initial=0))
    if last > _LAST_COLUMN:
        limit = f"{_LAST_COLUMN + 1:,} candidates"
        raise ValueError(
            f"a search may have at most {limit}; a mate is no. {last + 1:,}"
        )
    sizes, n_clusters = mated.sizes.copy(), mated.n_clusters.copy()
    n_probes, rows = mated.probes.size, 64
    uniform = np.empty((rows, n_probes - sizes.size))
    if sizes.size and sizes[0] == 1:
        # Permuting clusters of one probe is permuting the members of one cluster, which
        # is faster.
        sizes[0], n_clusters[0] = n_clusters[0], 1
    columns = np.empty((n_probes, n), dtype=np.uint16)
    mates = mated.mate.astype(np.uint16)
    # Few rows at a time, so that they stay in the processor's cache.
    for first in range(0, n, rows):
        draws = uniform[: n - first]
        rng.random(out=draws)
        import_loops().shuffle(draws, sizes, n_clusters, first, mates, columns)
    return columns


def add_shuffles(
    mated: Mated,
    columns: NDArray[np.uint16],
    log_rank: Floats,
    score_bin: NDArray[np.uint8],
    null: Floats,
    null_bins: NDArray[np.uint16],
) -> float:
    """Return the sum of `log_rank`, (P, G), over mates; add the n shuffles to `null`.

    Counts of their mated scores are added to `null_bins`, (bins, n); `score_bin`, (P,
    G), is the bin of every score.
    """
    import_loops().add_shuffles(
        columns, mated.probes, log_rank, score_bin, null, null_bins
    )
    return float(log_rank[mated.probes, mated.mate].sum())


def import_loops() -> Any:  # noqa: ANN401 - a module of compiled functions, which have no types
    """Import the compiled loops; the first call imports numba."""
    return import_module("isac_track.linkability._loops")


def holm(p_values: Floats) -> Floats:
    """Return p-values adjusted for all K tests, (K,): Holm's method.

    Holm, Scandinavian Journal of Statistics 6, 1979. The chance of even one false
    discovery is at most the level, however the tests depend on each other. An unknown
    p-value (NaN) stays NaN and does not count.
    """
    adjusted: Floats = np.full(p_values.shape, np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    times = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * times))
    return adjusted
