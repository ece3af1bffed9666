"""Compiled loops of the linkage scorecard: ranks, shuffled mates, ROCs and assignments.

A pair's weight is a product of two clusters' weights; all bootstrap replicates lie side
by side in memory, so that one vector instruction treats several.
"""

# ruff: noqa: C901, PLR0912, FURB136 - written out as they compile to the fastest code

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from isac_track.compiling import INT, compiled, part_of_loop, read, together, written
from isac_track.types import Floats, Ints

Cells: TypeAlias = NDArray[np.int32]
Places: TypeAlias = NDArray[np.uint16]
Bins: TypeAlias = NDArray[np.uint8]
_Ranked: TypeAlias = tuple[Floats, Cells, Ints, Ints]
_Pairs: TypeAlias = tuple[Ints, Ints, Ints, Ints, Cells, Ints]
"""The searches, (P, G) each, one after the other: their shapes, the clusters of probes and those of
candidates, the probes' mates, and the cell of every score; and `rank_rows`'s counts."""

_MOST = 2**16 - 1  # of a sum in 16 bits
_ROWS = 4  # Merged side by side.
_ASIDE = 8  # Minima kept side by side.


@compiled(
    read(2),
    read(2, "int64"),
    read(1),
    read(1),
    read(1, "int64"),
    together(written(2), written(2, "int32"), written(2, "int64"), written(2, "int64")),
)
def rank_rows(
    scores: Floats,
    order: Ints,
    breaks: Floats,
    log_factorial: Floats,
    mate: Ints,
    out: _Ranked,
) -> None:
    """Write -log(rank / G), expected under ties, and the cell of every score.

    `order` sorts each row, ascending; `breaks` ascends. Cell 2 k + 1 is the k-th break
    point, cell 2 k the gap below it. `standing`, (P, 2), gets how many stand above the
    probe's mate and how many as high. To `counts`, (cells, 2), are added the non-mated
    and the mated scores in each.
    """
    (log_rank, cell, standing, counts), (n_probes, n_gallery) = out, scores.shape
    log_gallery, n_breaks = np.log(n_gallery), breaks.size
    # Infinity ends every list: whatever is in it comes first.
    limits = np.full(n_breaks + 1, np.inf)
    limits[:n_breaks] = breaks
    ordered = np.full((_ROWS, n_gallery + 1), np.inf)
    codes = np.empty((_ROWS, n_gallery + 1), dtype=np.int32)
    places, passed = np.empty(_ROWS, dtype=np.uint64), np.empty(_ROWS, dtype=np.uint64)
    for first in range(0, n_probes, _ROWS):
        n_rows = min(_ROWS, n_probes - first)
        for row in range(n_rows):
            for place in range(n_gallery):
                ordered[row, place] = scores[first + row, order[first + row, place]]
        # Two ascending lists are merged without a branch, which no processor could
        # predict; one step of a row does not wait for those of the others.
        places[:], passed[:] = 0, 0
        for _ in range(n_gallery + n_breaks):
            for row in range(_ROWS):
                at, k = places[row], passed[row]
                score, limit = ordered[row, at], limits[k]
                codes[row, at] = np.uint64(2) * k + np.uint64(limit == score)
                is_below = np.uint64(limit < score)
                passed[row] = k + is_below
                places[row] = at + np.uint64(1) - is_below
        for row in range(n_rows):
            i = first + row
            of_row, start = order[i], 0
            while start < n_gallery:
                stop = start + 1
                while ordered[row, stop] == ordered[row, start]:
                    stop += 1
                code, above = codes[row, start], n_gallery - stop
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


@compiled(
    read(2),
    read(1, "int64"),
    read(1, "int64"),
    INT,
    written(1, "uint16"),
    written(2, "uint16"),
)
def shuffle(
    uniform: Floats,
    sizes: Ints,
    n_alike: Ints,
    first: int,
    now: Places,
    columns: Places,
) -> None:
    """Write whose mate each of N mated probes gets, (N, n), as `permutation_p` says.

    Fisher and Yates, from uniforms, a row for each shuffle from the `first` on. The
    probes come cluster by cluster: ``n_alike[a]`` clusters of ``sizes[a]`` probes each,
    for every a. `now` is the order to start from.
    """
    # The order that one draw leaves behind is as good a start for the next as any.
    for row in range(len(uniform)):
        uniforms = uniform[row]
        # Unsigned: no index from the end, which would have to be looked for.
        drawn = np.uint64(0)
        base = 0
        for a in range(sizes.size):
            size, n_clusters = sizes[a], n_alike[a]
            for c in range(n_clusters):
                # The last cluster has no choice left, nor has the last member: no
                # uniform.
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
        columns[:, first + row] = now


