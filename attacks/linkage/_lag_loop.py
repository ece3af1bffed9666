"""Compiled loop of `attacks.linkage.signals`: the best of all lags, for every pair."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track._compiling import (
    BOOL,
    FLOAT,
    FLOATS1,
    FLOATS3,
    INT,
    INTS1,
    OUT_FLOATS3,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


@part_of_loop
def _project(
    signal: Floats, start: int, m: int, basis: Floats, rank: int, parts: Floats, norm: Floats
) -> None:
    """Project cells ``start:start + m`` of (C, K, N) signals on the basis: (C * rank, N), (N,)."""
    channels, _, n = signal.shape
    norm[:] = 0.0
    for c in range(channels):
        for k in range(rank):
            row = parts[c * rank + k]
            row[:] = 0.0
            for j in range(m):
                # Walk by walk in the innermost loop, here as below: it becomes vector code.
                weight = basis[k * m + j]
                cell = signal[c, start + j]
                for i in range(n):
                    row[i] += weight * cell[i]
            for i in range(n):
                norm[i] += row[i] * row[i]


@compiled(
    FLOATS3,
    FLOATS3,
    FLOATS1,
    INTS1,
    INTS1,
    FLOATS1,
    FLOAT,
    INT,
    INT,
    FLOAT,
    BOOL,
    OUT_FLOATS3,
)
def least_costs(  # noqa: C901, PLR0912, PLR0917 - one loop, for speed
    probe: Floats,
    gallery: Floats,
    basis: Floats,
    begin: Ints,
    ranks: Ints,
    floors: Floats,
    exponent: float,
    reach: int,
    least: int,
    full: float,
    rotated: bool,  # noqa: FBT001 - numba passes by position
    out: Floats,
) -> None:
    """Fill `out` (E, P, G) with the least cost over all lags; see `signals.aligned_costs`."""
    channels, long_p, n_probe = probe.shape
    _, long_g, n_gallery = gallery.shape
    most = channels * max(ranks.max(), 1)
    p_parts, g_parts = np.empty((most, n_probe)), np.empty((most, n_gallery))
    p_norm, g_norm = np.empty(n_probe), np.empty(n_gallery)
    dot, cross, gap = np.empty(n_gallery), np.empty(n_gallery), np.empty(n_gallery)
    least = min(least, long_p, long_g)
    out[:] = np.inf
    for lag in range(-reach - max(long_g - long_p, 0), reach + max(long_p - long_g, 0) + 1):
        start_p, start_g = max(lag, 0), max(-lag, 0)
        m = min(long_p - start_p, long_g - start_g)
        if m < least:
            continue
        rank = ranks[m]
        here = basis[begin[m] : begin[m + 1]]
        _project(probe, start_p, m, here, rank, p_parts, p_norm)
        _project(gallery, start_g, m, here, rank, g_parts, g_norm)
        factor = (full / m) ** exponent
        for i in range(n_probe):
            dot[:] = 0.0
            if rotated:
                # The modulus of a b*: the rotation that fits best, which no reflection can enter.
                cross[:] = 0.0
                for k in range(rank):
                    ax, ay = p_parts[k, i], p_parts[rank + k, i]
                    for j in range(n_gallery):
                        dot[j] += ax * g_parts[k, j] + ay * g_parts[rank + k, j]
                        cross[j] += ay * g_parts[k, j] - ax * g_parts[rank + k, j]
                for j in range(n_gallery):
                    dot[j] = np.sqrt(dot[j] * dot[j] + cross[j] * cross[j])
            else:
                for k in range(channels * rank):
                    ax = p_parts[k, i]
                    for j in range(n_gallery):
                        dot[j] += ax * g_parts[k, j]
            own = p_norm[i]
            for j in range(n_gallery):
                gap[j] = max(own + g_norm[j] - 2.0 * dot[j], 0.0) / m
            for e in range(floors.size):
                for j in range(n_gallery):
                    out[e, i, j] = min(out[e, i, j], (gap[j] + floors[e]) * factor)
