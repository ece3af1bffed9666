"""Compiled loops of the likelihood ratio: what each walk tells, and what two tell together.

A pair's result does not hang on who else is there.
"""

from math import exp, log, sqrt
from typing import TypeAlias

import numpy as np

from isac_track.compiling import compiled, part_of_loop, read, together, written
from isac_track.types import Floats, Ints

_NEAR = 64  # Gallery walks at a time: all that is made of them stays in the cache.
_Walks: TypeAlias = tuple[Floats, Floats, Floats, Ints]
# A lag less likely by this factor's exponential adds nothing to a double.
_NOTHING = 64.0
_MIDDLE = exp(-0.5)
_BESSEL = 3.75  # Where one approximation gives way to the other.
_Told: TypeAlias = tuple[Floats, Floats, Floats]
_WALKS, _TOLD = (
    together(read(1), read(2), read(1), read(1, "int64")),
    together(*[read(3)] * 3),
)


@compiled(_WALKS, read(2), written(4))
def tell(  # noqa: C901 - moments, a sample at a time
    walks: _Walks, segments_s: Floats, told: Floats
) -> None:
    """Fill `told` (L, N, K, K + 2) with what walks tell of their coefficients, at each of L lags.

    That is their information, 1/m^2 per axis, and beside it the pull, 1/m: information
    times coefficients. Of walks (times, positions, information of each sample,
    offsets), in L stretches from their first samples on, with any shift left out.
    """
    t, xy, weight, offsets = walks
    rank = told.shape[2]
    q, moments, sums = (
        np.empty(rank + 1),
        np.empty((rank + 1, rank + 1)),
        np.empty((rank + 1, 2)),
    )
    degree = np.arange(2.0, rank + 1.0)
    slope, back = (
        (2.0 * degree - 1.0) / degree,
        (degree - 1.0) / degree,
    )  # of Legendre's recursion
    for at in range(len(segments_s)):
        start_s, end_s = segments_s[at]
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
                    told[at, row, a, rank + axis] = (
                        sums[a + 1, axis] - share * sums[0, axis]
                    )
                for b in range(a + 1):
                    left = moments[a + 1, b + 1] - share * moments[b + 1, 0]
                    told[at, row, a, b] = told[at, row, b, a] = left


