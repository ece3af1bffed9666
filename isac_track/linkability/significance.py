"""Is there a link at all? Tests against guessing and against shuffled mates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, betaincinv, gammaln, xlog1py, xlogy

from isac_track.linkability.ranks import Search, log_factorials
from isac_track.types import Floats, Ints, stretches

Outcome: TypeAlias = Literal["links", "no link detected", "attack too weak"]

People: TypeAlias = tuple[bytes, bytes, bytes]
"""Mates and clusters of a search, as 64-bit integers: unlike arrays, bytes are hashed."""

LEVEL = 0.05  # Of the tests.
_AT_ONCE = (
    2**20
)  # Scores that are ranked at a time: of thousands of people all take 400 MB.
_SPARE = 2**29 - 1  # Bits that a number in single precision leaves unused in double.


@dataclass(frozen=True, eq=False, slots=True)
class Mated:
    """The N probes of a search that have a mate."""

    probes: Ints  # (N,) cluster by cluster, those of the smallest first
    mate: Ints  # (N,) their columns
    sizes: Ints  # (A,) of clusters, ascending
    n_alike: Ints  # (A,) clusters of each size


def permutation_p(
    *, searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int = 999
) -> float:
    """Return the one-sided p-value of `mean_log_rank` against random mates.

    (1 + #{shuffled >= observed}) / (1 + n_shuffles), which is valid for any number of
    shuffles. 1 without a mated probe.

    People of one walking group resemble each other within a release, linked or not:
    mates that are shuffled one by one vary too little, and reject far too often. So in
    each search whole clusters of mated probes are permuted among those with equally
    many, and members freely within each: a mated probe gets the mate of some member of
    the cluster that its own is mapped to. With one probe a cluster this is a uniform
    permutation of the mates; who is nobody's mate is never drawn.

    The test has its level where, under the null, equally large clusters of one release
    may be exchanged, and so may the members of each, without a change in the law of the
    scores. Rare sizes cost power, not validity. Of several searches no two may be of
    the same two releases.

    Search by search, a shuffle draws one uniform number for each mated probe, less one
    for each size of a cluster. ValueError without a search or for fewer than 999
    shuffles.

    References
    ----------
    p-value: Phipson and Smyth, Statistical Applications in Genetics and Molecular
    Biology 9(1),
    2010. Blocks permuted whole and within: Winkler, Webster, Vidaurre, Nichols, Smith, NeuroImage
    123, 2015 (multi-level block permutation).
    """
    check_searches(searches, n_shuffles)
    observed, null, _ = shuffled_log_ranks(searches, rng, n_shuffles)
    return p_value_among(observed, null)


def shuffled_log_ranks(
    searches: Sequence[Search], rng: np.random.Generator, n_shuffles: int
) -> tuple[float, Floats, list[Ints]]:
    """Return the sum of `log_rank` over mates, those of shuffled mates, (n,), and `standing`s."""
    null, nowhere = np.zeros(n_shuffles), np.zeros((1, n_shuffles), dtype=np.uint16)
    observed, standings = 0.0, []
    for search in searches:
        mated, parts = mated_probes(people_of(search)), []
        columns = shuffled_mates(mated, rng, n_shuffles)
        n_at_once = max(1, _AT_ONCE // search.scores.shape[1])
        for first in range(0, search.mate.size, n_at_once):
            rows, unused = (
                slice(first, first + n_at_once),
                np.zeros((1, 2), dtype=np.int64),
            )
            scores, mate = search.scores[rows], search.mate[rows]
            ranks, cell, standing = rank_rows(scores, mate, np.empty(0), unused)
            some = np.flatnonzero(
                (mated.probes >= first) & (mated.probes < first + mate.size)
            )
            part = replace(
                mated, probes=mated.probes[some] - first, mate=mated.mate[some]
            )
            bins = cell.astype(np.uint8)
            observed += add_shuffles(part, columns[some], ranks, bins, null, nowhere)
            parts.append(standing)
        standings.append(np.concatenate(parts))
    return observed, null, standings


def rank1_p(*, hits: Floats, chance: Floats) -> float:
    """Return the p-value of so many hits at rank 1 or more, if all are guesses.

    Exact for independent probes: binomial where all have one chance, else
    Poisson-binomial. A fraction of a hit, left by ties, does not count: the sum is
    rounded down. 1 without a probe.

    `hits`, (N,), are from `rank1`, mated probes only, and `chance`, (N,), is that of
    each, 1 / G. ValueError if shapes differ, or a hit or a chance lies outside of 0..1.
    """
    if hits.shape != chance.shape or hits.ndim != 1:
        shapes = f"{hits.shape}, {chance.shape}"
        raise ValueError(f"hits and chance must have one shape (N,), got {shapes}")
    both = np.concatenate([hits, chance])
    if not ((both >= 0) & (both <= 1)).all():
        raise ValueError("hits and chance must lie in 0..1")
    # Three thirds are a hit, whatever rounding made of them.
    n_hits = math.floor(float(hits.sum()) + 1e-9)
    if n_hits == 0:
        return 1.0
    return float(_tail_of(chance.astype(np.float64).tobytes())[n_hits])


@lru_cache(maxsize=64)
def _tail_of(chance: bytes) -> Floats:
    """Return the probability of 0..N hits or more; attacks on the same people ask it again."""
    values, counts = np.unique(np.frombuffer(chance), return_counts=True)
    if values.size == 1:
        return np.append(1.0, bdtrc(np.arange(counts[0]), counts[0], values[0]))
    law = np.ones(1)
    for p, n in zip(values, counts, strict=True):
        k = np.arange(n + 1)
        log_choose = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
        law = np.convolve(law, np.exp(log_choose + xlogy(k, p) + xlog1py(n - k, -p)))
    return np.minimum(1.0, np.cumsum(law[::-1])[::-1])


@lru_cache(maxsize=64)
def minimum_detectable_rank1(*, n: int, chance: float) -> float:
    """Return the smallest rank-1 rate that the exact binomial test at `LEVEL` finds in 80 %.

    Of `n` mated probes, taken as independent, whose rate of guessing is `chance`.
    Infinity where no rate does: not even n hits of n are significant. ValueError if a
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
    """Return what a test at `LEVEL` says, given the same attack's p-value on unperturbed tracks.

    An attack that cannot link even those says nothing of a mechanism by failing.
    ValueError if a p-value is not in 0..1.
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


def people_of(search: Search) -> People:
    """Return who is searched for: two searches of the same people have the same."""
    arrays = (search.mate, search.probe_cluster, search.gallery_cluster)
    mate, probes, gallery = (each.astype(np.int64).tobytes() for each in arrays)
    return mate, probes, gallery


def n_candidates(people: People) -> int:
    """Return the size of the gallery."""
    return len(people[2]) // np.dtype(np.int64).itemsize


@lru_cache(maxsize=64)
def mated_probes(people: People) -> Mated:
    """Return who has a mate."""
    mate, cluster = (np.frombuffer(each, dtype=np.int64) for each in people[:2])
    probes = np.flatnonzero(mate >= 0)
    _, place, counts = np.unique(
        cluster[probes], return_inverse=True, return_counts=True
    )
    probes = probes[np.lexsort((place, counts[place]))]
    return Mated(probes, mate[probes], *np.unique(counts, return_counts=True))


@lru_cache(maxsize=64)
def companions_of(people: People) -> tuple[Ints, Ints]:
    """Return probes with a mate and the other candidates of their cluster, (n,) each, in pairs."""
    mate, probes, gallery = (np.frombuffer(each, dtype=np.int64) for each in people)
    order = np.argsort(gallery, kind="stable")
    first, last = (
        np.searchsorted(gallery[order], probes, side=end) for end in ("left", "right")
    )
    probe = np.repeat(np.arange(mate.size), last - first)
    column = order[stretches(first, last - first)[0]]
    others = (mate[probe] >= 0) & (mate[probe] != column)
    return probe[others], column[others]


def rank_rows(
    scores: Floats, mate: Ints, breaks: Floats, counts: Ints
) -> tuple[Floats, NDArray[np.int32], Ints]:
    """Return `log_rank` of every column were it the mate, (P, G), its cell, and `standing`, (P, 2).

    Cell 2 k + 1 is the k-th of the ascending `breaks`, cell 2 k the gap below it. To
    `counts`, (cells, 2), are added the non-mated and the mated scores in each. Without
    a mate -1 stand above it and 0 as high.
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
    return log_rank, cell, standing


def _ascending(scores: Floats) -> Ints:
    """Return the columns of each row, (P, G), from the lowest score to the highest."""
    bits = scores.view(np.int64)
    if (bits & _SPARE).any():
        return np.argsort(scores, axis=1)
    # Of single precision, scores have room for their own column: plain numbers sort
    # faster.
    packed = (bits | np.arange(scores.shape[1])).view(np.float64)
    packed.sort(axis=1)
    return np.asarray(packed.view(np.int64) & _SPARE)


def shuffled_mates(
    mated: Mated, rng: np.random.Generator, n: int
) -> NDArray[np.uint16]:
    """Return the column of the mate that each of N probes gets, (N, n), as `permutation_p` draws.

    Of more candidates than 16 bits can count no memory holds the scores.
    """
    sizes, n_alike = mated.sizes.copy(), mated.n_alike.copy()
    n_probes, rows = mated.probes.size, 64
    uniform = np.empty((rows, n_probes - sizes.size))
    if sizes.size and sizes[0] == 1:
        # Permuting clusters of one is permuting the members of one cluster, which is
        # faster.
        sizes[0], n_alike[0] = n_alike[0], 1
    columns, now = (
        np.empty((n_probes, n), dtype=np.uint16),
        mated.mate.astype(np.uint16),
    )
    # As few at a time as the cache holds.
    for first in range(0, n, rows):
        some = uniform[: n - first]
        rng.random(out=some)
        import_loops().shuffle(some, sizes, n_alike, first, now, columns)
    return columns


def add_shuffles(
    mated: Mated,
    columns: NDArray[np.uint16],
    log_rank: Floats,
    score_bin: NDArray[np.uint8],
    null: Floats,
    null_bins: NDArray[np.uint16],
) -> float:
    """Return the sum of `log_rank`, (P, G), over mates; add those of n shuffles to `null`.

    To `null_bins`, (bins, n), are added their mated scores, whose bins are `score_bin`,
    (P, G).
    """
    import_loops().add_shuffles(
        columns, mated.probes, log_rank, score_bin, null, null_bins
    )
    return float(log_rank[mated.probes, mated.mate].sum())


def import_loops() -> Any:  # noqa: ANN401 - a module of compiled functions, which have no types
    """Return the compiled loops; the first call imports numba."""
    return import_module("isac_track.linkability._loops")


def holm(p_values: Floats) -> Floats:
    """Return p-values adjusted for all of them, (K,): Holm (Scand. J. Statistics 6, 1979).

    The chance of even one false discovery is at most the level, however the numbers
    depend on each other. An unknown one (NaN) stays so and does not count.
    """
    adjusted: Floats = np.full(p_values.shape, np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    times = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * times))
    return adjusted
