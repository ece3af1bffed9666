"""Compiled loops of the linkage scorecard: ranks, cells of scores, and bootstrap replicates.

The scores of one scale are cut into *cells*: the break points are the distinct mated scores and
the inner edges of the D_sys bins, and a cell is one break point or the gap between two. Within a
cell no metric can tell two scores apart, so that a replicate needs the weight of mated and
non-mated scores per cell and nothing else. A pair's weight is a product of two clusters' weights;
`LANES` replicates lie side by side in memory, so that one vector instruction treats several.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from isac_track.compiling import (
    FLOAT,
    FLOATS1,
    FLOATS2,
    INT,
    INTS1,
    OUT_FLOATS1,
    OUT_FLOATS2,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isac_track.types import Floats, Ints

    Bytes = NDArray[np.uint8]
    Weights = NDArray[np.float32]

LANES = 104
"""Replicates side by side: so many that their latencies overlap and a pair's overhead vanishes.
Twice as many hold the 201 of a scorecard, and hardly more."""

_FEW = 8
"""Replicates whose numbers share a line of the cache."""

_BLOCK = 4096
"""Pairs whose weights a 32-bit number may add up: integers below 2^24 are exact."""

COLUMNS = 11
"""What `replicates` writes: mass of mated and of non-mated scores, AUC, EER, Cllr_min, TPR and
FPR at the first level, TPR and FPR at the second, D_sys, and room for Cllr."""

_WEIGHTS3 = numba.types.Array(numba.float32, 3, "C", readonly=True)
_BYTES2 = numba.types.Array(numba.uint8, 2, "C", readonly=True)
_INTS2 = numba.types.Array(numba.int64, 2, "C", readonly=True)
_OUT_INTS1 = numba.int64[::1]
_OUT_INTS2 = numba.int64[:, ::1]


@compiled(
    FLOATS2,
    _INTS2,
    FLOATS1,
    FLOATS1,
    INTS1,
    OUT_FLOATS2,
    _OUT_INTS2,
    _OUT_INTS2,
    _OUT_INTS1,
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
    counts: Ints,
) -> None:
    """Write -log(rank / G), expected under ties, and the cell of every score.

    `order` sorts each row, ascending; `breaks` ascends. Cell 2 k + 1 is the k-th break point,
    cell 2 k the gap below it. `standing`, (P, 3), gets how many stand above the probe's mate and
    how many as high, and the mate's cell; to `counts` are added the non-mated scores of each cell.
    """
    n_probes, n_gallery = scores.shape
    log_gallery = np.log(n_gallery)
    for i in range(n_probes):
        start = 0
        k = 0
        while start < n_gallery:
            score = scores[i, order[i, start]]
            stop = start + 1
            while stop < n_gallery and scores[i, order[i, stop]] == score:
                stop += 1
            while k < breaks.size and breaks[k] < score:
                k += 1
            code = 2 * k
            if k < breaks.size and breaks[k] == score:
                code += 1
            above = n_gallery - stop
            spread = log_factorial[n_gallery - start] - log_factorial[above]
            value = log_gallery - spread / (stop - start)
            for place in range(start, stop):
                j = order[i, place]
                log_rank[i, j] = value
                cell[i, j] = code
                if j == mate[i]:
                    standing[i, 0] = above
                    standing[i, 1] = stop - start
                    standing[i, 2] = code
            counts[code] += stop - start
            start = stop
        if mate[i] >= 0:
            counts[standing[i, 2]] -= 1


@compiled(FLOATS2, INTS1, INTS1, INTS1, FLOATS2, _BYTES2, OUT_FLOATS1, OUT_FLOATS2)
def shuffle(
    uniform: Floats,
    sizes: Ints,
    n_alike: Ints,
    mate: Ints,
    log_rank: Floats,
    score_bin: Bytes,
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


@compiled(_INTS2, INTS1, INTS1, INTS1, INT, _OUT_INTS1, _OUT_INTS1, _OUT_INTS1)
def fill_cells(
    cell: Ints,
    mate: Ints,
    probe_cluster: Ints,
    gallery_cluster: Ints,
    one: int,
    place: Ints,
    first: Ints,
    second: Ints,
) -> None:
    """Write the two clusters of each non-mated score where `place` says, cell by cell.

    `one` stands for the second of two equal clusters.
    """
    for i in range(cell.shape[0]):
        for j in range(cell.shape[1]):
            if j == mate[i]:
                continue
            at = place[cell[i, j]]
            place[cell[i, j]] = at + 1
            first[at] = probe_cluster[i]
            second[at] = one if gallery_cluster[j] == probe_cluster[i] else gallery_cluster[j]


@part_of_loop
def _excess(mated: float, non_mated: float) -> float:
    """D of Gomez-Barrero et al. (2017) times the mated share, from the shares of one bin."""
    if mated <= non_mated:
        return 0.0
    # 2 LR / (1 + LR) - 1 = (LR - 1) / (LR + 1), which is 1 where LR is infinite.
    return mated * (mated - non_mated) / (mated + non_mated)


@part_of_loop
def _x_log2_x(x: float) -> float:
    return x * np.log2(x) if x > 0 else 0.0


@part_of_loop
def _hull(
    mated: Floats, non_mated: Floats, totals: tuple[float, float], stack: Floats
) -> tuple[float, float]:
    """Return EER and Cllr_min from the convex hull of the ROC: pool adjacent violators.

    Blocks of cells come from the top, and are changed. The last has no mated scores.
    """
    # Without mated scores a block has the least likelihood ratio, and joins the one below.
    size = 0
    waiting = 0.0
    for k in range(mated.size):
        m, n = mated[k], non_mated[k] + waiting
        # Written without a branch, which no processor could predict.
        mated[size] = m
        non_mated[size] = n
        size += m > 0
        waiting = 0.0 if m > 0 else n
    depth = 0
    for k in range(size):
        m, n = mated[k], non_mated[k]
        # Downwards the likelihood ratio of a block must fall.
        while depth > 0 and m * stack[depth - 1, 1] >= stack[depth - 1, 0] * n:
            depth -= 1
            m += stack[depth, 0]
            n += stack[depth, 1]
        stack[depth, 0] = m
        stack[depth, 1] = n
        depth += 1
    if waiting > 0:
        stack[depth, 0] = 0.0
        stack[depth, 1] = waiting
        depth += 1
    miss, false = 1.0, 0.0
    eer = -1.0
    cost = 0.0
    for k in range(depth):
        m, n = stack[k, 0] / totals[0], stack[k, 1] / totals[1]
        cost += _x_log2_x(m + n) - _x_log2_x(m) - _x_log2_x(n)
        if eer < 0 and miss - m <= false + n:
            eer = false + n * (miss - false) / (m + n)
        miss -= m
        false += n
    return eer, cost / 2


@part_of_loop
def _turn(
    mated: Floats,
    non_mated: Floats,
    block_of_cell: Ints,
    lane: int,
    few_mated: Floats,
    few_non_mated: Floats,
) -> None:
    """Write the weights in each block of cells for a few lanes, a row each."""
    few_mated[:] = 0.0
    few_non_mated[:] = 0.0
    for k in range(block_of_cell.size):
        block = block_of_cell[k]
        for few in range(_FEW):
            few_mated[few, block] += mated[k, lane + few]
            few_non_mated[few, block] += non_mated[k, lane + few]


@part_of_loop
def _blocks(mated_cell: Ints, n_cells: int) -> Ints:
    """Return the block of each cell: a cell with mated scores, and those above up to the next.

    Blocks count from the top. The last, which may be empty, has no mated scores.
    """
    block_of_cell = np.zeros(n_cells, dtype=np.int64)
    for k in mated_cell:
        block_of_cell[k] = 1
    block = 0
    for back in range(n_cells):
        k = n_cells - 1 - back
        is_last = block_of_cell[k]
        block_of_cell[k] = block
        block += is_last
    return block_of_cell


@part_of_loop
def _areas(mated: Floats, non_mated: Floats, sums: Floats, out: Floats) -> None:
    """Write the mass of either class, and the AUC, of every lane: columns 0 to 2."""
    sums[:] = 0.0
    for k in range(mated.shape[0]):
        m, n = mated[k], non_mated[k]
        for lane in range(LANES):
            sums[2, lane] += m[lane] * (sums[1, lane] + n[lane] / 2)
            sums[0, lane] += m[lane]
            sums[1, lane] += n[lane]
    for lane in range(LANES):
        out[lane, 0] = sums[0, lane]
        out[lane, 1] = sums[1, lane]
        out[lane, 2] = sums[2, lane] / (sums[0, lane] * sums[1, lane])


@part_of_loop
def _tpr(
    mated: Floats, non_mated: Floats, level: float, column: int, sums: Floats, out: Floats
) -> None:
    """Write the largest TPR with FPR <= level, and the FPR of its highest threshold."""
    sums[:] = 0.0
    m, n, tpr, fpr = sums[0], sums[1], sums[2], sums[3]
    # Rounding must not refuse a share that lies exactly at the level.
    share = level * (1 + 1e-12)
    for back in range(mated.shape[0]):
        k = mated.shape[0] - 1 - back
        row_m, row_n = mated[k], non_mated[k]
        most = -1.0
        for lane in range(LANES):
            m[lane] += row_m[lane]
            n[lane] += row_n[lane]
            rest = share * out[lane, 1] - n[lane]
            most = max(most, rest)
            is_better = rest >= 0 and row_m[lane] > 0
            tpr[lane] = m[lane] if is_better else tpr[lane]
            fpr[lane] = n[lane] if is_better else fpr[lane]
        if most < 0:
            break
    for lane in range(LANES):
        out[lane, column] = tpr[lane] / out[lane, 0]
        out[lane, column + 1] = fpr[lane] / out[lane, 1]


@part_of_loop
def _d_sys(mated: Floats, non_mated: Floats, bin_of_cell: Ints, sums: Floats, out: Floats) -> None:
    """Write D_sys of every lane: column 9."""
    sums[:] = 0.0
    m, n, linked = sums[0], sums[1], sums[2]
    for k in range(mated.shape[0]):
        row_m, row_n = mated[k], non_mated[k]
        for lane in range(LANES):
            m[lane] += row_m[lane]
            n[lane] += row_n[lane]
        if k + 1 == mated.shape[0] or bin_of_cell[k + 1] != bin_of_cell[k]:
            for lane in range(LANES):
                linked[lane] += _excess(m[lane] / out[lane, 0], n[lane] / out[lane, 1])
                m[lane] = 0.0
                n[lane] = 0.0
    for lane in range(LANES):
        out[lane, 9] = linked[lane]


@part_of_loop
def _weigh(
    table: Weights,
    starts: Ints,
    first: Ints,
    second: Ints,
    cells: Ints,
    clusters: Ints,
    some: Weights,
    mated: Floats,
    non_mated: Floats,
) -> None:
    """Write the weight of mated and of non-mated scores per cell, (K, `LANES`) each."""
    mated[:] = 0.0
    non_mated[:] = 0.0
    for k in range(starts.size - 1):
        row = non_mated[k]
        for start in range(starts[k], starts[k + 1], _BLOCK):
            stop = min(start + _BLOCK, starts[k + 1])
            some[:] = 0.0
            # Four pairs a turn, since to fetch and store the sums takes longer than a product.
            for pair in range(start, stop - 3, 4):
                a, b = table[first[pair]], table[second[pair]]
                c, d = table[first[pair + 1]], table[second[pair + 1]]
                e, f = table[first[pair + 2]], table[second[pair + 2]]
                g, h = table[first[pair + 3]], table[second[pair + 3]]
                for lane in range(LANES):
                    two = a[lane] * b[lane] + c[lane] * d[lane]
                    some[lane] += two + (e[lane] * f[lane] + g[lane] * h[lane])
            for pair in range(stop - (stop - start) % 4, stop):
                a, b = table[first[pair]], table[second[pair]]
                for lane in range(LANES):
                    some[lane] += a[lane] * b[lane]
            for lane in range(LANES):
                row[lane] += some[lane]
    for k in range(cells.size):
        row = mated[cells[k]]
        a = table[clusters[k]]
        for lane in range(LANES):
            row[lane] += a[lane]


@compiled(_WEIGHTS3, INTS1, INTS1, INTS1, INTS1, INTS1, INTS1, FLOAT, FLOAT, OUT_FLOATS2)
def replicates(
    tables: Weights,
    starts: Ints,
    first: Ints,
    second: Ints,
    mated_cell: Ints,
    mated_cluster: Ints,
    bin_of_cell: Ints,
    level_1: float,
    level_2: float,
    out: Floats,
) -> None:
    """Write the metrics of every replicate, `COLUMNS` each; NaN where a class has no weight.

    `tables` is (chunks, C + 1, `LANES`): weights of the clusters, then a row of ones. Cell k owns
    the non-mated scores ``starts[k]:starts[k + 1]``; `bin_of_cell` ascends.
    """
    n_cells = starts.size - 1
    # Once for all chunks: the system hands out so much memory page by page.
    mated, non_mated = np.empty((n_cells, LANES)), np.empty((n_cells, LANES))
    block_of_cell = _blocks(mated_cell, n_cells)
    few_mated = np.empty((_FEW, block_of_cell.max() + 2))
    few_non_mated = np.empty_like(few_mated)
    stack = np.empty((few_mated.shape[1] + 1, 2))
    sums, some = np.empty((4, LANES)), np.empty(LANES, dtype=np.float32)
    for chunk in range(tables.shape[0]):
        table = tables[chunk]
        _weigh(table, starts, first, second, mated_cell, mated_cluster, some, mated, non_mated)
        block = out[chunk * LANES : (chunk + 1) * LANES]
        _areas(mated, non_mated, sums, block)
        for column in (5, 7):
            level = level_1 if column == 5 else level_2  # noqa: PLR2004
            _tpr(mated, non_mated, level, column, sums, block)
        _d_sys(mated, non_mated, bin_of_cell, sums, block)
        for lane in range(LANES):
            few = lane % _FEW
            if few == 0:
                _turn(mated, non_mated, block_of_cell, lane, few_mated, few_non_mated)
            line = block[lane]
            if line[0] > 0 and line[1] > 0:
                totals = (line[0], line[1])
                line[3], line[4] = _hull(few_mated[few], few_non_mated[few], totals, stack)
            else:
                for column in range(2, COLUMNS):
                    line[column] = np.nan
