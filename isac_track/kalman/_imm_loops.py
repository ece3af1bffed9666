"""Compiled loops of `kalman.imm`: several constant-velocity models that interact.

The state is (x, vx, y, vy). Mixing couples the axes, hence the full 4 x 4 covariance per mode.
"""

# Small matrices are spelled out, and compiled code has neither keywords nor objects to hide
# arguments in.
# ruff: noqa: C901, FBT001, PLR0912, PLR0917
from __future__ import annotations

from math import exp, inf, log, pi
from typing import TYPE_CHECKING

import numpy as np

from isac_track.compiling import (
    BOOL,
    FLOAT,
    FLOATS1,
    FLOATS2,
    FLOATS3,
    FLOATS4,
    INT,
    INTS1,
    OUT_FLOATS1,
    OUT_FLOATS2,
    OUT_FLOATS3,
    OUT_FLOATS4,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

_LOG_2PI = log(2 * pi)
_STATES = 4


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
def _copy(mu: Floats, x: Floats, p: Floats, out_mu: Floats, out_x: Floats, out_p: Floats) -> None:
    """Copy the states of all modes. Assigning slices would double the time to compile."""
    for n in range(mu.size):
        out_mu[n] = mu[n]
        for i in range(_STATES):
            out_x[n, i] = x[n, i]
            for j in range(_STATES):
                out_p[n, i, j] = p[n, i, j]


@compiled(
    *(FLOATS1, FLOATS2, FLOATS1, INTS1, FLOATS1, FLOATS3, FLOATS2, FLOATS3, FLOATS1),
    *(FLOAT, INT, BOOL),
    *(OUT_FLOATS3, OUT_FLOATS4, OUT_FLOATS2, OUT_FLOATS2, OUT_FLOATS3),
    OUT_FLOATS1,
)
def imm_filter(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: Floats,
    chances: Floats,
    initial_mean: Floats,
    initial_cov: Floats,
    initial_probability: Floats,
    gate: float,
    patience: int,
    every: bool,
    mean: Floats,
    cov: Floats,
    probability: Floats,
    mixed_mean: Floats,
    mixed_cov: Floats,
    log_likelihood: Floats,
) -> None:
    """Filter; row k of the outputs is sample k, or row i track i's last one if not `every`.

    ``chances[k, m, n]`` is that of mode n at sample k after mode m at the sample before.
    """
    modes = q.size
    x, p = np.empty((modes, _STATES)), np.empty((modes, _STATES, _STATES))
    before_x, before_p = np.empty((modes, _STATES)), np.empty((modes, _STATES, _STATES))
    mu, before_mu = np.empty(modes), np.empty(modes)
    weight, log_mode = np.empty(modes), np.empty(modes)
    for i in range(offsets.size - 1):
        for n in range(modes):
            mu[n] = initial_probability[n]
            for a in range(_STATES):
                x[n, a] = initial_mean[i, a]
                for b in range(_STATES):
                    p[n, a, b] = initial_cov[i, a, b]
        misses = 0
        first = offsets[i]
        for k in range(first, offsets[i + 1]):
            if k > first:
                dt = t[k] - t[k - 1]
                jump = chances[k]
                _copy(mu, x, p, before_mu, before_x, before_p)
                for n in range(modes):
                    mu[n] = 0.0
                    for m in range(modes):
                        mu[n] += jump[m, n] * before_mu[m]
                    for m in range(modes):
                        same = 1.0 if m == n else 0.0
                        weight[m] = jump[m, n] * before_mu[m] / mu[n] if mu[n] > 0 else same
                    _collapse(weight, before_x, before_p, x[n], p[n])
                    _predict(dt, q[n], x[n], p[n])

            r = variance[k]
            smallest = inf
            for n in range(modes):
                s00, s01, s11 = p[n, 0, 0] + r, p[n, 0, 2], p[n, 2, 2] + r
                e0, e1 = xy[k, 0] - x[n, 0], xy[k, 1] - x[n, 2]
                det = s00 * s11 - s01 * s01
                d2 = (s11 * e0 * e0 - 2 * s01 * e0 * e1 + s00 * e1 * e1) / det
                smallest = min(smallest, d2)
                log_mode[n] = -(log(det) + d2) / 2 - _LOG_2PI
            if smallest <= gate or misses >= patience:
                misses = 0
                # Relative to the best mode: far outliers underflow in all modes otherwise.
                best = -inf
                for n in range(modes):
                    if mu[n] > 0:
                        best = max(best, log_mode[n])
                total = 0.0
                for n in range(modes):
                    mu[n] *= exp(min(log_mode[n] - best, 0.0))
                    total += mu[n]
                for n in range(modes):
                    mu[n] /= total
                    _update(0, xy[k, 0], r, x[n], p[n])
                    _update(2, xy[k, 1], r, x[n], p[n])
                log_likelihood[i] += best + log(total)
            else:
                misses += 1

            row = k if every else i
            if every or k == offsets[i + 1] - 1:
                _copy(mu, x, p, probability[row], mean[row], cov[row])
                _collapse(mu, x, p, mixed_mean[row], mixed_cov[row])


@part_of_loop
def _factorise(matrix: Floats, weight: Floats, lower: Floats) -> None:
    """Write D and L of a positive matrix = L D L' to ``weight[:4]`` and `lower`."""
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
def _orthogonal(
    dt: float, q: float, weight: Floats, lower: Floats, rows: Floats, factor: Floats
) -> None:
    """Factorise F P F' + Q = M D' M' by modified weighted Gram-Schmidt, without a subtraction.

    On entry ``weight[:4]`` and `lower` are D and L of P = L D L'. On return `rows` is (4, 8)
    with ``M @ rows = [F L, Lq]``, its rows orthogonal under the eight weights (those of P, then
    those of Q = Lq Dq Lq'), `factor` is M and ``weight[8:]`` is D'.
    """
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
        weight[8 + m] = norm
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
    dt: float,
    x: Floats,
    next_x: Floats,
    next_p: Floats,
    weight: Floats,
    lower: Floats,
    rows: Floats,
    factor: Floats,
    work: Floats,
    left_open: Floats,
    out_x: Floats,
    out_p: Floats,
) -> float:
    """Rauch-Tung-Striebel from one mode to one next mode, in Joseph's form.

    Returns the log density of the next smoothed mean under the prediction, up to a constant.
    """
    gap, solved = work[0, 0], work[0, 1]
    log_density = 0.0
    for m in range(_STATES):
        moved = x[m] + dt * x[m + 1] if m % 2 == 0 else x[m]
        gap[m] = next_x[m] - moved
        solved[m] = gap[m]
        for j in range(m):
            solved[m] -= factor[m, j] * solved[j]
        log_density -= (solved[m] * solved[m] / weight[8 + m] + log(weight[8 + m])) / 2
    # product = L E with E = D V1' D'^-1; gain = product M^-1
    product, gain, carried = work[1], work[2], work[3]
    for m in range(_STATES):
        for n in range(_STATES):
            entry = 0.0
            for j in range(m + 1):
                entry += lower[m, j] * weight[j] * rows[n, j]
            product[m, n] = entry / weight[8 + n]
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


