"""Compiled loops of `isac_track.kalman`: several constant-velocity models that interact.

The state is (x, vx, y, vy). Mixing couples the axes, hence the full 4 x 4 covariance per mode.
"""

# ruff: noqa: C901, PLR0912 - small matrices are spelled out
from __future__ import annotations

from math import exp, inf, log, pi
from typing import TypeAlias

import numpy as np

from isac_track.compiling import FLOAT, INT, compiled, part_of_loop, read, together, written
from isac_track.types import Floats, Ints

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats]
"""Times, places, variances, offsets, variances of the prior."""
_Moods: TypeAlias = tuple[Floats, Floats, Floats]
"""Densities, probabilities, and (M, 2, 2) chances: ``[k, m, n]`` is that of mode n at sample k
after mode m at the sample before."""
_LOG_2PI = log(2 * pi)
_STATES = 4
_BATCH = together(read(1), read(2), read(1), read(1, "int64"), read(1))
_MOODS = together(read(1), read(1), read(3))
_LAST = together(written(3), written(4), written(2), written(1))


@part_of_loop
def _predict(dt: float, q: float, x: Floats, p: Floats) -> None:
    """Move one mode by `dt` in place: F x, F P F' + Q."""
    x[0] += dt * x[1]
    x[2] += dt * x[3]
    for j in range(_STATES):
        p[0, j] += dt * p[1, j]
        p[2, j] += dt * p[3, j]
    for j in range(_STATES):
        p[j, 0] += dt * p[j, 1]
        p[j, 2] += dt * p[j, 3]
    for m in (0, 2):
        p[m, m] += q * dt * dt * dt / 3
        p[m, m + 1] += q * dt * dt / 2
        p[m + 1, m] += q * dt * dt / 2
        p[m + 1, m + 1] += q * dt


@part_of_loop
def _update(m: int, z: float, r: float, x: Floats, p: Floats) -> None:
    """Measure coordinate `m` in place; row and column m shrink without a subtraction."""
    a = p[m, m]
    s = a + r
    error = z - x[m]
    for i in range(_STATES):
        x[i] += p[i, m] / s * error
    for i in range(_STATES):
        if i != m:
            gain = p[i, m] / s
            for j in range(i + 1):
                if j != m:
                    p[i, j] -= gain * p[j, m]
                    p[j, i] = p[i, j]
    for i in range(_STATES):
        p[i, m] *= r / s
        p[m, i] = p[i, m]


@part_of_loop
def _collapse(weight: Floats, x: Floats, p: Floats, mean: Floats, cov: Floats) -> None:
    """Write mean and covariance of a Gaussian mixture: the weighted ones and the spread."""
    for i in range(_STATES):
        mean[i] = 0.0
        for j in range(_STATES):
            cov[i, j] = 0.0
    for n in range(weight.size):
        for i in range(_STATES):
            mean[i] += weight[n] * x[n, i]
    for n in range(weight.size):
        if weight[n] > 0:
            for i in range(_STATES):
                for j in range(i + 1):
                    spread = (x[n, i] - mean[i]) * (x[n, j] - mean[j])
                    cov[i, j] += weight[n] * (p[n, i, j] + spread)
    for i in range(_STATES):
        for j in range(i):
            cov[j, i] = cov[i, j]


@part_of_loop
def _one(i: int, batch: _Batch, moods: _Moods) -> tuple[Floats, ...]:
    """Return what one track is filtered from."""
    t, xy, variance, offsets, prior = batch
    q, probability, chances = moods
    own = slice(offsets[i], offsets[i + 1])
    return t[own], xy[own], variance[own], prior, q, probability, chances[own]


