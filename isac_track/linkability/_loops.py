"""Compiled loops of the linkage scorecard: shuffled mates, weights of pairs, hulls of ROCs.

A pair's weight is a product of two clusters' weights; all bootstrap replicates lie side by side in
memory, so that one vector instruction treats several.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from isac_track.compiling import compiled, part_of_loop, read, written
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    Cells: TypeAlias = NDArray[np.int32]
    Places: TypeAlias = NDArray[np.uint16]
    Bins: TypeAlias = NDArray[np.uint8]
    Rows: TypeAlias = NDArray[np.uint32]

_MOST = 2**16 - 1  # of a sum in 16 bits
_ASIDE = 8  # ROCs that are laid out at a time: their numbers fill a line of the cache.
_FEW = 32  # Probes whose ranks stay in the cache while all shuffles look them up.


@compiled(
    *(read(2), read(2, "int64"), read(1), read(1), read(1, "int64")),
    *(written(2), written(2, "int32"), written(2, "int64"), written(2, "int64")),
)
def rank_rows(
    scores: Floats,
    order: Ints,
    breaks: Floats,
    log_factorial: Floats,
    mate: Ints,
    log_rank: Floats,
    cell: Cells,
    standing: Ints,
    counts: Ints,
) -> None:
    """Write -log(rank / G), expected under ties, and the cell of every score.

    `order` sorts each row, ascending; `breaks` ascends. Cell 2 k + 1 is the k-th break point, cell
    2 k the gap below it. `standing`, (P, 2), gets how many stand above the probe's mate and how
    many as high. To `counts`, (cells, 2), are added the non-mated and the mated scores in each.
    """
    n_probes, n_gallery = scores.shape
    log_gallery = np.log(n_gallery)
    ordered, codes = np.empty(n_gallery), np.empty(n_gallery + 1, dtype=np.int32)
    for i in range(n_probes):
        of_row = order[i]
        for place in range(n_gallery):
            ordered[place] = scores[i, of_row[place]]
        # Two ascending lists are merged without a branch, which no processor could predict.
        place, k = 0, 0
        while place < n_gallery and k < breaks.size:
            codes[place] = 2 * k + (breaks[k] == ordered[place])
            is_below = breaks[k] < ordered[place]
            k += is_below
            place += not is_below
        codes[place:] = 2 * breaks.size
        start = 0
        while start < n_gallery:
            stop = start + 1
            while stop < n_gallery and ordered[stop] == ordered[start]:
                stop += 1
            code, above = codes[start], n_gallery - stop
            spread = log_factorial[n_gallery - start] - log_factorial[above]
            value = log_gallery - spread / (stop - start)
            counts[code, 0] += stop - start
            for place in range(start, stop):
                j = of_row[place]
                log_rank[i, j] = value
                cell[i, j] = code
                if j == mate[i]:
                    standing[i, 0], standing[i, 1] = above, stop - start
                    counts[code, 0] -= 1
                    counts[code, 1] += 1
            start = stop


@compiled(read(2), read(1, "int64"), read(1, "int64"), read(1, "uint16"), written(2, "uint16"))
def shuffle(uniform: Floats, sizes: Ints, n_alike: Ints, before: Places, whose: Places) -> None:
    """Write whose mate each of N mated probes gets, once a row, (n, N), as `permutation_p` says.

    Fisher and Yates, from uniforms. The probes come cluster by cluster: ``n_alike[a]`` clusters of
    ``sizes[a]`` probes each, for every a. `before` is the order to start from.
    """
    # The order that one draw leaves behind is as good a start for the next as any.
    for row in range(whose.shape[0]):
        uniforms, now = uniform[row], whose[row]
        now[:] = before
        # Unsigned: no index from the end, which would have to be looked for.
        drawn = np.uint64(0)
        base = 0
        for a in range(sizes.size):
            size, n_clusters = sizes[a], n_alike[a]
            for c in range(n_clusters):
                # The last cluster has no choice left, nor has the last member: no uniform.
                start = base + c * size
                if c < n_clusters - 1:
                    far = start + size * int(uniforms[drawn] * (n_clusters - c))
                    drawn += np.uint64(1)
                    for k in range(size):
                        here, other = np.uint64(start + k), np.uint64(far + k)
                        now[here], now[other] = now[other], now[here]
                for k in range(size - 1):
                    here = np.uint64(start + k)
                    other = np.uint64(start + k + int(uniforms[drawn] * (size - k)))
                    drawn += np.uint64(1)
                    now[here], now[other] = now[other], now[here]
            base += size * n_clusters
        before = now


@compiled(
    *(read(2, "uint16"), read(1, "int64"), read(1, "int64"), read(2), read(2, "uint8")),
    *(written(1), written(2)),
)
def add_shuffles(
    whose: Places,
    probes: Ints,
    mate: Ints,
    log_rank: Floats,
    score_bin: Bins,
    total: Floats,
    bins: Floats,
) -> None:
    """Add the log-rank statistic, (n,), and the histogram of mated scores, (bins, n), of shuffles.

    `whose`, (n, N), says which of the N `probes` had the `mate` that each has now.
    """
    for first in range(0, whose.shape[1], _FEW):
        last = min(first + _FEW, whose.shape[1])
        for row in range(whose.shape[0]):
            of_row, now = total[row], whose[row]
            for k in range(first, last):
                here, column = np.uint64(probes[k]), np.uint64(mate[np.uint64(now[k])])
                of_row += log_rank[here, column]
                bins[score_bin[here, column], row] += 1.0
            total[row] = of_row


@part_of_loop
def _sorted_pairs(
    ones: int, shapes: Ints, first: Ints, second: Ints, mate: Ints, cell: Cells, counts: Ints
) -> tuple[Ints, Rows, Rows]:
    """Return where the pairs of each cell and class begin, and the rows that weigh each pair."""
    one = np.uint32(ones)
    starts = np.zeros(counts.size + 1, dtype=np.int64)
    for key in range(counts.size):
        starts[key + 1] = starts[key] + counts[key // 2, key % 2]
    a_of = np.empty(cell.size, dtype=np.uint32)
    b_of = np.empty(cell.size, dtype=np.uint32)
    place = starts.copy()
    pair, row, column = 0, 0, 0
    for s in range(shapes.shape[0]):
        for i in range(row, row + shapes[s, 0]):
            a = np.uint32(first[i])
            for j in range(shapes[s, 1]):
                is_mate = j == mate[i]
                b = np.uint32(second[column + j])
                key = 2 * cell[pair] + is_mate
                at = place[key]
                place[key] = at + 1
                a_of[at] = a
                # Within a cluster, a pair weighs no more than the probe.
                b_of[at] = one if is_mate or a == b else b
                pair += 1
        row += shapes[s, 0]
        column += shapes[s, 1]
    return starts, a_of, b_of


@compiled(
    *(read(2, "uint8"), read(2, "int64"), read(1, "int64"), read(1, "int64"), read(1, "int64")),
    *(read(1, "int32"), read(2, "int64"), written(3)),
)
def weigh(
    table: Bins,
    shapes: Ints,
    first: Ints,
    second: Ints,
    mate: Ints,
    cell: Cells,
    counts: Ints,
    out: Floats,
) -> None:
    """Write the weight of non-mated and of mated scores in each cell that holds any, (2, K, R).

    `table`, (C + 1, R), holds the weights of the clusters in every replicate, then a row of ones.
    The searches, (P, G) each, come one after the other: the clusters of their probes (`first`) and
    candidates (`second`), the probes' mates, and the cell of every score; `counts` are
    `rank_rows`'s.
    """
    n_replicates, ones = table.shape[1], table.shape[0] - 1
    starts, a_of, b_of = _sorted_pairs(ones, shapes, first, second, mate, cell, counts)
    # As narrow as they come, sixteen to thirty-two in a vector instruction; so few cannot overflow.
    some, most = np.empty(n_replicates, dtype=np.uint16), _MOST // int(table.max()) ** 2
    number = 0
    for k in range(counts.shape[0]):
        if counts[k, 0] + counts[k, 1] == 0:
            continue
        for is_mated in range(2):
            weight = out[is_mated, number]
            weight[:] = 0.0
            last = starts[2 * k + is_mated + 1]
            for start in range(starts[2 * k + is_mated], last, most):
                stop = min(start + most, last)
                some[:] = 0
                # Four pairs a turn: to fetch and store the sums takes longer than a product.
                for pair in range(start, stop - 3, 4):
                    a, b = table[a_of[pair]], table[b_of[pair]]
                    c, d = table[a_of[pair + 1]], table[b_of[pair + 1]]
                    e, f = table[a_of[pair + 2]], table[b_of[pair + 2]]
                    g, h = table[a_of[pair + 3]], table[b_of[pair + 3]]
                    for r in range(n_replicates):
                        two = a[r] * b[r] + c[r] * d[r]
                        some[r] = np.uint16(some[r] + two + e[r] * f[r] + g[r] * h[r])
                for pair in range(stop - (stop - start) % 4, stop):
                    a, b = table[a_of[pair]], table[b_of[pair]]
                    for r in range(n_replicates):
                        some[r] = np.uint16(some[r] + a[r] * b[r])
                for r in range(n_replicates):
                    weight[r] += some[r]
        number += 1


@compiled(read(2), read(2), read(1, "int64"), written(2), written(2))
def link_shares(mated: Floats, non_mated: Floats, bins: Ints, totals: Floats, out: Floats) -> None:
    """Write `d_sys` and `d_sys_published`, (2, R), of both classes' weights in K cells, (K, R).

    The `bins` of the cells, (K,), ascend from the first bin to the last. The `totals` of both
    classes, (2, R), are written, too.
    """
    n = out.shape[1]
    sums = np.zeros((2, n))
    totals[:], out[:] = 0.0, 0.0
    for k in range(bins.size):
        for r in range(n):
            totals[0, r] += mated[k, r]
            totals[1, r] += non_mated[k, r]
    for k in range(bins.size):
        for r in range(n):
            sums[0, r] += mated[k, r]
            sums[1, r] += non_mated[k, r]
        if k == bins.size - 1 or bins[k + 1] != bins[k]:
            # Of the trapezia between bin centres the outer bins have one instead of two.
            inner = 1.0 - 0.5 * (bins[k] == bins[0]) - 0.5 * (bins[k] == bins[-1])
            for r in range(n):
                p, q = sums[0, r] / totals[0, r], sums[1, r] / totals[1, r]
                # 2 LR / (1 + LR) - 1 = (LR - 1) / (LR + 1), which is 1 where LR is infinite.
                share = p * (p - q) / (p + q) if p > q else 0.0
                out[0, r] += share
                out[1, r] += inner * share
            sums[:] = 0.0


@part_of_loop
def _x_log2_x(x: float) -> float:
    return x * np.log2(x) if x > 0 else 0.0


@part_of_loop
def _read_hull(
    own: Floats, other: Floats, rest: float, totals: tuple[float, float], stack: Floats
) -> tuple[float, float]:
    """Return EER and Cllr_min from the convex hull of the ROC: pool adjacent violators.

    The cells are overwritten; below them lies the `rest` of the non-mated scores.
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
    if waiting + rest > 0:
        stack[depth, 0], stack[depth, 1] = 0.0, waiting + rest
        depth += 1
    miss, false, cost, eer = 1.0, 0.0, 0.0, -1.0
    for k in range(depth):
        m, n = stack[k, 0] / totals[0], stack[k, 1] / totals[1]
        cost += _x_log2_x(m + n) - _x_log2_x(m) - _x_log2_x(n)
        if eer < 0 and miss - m <= false + n:
            eer = false + n * (miss - false) / (m + n)
        miss -= m
        false += n
    return eer, cost / 2


