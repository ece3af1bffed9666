"""Compiled loops for a walk of constant velocity that is seen through a slowly changing error.

Per axis the state is (p, v, u): position, velocity, and an Ornstein-Uhlenbeck process of variance
1; what is measured is p + s u plus white noise, with an amplitude s for every sample. The error
itself is e = s u. Neither the filter nor the smoother inverts a covariance: with a constant error,
or none, it is singular.
"""

from math import exp, log, pi
from typing import TypeAlias

import numpy as np

from isac_track.compiling import FLOAT, INT, compiled, part_of_loop, read, together, written
from isac_track.types import Floats, Ints

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats, Floats]
"""Times, places, variances, offsets, variances of the prior of p and v, and amplitudes."""
_Six: TypeAlias = tuple[float, float, float, float, float, float]
"""Symmetric matrix: pp, pv, vv, pu, vu, uu."""
_BATCH = together(read(1), read(2), read(1), read(1, "int64"), read(1), read(1))
_LOG_2PI = log(2 * pi)
_BIG = 1e100
_ROW = 20
"""A sample as the filter leaves it: state, covariance, gain, innovation, its variance, f, dt."""


@compiled(read(1), written(2))
def recursion(decay: Floats, step: Floats) -> None:
    """Add to each step what is left of the one before it."""
    for k in range(1, len(step)):
        for axis in range(step.shape[1]):
            step[k, axis] += decay[k] * step[k - 1, axis]


@part_of_loop
def _memory(dt: float, tau_s: float) -> float:
    """Correlation of the error over dt; of none (0 s) it is 0, of a constant one (inf) 1."""
    return exp(-dt / tau_s) if tau_s > 0.0 else 0.0


@part_of_loop
def _predicted(cov: _Six, dt: float, f: float, q: float) -> _Six:
    pp, pv, vv, pu, vu, uu = cov
    grown = q * dt
    return (
        pp + dt * (2 * pv + dt * (vv + grown / 3)),
        pv + dt * (vv + grown / 2),
        vv + grown,
        f * (pu + dt * vu),
        f * vu,
        f * f * uu + (1.0 - f) * (1.0 + f),
    )


@part_of_loop
def _measured(cov: _Six, s: float, r: float, inverse: float) -> _Six:
    """P - P H' H P / S, multiplied out: the vague prior cancels before anything is rounded."""
    pp, pv, vv, pu, vu, uu = cov
    minor = pp * uu - pu * pu
    across, beside = pu * pv - pp * vu, uu * pv - pu * vu
    rest = pp * vv - pv * pv + s * (2 * (pu * vv - pv * vu) + s * (uu * vv - vu * vu))
    return (
        (r * pp + s * s * minor) * inverse,
        (r * pv + s * (across + s * beside)) * inverse,
        (r * vv + rest) * inverse,
        (r * pu - s * minor) * inverse,
        (r * vu - across - s * beside) * inverse,
        (r * uu + minor) * inverse,
    )


