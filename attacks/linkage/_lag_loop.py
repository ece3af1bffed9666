"""Compiled loops of the linkage attacks: what they do walk by walk or pair by pair.

Of every pair a loop makes the same, whoever else is there: no result hangs on its neighbours.
"""

from __future__ import annotations

from math import log
from typing import TYPE_CHECKING

import numpy as np

from isac_track.compiling import (
    BOOL,
    FLOAT,
    FLOATS1,
    FLOATS2,
    FLOATS3,
    INT,
    INTS1,
    OUT_FLOATS2,
    OUT_FLOATS3,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


@compiled(FLOATS1, FLOATS2, INTS1, INTS1, FLOAT, FLOAT, FLOAT, OUT_FLOATS3)
def cell_means(
    t: Floats,
    xy: Floats,
    offsets: Ints,
    count: Ints,
    step_s: float,
    longest_s: float,
    least_s: float,
    out: Floats,
) -> None:
    """Fill `out` (N, K, 2) with the means over the cells of a grid; see `signals.on_grid`."""
    out[:] = 0.0
    for row in range(count.size):
        first, last = offsets[row], offsets[row + 1] - 1
        if first == last:
            continue
        lasts_s = t[last] - t[first]
        start_s = max((min(lasts_s, longest_s) - count[row] * step_s) / 2.0, 0.0)
        k = first
        for cell in range(count[row]):
            at_s = min(start_s + cell * step_s, lasts_s)
            until_s = min(start_s + (cell + 1) * step_s, lasts_s)
            width_s = max(until_s - at_s, least_s)
            x, y = 0.0, 0.0
            while at_s < until_s:
                while k < last - 1 and t[k + 1] - t[first] <= at_s:
                    k += 1
                since_s = t[k] - t[first]
                end_s = min(t[k + 1] - t[first], until_s) if k < last - 1 else until_s
                # The line through two samples, in the middle of what lies in the cell.
                share = ((at_s + end_s) / 2.0 - since_s) / (t[k + 1] - t[k])
                x += (end_s - at_s) * (xy[k, 0] - xy[first, 0] + share * (xy[k + 1, 0] - xy[k, 0]))
                y += (end_s - at_s) * (xy[k, 1] - xy[first, 1] + share * (xy[k + 1, 1] - xy[k, 1]))
                at_s = end_s
            out[row, cell, 0] = x / width_s
            out[row, cell, 1] = y / width_s


@compiled(FLOATS2, FLOATS2, FLOATS2, FLOATS2, OUT_FLOATS2)
def shared_cells(a: Floats, b: Floats, f_a: Floats, f_b: Floats, out: Floats) -> None:
    """Fill `out` (P, G) with the sum of f(a + b) - f(a) - f(b), f(x) = x log x, of (P, K), (G, K).

    Where either is 0 the term is, and most are: they are passed over.
    """
    n_cells = a.shape[1]
    some = np.empty(n_cells, dtype=np.int64)
    for i in range(a.shape[0]):
        n_some = 0
        for k in range(n_cells):
            if a[i, k] > 0.0:
                some[n_some] = k
                n_some += 1
        for j in range(b.shape[0]):
            total = 0.0
            for at in range(n_some):
                k = some[at]
                if b[j, k] > 0.0:
                    both = a[i, k] + b[j, k]
                    total += both * log(both) - f_a[i, k] - f_b[j, k]
            out[i, j] = total


@compiled(FLOATS3, FLOATS3, INT, INT, FLOAT, OUT_FLOATS2)
def warp(
    probe: Floats, gallery: Floats, reach: int, loose: int, penalty: float, out: Floats
) -> None:
    """Fill `out` (P, G) with the least sums of squares under warping; see `dtw.warped_costs`.

    Of (C, n, P) and (C, m, G) signals, with cells ``-reach - max(n - m, 0) <= j - i <= reach +
    max(m - n, 0)`` and up to `loose` cells of either left out at either end.
    """
    channels, n, n_probe = probe.shape
    _, m, n_gallery = gallery.shape
    back, ahead = reach + max(n - m, 0), reach + max(m - n, 0)
    # Cell 0 is before the first; that m + 1 is out of reach for whoever looks there.
    rows = np.empty((2, m + 2, n_gallery))
    cost = np.empty(n_gallery)
    for p in range(n_probe):
        least = out[p]
        least[:] = np.inf
        rows[:] = np.inf
        rows[0, : loose + 1] = 0.0
        for i in range(1, n + 1):
            before, here = rows[(i - 1) % 2], rows[i % 2]
            low, high = max(i - back, 1), min(i + ahead, m)
            here[low - 1] = 0.0 if low == 1 and i <= loose else np.inf
            for j in range(low, high + 1):
                cost[:] = 0.0
                for c in range(channels):
                    own, other = probe[c, i - 1, p], gallery[c, j - 1]
                    for g in range(n_gallery):
                        cost[g] += (own - other[g]) * (own - other[g])
                on, up, left, to = before[j - 1], before[j], here[j - 1], here[j]
                for g in range(n_gallery):
                    aside = min(left[g], up[g])
                    aside += penalty
                    to[g] = cost[g] + min(on[g], aside)
                if (i == n and j >= m - loose) or (j == m and i >= n - loose):
                    for g in range(n_gallery):
                        least[g] = min(least[g], to[g])
            here[high + 1] = np.inf


@part_of_loop
def _add(weights: Floats, cells: Floats, row: Floats) -> None:
    """Add cells (K, N), times K weights, to a row of N."""
    last = weights.size
    # Walk by walk in the innermost loop: it becomes vector code. By fours, since it is the loads
    # and stores of the row that take the time.
    for j in range(0, last - 3, 4):
        w0, w1, w2, w3 = weights[j], weights[j + 1], weights[j + 2], weights[j + 3]
        c0, c1, c2, c3 = cells[j], cells[j + 1], cells[j + 2], cells[j + 3]
        for i in range(row.size):
            row[i] += (w0 * c0[i] + w1 * c1[i]) + (w2 * c2[i] + w3 * c3[i])
    for j in range(last - last % 4, last - 1, 2):
        for i in range(row.size):
            row[i] += weights[j] * cells[j, i] + weights[j + 1] * cells[j + 1, i]
    if last % 2:
        for i in range(row.size):
            row[i] += weights[last - 1] * cells[last - 1, i]


@part_of_loop
def _project(
    signal: Floats, start: int, m: int, basis: Floats, rank: int, parts: Floats, norm: Floats
) -> None:
    """Project cells ``start:start + m`` of (C, K, N) signals on the basis: (C * rank, N), (N,)."""
    norm[:] = 0.0
    for c in range(signal.shape[0]):
        for k in range(rank):
            row = parts[c * rank + k]
            row[:] = 0.0
            _add(basis[k * m : (k + 1) * m], signal[c, start : start + m], row)
            for i in range(norm.size):
                norm[i] += row[i] * row[i]


@compiled(FLOATS3, FLOATS3, FLOATS1, INTS1, FLOATS1, FLOATS1, INT, INT, BOOL, OUT_FLOATS3)
def least_costs(  # noqa: C901 - one loop, for speed
    probe: Floats,
    gallery: Floats,
    basis: Floats,
    begin: Ints,
    floors: Floats,
    weight: Floats,
    reach: int,
    least: int,
    rotated: bool,  # noqa: FBT001 - numba passes by position
    out: Floats,
) -> None:
    """Fill `out` (E, P, G) with the least cost over all lags; see `alignment.aligned_costs`.

    `weight` is the factor of an overlap of 1 cell, 2 cells and so on.
    """
    channels, long_p, n_probe = probe.shape
    _, long_g, n_gallery = gallery.shape
    longest = min(long_p, long_g)
    most = channels * max((begin[longest + 1] - begin[longest]) // longest, 1)
    p_parts, g_parts = np.empty((most, n_probe)), np.empty((most, n_gallery))
    p_norm, g_norm = np.empty(n_probe), np.empty(n_gallery)
    dot, cross, gap = np.empty(n_gallery), np.empty(n_gallery), np.empty(n_gallery)
    along = np.empty(most)
    out[:] = np.inf
    for lag in range(-reach - max(long_g - long_p, 0), reach + max(long_p - long_g, 0) + 1):
        start_p, start_g = max(lag, 0), max(-lag, 0)
        m = min(long_p - start_p, long_g - start_g)
        if m < min(least, longest):
            continue
        here = basis[begin[m] : begin[m + 1]]
        rank = here.size // m
        _project(probe, start_p, m, here, rank, p_parts, p_norm)
        _project(gallery, start_g, m, here, rank, g_parts, g_norm)
        for i in range(n_probe):
            dot[:] = 0.0
            for k in range(channels * rank):
                along[k] = p_parts[k, i]
            _add(along[: channels * rank], g_parts, dot)
            if rotated:
                # The modulus of a b*: the rotation that fits best, which no reflection can enter.
                cross[:] = 0.0
                for k in range(rank):
                    along[k], along[rank + k] = p_parts[rank + k, i], -p_parts[k, i]
                _add(along[: 2 * rank], g_parts, cross)
                for j in range(n_gallery):
                    dot[j] = np.sqrt(dot[j] * dot[j] + cross[j] * cross[j])
            own, scale = p_norm[i], weight[m - 1] / m
            for j in range(n_gallery):
                left = own + g_norm[j] - 2.0 * dot[j]
                gap[j] = max(left, 0.0) * scale
            for e in range(floors.size):
                best, more = out[e, i], floors[e] * weight[m - 1]
                for j in range(n_gallery):
                    cost = gap[j] + more
                    best[j] = min(best[j], cost)