@part_of_loop
def _read_thresholds(
    own: Floats, totals: Floats, true: Floats, false: Floats, level: float, out: Floats
) -> bool:
    """Write the counts at this threshold where it has FPR <= level; tell whether any has."""
    n_low = 0
    for r in range(own.size):
        # Rounding must not refuse a share that lies exactly at the level.
        is_low = false[r] <= level * (1 + 1e-12) * totals[r]
        n_low += is_low
        out[0, r] = true[r] if is_low and own[r] > 0 else out[0, r]
        out[1, r] = false[r] if is_low and own[r] > 0 else out[1, r]
    return n_low > 0


@part_of_loop
def _lay_out(weights: Floats, first: int, out: Floats) -> None:
    """Write the weights, (K, R), of some ROCs one after the other, (ROCs, K)."""
    for k in range(len(weights)):
        for r in range(first, min(first + len(out), weights.shape[1])):
            out[r - first, k] = weights[k, r]


@compiled(written(2), written(2), read(2), read(1), written(2))
def read_rocs(
    mated: Floats, non_mated: Floats, totals: Floats, levels: Floats, out: Floats
) -> None:
    """Write AUC, EER and Cllr_min, then TPR and FPR at each level, of R ROCs.

    (K, R) of either class are the weights in each cell, from the lowest, and are overwritten;
    `totals`, (2, R), are their sums. The TPR is that of the lowest threshold with FPR <= level.
    `out` is (3 + 2 levels, R).
    """
    n_cells, n = mated.shape
    true, false, before = np.zeros(n), np.zeros(n), np.zeros(n)
    out[:] = 0.0
    is_open, top = np.ones(levels.size, dtype=np.bool_), n_cells
    for k in range(n_cells - 1, -1, -1):
        own, other = mated[k], non_mated[k]
        for r in range(n):
            false[r] += other[r]
        if not own.any():
            continue
        top -= 1
        for r in range(n):
            true[r] += own[r]
            out[0, r] += own[r] * (totals[1, r] - false[r] + other[r] / 2)
            # A cell without mated scores joins the one below.
            mated[top, r] = own[r]
            non_mated[top, r] = false[r] - before[r]
            before[r] = false[r]
        for number in range(levels.size):
            if is_open[number]:
                at = out[3 + 2 * number : 5 + 2 * number]
                is_open[number] = _read_thresholds(
                    mated[top], totals[1], true, false, levels[number], at
                )
    out[0] /= totals[0] * totals[1]
    for row in range(3, len(out)):
        out[row] /= totals[(row + 1) % 2]
    stack, cells = np.empty((n_cells + 1, 2)), np.empty((2, _ASIDE, n_cells - top))
    for r in range(n):
        if r % _ASIDE == 0:
            _lay_out(mated[top:], r, cells[0])
            _lay_out(non_mated[top:], r, cells[1])
        both, rest = (totals[0, r], totals[1, r]), false[r] - before[r]
        own, other = cells[0, r % _ASIDE], cells[1, r % _ASIDE]
        out[1, r], out[2, r] = _read_hull(own, other, rest, both, stack)
