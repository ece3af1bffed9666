"""Compiled loops of the likelihood ratio: information of walks, evidence of pairs.

A pair's result does not depend on other walks.
"""

from math import exp, log, sqrt
from typing import TypeAlias

import numpy as np

from isac_track.compiling import compiled, part_of_loop, read, together, written
from isac_track.types import Floats, Ints

_NEAR = 64  # Gallery walks at a time: their intermediate results stay in the cache.
_Walks: TypeAlias = tuple[Floats, Floats, Floats, Ints]
# A lag less likely by this factor's exponential adds nothing to a double.
_NOTHING = 64.0
_MIDDLE = exp(-0.5)
_BESSEL = 3.75  # Where one approximation gives way to the other.
_Side: TypeAlias = tuple[Floats, Floats, Floats]
_WALKS = together(read(1), read(2), read(1), read(1, "int64"))
_SIDE = together(read(3), read(3), read(3))


@compiled(_WALKS, read(2), written(4))
def accumulate_information(  # noqa: C901 - moments, a sample at a time
    walks: _Walks, segments_s: Floats, out: Floats
) -> None:
    """Fill `out` (L, N, K, K + 2) with the information of walks, at each of L lags.

    A walk's K coefficients get their information, 1/m^2 per axis, and beside it the
    pull, 1/m: information times coefficients. `walks` are times, positions, information
    of each sample, and offsets. `segments_s` are L stretches, from the first sample of
    each walk on. A shift of the walk changes nothing.
    """
    t, xy, weight, offsets = walks
    rank = out.shape[2]
    q = np.empty(rank + 1)
    moments = np.empty((rank + 1, rank + 1))
    sums = np.empty((rank + 1, 2))
    # Coefficients of Legendre's recursion.
    degree = np.arange(2.0, rank + 1.0)
    slope = (2.0 * degree - 1.0) / degree
    back = (degree - 1.0) / degree
    for lag in range(len(segments_s)):
        start_s, end_s = segments_s[lag]
        middle_s, half_s = (start_s + end_s) / 2.0, (end_s - start_s) / 2.0
        for row in range(offsets.size - 1):
            first = offsets[row]
            moments[:], sums[:] = 0.0, 0.0
            for k in range(first, offsets[row + 1]):
                u = (t[k] - t[first] - middle_s) / half_s
                if u < -1.0 or u > 1.0:
                    continue
                q[0], q[1] = 1.0, u
                for d in range(2, rank + 1):
                    q[d] = slope[d - 2] * u * q[d - 1] - back[d - 2] * q[d - 2]
                for a in range(rank + 1):
                    own = weight[k] * q[a]
                    for axis in range(2):
                        sums[a, axis] += own * (xy[k, axis] - xy[first, axis])
                    for b in range(a + 1):
                        moments[a, b] += own * q[b]
            total = moments[0, 0]
            for a in range(rank):
                share = moments[a + 1, 0] / total if total > 0.0 else 0.0
                for axis in range(2):
                    out[lag, row, a, rank + axis] = (
                        sums[a + 1, axis] - share * sums[0, axis]
                    )
                for b in range(a + 1):
                    shared = moments[a + 1, b + 1] - share * moments[b + 1, 0]
                    out[lag, row, a, b] = out[lag, row, b, a] = shared


@part_of_loop
def _solve(rows: Floats) -> float:
    """Solve K equations (K, K + R) in place by Gauss-Jordan; return ln |det|.

    The solutions replace the last R columns.
    """
    rank, width = rows.shape
    log_det = 0.0
    for c in range(rank):
        top = c
        for a in range(c + 1, rank):
            if abs(rows[a, c]) > abs(rows[top, c]):
                top = a
        pivot = rows[top, c]
        log_det += log(abs(pivot))
        for b in range(c, width):
            rows[top, b], rows[c, b] = rows[c, b], rows[top, b] / pivot
        for a in range(rank):
            if a != c:
                times = rows[a, c]
                for b in range(c, width):
                    rows[a, b] -= times * rows[c, b]
    return log_det


