"""Compiled loops of the linkage scorecard: shuffled mates, weights of pairs, hulls of ROCs.

A pair's weight is a product of two clusters' weights; `LANES` bootstrap replicates lie side by side
in memory, so that one vector instruction treats several.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.compiling import compiled, part_of_loop, read, written

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isac_track.types import Floats, Ints

LANES = 104
"""Replicates side by side: so many that their latencies overlap and a pair's overhead vanishes.
Twice as many hold the 201 of a scorecard, and hardly more."""

_BLOCK = 4096
"""Pairs whose weights a 32-bit number may add up: integers below 2^24 are exact."""


@compiled(
    *(read(2), read(2, "int64"), read(1), read(1), read(1, "int64")),
    *(written(2), written(2, "int64"), written(2, "int64")),
)
def rank_rows(
    scores: Floats,
    order: Ints,
    breaks: Floats,
    log_factorial: Floats,
    mate: Ints,
    log_rank: Floats,
    cell: Ints,
    standing: Ints,
) -> None:
    """Write -log(rank / G), expected under ties, and the cell of every score.

    `order` sorts each row, ascending; `breaks` ascends. Cell 2 k + 1 is the k-th break point, cell
    2 k the gap below it. `standing`, (P, 2), gets how many stand above the probe's mate and how
    many as high.
    """
    n_probes, n_gallery = scores.shape
    log_gallery = np.log(n_gallery)
    for i in range(n_probes):
        start, k = 0, 0
        while start < n_gallery:
            score = scores[i, order[i, start]]
            stop = start + 1
            while stop < n_gallery and scores[i, order[i, stop]] == score:
                stop += 1
            while k < breaks.size and breaks[k] < score:
                k += 1
            code = 2 * k + (k < breaks.size and breaks[k] == score)
            above = n_gallery - stop
            spread = log_factorial[n_gallery - start] - log_factorial[above]
            value = log_gallery - spread / (stop - start)
            for place in range(start, stop):
                j = order[i, place]
                log_rank[i, j] = value
                cell[i, j] = code
                if j == mate[i]:
                    standing[i, 0], standing[i, 1] = above, stop - start
            start = stop


@compiled(
    *(read(2), read(1, "int64"), read(1, "int64"), read(1, "int64"), read(2), read(2, "uint8")),
    *(written(1), written(2)),
)
def shuffle(
    uniform: Floats,
    sizes: Ints,
    n_alike: Ints,
    mate: Ints,
    log_rank: Floats,
    score_bin: NDArray[np.uint8],
    total: Floats,
    bins: Floats,
) -> None:
    """Give mated probes one another's mates, once a row, as `permutation_p` says.

    Fisher and Yates, from uniforms. The probes come cluster by cluster: ``n_alike[a]`` clusters of
    ``sizes[a]`` probes each, for every a. Add the log-rank statistic, and the histogram of mated
    scores, of every set of mates.
    """
    # Unsigned: no index from the end, which would have to be looked for.
    columns = mate.astype(np.uint64)
    one = np.uint64(1)
    # The order that one draw leaves behind is as good a start for the next as any.
    for row in range(uniform.shape[0]):
        of_row, uniforms, histogram = total[row], uniform[row], bins[row]
        drawn = np.uint64(0)
        base = 0
        for a in range(sizes.size):
            size, n_clusters = sizes[a], n_alike[a]
            for c in range(n_clusters):
                # The last cluster has no choice left, nor has the last member: no uniform.
                start = base + c * size
                if c < n_clusters - 1:
                    far = start + size * int(uniforms[drawn] * (n_clusters - c))
                    drawn += one
                    for k in range(size):
                        here, other = np.uint64(start + k), np.uint64(far + k)
                        column = columns[other]
                        columns[other] = columns[here]
                        columns[here] = column
                for k in range(size - 1):
                    here = np.uint64(start + k)
                    other = np.uint64(start + k + int(uniforms[drawn] * (size - k)))
                    drawn += one
                    column = columns[other]
                    columns[other] = columns[here]
                    columns[here] = column
            base += size * n_clusters
        for k in range(columns.size):
            here = np.uint64(k)
            column = columns[here]
            of_row += log_rank[here, column]
            histogram[score_bin[here, column]] += 1.0
        total[row] = of_row


@part_of_loop
def _by_key(key: Ints, n_keys: int, first: Ints, second: Ints) -> tuple[Ints, Ints, Ints]:
    """Return where the pairs of each key begin, and the two clusters of each, key by key."""
    starts = np.zeros(n_keys + 1, dtype=np.int64)
    for one in key:
        starts[one + 1] += 1
    starts = np.cumsum(starts)
    place = starts.copy()
    sorted_first, sorted_second = np.empty_like(first), np.empty_like(second)
    for pair in range(key.size):
        at = place[key[pair]]
        place[key[pair]] = at + 1
        sorted_first[at], sorted_second[at] = first[pair], second[pair]
    return starts, sorted_first, sorted_second


@compiled(read(3, "float32"), read(1, "int64"), read(1, "int64"), read(1, "int64"), written(3))
def weigh(tables: NDArray[np.float32], key: Ints, first: Ints, second: Ints, out: Floats) -> None:
    """Write the weight of either class in each of K cells, (2, chunks * `LANES`, K).

    `tables` is (chunks, C + 1, `LANES`): weights of the clusters, then a row of ones. A pair of
    class c in cell k, of a `first` and a `second` cluster, has the key 2 k + c.
    """
    n_keys = 2 * out.shape[2]
    starts, a_of, b_of = _by_key(key, n_keys, first, second)
    some, row = np.empty(LANES, dtype=np.float32), np.empty(LANES)
    for chunk in range(tables.shape[0]):
        table = tables[chunk]
        for k in range(n_keys):
            row[:] = 0.0
            for start in range(starts[k], starts[k + 1], _BLOCK):
                stop = min(start + _BLOCK, starts[k + 1])
                some[:] = 0.0
                # Four pairs a turn: to fetch and store the sums takes longer than a product.
                for pair in range(start, stop - 3, 4):
                    a, b = table[a_of[pair]], table[b_of[pair]]
                    c, d = table[a_of[pair + 1]], table[b_of[pair + 1]]
                    e, f = table[a_of[pair + 2]], table[b_of[pair + 2]]
                    g, h = table[a_of[pair + 3]], table[b_of[pair + 3]]
                    for lane in range(LANES):
                        two = a[lane] * b[lane] + c[lane] * d[lane]
                        some[lane] += two + (e[lane] * f[lane] + g[lane] * h[lane])
                for pair in range(stop - (stop - start) % 4, stop):
                    a, b = table[a_of[pair]], table[b_of[pair]]
                    for lane in range(LANES):
                        some[lane] += a[lane] * b[lane]
                for lane in range(LANES):
                    row[lane] += some[lane]
            for lane in range(LANES):
                out[k % 2, chunk * LANES + lane, k // 2] = row[lane]


@part_of_loop
def _x_log2_x(x: float) -> float:
    return x * np.log2(x) if x > 0 else 0.0


@part_of_loop
def _read_thresholds(
    own: Floats, other: Floats, total_own: float, total_other: float, levels: Floats, out: Floats
) -> None:
    """Write the AUC, and TPR and FPR of the lowest threshold with FPR <= level."""
    out[3:] = 0.0
    for number in range(levels.size):
        # Rounding must not refuse a share that lies exactly at the level.
        most = levels[number] * (1 + 1e-12) * total_other
        true, false = 0.0, 0.0
        for k in range(own.size - 1, -1, -1):
            true += own[k]
            false += other[k]
            if false > most:
                break
            if own[k] > 0:
                out[3 + 2 * number] = true / total_own
                out[4 + 2 * number] = false / total_other
    false, area = 0.0, 0.0
    for k in range(own.size - 1, -1, -1):
        false += other[k]
        area += own[k] * (total_other - false + other[k] / 2)
    out[0] = area / (total_own * total_other)


@part_of_loop
def _read_hull(
    own: Floats, other: Floats, total_own: float, total_other: float, stack: Floats, out: Floats
) -> None:
    """Write EER and Cllr_min from the convex hull of the ROC: pool adjacent violators.

    The cells are overwritten.
    """
    # Without mated scores a cell has the least likelihood ratio, and joins the one below.
    size, waiting = own.size, 0.0
    for k in range(own.size - 1, -1, -1):
        m, n = own[k], other[k] + waiting
        # Written without a branch, which no processor could predict.
        own[size - 1] = m
        other[size - 1] = n
        size -= m > 0
        waiting = 0.0 if m > 0 else n
    depth = 0
    for k in range(own.size - 1, size - 1, -1):
        m, n = own[k], other[k]
        # Downwards the likelihood ratio of a block must fall.
        while depth > 0 and m * stack[depth - 1, 1] >= stack[depth - 1, 0] * n:
            depth -= 1
            m += stack[depth, 0]
            n += stack[depth, 1]
        stack[depth, 0], stack[depth, 1] = m, n
        depth += 1
    if waiting > 0:
        stack[depth, 0], stack[depth, 1] = 0.0, waiting
        depth += 1
    miss, false, cost, eer = 1.0, 0.0, 0.0, -1.0
    for k in range(depth):
        m, n = stack[k, 0] / total_own, stack[k, 1] / total_other
        cost += _x_log2_x(m + n) - _x_log2_x(m) - _x_log2_x(n)
        if eer < 0 and miss - m <= false + n:
            eer = false + n * (miss - false) / (m + n)
        miss -= m
        false += n
    out[1], out[2] = eer, cost / 2


@compiled(written(2), written(2), read(1), written(2))
def read_rocs(mated: Floats, non_mated: Floats, levels: Floats, out: Floats) -> None:
    """Write AUC, EER and Cllr_min, then TPR and FPR at each level, a row for each ROC.

    A row of either class, (K,), holds the weights in each cell, from the lowest, and is
    overwritten.
    """
    stack = np.empty((mated.shape[1] + 1, 2))
    for row in range(mated.shape[0]):
        own, other = mated[row], non_mated[row]
        totals = own.sum(), other.sum()
        _read_thresholds(own, other, totals[0], totals[1], levels, out[row])
        _read_hull(own, other, totals[0], totals[1], stack, out[row])