@compiled(
    *(FLOATS1, INTS1, FLOATS1, FLOATS3, FLOATS3, FLOATS4, FLOATS2),
    *(OUT_FLOATS3, OUT_FLOATS4, OUT_FLOATS2, OUT_FLOATS2, OUT_FLOATS3),
)
def imm_smoother(
    t: Floats,
    offsets: Ints,
    q: Floats,
    chances: Floats,
    filtered_mean: Floats,
    filtered_cov: Floats,
    filtered_probability: Floats,
    mean: Floats,
    cov: Floats,
    probability: Floats,
    mixed_mean: Floats,
    mixed_cov: Floats,
) -> None:
    """Smooth by expectation correction, one Gaussian per mode, from the last sample back."""
    modes = q.size
    pair_x, pair_p = np.empty((modes, modes, _STATES)), np.empty((modes, modes, _STATES, _STATES))
    share = np.empty((modes, modes))  # of mode m now and n next
    weight, lower, rows = np.empty(12), np.empty((_STATES, _STATES)), np.empty((_STATES, 8))
    factor, small = np.empty((_STATES, _STATES)), np.empty((4, _STATES, _STATES))
    left_open = np.empty((_STATES, 8))
    for i in range(offsets.size - 1):
        last = offsets[i + 1] - 1
        _copy(
            *(filtered_probability[last], filtered_mean[last], filtered_cov[last]),
            *(probability[last], mean[last], cov[last]),
        )
        _collapse(probability[last], mean[last], cov[last], mixed_mean[last], mixed_cov[last])
        for step in range(1, offsets[i + 1] - offsets[i]):
            k = last - step
            dt = t[k + 1] - t[k]
            jump = chances[k + 1]
            for m in range(modes):
                _factorise(filtered_cov[k, m], weight, lower)
                for n in range(modes):
                    _orthogonal(dt, q[n], weight, lower, rows, factor)
                    share[m, n] = _smooth_pair(
                        dt,
                        filtered_mean[k, m],
                        mean[k + 1, n],
                        cov[k + 1, n],
                        weight,
                        lower,
                        rows,
                        factor,
                        small,
                        left_open,
                        pair_x[m, n],
                        pair_p[m, n],
                    )
            for n in range(modes):
                best = -inf
                for m in range(modes):
                    if filtered_probability[k, m] * jump[m, n] > 0:
                        best = max(best, share[m, n])
                total = 0.0
                for m in range(modes):
                    prior = filtered_probability[k, m] * jump[m, n]
                    share[m, n] = prior * exp(min(share[m, n] - best, 0.0)) if prior > 0 else 0.0
                    total += share[m, n]
                for m in range(modes):
                    share[m, n] *= probability[k + 1, n] / total if total > 0 else 0.0
            for m in range(modes):
                total = 0.0
                for n in range(modes):
                    total += share[m, n]
                probability[k, m] = total
                for n in range(modes):
                    # An impossible mode keeps an estimate, weighted as if it were possible.
                    share[m, n] = share[m, n] / total if total > 0 else jump[m, n]
                _collapse(share[m], pair_x[m], pair_p[m], mean[k, m], cov[k, m])
            total = 0.0
            for m in range(modes):
                total += probability[k, m]
            for m in range(modes):
                probability[k, m] /= total
            _collapse(probability[k], mean[k], cov[k], mixed_mean[k], mixed_cov[k])
