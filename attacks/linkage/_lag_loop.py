"""Compiled loops of the linkage attacks, walk by walk or pair by pair.

Apart from the rounding of matrix products, a pair's result does not depend on other
walks.
"""

from math import log, log1p
from typing import TypeAlias

import numpy as np

from isac_track.compiling import (
    FLOAT,
    INT,
    compiled,
    part_of_loop,
    read,
    together,
    written,
)
from isac_track.types import Floats, Ints

_Triple: TypeAlias = tuple[float, float, float]
_Fits: TypeAlias = tuple[Floats, Floats, Floats]
_Lags: TypeAlias = tuple[int, int, int]
_TRIPLE, _LAGS = together(FLOAT, FLOAT, FLOAT), together(INT, INT, INT)
_SIDES, _FITS = together(read(3), read(3)), together(read(1), read(1), read(1))


@compiled(read(1), read(2), read(1, "int64"), read(1, "int64"), _TRIPLE, written(3))
def cell_means(
    t: Floats, xy: Floats, offsets: Ints, count: Ints, times_s: _Triple, out: Floats
) -> None:
    """Fill `out` (N, K, 2) with means over grid cells; see `signals.on_grid`."""
    step_s, longest_s, least_s = times_s
    out[:] = 0.0
    for row in range(count.size):
        first, last = offsets[row], offsets[row + 1] - 1
        if first == last:
            continue
        lasts_s = t[last] - t[first]
        start_s = max((min(lasts_s, longest_s) - count[row] * step_s) / 2.0, 0.0)
        k = first
        for cell in range(count[row]):
            from_s = min(start_s + cell * step_s, lasts_s)
            until_s = min(start_s + (cell + 1) * step_s, lasts_s)
            width_s = max(until_s - from_s, least_s)
            x, y = 0.0, 0.0
            while from_s < until_s:
                while k < last - 1 and t[k + 1] - t[first] <= from_s:
                    k += 1
                since_s = t[k] - t[first]
                end_s = min(t[k + 1] - t[first], until_s) if k < last - 1 else until_s
                # The line through two samples, at the middle of its part in the cell.
                share = ((from_s + end_s) / 2.0 - since_s) / (t[k + 1] - t[k])
                x += (end_s - from_s) * (
                    xy[k, 0] - xy[first, 0] + share * (xy[k + 1, 0] - xy[k, 0])
                )
                y += (end_s - from_s) * (
                    xy[k, 1] - xy[first, 1] + share * (xy[k + 1, 1] - xy[k, 1])
                )
                from_s = end_s
            out[row, cell, 0], out[row, cell, 1] = x / width_s, y / width_s


@compiled(read(2), read(2), read(2), read(2), written(2))
def shared_cells(a: Floats, b: Floats, f_a: Floats, f_b: Floats, out: Floats) -> None:
    """Fill `out` (P, G) with the sum over K cells of f(a + b) - f(a) - f(b).

    Here f(x) = x log x, with counts a (P, K) and b (G, K). A term is 0 where either
    count is 0, as most are: the loop skips it.
    """
    for i in range(a.shape[0]):
        occupied = np.flatnonzero(a[i] > 0.0)
        for j in range(b.shape[0]):
            total = 0.0
            for k in occupied:
                if b[j, k] > 0.0:
                    total_count = a[i, k] + b[j, k]
                    total += total_count * log(total_count) - f_a[i, k] - f_b[j, k]
            out[i, j] = total


@compiled(read(3), read(3), INT, INT, FLOAT, written(2))
def warp(
    probe: Floats, gallery: Floats, reach: int, loose: int, penalty: float, out: Floats
) -> None:
    """Fill `out` (P, G) with least sums of squares; see `dtw.warped_costs`.

    The signals are (C, n, P) and (C, m, G). Cell i may meet cell j if ``-reach - max(n
    - m, 0) <= j - i <= reach + max(m - n, 0)``. Up to `loose` cells of either signal
    may be left out at either end.
    """
    channels, n, n_probe = probe.shape
    _, m, n_gallery = gallery.shape
    back, ahead = reach + max(n - m, 0), reach + max(m - n, 0)
    # Cell 0 is before the first; cell m + 1 counts as out of reach.
    rows = np.empty((2, m + 2, n_gallery))
    cost = np.empty(n_gallery)
    for p in range(n_probe):
        least = out[p]
        least[:] = np.inf
        rows[:] = np.inf
        rows[0, : loose + 1] = 0.0
        for i in range(1, n + 1):
            previous, current = rows[(i - 1) % 2], rows[i % 2]
            low, high = max(i - back, 1), min(i + ahead, m)
            current[low - 1] = 0.0 if low == 1 and i <= loose else np.inf
            for j in range(low, high + 1):
                cost[:] = 0.0
                for c in range(channels):
                    own, other = probe[c, i - 1, p], gallery[c, j - 1]
                    for g in range(n_gallery):
                        cost[g] += (own - other[g]) * (own - other[g])
                diagonal, above = previous[j - 1], previous[j]
                left, target = current[j - 1], current[j]
                for g in range(n_gallery):
                    detour = min(left[g], above[g])
                    detour += penalty
                    target[g] = cost[g] + min(diagonal[g], detour)
                if (i == n and j >= m - loose) or (j == m and i >= n - loose):
                    for g in range(n_gallery):
                        least[g] = min(least[g], target[g])
            current[high + 1] = np.inf