@compiled(
    read(2, "uint16"),
    read(1, "int64"),
    read(2),
    read(2, "uint8"),
    written(1),
    written(2, "uint16"),
)
def add_shuffles(
    columns: Places,
    probes: Ints,
    log_rank: Floats,
    score_bin: Bins,
    total: Floats,
    bins: Places,
) -> None:
    """Add the log-rank statistic, (n,), and the histogram of mated scores, (bins, n), of shuffles.

    `columns`, (N, n), are those of the mates that the N `probes` have now.
    """
    for k in range(probes.size):
        ranks, bin_of, now = log_rank[probes[k]], score_bin[probes[k]], columns[k]
        for shuffled in range(now.size):
            column = np.uint64(now[shuffled])
            total[shuffled] += ranks[column]
            bins[bin_of[column], shuffled] += 1


@part_of_loop
def _sorted_pairs(ones: int, pairs: _Pairs) -> tuple[Ints, Places, Places]:
    """Return where the pairs of each cell and class begin, and the rows that weigh each pair."""
    (shapes, first, second, mate, cell, counts), one = pairs, np.uint16(ones)
    starts = np.zeros(counts.size + 1, dtype=np.int64)
    for key in range(counts.size):
        starts[key + 1] = starts[key] + counts[key // 2, key % 2]
    a_of, b_of = np.empty((2, cell.size), dtype=np.uint16)
    place = starts.copy()
    pair, row, column = 0, 0, 0
    for s in range(shapes.shape[0]):
        for i in range(row, row + shapes[s, 0]):
            a = np.uint16(first[i])
            for j in range(shapes[s, 1]):
                is_mate = j == mate[i]
                b = np.uint16(second[column + j])
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


@part_of_loop
def _weigh(
    table: Bins, most: int, a_of: Places, b_of: Places, some: Places, total: Floats
) -> None:
    """Write the weight of some pairs in every replicate, (R,); in 16 bits, `most` at a time."""
    total[:] = 0.0
    for start in range(0, a_of.size, most):
        stop = min(start + most, a_of.size)
        some[:] = 0
        # Four pairs a turn: to fetch and store the sums takes longer than a product.
        for pair in range(start, stop - 3, 4):
            a, b = table[a_of[pair]], table[b_of[pair]]
            c, d = table[a_of[pair + 1]], table[b_of[pair + 1]]
            e, f = table[a_of[pair + 2]], table[b_of[pair + 2]]
            g, h = table[a_of[pair + 3]], table[b_of[pair + 3]]
            for r in range(some.size):
                two = a[r] * b[r] + c[r] * d[r]
                some[r] = np.uint16(some[r] + two + e[r] * f[r] + g[r] * h[r])
        for pair in range(stop - (stop - start) % 4, stop):
            a, b = table[a_of[pair]], table[b_of[pair]]
            for r in range(some.size):
                some[r] = np.uint16(some[r] + a[r] * b[r])
        for r in range(some.size):
            total[r] += some[r]


@part_of_loop
def _add_share(sums: Floats, totals: Floats, inner: float, out: Floats) -> None:
    """Add what a bin contributes to `d_sys` and `d_sys_published`, (2, R); empty its sums."""
    for r in range(out.shape[1]):
        p, q = sums[0, r] / totals[0, r], sums[1, r] / totals[1, r]
        # 2 LR / (1 + LR) - 1 = (LR - 1) / (LR + 1), which is 1 where LR is infinite.
        share = p * (p - q) / (p + q) if p > q else 0.0
        out[0, r] += share
        out[1, r] += inner * share
    sums[:] = 0.0


@compiled(read(2, "uint16"), read(1, "int64"), written(1))
def mean_shares(mated: Places, counts: Ints, out: Floats) -> None:
    """Write `d_sys`, (n,), of histograms of mated scores, (bins, n), of all `counts`, (bins,)."""
    n_bins, n = mated.shape
    sums, totals, shares = np.empty((2, n)), np.zeros((2, n)), np.zeros((2, n))
    for k in range(n_bins):
        totals[0] += mated[k]
        totals[1] += counts[k] - mated[k]
    for k in range(n_bins):
        sums[0], sums[1] = mated[k], counts[k] - mated[k]
        _add_share(sums, totals, 1.0, shares)
    out[:] = shares[0]


@part_of_loop
def _x_log2_x(x: float) -> float:
    return x * np.log2(x) if x > 0 else 0.0


@part_of_loop
def _read_hull(blocks: Floats, totals: tuple[float, float]) -> tuple[float, float]:
    """Return EER and Cllr_min from the blocks of the convex hull of a ROC."""
    miss, false, cost, eer = 1.0, 0.0, 0.0, -1.0
    for k in range(len(blocks)):
        m, n = blocks[k, 0] / totals[0], blocks[k, 1] / totals[1]
        cost += _x_log2_x(m + n) - _x_log2_x(m) - _x_log2_x(n)
        if eer < 0 and miss - m <= false + n:
            eer = false + n * (miss - false) / (m + n)
        miss -= m
        false += n
    return eer, cost / 2


@part_of_loop
def _read_threshold(
    true: Floats, false: Floats, r: int, limit: float
) -> tuple[float, float]:
    """Return the counts at the highest threshold of the most hits with no more false links.

    Of column `r`. The search is written out: numpy's takes seconds to compile.
    """
    # Rounding must not refuse a share that lies exactly at the level.
    limit *= 1 + 1e-12
    k, above = -1, false.shape[0]
    while above - k > 1:
        middle = (k + above) // 2
        if false[middle, r] <= limit:
            k = middle
        else:
            above = middle
    while k > 0 and true[k - 1, r] == true[k, r]:
        k -= 1
    return (true[k, r], false[k, r]) if k >= 0 and true[k, r] > 0 else (0.0, 0.0)


@part_of_loop
def _heaviest(table: Bins) -> int:
    """Return the greatest weight, at least 1."""
    heaviest = 1
    for c in range(table.shape[0]):
        for r in range(table.shape[1]):
            heaviest = max(heaviest, int(table[c, r]))
    return heaviest


@part_of_loop
def _occupied(counts: Ints) -> tuple[Ints, int]:
    """Return the cells that have scores, ascending, and how many have mated ones."""
    cells = np.empty(counts.shape[0], dtype=np.int64)
    n, n_mated = 0, 0
    for k in range(counts.shape[0]):
        cells[n] = k
        n += counts[k, 0] + counts[k, 1] > 0
        n_mated += counts[k, 1] > 0
    return cells[:n], n_mated


@compiled(
    read(2, "uint8"),
    together(
        read(2, "int64"), *[read(1, "int64")] * 3, read(1, "int32"), read(2, "int64")
    ),
    read(1, "uint8"),
    read(2),
    read(1),
    written(2),
)
def read_scores(
    table: Bins, pairs: _Pairs, bins: Bins, totals: Floats, levels: Floats, out: Floats
) -> None:
    """Write `d_sys`, `d_sys_published`, AUC, EER, Cllr_min, then TPR and FPR at each level.

    `out` is (5 + 2 levels, R). `table`, (C + 1, R), holds the weights of the clusters
    in every replicate, then a row of ones. The `bins` of the cells ascend; `totals`,
    (2, R), are the weights of all mated and of all non-mated scores. A TPR is that of
    the lowest threshold with FPR <= level. The hull is that of pooled adjacent
    violators.
    """
    n_replicates, counts = table.shape[1], pairs[5]
    starts, a_of, b_of = _sorted_pairs(table.shape[0] - 1, pairs)
    # As narrow as they come, sixteen to thirty-two in a vector instruction; so few
    # cannot overflow.
    most = _MOST // _heaviest(table) ** 2
    some = np.empty(n_replicates, dtype=np.uint16)
    own, other = np.empty(n_replicates), np.empty(n_replicates)
    true, false, waiting = (
        np.zeros(n_replicates),
        np.zeros(n_replicates),
        np.zeros(n_replicates),
    )
    occupied, n_mated = _occupied(counts)
    sums, n_thresholds = np.zeros((2, n_replicates)), 0
    hits, alarms = np.empty((n_mated, n_replicates)), np.empty((n_mated, n_replicates))
    # At the bottom of every stack lies what no block is merged with.
    stacks = np.empty((n_replicates, n_mated + 2, 2))
    stacks[:, 0, 0], stacks[:, 0, 1] = np.inf, 0.0
    depths = np.zeros(n_replicates, dtype=np.int64)
    drawn = np.zeros(n_replicates, dtype=np.int64)
    lowest, highest = bins[occupied[0]], bins[occupied[-1]]
    out[:] = 0.0
    for place in range(occupied.size - 1, -1, -1):
        k = occupied[place]
        start, middle, stop = starts[2 * k : 2 * k + 3]
        _weigh(table, most, a_of[start:middle], b_of[start:middle], some, other)
        for r in range(n_replicates):
            false[r] += other[r]
            # A cell without mated scores joins the one below.
            waiting[r] += other[r]
            sums[1, r] += other[r]
        if counts[k, 1]:
            _weigh(table, most, a_of[middle:stop], b_of[middle:stop], some, own)
            for r in range(n_replicates):
                true[r] += own[r]
                sums[0, r] += own[r]
                out[2, r] += own[r] * (totals[1, r] - false[r] + other[r] / 2)
            n_own = 0
            for r in range(n_replicates):
                drawn[n_own] = r
                n_own += own[r] > 0
            for r in drawn[:n_own]:
                m, n, depth, stack = own[r], waiting[r], depths[r], stacks[r]
                # Downwards the likelihood ratio of a block must fall.
                while m * stack[depth, 1] >= stack[depth, 0] * n:
                    m += stack[depth, 0]
                    n += stack[depth, 1]
                    depth -= 1
                depths[r], waiting[r] = depth + 1, 0.0
                stack[depth + 1, 0], stack[depth + 1, 1] = m, n
            hits[n_thresholds], alarms[n_thresholds] = true, false
            n_thresholds += 1
        if place == 0 or bins[occupied[place - 1]] != bins[k]:
            # Of the trapezia between bin centres the outer bins have one instead of
            # two.
            inner = 1.0 - 0.5 * (bins[k] == lowest) - 0.5 * (bins[k] == highest)
            _add_share(sums, totals, inner, out[:2])
    for r in range(n_replicates):
        out[2, r] /= totals[0, r] * totals[1, r]
        blocks = stacks[r, 1 : depths[r] + 2]
        blocks[-1, 0], blocks[-1, 1] = 0.0, waiting[r]
        mated, non_mated = totals[0, r], totals[1, r]
        out[3, r], out[4, r] = _read_hull(blocks, (mated, non_mated))
        for number in range(levels.size):
            limit = levels[number] * non_mated
            true_r, false_r = _read_threshold(hits, alarms, r, limit)
            out[5 + 2 * number, r], out[6 + 2 * number, r] = (
                true_r / mated,
                false_r / non_mated,
            )


@compiled(read(2), written(1, "int64"))
def assign(cost: Floats, column_of: Ints) -> None:
    """Write the column of each row, (P,), of the least total cost; (P, G), P <= G.

    By shortest augmenting paths (Crouse, IEEE T-AES 52(4), 2016), with ties broken as
    scipy's `linear_sum_assignment` does.
    """
    n_rows, n = cost.shape
    u, v, row_of = np.zeros(n_rows), np.zeros(n), np.full(n, -1)
    # Lengths of the paths to columns that wait, infinite beyond them; and to those
    # reached.
    front, reached_at, left = np.full(n + _ASIDE, np.inf), np.empty(n), np.empty(n)
    path, waiting, place_of, reached = np.empty((4, n), dtype=np.int64)
    least = np.empty(_ASIDE)
    column_of[:] = -1
    for start in range(n_rows):
        left[:] = v
        for j in range(n):
            waiting[j] = place_of[j] = n - 1 - j
            front[j] = np.inf
        i, length, n_reached, sink = start, 0.0, 0, -1
        while sink < 0:
            of_row, own = cost[i], u[i]
            for j in range(n):
                to_column = length + of_row[j] - own - left[j]
                path[j] = i if to_column < front[j] else path[j]
                front[j] = to_column if to_column < front[j] else front[j]
            least[:] = np.inf
            for first in range(0, n, _ASIDE):
                for lane in range(_ASIDE):
                    one = front[first + lane]
                    least[lane] = one if one < least[lane] else least[lane]
            length = least.min()
            j, n_alike = 0, 0
            while front[j] != length:
                j += 1
            for lane in range(_ASIDE):
                n_alike += least[lane] == length
            for other in range(j + _ASIDE, n, _ASIDE):
                n_alike += front[other] == length
            if n_alike > 1:
                j = -1
                for other in waiting[: n - n_reached]:
                    if front[other] == length and (j < 0 or row_of[other] < 0):
                        j = other
            reached[n_reached], reached_at[j] = j, length
            n_reached += 1
            # The last that waits takes its place.
            last = waiting[n - n_reached]
            waiting[place_of[j]], place_of[last] = last, place_of[j]
            front[j], left[j] = np.inf, -np.inf
            i = row_of[j]
            sink = j if i < 0 else -1
        u[start] += length
        for j in reached[:n_reached]:
            if row_of[j] >= 0:
                u[row_of[j]] += length - reached_at[j]
            v[j] -= length - reached_at[j]
        j = sink
        while j >= 0:
            i = path[j]
            row_of[j] = i
            j, column_of[i] = column_of[i], j