@compiled(_BATCH, FLOAT, FLOAT, FLOAT, INT, together(*map(written, (3, 3, 1, 2))))
def filter_tracks(
    batch: _Batch, tau_s: float, q: float, gate: float, patience: int, out: tuple[Floats, ...]
) -> None:
    """Filter to the last state (p, v, error) of every track; `causal` are positions by the way."""
    t, xy, variance, offsets, prior, amplitude = batch
    mean, covariance, log_likelihood, causal = out
    for i in range(offsets.size - 1):
        first = offsets[i]
        px, py = xy[first, 0], xy[first, 1]
        vx = vy = ux = uy = 0.0
        cov = (prior[0], 0.0, prior[1], 0.0, 0.0, 1.0)
        scale, total, misses = 1.0, 0.0, 0
        for k in range(first, offsets[i + 1]):
            if k > first:
                dt = t[k] - t[k - 1]
                f = _memory(dt, tau_s)
                cov = _predicted(cov, dt, f, q)
                px, py, ux, uy = px + dt * vx, py + dt * vy, f * ux, f * uy
            s, r = amplitude[k], variance[k]
            pp, pv, _, pu, vu, uu = cov
            hp, hv, hu = pp + s * pu, pv + s * vu, pu + s * uu
            spread = hp + s * hu + r
            inverse = 1 / spread
            ex, ey = xy[k, 0] - px - s * ux, xy[k, 1] - py - s * uy
            square = (ex * ex + ey * ey) * inverse
            if misses < patience and not square <= gate:
                misses += 1
            else:
                misses = 0
                px, py = px + hp * inverse * ex, py + hp * inverse * ey
                vx, vy = vx + hv * inverse * ex, vy + hv * inverse * ey
                ux, uy = ux + hu * inverse * ex, uy + hu * inverse * ey
                cov = _measured(cov, s, r, inverse)
                total += square / 2 + _LOG_2PI
                scale *= spread
                if scale > _BIG or scale < 1 / _BIG:
                    total += log(scale)
                    scale = 1.0
            causal[k, 0], causal[k, 1] = px, py
        s = amplitude[offsets[i + 1] - 1]
        pp, pv, vv, pu, vu, uu = cov
        mean[i, 0, 0], mean[i, 0, 1], mean[i, 0, 2] = px, vx, s * ux
        mean[i, 1, 0], mean[i, 1, 1], mean[i, 1, 2] = py, vy, s * uy
        covariance[i, 0, 0], covariance[i, 1, 1], covariance[i, 2, 2] = pp, vv, s * s * uu
        covariance[i, 0, 1] = covariance[i, 1, 0] = pv
        covariance[i, 0, 2] = covariance[i, 2, 0] = s * pu
        covariance[i, 1, 2] = covariance[i, 2, 1] = s * vu
        log_likelihood[i] = -total - log(scale)


@part_of_loop
def _forward(
    xy: Floats, amplitude: Floats, variance: Floats, prior: Floats, q: float, rows: Floats
) -> None:
    """Filter one track; `rows` hold the steps already."""
    px, py = xy[0, 0], xy[0, 1]
    vx = vy = ux = uy = 0.0
    cov = (prior[0], 0.0, prior[1], 0.0, 0.0, 1.0)
    for k in range(len(xy)):
        row = rows[k]
        if k > 0:
            dt, f = row[19], row[18]
            cov = _predicted(cov, dt, f, q)
            px, py, ux, uy = px + dt * vx, py + dt * vy, f * ux, f * uy
        s, r = amplitude[k], variance[k]
        pp, pv, _, pu, vu, uu = cov
        hp, hv, hu = pp + s * pu, pv + s * vu, pu + s * uu
        inverse = 1 / (hp + s * hu + r)
        gp, gv, gu = hp * inverse, hv * inverse, hu * inverse
        ex, ey = xy[k, 0] - px - s * ux, xy[k, 1] - py - s * uy
        px, py = px + gp * ex, py + gp * ey
        vx, vy = vx + gv * ex, vy + gv * ey
        ux, uy = ux + gu * ex, uy + gu * ey
        cov = _measured(cov, s, r, inverse)
        row[0], row[1], row[2], row[3] = px, py, ux, uy
        row[4], row[5], row[6], row[7], row[8], row[9] = cov
        row[10], row[11], row[12] = gp, gv, gu
        row[13], row[14], row[15] = ex * inverse, ey * inverse, inverse