@part_of_loop
def _filter(
    track: tuple[Floats, ...], gate: float, patience: int, x: Floats, p: Floats, mu: Floats
) -> float:
    """Write mean, covariance and probability after each sample, and return the log-likelihood."""
    t, xy, variance, prior, q, probability, chances = track
    modes = q.size
    weight, log_mode = np.empty(modes), np.empty(modes)
    misses, log_likelihood = 0, 0.0
    for k in range(t.size):
        for n in range(modes):
            if k == 0:
                mu[0, n] = probability[n]
                # Element by element: to assign slices would double the time to compile.
                for a in range(_STATES):
                    x[0, n, a] = xy[0, a // 2] if a % 2 == 0 else 0.0
                    for b in range(_STATES):
                        p[0, n, a, b] = prior[a % 2] if a == b else 0.0
                continue
            dt = t[k] - t[k - 1]
            mu[k, n] = 0.0
            for m in range(modes):
                mu[k, n] += chances[k, m, n] * mu[k - 1, m]
            for m in range(modes):
                same = 1.0 if m == n else 0.0
                joint = chances[k, m, n] * mu[k - 1, m]
                weight[m] = joint / mu[k, n] if mu[k, n] > 0 else same
            _collapse(weight, x[k - 1], p[k - 1], x[k, n], p[k, n])
            _predict(dt, q[n], x[k, n], p[k, n])

        r = variance[k]
        smallest = inf
        for n in range(modes):
            s00, s01, s11 = p[k, n, 0, 0] + r, p[k, n, 0, 2], p[k, n, 2, 2] + r
            e0, e1 = xy[k, 0] - x[k, n, 0], xy[k, 1] - x[k, n, 2]
            det = s00 * s11 - s01 * s01
            d2 = (s11 * e0 * e0 - 2 * s01 * e0 * e1 + s00 * e1 * e1) / det
            smallest = min(smallest, d2)
            log_mode[n] = -(log(det) + d2) / 2 - _LOG_2PI
        if smallest > gate and misses < patience:
            misses += 1
            continue
        misses = 0
        # Relative to the best mode: far outliers underflow in all modes otherwise.
        best = -inf
        for n in range(modes):
            if mu[k, n] > 0:
                best = max(best, log_mode[n])
        total = 0.0
        for n in range(modes):
            mu[k, n] *= exp(min(log_mode[n] - best, 0.0))
            total += mu[k, n]
        for n in range(modes):
            mu[k, n] /= total
            _update(0, xy[k, 0], r, x[k, n], p[k, n])
            _update(2, xy[k, 1], r, x[k, n], p[k, n])
        log_likelihood += best + log(total)
    return log_likelihood


@part_of_loop
def _room(batch: _Batch, modes: int) -> _Moods:
    """Return memory for the states and probabilities along any one of the tracks."""
    longest = 0
    for i in range(batch[3].size - 1):
        longest = max(longest, batch[3][i + 1] - batch[3][i])
    return (
        np.empty((longest, modes, _STATES)),
        np.empty((longest, modes, _STATES, _STATES)),
        np.empty((longest, modes)),
    )


@compiled(_BATCH, _MOODS, FLOAT, INT, _LAST)
def imm_last(
    batch: _Batch,
    moods: _Moods,
    gate: float,
    patience: int,
    out: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Filter; row i of the outputs is the state after the last sample of track i."""
    offsets, modes, (mean, cov, last_probability, log_likelihood) = batch[3], moods[0].size, out
    x, p, mu = _room(batch, modes)
    for i in range(offsets.size - 1):
        last = offsets[i + 1] - offsets[i] - 1
        log_likelihood[i] = _filter(_one(i, batch, moods), gate, patience, x, p, mu)
        for n in range(modes):
            last_probability[i, n] = mu[last, n]
            for a in range(_STATES):
                mean[i, n, a] = x[last, n, a]
                for b in range(_STATES):
                    cov[i, n, a, b] = p[last, n, a, b]


@part_of_loop
def _factorise(matrix: Floats, work: Floats) -> None:
    """Write D and L of a positive matrix = L D L' to ``work[0, 0, :4]`` and ``work[1]``."""
    weight, lower = work[0, 0], work[1]
    for n in range(_STATES):
        pivot = matrix[n, n]
        for j in range(n):
            pivot -= lower[n, j] * lower[n, j] * weight[j]
        # Rounding alone could push a nearly singular matrix below zero.
        weight[n] = max(pivot, 0.0)
        lower[n, n] = 1.0
        for m in range(n + 1, _STATES):
            entry = matrix[m, n]
            for j in range(n):
                entry -= lower[m, j] * lower[n, j] * weight[j]
            lower[m, n] = entry / pivot if pivot > 0 else 0.0
            lower[n, m] = 0.0


@part_of_loop
def _orthogonal(dt: float, q: float, work: Floats) -> None:
    """Factorise F P F' + Q = M D' M' by modified weighted Gram-Schmidt, without a subtraction.

    On entry ``weight[:4]`` and `lower` are D and L of P = L D L'. On return `rows` is (4, 8)
    with ``M @ rows = [F L, Lq]``, its rows orthogonal under the eight weights (those of P, then
    those of Q = Lq Dq Lq'), `factor` is M and `moved` D'.
    """
    weight, moved, lower, rows, factor = work[0, 0], work[0, 1], work[1], work[2], work[3]
    for m in range(_STATES):
        for j in range(_STATES, 8):
            rows[m, j] = 0.0
    for j in range(_STATES):
        rows[0, j] = lower[0, j] + dt * lower[1, j]
        rows[1, j] = lower[1, j]
        rows[2, j] = lower[2, j] + dt * lower[3, j]
        rows[3, j] = lower[3, j]
    for m in (0, 2):
        rows[m, m + 4] = dt
        rows[m + 1, m + 4] = 1.5
        rows[m + 1, m + 5] = 1.0
        weight[m + 4] = q * dt / 3
        weight[m + 5] = q * dt / 4
    for m in range(_STATES):
        norm = 0.0
        for j in range(8):
            norm += weight[j] * rows[m, j] * rows[m, j]
        moved[m] = norm
        for n in range(m + 1, _STATES):
            dot = 0.0
            for j in range(8):
                dot += weight[j] * rows[m, j] * rows[n, j]
            dot /= norm
            factor[n, m] = dot
            for j in range(8):
                rows[n, j] -= dot * rows[m, j]


@part_of_loop
def _smooth_pair(
    dt: float, x: Floats, next_x: Floats, next_p: Floats, work: Floats, out_x: Floats, out_p: Floats
) -> float:
    """Rauch-Tung-Striebel from one mode to one next mode, in Joseph's form.

    Returns the log density of the next smoothed mean under the prediction, up to a constant.
    """
    weight, moved, gap, solved = work[0, 0], work[0, 1], work[0, 2], work[0, 3]
    lower, rows, factor, left_open = work[1], work[2], work[3], work[4]
    product, gain, carried = work[5], work[6], work[7]
    log_density = 0.0
    for m in range(_STATES):
        gap[m] = next_x[m] - (x[m] + dt * x[m + 1] if m % 2 == 0 else x[m])
        solved[m] = gap[m]
        for j in range(m):
            solved[m] -= factor[m, j] * solved[j]
        log_density -= (solved[m] * solved[m] / moved[m] + log(moved[m])) / 2
    # product = L E with E = D V1' D'^-1; gain = product M^-1
    for m in range(_STATES):
        for n in range(_STATES):
            entry = 0.0
            for j in range(m + 1):
                entry += lower[m, j] * weight[j] * rows[n, j]
            product[m, n] = entry / moved[n]
    for m in range(_STATES):
        for n in range(_STATES - 1, -1, -1):
            entry = product[m, n]
            for j in range(n + 1, _STATES):
                entry -= gain[m, j] * factor[j, n]
            gain[m, n] = entry
    for m in range(_STATES):
        out_x[m] = x[m]
        for n in range(_STATES):
            out_x[m] += gain[m, n] * gap[n]
            entry = 0.0
            for j in range(_STATES):
                entry += gain[m, j] * next_p[j, n]
            carried[m, n] = entry
    # what the next state leaves open: [L - L E V1, -L E V2], weighted
    for m in range(_STATES):
        for n in range(8):
            entry = lower[m, n] if n < _STATES else 0.0
            for j in range(_STATES):
                entry -= product[m, j] * rows[j, n]
            left_open[m, n] = entry
    for m in range(_STATES):
        for n in range(m + 1):
            entry = 0.0
            for j in range(8):
                entry += left_open[m, j] * weight[j] * left_open[n, j]
            for j in range(_STATES):
                entry += carried[m, j] * gain[n, j]
            out_p[m, n] = out_p[n, m] = entry
    return log_density


@compiled(_BATCH, _MOODS, written(2), written(1))
def imm_smoother(batch: _Batch, moods: _Moods, position: Floats, spread: Floats) -> None:
    """Filter, then smooth by expectation correction, one Gaussian per mode, from the last back."""
    t, offsets, (q, _, chances) = batch[0], batch[3], moods
    modes = q.size
    x, p, mu = _room(batch, modes)
    pair_x, pair_p = np.empty((modes, modes, _STATES)), np.empty((modes, modes, _STATES, _STATES))
    share = np.empty((modes, modes))  # of mode m now and n next
    work = np.empty((8, _STATES, 8))  # some rows of it are half as long
    mean, cov = np.empty(_STATES), np.empty((_STATES, _STATES))
    for i in range(offsets.size - 1):
        first = offsets[i]
        _filter(_one(i, batch, moods), inf, 0, x, p, mu)
        # The smoothed states of the next sample take the place of the filtered ones.
        for k in range(offsets[i + 1] - first - 1, -1, -1):
            if first + k + 1 < offsets[i + 1]:
                dt = t[first + k + 1] - t[first + k]
                jump = chances[first + k + 1]
                for m in range(modes):
                    _factorise(p[k, m], work)
                    for n in range(modes):
                        _orthogonal(dt, q[n], work)
                        share[m, n] = _smooth_pair(
                            *(dt, x[k, m], x[k + 1, n], p[k + 1, n]),
                            *(work, pair_x[m, n], pair_p[m, n]),
                        )
                for n in range(modes):
                    best = -inf
                    for m in range(modes):
                        if mu[k, m] * jump[m, n] > 0:
                            best = max(best, share[m, n])
                    total = 0.0
                    for m in range(modes):
                        before = mu[k, m] * jump[m, n]
                        nearer = exp(min(share[m, n] - best, 0.0))
                        share[m, n] = before * nearer if before > 0 else 0.0
                        total += share[m, n]
                    for m in range(modes):
                        share[m, n] *= mu[k + 1, n] / total if total > 0 else 0.0
                for m in range(modes):
                    mu[k, m] = 0.0
                    for n in range(modes):
                        mu[k, m] += share[m, n]
                    for n in range(modes):
                        # An impossible mode keeps an estimate, weighted as if it were possible.
                        share[m, n] = share[m, n] / mu[k, m] if mu[k, m] > 0 else jump[m, n]
                    _collapse(share[m], pair_x[m], pair_p[m], x[k, m], p[k, m])
                total = 0.0
                for m in range(modes):
                    total += mu[k, m]
                for m in range(modes):
                    mu[k, m] /= total
            _collapse(mu[k], x[k], p[k], mean, cov)
            position[first + k, 0], position[first + k, 1] = mean[0], mean[2]
            spread[first + k] = (cov[0, 0] + cov[2, 2]) / 2
