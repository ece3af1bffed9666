"""The compiled loop of two releases under one walk: what `isac_track.model_world` averages."""

from math import log, pi, sqrt
from typing import TypeAlias

import numpy as np

from isac_track.compiling import FLOAT, INT, compiled, read, together, written
from isac_track.types import Floats, Ints

_BIG = 1e100
_Walks: TypeAlias = tuple[Floats, Floats, Floats, Ints]
_WALKS = together(read(1), read(2), read(1), read(1, "int64"))


@compiled(_WALKS, INT, _WALKS, read(1), read(1), FLOAT, written(3))
def one_walk(
    probe: _Walks,
    row: int,
    gallery: _Walks,
    lags_s: Floats,
    prior: Floats,
    q: float,
    out: Floats,
) -> None:
    """Fill `out` (G, L, 2) for one walk of `probe` and all of `gallery`, at every lag.

    Sides are times from each walk's own start, positions from its first sample,
    variances and offsets. The state is (p, v, b), b how far the second frame is
    shifted; `prior`, (3,), are its variances. What is measured is linear in either
    side's positions, so that one filter with a column for each tells the density under
    any rotation: `out` is its log but for a term in the angle, and how strong that is.
    """
    t1, z1, r1, o1 = probe
    t2, z2, r2, o2 = gallery
    mean = np.empty((3, 4))  # of either side's column, x and y
    for other in range(o2.size - 1):
        for at in range(lags_s.size):
            i, j = o1[row], o2[other]
            pp, pv, pb, vv, vb, bb = prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]
            mean[:] = 0.0
            square, volume, scale, along, across = 0.0, 0.0, 1.0, 0.0, 0.0
            now, started = 0.0, False
            while i < o1[row + 1] or j < o2[other + 1]:
                mine = j >= o2[other + 1] or (
                    i < o1[row + 1] and t1[i] <= t2[j] + lags_s[at]
                )
                then = t1[i] if mine else t2[j] + lags_s[at]
                if started:
                    dt = then - now
                    pp += dt * (2.0 * pv + dt * vv) + q * dt * dt * dt / 3.0
                    pv += dt * vv + q * dt * dt / 2.0
                    pb += dt * vb
                    vv += q * dt
                    for c in range(4):
                        mean[0, c] += dt * mean[1, c]
                now, started = then, True
                if mine:
                    h_p, h_v, h_b = pp, pv, pb
                    s = pp + r1[i]
                else:
                    h_p, h_v, h_b = pp + pb, pv + vb, pb + bb
                    s = h_p + h_b + r2[j]
                inverse = 1.0 / s
                k_p, k_v, k_b = h_p * inverse, h_v * inverse, h_b * inverse
                scale *= 2.0 * pi * s  # one logarithm for many samples
                if scale > _BIG or scale < 1.0 / _BIG:
                    volume += log(scale)
                    scale = 1.0
                shift = 0.0 if mine else 1.0
                ax = (z1[i, 0] if mine else 0.0) - mean[0, 0] - shift * mean[2, 0]
                ay = (z1[i, 1] if mine else 0.0) - mean[0, 1] - shift * mean[2, 1]
                bx = (0.0 if mine else z2[j, 0]) - mean[0, 2] - shift * mean[2, 2]
                by = (0.0 if mine else z2[j, 1]) - mean[0, 3] - shift * mean[2, 3]
                square += (ax * ax + ay * ay + bx * bx + by * by) * inverse
                along += (ax * bx + ay * by) * inverse
                across += (ax * by - ay * bx) * inverse
                for c, off in ((0, ax), (1, ay), (2, bx), (3, by)):
                    mean[0, c] += k_p * off
                    mean[1, c] += k_v * off
                    mean[2, c] += k_b * off
                pp, pv, pb = pp - k_p * h_p, pv - k_p * h_v, pb - k_p * h_b
                vv, vb, bb = vv - k_v * h_v, vb - k_v * h_b, bb - k_b * h_b
                i, j = (i + 1, j) if mine else (i, j + 1)
            out[other, at, 0] = -volume - log(scale) - 0.5 * square
            out[other, at, 1] = sqrt(along * along + across * across)
