"""Compiled loop of `imm_rts`: the way back of a smoother of two motions.

The state is (x, vx, y, vy). Mixing couples the axes, hence the full 4 x 4 covariance
per mode.
"""

# ruff: noqa: C901, PLR0912 - small matrices are spelled out
from math import exp, inf, log

import numba
import numpy as np

from isac_track.types import Floats, Ints

_STATES = 4
# As the project compiles its own loops: FMA only, and no test before every division.
_compiled = numba.njit(
    cache=True, nogil=True, fastmath={"contract"}, error_model="numpy"
)


@_compiled
def _collapse(weight: Floats, x: Floats, p: Floats, mean: Floats, cov: Floats) -> None:
    """Write mean and covariance of a Gaussian mixture: weighted sums and spread."""
    mean[:] = 0.0
    cov[:] = 0.0
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


@_compiled
def _factorise(matrix: Floats, work: Floats) -> None:
    """Write D and L of a positive L D L' to ``work[0, 0, :4]`` and ``work[1]``."""
    weight, lower = work[0, 0], work[1]
    for n in range(_STATES):
        pivot = matrix[n, n]
        for j in range(n):
            pivot -= lower[n, j] * lower[n, j] * weight[j]
        # Rounding could push a nearly singular matrix below zero.
        weight[n] = max(pivot, 0.0)
        lower[n, n] = 1.0
        for m in range(n + 1, _STATES):
            entry = matrix[m, n]
            for j in range(n):
                entry -= lower[m, j] * lower[n, j] * weight[j]
            lower[m, n] = entry / pivot if pivot > 0 else 0.0
            lower[n, m] = 0.0


@_compiled
def _orthogonal(dt: float, q: float, work: Floats) -> None:
    """Factorise F P F' + Q = M D' M' by modified weighted Gram-Schmidt.

    Nothing is subtracted from a covariance.

    On entry ``weight[:4]`` and `lower` are D and L of P = L D L'. On return `rows` is
    (4, 8) with ``M @ rows = [F L, Lq]``, its rows orthogonal under the eight weights
    (those of P, then those of Q = Lq Dq Lq'), `factor` is M and `moved` D'.
    """
    weight, moved, lower = work[0, 0], work[0, 1], work[1]
    rows, factor = work[2], work[3]
    for m in range(_STATES):
        for j in range(_STATES, 8):
            rows[m, j] = 0.0
    for j in range(_STATES):
        rows[0, j] = lower[0, j] + dt * lower[1, j]
        rows[1, j] = lower[1, j]
        rows[2, j] = lower[2, j] + dt * lower[3, j]
        rows[3, j] = lower[3, j]
    for m in (0, 2):
        rows[m, m + 4], rows[m + 1, m + 4], rows[m + 1, m + 5] = dt, 1.5, 1.0
        weight[m + 4], weight[m + 5] = q * dt / 3, q * dt / 4
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


@_compiled
def _smooth_pair(
    dt: float,
    x: Floats,
    next_x: Floats,
    next_p: Floats,
    work: Floats,
    out_x: Floats,
    out_p: Floats,
) -> float:
    """Smooth from one mode to one next mode: Rauch-Tung-Striebel in Joseph's form.

    Returns the log density of the next smoothed mean under the prediction, up to a
    constant.
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
    # product = L E with E = D V1' D'^-1; gain = product M^-1.
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
    # What the next state leaves open: [L - L E V1, -L E V2], weighted.
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


@_compiled
def smooth_back(
    t: Floats,
    offsets: Ints,
    q: Floats,
    chances: Floats,
    mean: Floats,
    cov: Floats,
    probability: Floats,
    position: Floats,
    spread: Floats,
) -> None:
    """Smooth backwards by expectation correction, a Gaussian per mode.

    Filtered states, (M, 2, 4), (M, 2, 4, 4) and (M, 2), become smoothed states in
    place. `position`, (M, 2), and `spread`, (M,), get the mixture of the modes.
    """
    modes = q.size
    pair_x = np.empty((modes, modes, _STATES))
    pair_p = np.empty((modes, modes, _STATES, _STATES))
    share = np.empty((modes, modes))  # Weight of mode m now and n next.
    work = np.empty((8, _STATES, 8))  # Some of its rows are only half used.
    mixed, mixed_cov = np.empty(_STATES), np.empty((_STATES, _STATES))
    for i in range(offsets.size - 1):
        rows = slice(offsets[i], offsets[i + 1])
        x, p, mu = mean[rows], cov[rows], probability[rows]
        first = offsets[i]
        # The smoothed states of the next sample replace the filtered states.
        for k in range(offsets[i + 1] - first - 1, -1, -1):
            if first + k + 1 < offsets[i + 1]:
                dt = t[first + k + 1] - t[first + k]
                jump = chances[first + k + 1]
                for m in range(modes):
                    _factorise(p[k, m], work)
                    for n in range(modes):
                        _orthogonal(dt, q[n], work)
                        share[m, n] = _smooth_pair(
                            dt,
                            x[k, m],
                            x[k + 1, n],
                            p[k + 1, n],
                            work,
                            pair_x[m, n],
                            pair_p[m, n],
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
                    mu[k, m] = share[m, 0] + share[m, 1]
                    for n in range(modes):
                        # An impossible mode keeps an estimate, weighted as if it were
                        # possible.
                        share[m, n] = (
                            share[m, n] / mu[k, m] if mu[k, m] > 0 else jump[m, n]
                        )
                    _collapse(share[m], pair_x[m], pair_p[m], x[k, m], p[k, m])
                mu[k] /= mu[k, 0] + mu[k, 1]
            _collapse(mu[k], x[k], p[k], mixed, mixed_cov)
            position[first + k, 0], position[first + k, 1] = mixed[0], mixed[2]
            spread[first + k] = (mixed_cov[0, 0] + mixed_cov[2, 2]) / 2
