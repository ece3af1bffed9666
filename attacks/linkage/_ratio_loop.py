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
_NOTHING = 40.0  # A lag less likely by this factor's exponential adds nothing to a double.
_BESSEL = 3.75  # Where one approximation gives way to the other.
_Told: TypeAlias = tuple[Floats, Floats, Floats]
_WALKS, _TOLD = together(read(1), read(2), read(1), read(1, "int64")), together(*[read(3)] * 3)


@compiled(_WALKS, read(2), written(4), written(4))
def tell(  # noqa: C901 - moments, a sample at a time
    walks: _Walks, segments_s: Floats, information: Floats, pull: Floats
) -> None:
    """Fill `information` (L, N, K, K) and `pull` (L, N, K, 2); see `likelihood_ratio.Told`.

    Of walks (times, positions, information of each sample, offsets), in L stretches from their
    first samples on, with any shift left out.
    """
    t, xy, weight, offsets = walks
    rank = information.shape[2]
    q, moments, sums = np.empty(rank + 1), np.empty((rank + 1, rank + 1)), np.empty((rank + 1, 2))
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
                for d in range(2, rank + 1):  # Legendre's recursion
                    q[d] = ((2 * d - 1) * u * q[d - 1] - (d - 1) * q[d - 2]) / d
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
                    pull[at, row, a, axis] = sums[a + 1, axis] - share * sums[0, axis]
                for b in range(a + 1):
                    left = moments[a + 1, b + 1] - share * moments[b + 1, 0]
                    information[at, row, a, b] = information[at, row, b, a] = left


@part_of_loop
def _log_i0(x: float) -> float:
    """Return the log of the modified Bessel function I0 (Abramowitz, Stegun, 9.8.1 and 9.8.2)."""
    if x < _BESSEL:
        y = (x / _BESSEL) ** 2
        total = 0.0360768 + y * 0.0045813
        for factor in (0.2659732, 1.2067492, 3.0899424, 3.5156229, 1.0):
            total = factor + y * total
        return log(total)
    y = _BESSEL / x
    total = -0.01647633 + y * 0.00392377
    for factor in (0.02635537, -0.02057706, 0.00916281, -0.00157565, 0.00225319, 0.01328592):
        total = factor + y * total
    return x - 0.5 * log(x) + log(0.39894228 + y * total)


@compiled(_TOLD, _TOLD, read(2), read(1), written(2))
def ratios(  # noqa: C901, PLR0912 - a Cholesky factor of many pairs at a time
    probe: _Told, gallery: _Told, prior: Floats, log_lag: Floats, out: Floats
) -> None:
    """Fill `out` (P, G) with log likelihood ratios; see `likelihood_ratio.LikelihoodRatio`.

    Of either side, at each lag: the lower triangle of the information (L, K (K + 1) / 2, N), the
    pull (L, 2 K, N), and the log evidence of each walk alone (L, 1, N). `prior`, (L, K), is the
    information of the walks' prior, `log_lag`, (L,), what else belongs to a lag.
    """
    (p_known, p_pull, p_alone), (g_known, g_pull, g_alone) = probe, gallery
    n_lags, rank = prior.shape
    root, scale = np.empty((rank, rank, _NEAR)), np.empty((rank, _NEAR))
    own, other = np.empty((rank, 2, _NEAR)), np.empty((rank, 2, _NEAR))
    volume, best, total = np.empty(_NEAR), np.empty(_NEAR), np.empty(_NEAR)
    for i in range(out.shape[0]):
        for begin in range(0, out.shape[1], _NEAR):
            n = min(_NEAR, out.shape[1] - begin)
            best[:], total[:] = -np.inf, 0.0
            for at in range(n_lags):
                volume[:] = 1.0
                for a in range(rank):
                    for b in range(a + 1):
                        entry = a * (a + 1) // 2 + b
                        here, mine = root[a, b], p_known[at, entry, i]
                        if a == b:
                            mine += prior[at, a]
                        theirs = g_known[at, entry]
                        for j in range(n):
                            here[j] = mine + theirs[begin + j]
                        for c in range(b):
                            left, right = root[a, c], root[b, c]
                            for j in range(n):
                                here[j] -= left[j] * right[j]
                        if a == b:
                            for j in range(n):
                                volume[j] *= here[j]
                                scale[a, j] = 1.0 / sqrt(here[j])
                        else:
                            for j in range(n):
                                here[j] *= scale[b, j]
                    for axis in range(2):
                        mine, theirs = p_pull[at, 2 * a + axis, i], g_pull[at, 2 * a + axis]
                        for j in range(n):
                            own[a, axis, j] = mine
                            other[a, axis, j] = theirs[begin + j]
                        for c in range(a):
                            for j in range(n):
                                own[a, axis, j] -= root[a, c, j] * own[c, axis, j]
                                other[a, axis, j] -= root[a, c, j] * other[c, axis, j]
                        for j in range(n):
                            own[a, axis, j] *= scale[a, j]
                            other[a, axis, j] *= scale[a, j]
                for j in range(n):
                    square, along, across = 0.0, 0.0, 0.0
                    for a in range(rank):
                        x, y, u, v = own[a, 0, j], own[a, 1, j], other[a, 0, j], other[a, 1, j]
                        square += x * x + y * y + u * u + v * v
                        along += x * u + y * v
                        across += x * v - y * u
                    found = log_lag[at] + p_alone[at, 0, i] + g_alone[at, 0, begin + j]
                    found += 0.5 * square - log(volume[j])
                    turned = sqrt(along * along + across * across)
                    if found + turned < best[j] - _NOTHING:  # I0(x) is less than exp(x)
                        continue
                    found += _log_i0(turned)
                    if found > best[j]:
                        total[j] = total[j] * exp(best[j] - found) + 1.0
                        best[j] = found
                    else:
                        total[j] += exp(found - best[j])
            for j in range(n):
                out[i, begin + j] = best[j] + log(total[j])
