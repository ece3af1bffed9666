"""Compiled loops of the linkage scorecard: ranks, shuffles, ROCs and assignments.

The weight of a pair is the product of the weights of its two clusters. All bootstrap
replicates lie side by side in memory, so that one vector instruction treats several.
"""

# ruff: noqa: C901, PLR0912, PLR0915, FURB136 - this form compiles to the fastest code

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
"""All searches, (P, G) each, one after the other.

Their shapes, the clusters of the probes, the clusters of the candidates, the mates of
the probes, the cell of every score, and the `counts` of `rank_rows`.
"""

_MOST_16_BITS = 2**16 - 1  # The largest sum that 16 bits hold.
_ROWS = 4  # Rows that are merged side by side.
_ASIDE = 8  # Minima side by side.


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
    point, cell 2 k the gap below it. The loop writes to `standing`, (P, 2), how many
    candidates score above the probe's mate and how many as high. It adds to `counts`,
    (cells, 2), the numbers of non-mated and of mated scores in each cell.
    """
    (log_rank, cell, standing, counts), (n_probes, n_gallery) = out, scores.shape
    log_gallery, n_breaks = np.log(n_gallery), breaks.size
    # Infinity ends every list, behind all finite values.
    limits = np.full(n_breaks + 1, np.inf)
    limits[:n_breaks] = breaks
    ordered = np.full((_ROWS, n_gallery + 1), np.inf)
    codes = np.empty((_ROWS, n_gallery + 1), dtype=np.int32)
    places = np.empty(_ROWS, dtype=np.uint64)
    n_passed = np.empty(_ROWS, dtype=np.uint64)
    for first in range(0, n_probes, _ROWS):
        n_rows = min(_ROWS, n_probes - first)
        for row in range(n_rows):
            for place in range(n_gallery):
                ordered[row, place] = scores[first + row, order[first + row, place]]
        # The loop merges two ascending lists without a branch, which no processor could
        # predict. The steps of the four rows do not wait for each other.
        places[:], n_passed[:] = 0, 0
        for _ in range(n_gallery + n_breaks):
            for row in range(_ROWS):
                position, k = places[row], n_passed[row]
                score, limit = ordered[row, position], limits[k]
                codes[row, position] = np.uint64(2) * k + np.uint64(limit == score)
                is_below = np.uint64(limit < score)
                n_passed[row] = k + is_below
                places[row] = position + np.uint64(1) - is_below
        for row in range(n_rows):
            i = first + row
            columns, start = order[i], 0
            while start < n_gallery:
                stop = start + 1
                while ordered[row, stop] == ordered[row, start]:
                    stop += 1
                code, above = codes[row, start], n_gallery - stop
                spread = log_factorial[n_gallery - start] - log_factorial[above]
                value = log_gallery - spread / (stop - start)
                counts[code, 0] += stop - start
                for place in range(start, stop):
                    j = columns[place]
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
    counts: Ints,
    first: int,
    mates: Places,
    columns: Places,
) -> None:
    """Write the mate that each of N mated probes gets, (N, n): see `permutation_p`.

    The method of Fisher and Yates, with one row of `uniform` for each shuffle from the
    `first` on. The probes come cluster by cluster: ``counts[a]`` clusters of
    ``sizes[a]`` probes each, for every a. `mates` is the order to start from.
    """
    # The order that a shuffle leaves behind is as good a start for the next as any.
    for row in range(len(uniform)):
        uniforms = uniform[row]
        # Unsigned: the compiler need not check for negative indices.
        drawn = np.uint64(0)
        base = 0
        for a in range(sizes.size):
            size, n_clusters = sizes[a], counts[a]
            for c in range(n_clusters):
                # The last cluster, and the last member, need no draw.
                start = base + c * size
                if c < n_clusters - 1:
                    far = start + size * int(uniforms[drawn] * (n_clusters - c))
                    drawn += np.uint64(1)
                    for k in range(size):
                        place, chosen = np.uint64(start + k), np.uint64(far + k)
                        mates[place], mates[chosen] = mates[chosen], mates[place]
                for k in range(size - 1):
                    place = np.uint64(start + k)
                    chosen = np.uint64(start + k + int(uniforms[drawn] * (size - k)))
                    drawn += np.uint64(1)
                    mates[place], mates[chosen] = mates[chosen], mates[place]
            base += size * n_clusters
        columns[:, first + row] = mates


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
    """Add the log-rank statistic and the histogram of mated scores of n shuffles.

    `total`, (n,), gets the statistic, `bins`, (bins, n), the histogram. `columns`,
    (N, n), are the columns of the shuffled mates of the N `probes`.
    """
    for k in range(probes.size):
        ranks, row_bins = log_rank[probes[k]], score_bin[probes[k]]
        row_mates = columns[k]
        for shuffled in range(row_mates.size):
            column = np.uint64(row_mates[shuffled])
            total[shuffled] += ranks[column]
            bins[row_bins[column], shuffled] += 1


@part_of_loop
def _sorted_pairs(unit_row: int, pairs: _Pairs) -> tuple[Ints, Places, Places]:
    """Sort pairs by cell and class: return the starts, and two weight rows a pair.

    `unit_row` is the row of the table of weights that holds ones.
    """
    (shapes, first, second, mate, cell, counts), unit = pairs, np.uint16(unit_row)
    starts = np.zeros(counts.size + 1, dtype=np.int64)
    for key in range(counts.size):
        starts[key + 1] = starts[key] + counts[key // 2, key % 2]
    first_row, second_row = np.empty((2, cell.size), dtype=np.uint16)
    place = starts.copy()
    pair, row, column = 0, 0, 0
    for s in range(shapes.shape[0]):
        for i in range(row, row + shapes[s, 0]):
            a = np.uint16(first[i])
            for j in range(shapes[s, 1]):
                is_mate = j == mate[i]
                b = np.uint16(second[column + j])
                key = 2 * cell[pair] + is_mate
                slot = place[key]
                place[key] = slot + 1
                first_row[slot] = a
                # Within a cluster, a pair weighs no more than the probe.
                second_row[slot] = unit if is_mate or a == b else b
                pair += 1
        row += shapes[s, 0]
        column += shapes[s, 1]
    return starts, first_row, second_row


@part_of_loop
def _weigh(
    table: Bins,
    n_at_once: int,
    first_row: Places,
    second_row: Places,
    partial: Places,
    total: Floats,
) -> None:
    """Write to `total`, (R,), the summed weight of these pairs in every replicate.

    The loop sums in 16 bits, `n_at_once` pairs at a time.
    """
    total[:] = 0.0
    for start in range(0, first_row.size, n_at_once):
        stop = min(start + n_at_once, first_row.size)
        partial[:] = 0
        # Four pairs a turn: fetching and storing sums takes longer than a product.
        for pair in range(start, stop - 3, 4):
            a, b = table[first_row[pair]], table[second_row[pair]]
            c, d = table[first_row[pair + 1]], table[second_row[pair + 1]]
            e, f = table[first_row[pair + 2]], table[second_row[pair + 2]]
            g, h = table[first_row[pair + 3]], table[second_row[pair + 3]]
            for r in range(partial.size):
                pair_sum = a[r] * b[r] + c[r] * d[r]
                partial[r] = np.uint16(
                    partial[r] + pair_sum + e[r] * f[r] + g[r] * h[r]
                )
        for pair in range(stop - (stop - start) % 4, stop):
            a, b = table[first_row[pair]], table[second_row[pair]]
            for r in range(partial.size):
                partial[r] = np.uint16(partial[r] + a[r] * b[r])
        for r in range(partial.size):
            total[r] += partial[r]


@part_of_loop
def _add_share(sums: Floats, totals: Floats, inner: float, out: Floats) -> None:
    """Add a bin's share of `d_sys` and `d_sys_published`, (2, R); empty its sums."""
    for r in range(out.shape[1]):
        p, q = sums[0, r] / totals[0, r], sums[1, r] / totals[1, r]
        # 2 LR / (1 + LR) - 1 = (LR - 1) / (LR + 1), which is 1 where LR is infinite.
        share = p * (p - q) / (p + q) if p > q else 0.0
        out[0, r] += share
        out[1, r] += inner * share
    sums[:] = 0.0


