"""Compiled loop of two releases of a walk, which `isac_track.model_world` averages."""

from math import log, pi, sqrt
from typing import TypeAlias

import numpy as np

from isac_track.compiling import FLOAT, INT, compiled, read, together, written
from isac_track.types import Floats, Ints

_BIG = 1e100
_Walks: TypeAlias = tuple[Floats, Floats, Floats, Ints]
_WALKS = together(read(1), read(2), read(1), read(1, "int64"))


@compiled(_WALKS, INT, _WALKS, read(1), read(1), FLOAT, written(3))
def fill_walk_densities(
    probe: _Walks,
    row: int,
    gallery: _Walks,
    lags_s: Floats,
    prior: Floats,
    q: float,
    out: Floats,
) -> None:
    """Fill `out`, (G, L, 2), for a walk of `probe` and all of `gallery`, at every lag.

    `probe` and `gallery` are times from each walk's start, positions from its first
    sample, variances and offsets. The state is (p, v, b), where b is the shift of the
    second frame; `prior`, (3,), are its variances. Measurements are linear in the
    positions of both releases. So one filter with a column for each gives the density
    under any rotation: `out` is its logarithm without the term in the angle, and the
    strength of that term.
    """
    t1, z1, r1, o1 = probe
    t2, z2, r2, o2 = gallery
    mean = np.empty((3, 4))  # Columns: x and y of the probe, x and y of the gallery.
    for walk in range(o2.size - 1):
        for lag in range(lags_s.size):
            i, j = o1[row], o2[walk]
            pp, pv, pb, vv, vb, bb = prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]
            mean[:] = 0.0
            square, volume, scale, along, across = 0.0, 0.0, 1.0, 0.0, 0.0
            now, started = 0.0, False
            while i < o1[row + 1] or j < o2[walk + 1]:
                is_probe = j >= o2[walk + 1] or (
                    i < o1[row + 1] and t1[i] <= t2[j] + lags_s[lag]
                )
                then = t1[i] if is_probe else t2[j] + lags_s[lag]
                if started:
                    dt = then - now
                    pp += dt * (2.0 * pv + dt * vv) + q * dt * dt * dt / 3.0
                    pv += dt * vv + q * dt * dt / 2.0
                    pb += dt * vb
                    vv += q * dt
                    for c in range(4):
                        mean[0, c] += dt * mean[1, c]
                now, started = then, True
                if is_probe:
                    h_p, h_v, h_b = pp, pv, pb
                    s = pp + r1[i]
                else:
                    h_p, h_v, h_b = pp + pb, pv + vb, pb + bb
                    s = h_p + h_b + r2[j]
                inverse = 1.0 / s
                k_p, k_v, k_b = h_p * inverse, h_v * inverse, h_b * inverse
                scale *= 2.0 * pi * s  # One logarithm serves many samples.
                if scale > _BIG or scale < 1.0 / _BIG:
                    volume += log(scale)
                    scale = 1.0
                shift = 0.0 if is_probe else 1.0
                ax = (z1[i, 0] if is_probe else 0.0) - mean[0, 0] - shift * mean[2, 0]
                ay = (z1[i, 1] if is_probe else 0.0) - mean[0, 1] - shift * mean[2, 1]
                bx = (0.0 if is_probe else z2[j, 0]) - mean[0, 2] - shift * mean[2, 2]
                by = (0.0 if is_probe else z2[j, 1]) - mean[0, 3] - shift * mean[2, 3]
                square += (ax * ax + ay * ay + bx * bx + by * by) * inverse
                along += (ax * bx + ay * by) * inverse
                across += (ax * by - ay * bx) * inverse
                for c, error in ((0, ax), (1, ay), (2, bx), (3, by)):
                    mean[0, c] += k_p * error
                    mean[1, c] += k_v * error
                    mean[2, c] += k_b * error
                pp, pv, pb = pp - k_p * h_p, pv - k_p * h_v, pb - k_p * h_b
                vv, vb, bb = vv - k_v * h_v, vb - k_v * h_b, bb - k_b * h_b
                i, j = (i + 1, j) if is_probe else (i, j + 1)
            out[walk, lag, 0] = -volume - log(scale) - 0.5 * square
            out[walk, lag, 1] = sqrt(along * along + across * across)
