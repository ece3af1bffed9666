"""Compiled loops of the linkage attacks: what they do walk by walk or pair by pair.

A pair's result does not hang on who else is there, but for the rounding of matrix
products.
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

_Three: TypeAlias = tuple[float, float, float]
_Fits: TypeAlias = tuple[Floats, Floats, Floats]
_Lags: TypeAlias = tuple[int, int, int]
_THREE, _LAGS = together(*[FLOAT] * 3), together(*[INT] * 3)
_SIDES, _FITS = together(*[read(3)] * 2), together(*[read(1)] * 3)


@compiled(read(1), read(2), read(1, "int64"), read(1, "int64"), _THREE, written(3))
def cell_means(
    t: Floats, xy: Floats, offsets: Ints, count: Ints, times_s: _Three, out: Floats
) -> None:
    """Fill `out` (N, K, 2) with the means over the cells of a grid; see `signals.on_grid`."""
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
                x += (end_s - at_s) * (
                    xy[k, 0] - xy[first, 0] + share * (xy[k + 1, 0] - xy[k, 0])
                )
                y += (end_s - at_s) * (
                    xy[k, 1] - xy[first, 1] + share * (xy[k + 1, 1] - xy[k, 1])
                )
                at_s = end_s
            out[row, cell, 0], out[row, cell, 1] = x / width_s, y / width_s


@compiled(read(2), read(2), read(2), read(2), written(2))
def shared_cells(a: Floats, b: Floats, f_a: Floats, f_b: Floats, out: Floats) -> None:
    """Fill `out` (P, G) with the sum of f(a + b) - f(a) - f(b), f(x) = x log x, of (P, K), (G, K).

    Where either is 0 the term is, and most are: they are passed over.
    """
    for i in range(a.shape[0]):
        some = np.flatnonzero(a[i] > 0.0)
        for j in range(b.shape[0]):
            total = 0.0
            for k in some:
                if b[j, k] > 0.0:
                    both = a[i, k] + b[j, k]
                    total += both * log(both) - f_a[i, k] - f_b[j, k]
            out[i, j] = total


@compiled(read(3), read(3), INT, INT, FLOAT, written(2))
def warp(
    probe: Floats, gallery: Floats, reach: int, loose: int, penalty: float, out: Floats
) -> None:
    """Fill `out` (P, G) with the least sums of squares under warping; see `dtw.warped_costs`.

    Of (C, n, P) and (C, m, G) signals, with cells ``-reach - max(n - m, 0) <= j - i <=
    reach + max(m - n, 0)`` and up to `loose` cells of either left out at either end.
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
def _projected(signals: Floats, start: int, basis: Floats) -> tuple[Floats, Floats]:
    """Project cells from `start` on of (C, K, N) signals on a basis (R, m): (C R, N), squares."""
    rank, m = basis.shape
    parts, square = (
        np.empty((len(signals) * rank, signals.shape[2])),
        np.zeros(signals.shape[2]),
    )
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
    """Fill `out` (E, P, G) with the least cost over all lags; see `signals.aligned_costs`.

    `weight` is the factor of an overlap of 1 cell, 2 cells and so on.
    """
    (probe, gallery), (basis, floors, weight), (reach, least, rotated) = (
        sides,
        fits,
        lags,
    )
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
        here = basis[begin[m] : begin[m + 1]].reshape(-1, m)
        p_parts, p_square = _projected(probe, start_p, here)
        g_parts, g_square = _projected(gallery, start_g, here)
        dots = crosses = np.dot(p_parts.T, g_parts)
        if rotated:
            turned, rank = np.empty_like(p_parts), len(here)
            turned[:rank], turned[rank:] = p_parts[rank:], -p_parts[:rank]
            crosses = np.dot(turned.T, g_parts)
        for i in range(p_square.size):
            own, scale, dot, cross = p_square[i], weight[m - 1] / m, dots[i], crosses[i]
            if rotated:
                # The modulus of a b*: the rotation that fits best, which no reflection
                # can enter.
                for j in range(n_gallery):
                    modulus = np.sqrt(dot[j] * dot[j] + cross[j] * cross[j])
                    gap[j] = max(own + g_square[j] - 2.0 * modulus, 0.0) * scale
            else:
                for j in range(n_gallery):
                    gap[j] = max(own + g_square[j] - 2.0 * dot[j], 0.0) * scale
            for e in range(floors.size):
                best, more = out[e, i], floors[e] * weight[m - 1]
                for j in range(n_gallery):
                    best[j] = min(best[j], gap[j] + more)


@compiled(read(1), read(3), read(3), FLOAT, _THREE, FLOAT, written(2))
def continued(
    until_s: Floats,
    mean: Floats,
    cov: Floats,
    q: float,
    gap: _Three,
    tail: float,
    out: Floats,
) -> None:
    """Fill `out` (P, G) with the log density of continuations; see `kinematic.continuations`.

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
        place = p00 + gap_s * (2.0 * p01 + gap_s * p11) + grown * gap_s * gap_s / 3.0
        place += cov[other, 0, 0]
        both = p01 + gap_s * p11 + grown * gap_s / 2.0 - cov[other, 0, 1]
        pace = p11 + grown + cov[other, 1, 1]
        determinant = place * pace - both * both
        square = 0.0
        for axis in range(2):
            off = mean[i, axis, 0] + gap_s * mean[i, axis, 1] - mean[other, axis, 0]
            drift = mean[i, axis, 1] + mean[other, axis, 1]
            square += (pace * off - 2.0 * both * drift) * off + place * drift * drift
        # Of four dimensions.
        out[i, j] = -log(determinant) - (tail + 4.0) / 2.0 * log1p(
            square / determinant / tail
        )