@compiled(read(2, "uint16"), read(1, "int64"), written(1))
def mean_shares(mated: Places, counts: Ints, out: Floats) -> None:
    """Write `d_sys`, (n,), of n histograms of mated scores, (bins, n).

    `counts`, (bins,), are those of all scores, mated or not.
    """
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
    """Return the hits and false links of replicate `r` at the best threshold.

    It has the most hits with at most `limit` false links; of several, it is the
    highest. The binary search is written out: numpy's takes seconds to compile.
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
    """Return the cells with scores, ascending, and the number with mated scores."""
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
    """Write all score metrics of every replicate.

    `out`, (5 + 2 levels, R), gets `d_sys`, `d_sys_published`, AUC, EER, Cllr_min, then
    TPR and FPR at each level. `table`, (C + 1, R), holds the weights of the clusters
    in every replicate, then a row of ones. The `bins` of the cells ascend; `totals`,
    (2, R), are the weights of all mated and of all non-mated scores. A TPR is that of
    the lowest threshold with FPR <= level. The hull is that of pooled adjacent
    violators.
    """
    n_replicates, counts = table.shape[1], pairs[5]
    starts, first_row, second_row = _sorted_pairs(table.shape[0] - 1, pairs)
    # Sums of 16 bits: a vector instruction treats sixteen to thirty-two of them. So few
    # pairs at once cannot overflow.
    n_at_once = _MOST_16_BITS // _heaviest(table) ** 2
    partial = np.empty(n_replicates, dtype=np.uint16)
    mated_sum, non_mated_sum = np.empty(n_replicates), np.empty(n_replicates)
    true, false = np.zeros(n_replicates), np.zeros(n_replicates)
    waiting = np.zeros(n_replicates)
    occupied, n_mated = _occupied(counts)
    sums, n_thresholds = np.zeros((2, n_replicates)), 0
    hits, alarms = np.empty((n_mated, n_replicates)), np.empty((n_mated, n_replicates))
    # At the bottom of every stack lies a block that no other is merged with.
    stacks = np.empty((n_replicates, n_mated + 2, 2))
    stacks[:, 0, 0], stacks[:, 0, 1] = np.inf, 0.0
    depths = np.zeros(n_replicates, dtype=np.int64)
    drawn = np.zeros(n_replicates, dtype=np.int64)
    lowest, highest = bins[occupied[0]], bins[occupied[-1]]
    out[:] = 0.0
    for place in range(occupied.size - 1, -1, -1):
        k = occupied[place]
        start, middle, stop = starts[2 * k : 2 * k + 3]
        _weigh(
            table,
            n_at_once,
            first_row[start:middle],
            second_row[start:middle],
            partial,
            non_mated_sum,
        )
        for r in range(n_replicates):
            false[r] += non_mated_sum[r]
            # A cell without mated scores joins the cell below.
            waiting[r] += non_mated_sum[r]
            sums[1, r] += non_mated_sum[r]
        if counts[k, 1]:
            _weigh(
                table,
                n_at_once,
                first_row[middle:stop],
                second_row[middle:stop],
                partial,
                mated_sum,
            )
            for r in range(n_replicates):
                true[r] += mated_sum[r]
                sums[0, r] += mated_sum[r]
                out[2, r] += mated_sum[r] * (
                    totals[1, r] - false[r] + non_mated_sum[r] / 2
                )
            n_own = 0
            for r in range(n_replicates):
                drawn[n_own] = r
                n_own += mated_sum[r] > 0
            for r in drawn[:n_own]:
                m, n, depth, stack = mated_sum[r], waiting[r], depths[r], stacks[r]
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
            # An outer bin lies in one of the trapezia between bin centres, an inner bin
            # in two.
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
def assign(cost: Floats, row_to_column: Ints) -> None:
    """Write the column assigned to each row, (P,), at the least total cost.

    `cost` is (P, G), P <= G. The method is shortest augmenting paths (Crouse, IEEE
    T-AES 52(4), 2016); ties are broken as in scipy's `linear_sum_assignment`.
    """
    n_rows, n = cost.shape
    u, v, column_to_row = np.zeros(n_rows), np.zeros(n), np.full(n, -1)
    # Lengths of the paths to columns that wait (infinite beyond them), and to columns
    # that were reached.
    front, reached_at, left = np.full(n + _ASIDE, np.inf), np.empty(n), np.empty(n)
    path, waiting, waiting_place, reached = np.empty((4, n), dtype=np.int64)
    least = np.empty(_ASIDE)
    row_to_column[:] = -1
    for start in range(n_rows):
        left[:] = v
        for j in range(n):
            waiting[j] = waiting_place[j] = n - 1 - j
            front[j] = np.inf
        i, length, n_reached, sink = start, 0.0, 0, -1
        while sink < 0:
            row_cost, own = cost[i], u[i]
            for j in range(n):
                to_column = length + row_cost[j] - own - left[j]
                path[j] = i if to_column < front[j] else path[j]
                front[j] = to_column if to_column < front[j] else front[j]
            least[:] = np.inf
            for first in range(0, n, _ASIDE):
                for lane in range(_ASIDE):
                    candidate = front[first + lane]
                    least[lane] = candidate if candidate < least[lane] else least[lane]
            length = least.min()
            j, n_ties = 0, 0
            while front[j] != length:
                j += 1
            for lane in range(_ASIDE):
                n_ties += least[lane] == length
            for other in range(j + _ASIDE, n, _ASIDE):
                n_ties += front[other] == length
            if n_ties > 1:
                j = -1
                for other in waiting[: n - n_reached]:
                    if front[other] == length and (j < 0 or column_to_row[other] < 0):
                        j = other
            reached[n_reached], reached_at[j] = j, length
            n_reached += 1
            # The last that waits takes its place.
            last = waiting[n - n_reached]
            waiting[waiting_place[j]], waiting_place[last] = last, waiting_place[j]
            front[j], left[j] = np.inf, -np.inf
            i = column_to_row[j]
            sink = j if i < 0 else -1
        u[start] += length
        for j in reached[:n_reached]:
            if column_to_row[j] >= 0:
                u[column_to_row[j]] += length - reached_at[j]
            v[j] -= length - reached_at[j]
        j = sink
        while j >= 0:
            i = path[j]
            column_to_row[j] = i
            j, row_to_column[i] = row_to_column[i], j
