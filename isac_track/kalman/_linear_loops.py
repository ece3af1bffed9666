"""Compiled loops of `isac_track.kalman`: constant velocity and constant acceleration.

The forms avoid every subtraction of nearly equal numbers that can be avoided, so that the
covariance stays positive over ten decades of noise and step without a square-root filter.
"""

# Small matrices are spelled out, and compiled code has neither keywords nor objects to hide
# arguments in.
# ruff: noqa: C901, FBT001, PLR0912, PLR0915, PLR0917
from __future__ import annotations

from math import log, pi
from typing import TYPE_CHECKING

import numpy as np

from isac_track.compiling import (
    BOOL,
    FLOAT,
    FLOATS1,
    FLOATS2,
    FLOATS3,
    INT,
    INTS1,
    OUT_BOOLS1,
    OUT_FLOATS1,
    OUT_FLOATS2,
    OUT_FLOATS3,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Bools, Floats, Ints

_LOG_2PI = log(2 * pi)
_BIG = 1e100

_FILTER = (
    *(FLOATS1, FLOATS2, FLOATS1, INTS1, FLOAT, FLOATS3, FLOATS3, FLOAT, INT, BOOL),
    *(OUT_FLOATS3, OUT_FLOATS3, OUT_FLOATS1, OUT_BOOLS1, OUT_FLOATS1, OUT_FLOATS2),
)
_SMOOTHER = (FLOATS1, INTS1, FLOAT, FLOATS3, FLOATS3, OUT_FLOATS3, OUT_FLOATS3)


@part_of_loop
def _cv_step(
    dt: float,
    q: float,
    zx: float,
    zy: float,
    r: float,
    gate: float,
    forced: bool,
    px: float,
    vx: float,
    py: float,
    vy: float,
    a: float,
    b: float,
    c: float,
    det: float,
) -> tuple[float, ...]:
    """Predict by `dt` and measure.

    Returns the state (px to det), the predicted variance of a coordinate, that of its
    innovation, the squared innovation, the normalised one, and whether the sample was used.


    Beside the covariance [[a, b], [b, c]] its determinant is carried: every update is then a
    sum of positive terms, also where one measurement is worth all that was known before.
    """
    grown = q * dt
    det += grown * (a + dt * (b + dt * (c / 3 + grown / 12)))
    a += dt * (2 * b + dt * (c + grown / 3))
    b += dt * (c + grown / 2)
    c += grown
    px += dt * vx
    py += dt * vy
    s = a + r
    inverse = 1 / s
    ex = zx - px
    ey = zy - py
    square = ex * ex + ey * ey
    d2 = square * inverse
    take = forced or d2 <= gate
    predicted = a
    if take:
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
    return px, vx, py, vy, a, b, c, det, predicted, s, square, d2, take


@part_of_loop
def _cv_back(
    dt: float, q: float, a: float, b: float, c: float, det: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return gain G and open covariance C of the smoother, multiplied out: little cancels.

    With P the filtered covariance, B = F^-1 Q F^-T and P' = F P F' + Q the smoothed covariance
    is C + G Ps G', where C = (|Q| P + |P| B) / |P'| (two-dimensional matrices only).
    """
    grown = q * dt
    det_q = grown * grown * dt * dt / 12
    inverse = 1 / (det + grown * (a + dt * (b + dt * c / 3)) + det_q)
    det *= inverse
    det_q *= inverse
    share = grown * inverse
    g00 = det + share * (a + dt * b / 2)
    g01 = -dt * (det + share * (a / 2 + dt * b / 6))
    g10 = share * (b + dt * c / 2)
    g11 = det - share * dt * (b / 2 + dt * c / 6)
    spread = det * grown
    c00 = det_q * a + spread * dt * dt / 3
    c01 = det_q * b - spread * dt / 2
    c11 = det_q * c + spread
    return g00, g01, g10, g11, c00, c01, c11


@compiled(*_FILTER)
def cv_filter(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
    patience: int,
    every: bool,
    mean: Floats,
    cov: Floats,
    nis: Floats,
    accepted: Bools,
    log_likelihood: Floats,
    sums: Floats,
) -> None:
    """Filter; row k of the outputs is sample k, or row i track i's last one if not `every`."""
    for i in range(offsets.size - 1):
        px, vx = initial_mean[i, 0, 0], initial_mean[i, 0, 1]
        py, vy = initial_mean[i, 1, 0], initial_mean[i, 1, 1]
        a, b, c = initial_cov[i, 0, 0], initial_cov[i, 0, 1], initial_cov[i, 1, 1]
        det = a * c - b * b
        scale = 1.0  # product of innovation variances: one logarithm for many samples
        total = 0.0
        count = squares = spread = 0.0
        misses = 0
        first = offsets[i]
        before = t[first]
        for k in range(first, offsets[i + 1]):
            dt = t[k] - before  # 0 at the first sample, where the prediction changes nothing
            before = t[k]
            px, vx, py, vy, a, b, c, det, predicted, s, square, d2, take = _cv_step(
                *(dt, q, xy[k, 0], xy[k, 1], variance[k], gate, misses >= patience),
                *(px, vx, py, vy, a, b, c, det),
            )
            if take:
                misses = 0
                if k > first:
                    count += 2
                    squares += square
                    spread += 2 * predicted
                total += d2 / 2 + _LOG_2PI
                scale *= s
                if scale > _BIG or scale < 1 / _BIG:
                    total += log(scale)
                    scale = 1.0
            else:
                misses += 1

            row = k if every else i
            mean[row, 0, 0], mean[row, 0, 1] = px, vx
            mean[row, 1, 0], mean[row, 1, 1] = py, vy
            cov[row, 0, 0], cov[row, 0, 1] = a, b
            cov[row, 1, 0], cov[row, 1, 1] = b, c
            nis[row] = d2
            accepted[row] = take
        log_likelihood[i] = -total - log(scale)
        sums[i, 0], sums[i, 1], sums[i, 2] = count, squares, spread


@compiled(*_SMOOTHER)
def cv_smoother(
    t: Floats,
    offsets: Ints,
    q: float,
    filtered_mean: Floats,
    filtered_cov: Floats,
    mean: Floats,
    cov: Floats,
) -> None:
    """Rauch-Tung-Striebel, from the last sample of a track to its first."""
    for i in range(offsets.size - 1):
        last = offsets[i + 1] - 1
        px, vx = filtered_mean[last, 0, 0], filtered_mean[last, 0, 1]
        py, vy = filtered_mean[last, 1, 0], filtered_mean[last, 1, 1]
        pp, pv, vv = filtered_cov[last, 0, 0], filtered_cov[last, 0, 1], filtered_cov[last, 1, 1]
        for step in range(offsets[i + 1] - offsets[i]):
            k = last - step
            if step > 0:
                dt = t[k + 1] - t[k]
                a, b, c = filtered_cov[k, 0, 0], filtered_cov[k, 0, 1], filtered_cov[k, 1, 1]
                det = max(a * c - b * b, 0.0)
                g00, g01, g10, g11, c00, c01, c11 = _cv_back(dt, q, a, b, c, det)
                fx, fvx = filtered_mean[k, 0, 0], filtered_mean[k, 0, 1]
                fy, fvy = filtered_mean[k, 1, 0], filtered_mean[k, 1, 1]
                ex, evx = px - (fx + dt * fvx), vx - fvx
                ey, evy = py - (fy + dt * fvy), vy - fvy
                px, vx = fx + g00 * ex + g01 * evx, fvx + g10 * ex + g11 * evx
                py, vy = fy + g00 * ey + g01 * evy, fvy + g10 * ey + g11 * evy
                h00, h01 = g00 * pp + g01 * pv, g00 * pv + g01 * vv
                h10, h11 = g10 * pp + g11 * pv, g10 * pv + g11 * vv
                pp = c00 + h00 * g00 + h01 * g01
                pv = c01 + h00 * g10 + h01 * g11
                vv = c11 + h10 * g10 + h11 * g11
            mean[k, 0, 0], mean[k, 0, 1] = px, vx
            mean[k, 1, 0], mean[k, 1, 1] = py, vy
            cov[k, 0, 0], cov[k, 0, 1] = pp, pv
            cov[k, 1, 0], cov[k, 1, 1] = pv, vv


@compiled(
    *(FLOATS1, FLOATS2, FLOATS1, INTS1, FLOAT, FLOATS3, FLOATS3, FLOAT, INT),
    *(OUT_FLOATS2, OUT_FLOATS3, OUT_FLOATS3),
)
def cv_both(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
    patience: int,
    scratch: Floats,
    mean: Floats,
    cov: Floats,
) -> None:
    """Filter and smooth track by track; what the filter found stays in the processor's cache.

    The filter waits for each division before it can go on: gain and open covariance of the
    smoother, worked out meanwhile, cost next to nothing.
    """
    for i in range(offsets.size - 1):
        px, vx = initial_mean[i, 0, 0], initial_mean[i, 0, 1]
        py, vy = initial_mean[i, 1, 0], initial_mean[i, 1, 1]
        a, b, c = initial_cov[i, 0, 0], initial_cov[i, 0, 1], initial_cov[i, 1, 1]
        det = a * c - b * b
        misses = 0
        first, end = offsets[i], offsets[i + 1]
        before = t[first]
        for k in range(first, end):
            dt = t[k] - before
            before = t[k]
            row = scratch[k - first]
            row[0], row[1], row[2], row[3], row[4], row[5], row[6] = _cv_back(dt, q, a, b, c, det)
            px, vx, py, vy, a, b, c, det, _, _, _, _, take = _cv_step(
                *(dt, q, xy[k, 0], xy[k, 1], variance[k], gate, misses >= patience),
                *(px, vx, py, vy, a, b, c, det),
            )
            misses = 0 if take else misses + 1
            mean[k, 0, 0], mean[k, 0, 1] = px, vx
            mean[k, 1, 0], mean[k, 1, 1] = py, vy
        for step in range(end - first):
            k = end - 1 - step
            if step > 0:
                row = scratch[k + 1 - first]
                dt = t[k + 1] - t[k]
                g00, g01, g10, g11 = row[0], row[1], row[2], row[3]
                fx, fvx = mean[k, 0, 0], mean[k, 0, 1]
                fy, fvy = mean[k, 1, 0], mean[k, 1, 1]
                ex, evx = px - (fx + dt * fvx), vx - fvx
                ey, evy = py - (fy + dt * fvy), vy - fvy
                px, vx = fx + g00 * ex + g01 * evx, fvx + g10 * ex + g11 * evx
                py, vy = fy + g00 * ey + g01 * evy, fvy + g10 * ey + g11 * evy
                h00, h01 = g00 * a + g01 * b, g00 * b + g01 * c
                h10, h11 = g10 * a + g11 * b, g10 * b + g11 * c
                a = row[4] + h00 * g00 + h01 * g01
                b = row[5] + h00 * g10 + h01 * g11
                c = row[6] + h10 * g10 + h11 * g11
            mean[k, 0, 0], mean[k, 0, 1] = px, vx
            mean[k, 1, 0], mean[k, 1, 1] = py, vy
            cov[k, 0, 0], cov[k, 0, 1] = a, b
            cov[k, 1, 0], cov[k, 1, 1] = b, c


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


@compiled(*_FILTER)
def ca_filter(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
    patience: int,
    every: bool,
    mean: Floats,
    cov: Floats,
    nis: Floats,
    accepted: Bools,
    log_likelihood: Floats,
    sums: Floats,
) -> None:
    """Filter, as `cv_filter`, on the factors L D L' of the covariance.

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
        count = squares = spread = 0.0
        misses = 0
        first = offsets[i]
        for k in range(first, offsets[i + 1]):
            if k > first:
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
            take = d2 <= gate or misses >= patience
            if take:
                misses = 0
                for axis in range(2):
                    moved = a / s * error[axis]
                    state[axis, 0] += moved
                    state[axis, 1] += lower[1, 0] * moved
                    state[axis, 2] += lower[2, 0] * moved
                weight[0] = a * (r / s)
                if k > first:
                    count += 2
                    squares += square
                    spread += 2 * a
                total += d2 / 2 + _LOG_2PI
                scale *= s
                if scale > _BIG or scale < 1 / _BIG:
                    total += log(scale)
                    scale = 1.0
            else:
                misses += 1

            row = k if every else i
            for axis in range(2):
                for m in range(3):
                    mean[row, axis, m] = state[axis, m]
            for m in range(3):
                for n in range(m + 1):
                    entry = 0.0
                    for j in range(n + 1):
                        entry += lower[m, j] * weight[j] * lower[n, j]
                    cov[row, m, n] = cov[row, n, m] = entry
            nis[row] = d2
            accepted[row] = take
        log_likelihood[i] = -total - log(scale)
        sums[i, 0], sums[i, 1], sums[i, 2] = count, squares, spread


@compiled(*_SMOOTHER)
def ca_smoother(
    t: Floats,
    offsets: Ints,
    q: float,
    filtered_mean: Floats,
    filtered_cov: Floats,
    mean: Floats,
    cov: Floats,
) -> None:
    """Rauch-Tung-Striebel in Joseph's form: the smoothed covariance is a sum of squares.

    With [F L, Lq] = M V (see `_orthogonal`) the gain is L E M^-1, E = D V1' D'^-1, and what the
    next state leaves open is L [(I - E V1) D (I - E V1)' + E V2 Dq V2' E'] L'.
    """
    weight = np.empty(9)
    before = np.empty((3, 3))  # L
    lower = np.empty((3, 3))  # M
    rows = np.empty((3, 6))  # V
    inner = np.empty((3, 3))  # E
    gain = np.empty((3, 3))
    open_ = np.empty((3, 6))  # L [I - E V1, -E V2]
    product = np.empty((3, 3))
    gap = np.empty((2, 3))
    for i in range(offsets.size - 1):
        last = offsets[i + 1] - 1
        for m in range(3):
            for axis in range(2):
                mean[last, axis, m] = filtered_mean[last, axis, m]
            for n in range(3):
                cov[last, m, n] = filtered_cov[last, m, n]
        for step in range(1, offsets[i + 1] - offsets[i]):
            k = last - step
            dt = t[k + 1] - t[k]
            _factorise(filtered_cov[k], weight, before)
            for m in range(3):
                for n in range(3):
                    lower[m, n] = before[m, n]
            _orthogonal(dt, q, weight, rows, lower)
            for m in range(3):
                for n in range(3):
                    inner[m, n] = weight[m] * rows[n, m] / weight[6 + n]
            # gain = L E M^-1, solved from the last column: M is unit lower triangular
            for m in range(3):
                for n in range(3):
                    entry = 0.0
                    for j in range(m + 1):
                        entry += before[m, j] * inner[j, n]
                    product[m, n] = entry
                gain[m, 2] = product[m, 2]
                gain[m, 1] = product[m, 1] - gain[m, 2] * lower[2, 1]
                gain[m, 0] = product[m, 0] - gain[m, 1] * lower[1, 0] - gain[m, 2] * lower[2, 0]
            for m in range(3):
                for n in range(6):
                    entry = before[m, n] if n < 3 else 0.0  # noqa: PLR2004 - three states
                    for j in range(3):
                        entry -= product[m, j] * rows[j, n]
                    open_[m, n] = entry

            for axis in range(2):
                v, acc = filtered_mean[k, axis, 1], filtered_mean[k, axis, 2]
                moved = filtered_mean[k, axis, 0] + dt * (v + dt / 2 * acc)
                gap[axis, 0] = mean[k + 1, axis, 0] - moved
                gap[axis, 1] = mean[k + 1, axis, 1] - (v + dt * acc)
                gap[axis, 2] = mean[k + 1, axis, 2] - acc
                for m in range(3):
                    entry = filtered_mean[k, axis, m]
                    for j in range(3):
                        entry += gain[m, j] * gap[axis, j]
                    mean[k, axis, m] = entry
            for m in range(3):
                for n in range(3):
                    entry = 0.0
                    for j in range(3):
                        entry += gain[m, j] * cov[k + 1, j, n]
                    product[m, n] = entry
            for m in range(3):
                for n in range(m + 1):
                    entry = 0.0
                    for j in range(6):
                        entry += open_[m, j] * weight[j] * open_[n, j]
                    for j in range(3):
                        entry += product[m, j] * gain[n, j]
                    cov[k, m, n] = cov[k, n, m] = entry