@part_of_loop
def _backward(amplitude: Floats, rows: Floats) -> None:
    """Smooth one track: each row's p and u give way to the smoothed ones, pp to its variance.

    Modified Bryson-Frazier: the adjoint l and its variance m = (pp, pv, vv, pu, vu, uu) run
    backwards, x + = -P l and P + = -P m P. Row field 16 is then the variance of p + s u.
    """
    lxp = lxv = lxu = lyp = lyv = lyu = 0.0
    mpp = mpv = mvv = mpu = mvu = muu = 0.0
    for step in range(len(rows)):
        k = len(rows) - 1 - step
        row, s = rows[k], amplitude[k]
        pp, pv, pu, vu, uu = row[4], row[5], row[7], row[8], row[9]
        row[0] -= pp * lxp + pv * lxv + pu * lxu
        row[1] -= pp * lyp + pv * lyv + pu * lyu
        row[2] -= pu * lxp + vu * lxv + uu * lxu
        row[3] -= pu * lyp + vu * lyv + uu * lyu
        hp, hv, hu = pp + s * pu, pv + s * vu, pu + s * uu
        m = mpp, mpv, mvv, mpu, mvu, muu
        row[4] = pp - _form(pp, pv, pu, m)
        row[16] = hp + s * hu - _form(hp, hv, hu, m)

        gp, gv, gu = row[10], row[11], row[12]
        nx = gp * lxp + gv * lxv + gu * lxu + row[13]
        ny = gp * lyp + gv * lyv + gu * lyu + row[14]
        bp = mpp * gp + mpv * gv + mpu * gu
        bv = mpv * gp + mvv * gv + mvu * gu
        bu = mpu * gp + mvu * gv + muu * gu
        both = gp * bp + gv * bv + gu * bu + row[15]
        lxp, lxu, lyp, lyu = lxp - nx, lxu - s * nx, lyp - ny, lyu - s * ny
        mpp, mpv = mpp - 2 * bp + both, mpv - bv
        mpu, mvu = mpu - bu - s * bp + s * both, mvu - s * bv
        muu += s * (s * both - 2 * bu)

        dt, f = row[19], row[18]
        lxv, lyv = lxv + dt * lxp, lyv + dt * lyp
        lxu, lyu = f * lxu, f * lyu
        mvv += dt * (2 * mpv + dt * mpp)
        mvu = f * (mvu + dt * mpu)
        mpv += dt * mpp
        mpu *= f
        muu *= f * f


@part_of_loop
def _form(a: float, b: float, c: float, m: _Six) -> float:
    """Return (a, b, c) m (a, b, c)'."""
    mpp, mpv, mvv, mpu, mvu, muu = m
    ahead: float = a * (a * mpp + 2 * (b * mpv + c * mpu)) + b * (b * mvv + 2 * c * mvu)
    return ahead + c * c * muu


@compiled(_BATCH, FLOAT, FLOAT, INT, FLOAT, together(written(2), written(1)))
def smooth_tracks(
    batch: _Batch, tau_s: float, q: float, passes: int, anneal: float, out: tuple[Floats, Floats]
) -> None:
    """Smooth every track, `passes` times, as `smooth_positions` re-weighs what is not the error."""
    (t, xy, variance, offsets, prior, amplitude), (position, spread) = batch, out
    longest = 0
    for i in range(offsets.size - 1):
        longest = max(longest, offsets[i + 1] - offsets[i])
    buffer, weighed = np.empty((longest, _ROW)), np.empty(longest)
    for i in range(offsets.size - 1):
        first, end = offsets[i], offsets[i + 1]
        n = end - first
        rows, own, places, noise = buffer[:n], amplitude[first:end], xy[first:end], weighed[:n]
        for k in range(n):
            dt = t[first + k] - t[first + k - 1] if k > 0 else 0.0
            rows[k, 19], rows[k, 18] = dt, _memory(dt, tau_s)
            noise[k] = variance[first + k]
        blur = 1.0
        for turn in range(passes):
            if turn > 0:
                for k in range(n):
                    row, s, square = rows[k], own[k], 2.0 * variance[first + k]
                    rx = places[k, 0] - row[0] - s * row[2]
                    ry = places[k, 1] - row[1] - s * row[3]
                    near = rx * rx + ry * ry + 2 * row[16] + blur * square
                    noise[k] = near * (square / (near + square))
                blur *= anneal
            _forward(places, own, noise, prior, q, rows)
            _backward(own, rows)
        for k in range(n):
            position[first + k, 0], position[first + k, 1] = rows[k, 0], rows[k, 1]
            spread[first + k] = rows[k, 4]