@part_of_loop
def _projected(signals: Floats, start: int, basis: Floats) -> tuple[Floats, Floats]:
    """Project m cells from `start` on of (C, K, N) signals on a basis (R, m).

    Return the projections, (C R, N), and their sums of squares, (N,).
    """
    rank, m = basis.shape
    parts = np.empty((len(signals) * rank, signals.shape[2]))
    square = np.zeros(signals.shape[2])
    for c in range(len(signals)):
        np.dot(basis, signals[c, start : start + m], parts[c * rank : (c + 1) * rank])
    for part in parts:
        for i in range(part.size):
            square[i] += part[i] * part[i]
    return parts, square


@compiled(_SIDES, _FITS, read(1, "int64"), _LAGS, written(3))
def least_costs(
    sides: tuple[Floats, Floats], fits: _Fits, begin: Ints, lags: _Lags, out: Floats
) -> None:
    """Fill `out` (E, P, G) with least costs over lags; see `signals.aligned_costs`.

    `weight` is the factor of an overlap of 1 cell, 2 cells and so on.
    """
    probe, gallery = sides
    basis, floors, weight = fits
    reach, least, rotated = lags
    long_p, long_g, n_gallery = probe.shape[1], gallery.shape[1], gallery.shape[2]
    longest = min(long_p, long_g)
    gap = np.empty(n_gallery)
    out[:] = np.inf
    for lag in range(
        -reach - max(long_g - long_p, 0), reach + max(long_p - long_g, 0) + 1
    ):
        start_p, start_g = max(lag, 0), max(-lag, 0)
        m = min(long_p - start_p, long_g - start_g)
        if m < min(least, longest):
            continue
        projection = basis[begin[m] : begin[m + 1]].reshape(-1, m)
        p_parts, p_square = _projected(probe, start_p, projection)
        g_parts, g_square = _projected(gallery, start_g, projection)
        dots = crosses = np.dot(p_parts.T, g_parts)
        if rotated:
            turned, rank = np.empty_like(p_parts), len(projection)
            turned[:rank], turned[rank:] = p_parts[rank:], -p_parts[:rank]
            crosses = np.dot(turned.T, g_parts)
        for i in range(p_square.size):
            own, scale, dot, cross = p_square[i], weight[m - 1] / m, dots[i], crosses[i]
            if rotated:
                # The modulus of a b* is that of the best rotation, without reflection.
                for j in range(n_gallery):
                    modulus = np.sqrt(dot[j] * dot[j] + cross[j] * cross[j])
                    gap[j] = max(own + g_square[j] - 2.0 * modulus, 0.0) * scale
            else:
                for j in range(n_gallery):
                    gap[j] = max(own + g_square[j] - 2.0 * dot[j], 0.0) * scale
            for e in range(floors.size):
                best, added = out[e, i], floors[e] * weight[m - 1]
                for j in range(n_gallery):
                    best[j] = min(best[j], gap[j] + added)


@compiled(read(1), read(3), read(3), FLOAT, _TRIPLE, FLOAT, written(2))
def continuation_densities(
    until_s: Floats,
    mean: Floats,
    cov: Floats,
    q: float,
    gap: _Triple,
    tail: float,
    out: Floats,
) -> None:
    """Fill `out` (P, G) with log densities; see `kinematic.continuations`.

    The states are those of P probes and then, back in time, of G gallery walks.
    """
    n_probe, (least_s, most_s, longest_s) = len(out), gap
    for i, j in np.ndindex(out.shape):
        other = n_probe + j
        # Backwards in time, clock and velocity have the other sign.
        gap_s = -until_s[other] - until_s[i]
        if not least_s <= gap_s <= most_s:
            out[i, j] = -np.inf
            continue
        gap_s = min(max(gap_s, -longest_s), longest_s)
        grown = q * abs(gap_s)
        p00, p01, p11 = cov[i, 0, 0], cov[i, 0, 1], cov[i, 1, 1]
        position = p00 + gap_s * (2.0 * p01 + gap_s * p11) + grown * gap_s * gap_s / 3.0
        position += cov[other, 0, 0]
        cross = p01 + gap_s * p11 + grown * gap_s / 2.0 - cov[other, 0, 1]
        velocity = p11 + grown + cov[other, 1, 1]
        determinant = position * velocity - cross * cross
        square = 0.0
        for axis in range(2):
            off = mean[i, axis, 0] + gap_s * mean[i, axis, 1] - mean[other, axis, 0]
            drift = mean[i, axis, 1] + mean[other, axis, 1]
            square += (
                velocity * off - 2.0 * cross * drift
            ) * off + position * drift * drift
        # Student's t in four dimensions.
        out[i, j] = -log(determinant) - (tail + 4.0) / 2.0 * log1p(
            square / determinant / tail
        )