@compiled(read(4), read(3), read(2), written(3), written(3), written(3))
def take_sides(
    information: Floats,
    added_m2: Floats,
    prior: Floats,
    lower_triangle: Floats,
    pull: Floats,
    log_evidence: Floats,
) -> None:
    """Fill the three arrays that `ratios` takes for a side; see there.

    `information`, (L, N, K, K + 2), comes from `accumulate_information`. The covariance
    of a walk's coefficients grows by `added_m2`, (L, K, K): further errors. `prior`,
    (L, K), is the information of the walks' prior.
    """
    n_lags, n_walks, rank = information.shape[:3]
    rows, own = np.empty((rank, 2 * rank + 2)), np.empty((rank, rank + 2))
    for lag, row in np.ndindex(n_lags, n_walks):
        rows[:, rank:] = information[lag, row]
        for a in range(rank):
            for b in range(rank):
                total = 1.0 if a == b else 0.0
                for c in range(rank):
                    total += information[lag, row, a, c] * added_m2[lag, c, b]
                rows[a, b] = total
        _solve(rows)
        own[:] = rows[:, rank:]
        for a in range(rank):
            own[a, a] += prior[lag, a]
            for b in range(a + 1):
                lower_triangle[lag, a * (a + 1) // 2 + b, row] = rows[a, rank + b]
        evidence = _solve(own)
        for a in range(rank):
            for axis in range(2):
                force = rows[a, 2 * rank + axis]
                evidence -= 0.5 * force * own[a, rank + axis]
                pull[lag, 2 * a + axis, row] = force
        log_evidence[lag, 0, row] = evidence


@part_of_loop
def _average_over_turns(
    turned: Floats, factor: Floats, exponent: Floats, n: int
) -> None:
    """Multiply n values, factor times e^exponent, by I0(turned).

    Abramowitz, Stegun, equations 9.8.1 and 9.8.2.
    """
    for j in range(n):
        x = turned[j]
        is_small = x < _BESSEL
        far = max(x, _BESSEL)
        y, z = (x / _BESSEL) ** 2, _BESSEL / far
        near = 0.0360768 + y * 0.0045813
        near = 3.5156229 + y * (
            3.0899424 + y * (1.2067492 + y * (0.2659732 + y * near))
        )
        beyond = 0.00916281 + z * (
            -0.02057706 + z * (0.02635537 + z * (-0.01647633 + z * 0.00392377))
        )
        beyond = 0.39894228 + z * (
            0.01328592 + z * (0.00225319 + z * (-0.00157565 + z * beyond))
        )
        factor[j] *= 1.0 + y * near if is_small else beyond / sqrt(far)
        exponent[j] += 0.0 if is_small else x


@part_of_loop
def _fading(x: float) -> float:
    """Return exp(-x) for x >= 0, or 0 where that adds nothing to a double.

    It is the series about half of `_NOTHING`, of a 64th of x, to the 64th power. Unlike
    the function of libm, it compiles to code for several values at a time.
    """
    offset, value = 0.5 - min(x, _NOTHING) / _NOTHING, 1.0
    for n in range(14, 0, -1):
        value = 1.0 + offset * (1.0 / n) * value
    value *= _MIDDLE
    for _ in range(6):
        value *= value
    return value if x < _NOTHING else 0.0


@compiled(_SIDE, _SIDE, read(2), read(1), written(2))
def ratios(  # noqa: C901, PLR0912, PLR0915 - an elimination of many pairs at a time
    probe: _Side, gallery: _Side, prior: Floats, log_lag: Floats, out: Floats
) -> None:
    """Fill `out` (P, G) with log ratios; see `likelihood_ratio.LikelihoodRatio`.

    Either side holds, at each lag, the lower triangle of the information (L, K (K + 1)
    / 2, N), the pull (L, 2 K, N), and the log evidence of each walk by itself (L, 1,
    N). `prior`, (L, K), is the information of the walks' prior. `log_lag`, (L,), holds
    all terms that depend on the lag alone.
    """
    p_triangle, p_pull, p_evidence = probe
    g_triangle, g_pull, g_evidence = gallery
    n_lags, rank = prior.shape
    # Blocks of 2 x 2 hold the lower triangle of M, and below it both pulls. Once M is
    # eliminated, the blocks that remain below are minus the products h* M^-1 h.
    k = (rank + 1) // 2
    first_left = k * (k + 1) // 2 + k  # The first of the blocks that remain.
    blocks = np.zeros((first_left + k + 3, 4, _NEAR))
    if rank % 2:  # a row and a column of the unit matrix
        blocks[first_left - k - 1, 3] = 1.0
    column = np.empty((k + 2, 4, _NEAR))
    pivot = np.empty((3, _NEAR))
    times = np.empty((4, _NEAR))
    turned, factor, exponent = np.empty((3, _NEAR))
    best, total = np.empty((2, len(out), _NEAR))
    for begin in range(0, out.shape[1], _NEAR):
        n = min(_NEAR, out.shape[1] - begin)
        best[:], total[:] = -np.inf, 0.0
        for lag, i in np.ndindex(n_lags, len(out)):
            for a in range(rank):
                for b in range(a + 1):
                    entry = a * (a + 1) // 2 + b
                    own_entry = p_triangle[lag, entry, i] + (
                        prior[lag, a] if a == b else 0.0
                    )
                    to = blocks[
                        (a // 2) * (a // 2 + 1) // 2 + b // 2, a % 2 * 2 + b % 2
                    ]
                    for j in range(n):
                        to[j] = own_entry + g_triangle[lag, entry, begin + j]
                for axis in range(2):
                    entry, part = 2 * a + axis, 2 * axis + a % 2
                    own_entry = p_pull[lag, entry, i]
                    to = blocks[first_left - k + a // 2]
                    other_pull = blocks[first_left + 1 + a // 2]
                    for j in range(n):
                        to[part, j] = own_entry
                    for j in range(n):
                        other_pull[part, j] = g_pull[lag, entry, begin + j]
            blocks[first_left], blocks[first_left + k + 1 :], factor[:] = 0.0, 0.0, 1.0
            for c in range(k):
                own = blocks[c * (c + 1) // 2 + c]
                for j in range(n):
                    first = 1.0 / own[0, j]
                    slope = own[2, j] * first
                    second = 1.0 / (own[3, j] - slope * own[2, j])
                    factor[j] *= first * second
                    pivot[0, j], pivot[1, j], pivot[2, j] = first, second, slope
                for a in range(c + 1, k + 2):
                    own, below = blocks[a * (a + 1) // 2 + c], column[a]
                    for row in (0, 2):
                        for j in range(n):
                            below[row, j] = own[row, j]
                            below[row + 1, j] = (
                                own[row + 1, j] - pivot[2, j] * own[row, j]
                            )
                            times[row, j] = pivot[0, j] * below[row, j]
                            times[row + 1, j] = pivot[1, j] * below[row + 1, j]
                    for b in range(c + 1, a + 1):
                        to, by = blocks[a * (a + 1) // 2 + b], column[b]
                        for j in range(n):
                            to[0, j] -= times[0, j] * by[0, j] + times[1, j] * by[1, j]
                            to[1, j] -= times[0, j] * by[2, j] + times[1, j] * by[3, j]
                            to[2, j] -= times[2, j] * by[0, j] + times[3, j] * by[1, j]
                            to[3, j] -= times[2, j] * by[2, j] + times[3, j] * by[3, j]
            own, other = blocks[first_left], blocks[first_left + k + 2]
            cross = blocks[first_left + k + 1]
            evidence = log_lag[lag] + p_evidence[lag, 0, i]
            for j in range(n):
                square = own[0, j] + own[3, j] + other[0, j] + other[3, j]
                exponent[j] = evidence + g_evidence[lag, 0, begin + j] - 0.5 * square
            for j in range(n):
                along, across = cross[0, j] + cross[3, j], cross[2, j] - cross[1, j]
                turned[j] = sqrt(along * along + across * across)
            _average_over_turns(turned, factor, exponent, n)
            largest, sums = best[i], total[i]
            for j in range(n):
                gain = exponent[j] - largest[j]
                fade = _fading(abs(gain))
                sums[j] = (
                    sums[j] * fade + factor[j]
                    if gain > 0.0
                    else sums[j] + factor[j] * fade
                )
                largest[j] = max(largest[j], exponent[j])
        for i in range(len(out)):
            for j in range(n):
                out[i, begin + j] = best[i, j] + log(total[i, j])