@part_of_loop
def _solve(rows: Floats) -> float:
    """Solve K equations (K, K + R) by Gauss-Jordan, into the last R columns; return ln |det|."""
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
    told: Floats,
    more_m2: Floats,
    prior: Floats,
    known: Floats,
    pull: Floats,
    alone: Floats,
) -> None:
    """Fill what `ratios` takes of a side from what `tell` tells, its errors as large as they are.

    To the covariance of a walk's coefficients is added `more_m2`, (L, K, K).
    """
    n_lags, n_walks, rank = told.shape[:3]
    rows, own = np.empty((rank, 2 * rank + 2)), np.empty((rank, rank + 2))
    for at, row in np.ndindex(n_lags, n_walks):
        rows[:, rank:] = told[at, row]
        for a in range(rank):
            for b in range(rank):
                total = 1.0 if a == b else 0.0
                for c in range(rank):
                    total += told[at, row, a, c] * more_m2[at, c, b]
                rows[a, b] = total
        _solve(rows)
        own[:] = rows[:, rank:]
        for a in range(rank):
            own[a, a] += prior[at, a]
            for b in range(a + 1):
                known[at, a * (a + 1) // 2 + b, row] = rows[a, rank + b]
        evidence = _solve(own)
        for a in range(rank):
            for axis in range(2):
                force = rows[a, 2 * rank + axis]
                evidence -= 0.5 * force * own[a, rank + axis]
                pull[at, 2 * a + axis, row] = force
        alone[at, 0, row] = evidence


@part_of_loop
def _average_over_turns(
    turned: Floats, factor: Floats, exponent: Floats, n: int
) -> None:
    """Multiply factor times e^exponent by I0(turned) (Abramowitz, Stegun, 9.8.1 and 2), n times."""
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
    """Return exp(-x) of x >= 0, or 0 where that adds nothing; unlike libm's, for many at a time.

    The series about half of `_NOTHING`, of a 64th of x, to the 64th power.
    """
    at, value = 0.5 - min(x, _NOTHING) / _NOTHING, 1.0
    for n in range(14, 0, -1):
        value = 1.0 + at * (1.0 / n) * value
    value *= _MIDDLE
    for _ in range(6):
        value *= value
    return value if x < _NOTHING else 0.0


@compiled(_TOLD, _TOLD, read(2), read(1), written(2))
def ratios(  # noqa: C901, PLR0912, PLR0915 - an elimination of many pairs at a time
    probe: _Told, gallery: _Told, prior: Floats, log_lag: Floats, out: Floats
) -> None:
    """Fill `out` (P, G) with log likelihood ratios; see `likelihood_ratio.LikelihoodRatio`.

    Of either side, at each lag: the lower triangle of the information (L, K (K + 1) /
    2, N), the pull (L, 2 K, N), and the log evidence of each walk alone (L, 1, N).
    `prior`, (L, K), is the information of the walks' prior, `log_lag`, (L,), what else
    belongs to a lag.
    """
    (p_known, p_pull, p_alone), (g_known, g_pull, g_alone) = probe, gallery
    n_lags, rank = prior.shape
    # The lower triangle of M, and below it both pulls, in blocks of 2 x 2. When M is
    # eliminated, what is left below are minus the products h* M^-1 h.
    k = (rank + 1) // 2
    left = k * (k + 1) // 2 + k  # Of the blocks that are left, the first.
    blocks = np.zeros((left + k + 3, 4, _NEAR))
    if rank % 2:  # a row and a column of the unit matrix
        blocks[left - k - 1, 3] = 1.0
    column, pivot, times = (
        np.empty((k + 2, 4, _NEAR)),
        np.empty((3, _NEAR)),
        np.empty((4, _NEAR)),
    )
    turned, factor, exponent = np.empty((3, _NEAR))
    best, total = np.empty((2, len(out), _NEAR))
    for begin in range(0, out.shape[1], _NEAR):
        n = min(_NEAR, out.shape[1] - begin)
        best[:], total[:] = -np.inf, 0.0
        for at, i in np.ndindex(n_lags, len(out)):
            for a in range(rank):
                for b in range(a + 1):
                    entry = a * (a + 1) // 2 + b
                    mine = p_known[at, entry, i] + (prior[at, a] if a == b else 0.0)
                    to = blocks[
                        (a // 2) * (a // 2 + 1) // 2 + b // 2, a % 2 * 2 + b % 2
                    ]
                    for j in range(n):
                        to[j] = mine + g_known[at, entry, begin + j]
                for axis in range(2):
                    mine, to = p_pull[at, 2 * a + axis, i], blocks[left - k + a // 2]
                    too = blocks[left + 1 + a // 2]
                    for j in range(n):
                        to[2 * axis + a % 2, j] = mine
                    for j in range(n):
                        too[2 * axis + a % 2, j] = g_pull[at, 2 * a + axis, begin + j]
            blocks[left], blocks[left + k + 1 :], factor[:] = 0.0, 0.0, 1.0
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
            own, both, other = blocks[left], blocks[left + k + 1], blocks[left + k + 2]
            evidence = log_lag[at] + p_alone[at, 0, i]
            for j in range(n):
                square = own[0, j] + own[3, j] + other[0, j] + other[3, j]
                exponent[j] = evidence + g_alone[at, 0, begin + j] - 0.5 * square
            for j in range(n):
                along, across = both[0, j] + both[3, j], both[2, j] - both[1, j]
                turned[j] = sqrt(along * along + across * across)
            _average_over_turns(turned, factor, exponent, n)
            most, sums = best[i], total[i]
            for j in range(n):
                more = exponent[j] - most[j]
                less = _fading(abs(more))
                sums[j] = (
                    sums[j] * less + factor[j]
                    if more > 0.0
                    else sums[j] + factor[j] * less
                )
                most[j] = max(most[j], exponent[j])
        for i in range(len(out)):
            for j in range(n):
                out[i, begin + j] = best[i, j] + log(total[i, j])
