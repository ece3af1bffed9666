"""Compiled loops of `kalman.linear`: constant velocity and constant acceleration.

The forms avoid every subtraction of nearly equal numbers that can be avoided, so that the
covariance stays positive over ten decades of noise and step without a square-root filter.
"""

# Small matrices are spelled out, and compiled code has neither keywords nor objects to hide
# arguments in.
# ruff: noqa: C901, PLR0912, PLR0917
from __future__ import annotations

from math import log, pi
from typing import TYPE_CHECKING

import numpy as np

from isac_track.compiling import (
    FLOAT,
    FLOATS1,
    FLOATS2,
    FLOATS3,
    INT,
    INTS1,
    OUT_FLOATS1,
    OUT_FLOATS3,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

_LOG_2PI = log(2 * pi)
_BIG = 1e100

_LAST = (
    *(FLOATS1, FLOATS2, FLOATS1, INTS1, FLOAT, FLOATS3, FLOATS3, FLOAT, INT),
    *(OUT_FLOATS3, OUT_FLOATS3, OUT_FLOATS1),
)


@compiled(*_LAST)
def cv_last(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
    patience: int,
    mean: Floats,
    cov: Floats,
    log_likelihood: Floats,
) -> None:
    """Filter; row i of the outputs is the state after the last sample of track i.

    Beside the covariance [[a, b], [b, c]] its determinant is carried: every update is then a
    sum of positive terms, also where one measurement is worth all that was known before.
    """
    for i in range(offsets.size - 1):
        px, vx = initial_mean[i, 0, 0], initial_mean[i, 0, 1]
        py, vy = initial_mean[i, 1, 0], initial_mean[i, 1, 1]
        a, b, c = initial_cov[i, 0, 0], initial_cov[i, 0, 1], initial_cov[i, 1, 1]
        det = a * c - b * b
        scale = 1.0  # product of innovation variances: one logarithm for many samples
        total = 0.0
        misses = 0
        before = t[offsets[i]]
        for k in range(offsets[i], offsets[i + 1]):
            dt = t[k] - before  # 0 at the first sample, where the prediction changes nothing
            before = t[k]
            grown = q * dt
            det += grown * (a + dt * (b + dt * (c / 3 + grown / 12)))
            a += dt * (2 * b + dt * (c + grown / 3))
            b += dt * (c + grown / 2)
            c += grown
            px += dt * vx
            py += dt * vy

            r = variance[k]
            s = a + r
            inverse = 1 / s
            ex = xy[k, 0] - px
            ey = xy[k, 1] - py
            d2 = (ex * ex + ey * ey) * inverse
            if misses < patience and not d2 <= gate:
                misses += 1
                continue
            misses = 0
            gain_p = a * inverse
            gain_v = b * inverse
            px += gain_p * ex
            vx += gain_v * ex
            py += gain_p * ey
            vy += gain_v * ey
            shrink = r * inverse
            c = (det + c * r) * inverse
            a *= shrink
            b *= shrink
            det *= shrink
            total += d2 / 2 + _LOG_2PI
            scale *= s
            if scale > _BIG or scale < 1 / _BIG:
                total += log(scale)
                scale = 1.0
        mean[i, 0, 0], mean[i, 0, 1] = px, vx
        mean[i, 1, 0], mean[i, 1, 1] = py, vy
        cov[i, 0, 0], cov[i, 0, 1] = a, b
        cov[i, 1, 0], cov[i, 1, 1] = b, c
        log_likelihood[i] = -total - log(scale)


@compiled(FLOATS1, FLOATS2, INTS1, OUT_FLOATS1)
def innovation_level(t: Floats, xy: Floats, offsets: Ints, level: Floats) -> None:
    """Mean of the scaled squared innovations of each track; see `isac_track.noise`."""
    for i in range(offsets.size - 1):
        first, end = offsets[i], offsets[i + 1]
        total = 0.0
        for k in range(first + 2, end):
            ratio = (t[k] - t[k - 1]) / (t[k - 1] - t[k - 2])
            ex = xy[k, 0] - xy[k - 1, 0] - ratio * (xy[k - 1, 0] - xy[k - 2, 0])
            ey = xy[k, 1] - xy[k - 1, 1] - ratio * (xy[k - 1, 1] - xy[k - 2, 1])
            total += (ex * ex + ey * ey) / (1 + (1 + ratio) * (1 + ratio) + ratio * ratio)
        level[i] = total / (2 * max(end - first - 2, 1))


@part_of_loop
def _orthogonal(dt: float, q: float, weight: Floats, rows: Floats, lower: Floats) -> None:
    """Factorise F P F' + Q = M D M' by modified weighted Gram-Schmidt, without a subtraction.

    On entry ``weight[:3]`` and the unit lower triangular `lower` are D and L of P = L D L'. On
    return `rows` is (3, 6) with ``M @ rows = [F L, Lq]``, its rows orthogonal under the six
    weights (those of P, then those of Q = Lq Dq Lq'), and `lower` is M.
    """
    half = dt * dt / 2
    for j in range(3):
        rows[0, j] = lower[0, j] + dt * lower[1, j] + half * lower[2, j]
        rows[1, j] = lower[1, j] + dt * lower[2, j]
        rows[2, j] = lower[2, j]
    rows[0, 3], rows[0, 4], rows[0, 5] = dt * dt, 0.0, 0.0
    rows[1, 3], rows[1, 4], rows[1, 5] = 2.5 * dt, dt, 0.0
    rows[2, 3], rows[2, 4], rows[2, 5] = 10 / 3, 4.0, 1.0
    weight[3], weight[4], weight[5] = q * dt / 20, q * dt / 48, q * dt / 9
    for m in range(3):
        norm = 0.0
        for j in range(6):
            norm += weight[j] * rows[m, j] * rows[m, j]
        weight[6 + m] = norm
        for n in range(m + 1, 3):
            dot = 0.0
            for j in range(6):
                dot += weight[j] * rows[m, j] * rows[n, j]
            dot /= norm
            lower[n, m] = dot
            for j in range(6):
                rows[n, j] -= dot * rows[m, j]


@part_of_loop
def _factorise(matrix: Floats, weight: Floats, lower: Floats) -> None:
    """Write D and L of a positive matrix = L D L' to ``weight[:3]`` and `lower`."""
    d0 = matrix[0, 0]
    l10, l20 = matrix[1, 0] / d0, matrix[2, 0] / d0
    # Rounding alone could push a nearly singular matrix below zero.
    d1 = max(matrix[1, 1] - l10 * l10 * d0, 0.0)
    l21 = (matrix[2, 1] - l20 * l10 * d0) / d1 if d1 > 0 else 0.0
    weight[0], weight[1] = d0, d1
    weight[2] = max(matrix[2, 2] - l20 * l20 * d0 - l21 * l21 * d1, 0.0)
    lower[0, 0] = lower[1, 1] = lower[2, 2] = 1.0
    lower[0, 1] = lower[0, 2] = lower[1, 2] = 0.0
    lower[1, 0], lower[2, 0], lower[2, 1] = l10, l20, l21


@compiled(*_LAST)
def ca_last(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
    patience: int,
    mean: Floats,
    cov: Floats,
    log_likelihood: Floats,
) -> None:
    """Filter, as `cv_last`, on the factors L D L' of the covariance.

    The position comes first, so a measurement of it changes the first element of D and nothing
    else: what is uncertain beyond the position stays, and so does its regression on it.
    """
    weight = np.empty(9)
    lower = np.empty((3, 3))
    rows = np.empty((3, 6))
    state = np.empty((2, 3))
    error = np.empty(2)
    for i in range(offsets.size - 1):
        for axis in range(2):
            for m in range(3):
                state[axis, m] = initial_mean[i, axis, m]
        _factorise(initial_cov[i], weight, lower)
        scale = 1.0
        total = 0.0
        misses = 0
        for k in range(offsets[i], offsets[i + 1]):
            if k > offsets[i]:
                dt = t[k] - t[k - 1]
                _orthogonal(dt, q, weight, rows, lower)
                for m in range(3):
                    weight[m] = weight[6 + m]
                for axis in range(2):
                    state[axis, 0] += dt * (state[axis, 1] + dt / 2 * state[axis, 2])
                    state[axis, 1] += dt * state[axis, 2]

            a, r = weight[0], variance[k]
            s = a + r
            square = 0.0
            for axis in range(2):
                error[axis] = xy[k, axis] - state[axis, 0]
                square += error[axis] * error[axis]
            d2 = square / s
            if misses < patience and not d2 <= gate:
                misses += 1
                continue
            misses = 0
            for axis in range(2):
                moved = a / s * error[axis]
                state[axis, 0] += moved
                state[axis, 1] += lower[1, 0] * moved
                state[axis, 2] += lower[2, 0] * moved
            weight[0] = a * (r / s)
            total += d2 / 2 + _LOG_2PI
            scale *= s
            if scale > _BIG or scale < 1 / _BIG:
                total += log(scale)
                scale = 1.0
        for axis in range(2):
            for m in range(3):
                mean[i, axis, m] = state[axis, m]
        for m in range(3):
            for n in range(m + 1):
                entry = 0.0
                for j in range(n + 1):
                    entry += lower[m, j] * weight[j] * lower[n, j]
                cov[i, m, n] = cov[i, n, m] = entry
        log_likelihood[i] = -total - log(scale)
