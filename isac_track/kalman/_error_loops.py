"""Compiled loops for a constant-velocity walk behind a slowly changing error.

Per axis the state is (p, v, u): position, velocity, and an Ornstein-Uhlenbeck process
of variance 1. The measurement is p + s u plus white noise, with an amplitude s for
every sample: the error is e = s u. The velocity may be such a process, too. A `motion`
has three numbers: the variance of the velocity at the start, its correlation time (the
velocity wanders if it is infinite) and the spectral density of the acceleration. Filter
and smoother invert no covariance: with a constant error, or none, it is singular.
"""

from math import exp, expm1, inf, log, pi
from typing import TypeAlias

import numpy as np

from isac_track.compiling import (
    FLOAT,
    INT,
    compiled,
    part_of_loop,
    read,
    together,
    written,
)
from isac_track.types import Floats, Ints

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats, Floats]
"""Times, positions, variances, offsets, prior variances of p and v, and amplitudes."""
_Symmetric: TypeAlias = tuple[float, float, float, float, float, float]
"""Symmetric matrix: pp, pv, vv, pu, vu, uu."""
_Step: TypeAlias = tuple[float, float, float, float, float, float]
"""The displacement per velocity, what remains of velocity and error, and the increments
of pp, pv and vv by the acceleration.
"""
_BATCH = together(read(1), read(2), read(1), read(1, "int64"), read(1), read(1))
_LOG_2PI = log(2 * pi)
_BIG = 1e100
_SMALL = 0.03  # Step over correlation time; below it a series is more exact.
_ROW = 23
"""Length of a sample's row.

Its fields are state, covariance, gain, innovation, its variance, a variance for the
next pass, and the `_Step`.
"""
_STEP = 17  # Where the `_Step` begins.


@compiled(read(1), written(2))
def recursion(decay: Floats, step: Floats) -> None:
    """Add to each step the decayed step before it."""
    for k in range(1, len(step)):
        for axis in range(step.shape[1]):
            step[k, axis] += decay[k] * step[k - 1, axis]


@part_of_loop
def _memory(dt: float, tau_s: float) -> float:
    """Correlation of the error over dt: 0 if white (0 s), 1 if constant (infinite)."""
    return exp(-dt / tau_s) if tau_s > 0.0 else 0.0


@part_of_loop
def _integrate(dt: float, tau_s: float, memory_s: float, q: float) -> _Step:
    """Integrate an Ornstein-Uhlenbeck velocity of time `memory_s` over dt, exactly."""
    f = _memory(dt, tau_s)
    grown = q * dt
    x = dt / memory_s
    if x == 0.0:
        return dt, 1.0, f, grown * dt * dt / 3, grown * dt / 2, grown
    left = -expm1(-x)
    fades = (
        x * x * x * (1 / 3 - x * (1 / 4 - x * (7 / 60 - x * (1 / 24 - x * 31 / 2520))))
    )
    double_decay = left * (2.0 - left)  # 1 - exp(-2 x)
    if x > _SMALL:
        fades = x - 2 * left + double_decay / 2
    half = q * memory_s / 2
    return (
        memory_s * left,
        1.0 - left,
        f,
        2 * half * memory_s * memory_s * fades,
        half * memory_s * left * left,
        half * double_decay,
    )


@compiled(read(1), read(1, "int64"), read(1), written(2))
def fill_steps(t: Floats, offsets: Ints, motion: Floats, out: Floats) -> None:
    """Fill the step to each sample under a motion, (M, 5): `_Step` without an error.

    They are the displacement per velocity, what remains of the velocity, and the
    increments of pp, pv and vv; those of a track's first sample are of no time.
    """
    for i in range(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            dt = t[k] - t[k - 1] if k > offsets[i] else 0.0
            step = _integrate(dt, 0.0, motion[1], motion[2])
            out[k, 0], out[k, 1] = step[0], step[1]
            out[k, 2], out[k, 3], out[k, 4] = step[3], step[4], step[5]


@part_of_loop
def _predict(cov: _Symmetric, step: _Step) -> _Symmetric:
    """Return the covariance after a step: F P F' + Q."""
    pp, pv, vv, pu, vu, uu = cov
    a, g, f, qpp, qpv, qvv = step
    return (
        pp + a * (2 * pv + a * vv) + qpp,
        g * (pv + a * vv) + qpv,
        g * g * vv + qvv,
        f * (pu + a * vu),
        f * g * vu,
        f * f * uu + (1.0 - f) * (1.0 + f),
    )


@part_of_loop
def _update(cov: _Symmetric, s: float, r: float, inverse: float) -> _Symmetric:
    """Return P - P H' H P / S, multiplied out: a vague prior cancels exactly."""
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
    batch: _Batch,
    tau_s: float,
    q: float,
    gate: float,
    patience: int,
    out: tuple[Floats, ...],
) -> None:
    """Filter to the last state (p, v, error) of every track, and write positions.

    `causal`, (M, 2), gets the position after each sample.
    """
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
                step = _integrate(dt, tau_s, inf, q)
                cov = _predict(cov, step)
                px, py, ux, uy = px + dt * vx, py + dt * vy, step[2] * ux, step[2] * uy
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
                cov = _update(cov, s, r, inverse)
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
        covariance[i, 0, 0], covariance[i, 1, 1] = pp, vv
        covariance[i, 2, 2] = s * s * uu
        covariance[i, 0, 1] = covariance[i, 1, 0] = pv
        covariance[i, 0, 2] = covariance[i, 2, 0] = s * pu
        covariance[i, 1, 2] = covariance[i, 2, 1] = s * vu
        log_likelihood[i] = -total - log(scale)


@compiled(_BATCH, FLOAT, read(2), written(2))
def log_likelihoods(batch: _Batch, tau_s: float, motions: Floats, out: Floats) -> None:
    """Fill `out`, (N, K), with log densities of tracks under K motions, (K, 3)."""
    t, xy, variance, offsets, prior, amplitude = batch
    for i in range(offsets.size - 1):
        for motion in range(len(motions)):
            first = offsets[i]
            start_m2, memory_s, q = motions[motion]
            px, py = xy[first, 0], xy[first, 1]
            vx = vy = ux = uy = 0.0
            cov = (prior[0], 0.0, start_m2, 0.0, 0.0, 1.0)
            scale, total = 1.0, 0.0
            for k in range(first, offsets[i + 1]):
                if k > first:
                    step = _integrate(t[k] - t[k - 1], tau_s, memory_s, q)
                    a, g, f = step[0], step[1], step[2]
                    cov = _predict(cov, step)
                    px, py = px + a * vx, py + a * vy
                    vx, vy, ux, uy = g * vx, g * vy, f * ux, f * uy
                s, r = amplitude[k], variance[k]
                pp, pv, _, pu, vu, uu = cov
                hp, hv, hu = pp + s * pu, pv + s * vu, pu + s * uu
                spread = hp + s * hu + r
                inverse = 1 / spread
                ex, ey = xy[k, 0] - px - s * ux, xy[k, 1] - py - s * uy
                total += (ex * ex + ey * ey) * inverse / 2 + _LOG_2PI
                ex, ey = ex * inverse, ey * inverse
                px, vx, ux = px + hp * ex, vx + hv * ex, ux + hu * ex
                py, vy, uy = py + hp * ey, vy + hv * ey, uy + hu * ey
                cov = _update(cov, s, r, inverse)
                scale *= spread
                if scale > _BIG or scale < 1 / _BIG:
                    total += log(scale)
                    scale = 1.0
            out[i, motion] = -total - log(scale)


@part_of_loop
def _forward(
    xy: Floats,
    amplitude: Floats,
    variance: Floats,
    start_m2: tuple[float, float],
    rows: Floats,
) -> None:
    """Filter a track; `rows` hold the steps already."""
    px, py = xy[0, 0], xy[0, 1]
    vx = vy = ux = uy = 0.0
    cov = (start_m2[0], 0.0, start_m2[1], 0.0, 0.0, 1.0)
    for k in range(len(xy)):
        row = rows[k]
        if k > 0:
            a, g, f = row[_STEP], row[_STEP + 1], row[_STEP + 2]
            cov = _predict(
                cov, (a, g, f, row[_STEP + 3], row[_STEP + 4], row[_STEP + 5])
            )
            px, py = px + a * vx, py + a * vy
            vx, vy, ux, uy = g * vx, g * vy, f * ux, f * uy
        s, r = amplitude[k], variance[k]
        pp, pv, _, pu, vu, uu = cov
        hp, hv, hu = pp + s * pu, pv + s * vu, pu + s * uu
        inverse = 1 / (hp + s * hu + r)
        gp, gv, gu = hp * inverse, hv * inverse, hu * inverse
        ex, ey = xy[k, 0] - px - s * ux, xy[k, 1] - py - s * uy
        px, py = px + gp * ex, py + gp * ey
        vx, vy = vx + gv * ex, vy + gv * ey
        ux, uy = ux + gu * ex, uy + gu * ey
        cov = _update(cov, s, r, inverse)
        row[0], row[1], row[2], row[3] = px, py, ux, uy
        row[4], row[5], row[6], row[7], row[8], row[9] = cov
        row[10], row[11], row[12] = gp, gv, gu
        row[13], row[14], row[15] = ex * inverse, ey * inverse, inverse


@part_of_loop
def _backward(amplitude: Floats, rows: Floats) -> None:
    """Smooth a track: each row's p, u and pp become smoothed.

    Modified Bryson-Frazier: the adjoint l and its variance m = (pp, pv, vv, pu, vu, uu)
    run backwards, x + = -P l and P + = -P m P. Row field 16 becomes the variance of p +
    s u.
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
        row[4] = pp - _quadratic_form(pp, pv, pu, m)
        row[16] = hp + s * hu - _quadratic_form(hp, hv, hu, m)

        gp, gv, gu = row[10], row[11], row[12]
        nx = gp * lxp + gv * lxv + gu * lxu + row[13]
        ny = gp * lyp + gv * lyv + gu * lyu + row[14]
        bp = mpp * gp + mpv * gv + mpu * gu
        bv = mpv * gp + mvv * gv + mvu * gu
        bu = mpu * gp + mvu * gv + muu * gu
        total = gp * bp + gv * bv + gu * bu + row[15]
        lxp, lxu, lyp, lyu = lxp - nx, lxu - s * nx, lyp - ny, lyu - s * ny
        mpp, mpv = mpp - 2 * bp + total, mpv - bv
        mpu, mvu = mpu - bu - s * bp + s * total, mvu - s * bv
        muu += s * (s * total - 2 * bu)

        a, g, f = row[_STEP], row[_STEP + 1], row[_STEP + 2]
        lxv, lyv = g * lxv + a * lxp, g * lyv + a * lyp
        lxu, lyu = f * lxu, f * lyu
        mvv = g * g * mvv + a * (2 * g * mpv + a * mpp)
        mvu = f * (g * mvu + a * mpu)
        mpv = g * mpv + a * mpp
        mpu *= f
        muu *= f * f


@part_of_loop
def _quadratic_form(a: float, b: float, c: float, m: _Symmetric) -> float:
    """Return (a, b, c) m (a, b, c)'."""
    mpp, mpv, mvv, mpu, mvu, muu = m
    ahead: float = a * (a * mpp + 2 * (b * mpv + c * mpu)) + b * (b * mvv + 2 * c * mvu)
    return ahead + c * c * muu


@part_of_loop
def _reweigh(
    xy: Floats,
    amplitude: Floats,
    variance: Floats,
    blur: float,
    rows: Floats,
    noise: Floats,
) -> None:
    """Weigh the samples of a track anew by the rows that the last pass left."""
    for k in range(len(xy)):
        row, s, square = rows[k], amplitude[k], 2.0 * variance[k]
        rx = xy[k, 0] - row[0] - s * row[2]
        ry = xy[k, 1] - row[1] - s * row[3]
        near = rx * rx + ry * ry + 2 * row[16] + blur * square
        noise[k] = near * (square / (near + square))


@part_of_loop
def _add_to_mixture(
    rows: Floats, weight: float, weight_before: float, position: Floats, spread: Floats
) -> None:
    """Add a smoothed track with a `weight` to the mixture of the tracks before.

    `position` and `spread` hold the mean and its variance, `weight_before` the weight.
    """
    share = weight / (weight_before + weight)
    for k in range(len(rows)):
        x, y = rows[k, 0] - position[k, 0], rows[k, 1] - position[k, 1]
        apart = weight_before * share * (x * x + y * y) / 2
        spread[k] = (weight_before * spread[k] + weight * rows[k, 4] + apart) / (
            weight_before + weight
        )
        position[k, 0] += share * x
        position[k, 1] += share * y


@compiled(
    _BATCH,
    FLOAT,
    together(read(1, "int64"), read(2), read(1)),
    INT,
    FLOAT,
    together(written(2), written(1), written(1)),
)
def smooth_tracks(
    batch: _Batch,
    tau_s: float,
    runs: tuple[Ints, Floats, Floats],
    passes: int,
    anneal: float,
    out: tuple[Floats, Floats, Floats],
) -> None:
    """Smooth tracks in `passes` passes, with weights as in `smooth_positions`.

    Each of the R `runs` has a track, a motion, (R, 3), and a weight. Positions and
    variances are those of the mixture of a track's runs. `out` begins as zeros; its
    last array gets the sums of weights.
    """
    t, xy, variance, offsets, prior, amplitude = batch
    position, spread, total_weight = out
    longest = 0
    for i in range(offsets.size - 1):
        longest = max(longest, offsets[i + 1] - offsets[i])
    buffer, weighed = np.empty((longest, _ROW)), np.empty(longest)
    track, motion, weight = runs
    for run in range(track.size):
        i = track[run]
        first, end = offsets[i], offsets[i + 1]
        n = end - first
        rows, noise = buffer[:n], weighed[:n]
        own_amplitude, places = amplitude[first:end], xy[first:end]
        start_m2, memory_s, q = motion[run]
        for k in range(n):
            dt = t[first + k] - t[first + k - 1] if k > 0 else 0.0
            step = _integrate(dt, tau_s, memory_s, q)
            for field in range(6):
                rows[k, _STEP + field] = step[field]
            noise[k] = variance[first + k]
        blur = 1.0
        for turn in range(passes):
            if turn > 0:
                _reweigh(places, own_amplitude, variance[first:end], blur, rows, noise)
                blur *= anneal
            _forward(places, own_amplitude, noise, (prior[0], start_m2), rows)
            _backward(own_amplitude, rows)
        _add_to_mixture(
            rows, weight[run], total_weight[i], position[first:end], spread[first:end]
        )
        total_weight[i] += weight[run]


LANES = 8
"""Runs side by side: `_linear_loops` says why, and what lies beyond a run's end."""
_FAR = 2.0**600
_NOTHING = 2.0**200

# Starts of the fields of a row: sample, sigma^2, state and covariance, the values that
# the backward run reads, and the `_Step` without the error's part.
_X, _Y, _SQUARE, _PX, _VX, _PY, _VY, _A, _B, _C, *_OTHER = range(0, 20 * LANES, LANES)
_GP, _GV, _EX, _EY, _INVERSE, _MOVE, _LEFT, _QPP, _QPV, _QVV = _OTHER
_LANE_ROW = 20 * LANES


@part_of_loop
def _lanes_forward(buffer: Floats, n: int, blur: float) -> None:
    """Filter as `_forward` without an error; row 0 is the prior.

    A sample is weighed on the way.
    """
    for k in range(n):
        rows = buffer[k * _LANE_ROW : (k + 2) * _LANE_ROW]
        for lane in range(LANES):
            after = lane + _LANE_ROW
            move, left = rows[after + _MOVE], rows[after + _LEFT]
            vx, vy = rows[lane + _VX], rows[lane + _VY]
            px, py = rows[lane + _PX] + move * vx, rows[lane + _PY] + move * vy
            vx, vy = left * vx, left * vy
            a, b, c = rows[lane + _A], rows[lane + _B], rows[lane + _C]
            a += move * (2 * b + move * c) + rows[after + _QPP]
            b = left * (b + move * c) + rows[after + _QPV]
            c = left * left * c + rows[after + _QVV]
            x, y, square = rows[after + _X], rows[after + _Y], rows[after + _SQUARE]
            rx, ry = x - rows[after + _PX], y - rows[after + _PY]
            far = _FAR if square == _NOTHING else 0.0
            near = rx * rx + ry * ry + 2 * rows[after + _A] + blur * square + far
            r = near * (square / (near + square))
            inverse = 1 / (a + r)
            ex, ey = x - px, y - py
            gain_p, gain_v = a * inverse, b * inverse
            rows[after + _PX], rows[after + _VX] = px + gain_p * ex, vx + gain_v * ex
            rows[after + _PY], rows[after + _VY] = py + gain_p * ey, vy + gain_v * ey
            rows[after + _A], rows[after + _B] = gain_p * r, gain_v * r
            rows[after + _C] = (c * r + (a * c - b * b)) * inverse
            rows[after + _GP], rows[after + _GV], rows[after + _INVERSE] = (
                gain_p,
                gain_v,
                inverse,
            )
            rows[after + _EX], rows[after + _EY] = ex * inverse, ey * inverse


@part_of_loop
def _lanes_backward(buffer: Floats, n: int, adjoint: Floats) -> None:
    """Smooth as `_backward` without an error: only positions and their variances."""
    adjoint[:] = 0.0
    for step in range(n):
        rows = buffer[(n - step) * _LANE_ROW : (n - step + 1) * _LANE_ROW]
        for lane in range(LANES):
            lxp, lxv = adjoint[lane], adjoint[lane + LANES]
            lyp, lyv = adjoint[lane + 2 * LANES], adjoint[lane + 3 * LANES]
            mpp, mpv = adjoint[lane + 4 * LANES], adjoint[lane + 5 * LANES]
            mvv = adjoint[lane + 6 * LANES]
            pp, pv = rows[lane + _A], rows[lane + _B]
            rows[lane + _PX] -= pp * lxp + pv * lxv
            rows[lane + _PY] -= pp * lyp + pv * lyv
            rows[lane + _A] = pp - (pp * (pp * mpp + 2 * (pv * mpv)) + pv * pv * mvv)

            gp, gv, inverse = rows[lane + _GP], rows[lane + _GV], rows[lane + _INVERSE]
            bp, bv = mpp * gp + mpv * gv, mpv * gp + mvv * gv
            lxp -= gp * lxp + gv * lxv + rows[lane + _EX]
            lyp -= gp * lyp + gv * lyv + rows[lane + _EY]
            mpp += gp * bp + gv * bv + inverse - 2 * bp
            mpv -= bv

            move, left = rows[lane + _MOVE], rows[lane + _LEFT]
            adjoint[lane], adjoint[lane + LANES] = lxp, left * lxv + move * lxp
            adjoint[lane + 2 * LANES] = lyp
            adjoint[lane + 3 * LANES] = left * lyv + move * lyp
            adjoint[lane + 4 * LANES] = mpp
            adjoint[lane + 5 * LANES] = left * mpv + move * mpp
            adjoint[lane + 6 * LANES] = left * left * mvv + move * (
                2 * left * mpv + move * mpp
            )


@part_of_loop
def _fill_rows(
    batch: _Batch, track: Ints, motion: Floats, group: int, buffer: Floats
) -> None:
    """Fill the rows of a group of runs; the shortest fills empty lanes."""
    t, xy, variance, offsets, prior, _ = batch
    n = offsets[track[group + LANES - 1] + 1] - offsets[track[group + LANES - 1]]
    for lane in range(LANES):
        run = max(group + lane, 0)
        first, end = offsets[track[run]], offsets[track[run] + 1]
        start_m2, memory_s, q = motion[run]
        buffer[lane + _PX], buffer[lane + _PY] = xy[first, 0], xy[first, 1]
        buffer[lane + _VX] = buffer[lane + _VY] = buffer[lane + _B] = 0.0
        buffer[lane + _A], buffer[lane + _C] = prior[0], start_m2
        for k in range(n):
            sample = min(first + k, end - 1)
            dt = t[sample] - t[sample - 1] if 0 < k < end - first else 0.0
            move, left, _, qpp, qpv, qvv = _integrate(dt, 0.0, memory_s, q)
            row = buffer[(k + 1) * _LANE_ROW : (k + 2) * _LANE_ROW]
            row[lane + _X], row[lane + _Y] = xy[sample, 0], xy[sample, 1]
            row[lane + _PX], row[lane + _PY], row[lane + _A] = (
                xy[sample, 0],
                xy[sample, 1],
                0.0,
            )
            row[lane + _SQUARE] = (
                2.0 * variance[sample] if k < end - first else _NOTHING
            )
            row[lane + _MOVE], row[lane + _LEFT] = move, left
            row[lane + _QPP], row[lane + _QPV], row[lane + _QVV] = qpp, qpv, qvv


@compiled(
    _BATCH,
    together(read(1, "int64"), read(2), read(1)),
    INT,
    FLOAT,
    together(written(2), written(1), written(1)),
)
def smooth_lanes(
    batch: _Batch,
    runs: tuple[Ints, Floats, Floats],
    passes: int,
    anneal: float,
    out: tuple[Floats, Floats, Floats],
) -> None:
    """Smooth as `smooth_tracks` without a slow error; the longest runs come last."""
    (track, motion, weight), offsets = runs, batch[3]
    position, spread, total_weight = out
    longest = offsets[track[-1] + 1] - offsets[track[-1]] if track.size > 0 else 0
    buffer, adjoint = np.zeros((longest + 1) * _LANE_ROW), np.empty(7 * LANES)
    # The first group may be incomplete.
    for group in range(-(-track.size % LANES), track.size, LANES):
        _fill_rows(batch, track, motion, group, buffer)
        last = track[group + LANES - 1]
        n, blur = offsets[last + 1] - offsets[last], 1.0
        for turn in range(passes):
            _lanes_forward(buffer, n, blur)
            _lanes_backward(buffer, n, adjoint)
            if turn > 0:
                blur *= anneal
        for lane in range(max(-group, 0), LANES):
            i = track[group + lane]
            weight_before, run_weight = total_weight[i], weight[group + lane]
            share = run_weight / (weight_before + run_weight)
            for k in range(offsets[i + 1] - offsets[i]):
                sample, row = offsets[i] + k, (k + 1) * _LANE_ROW + lane
                x = buffer[row + _PX] - position[sample, 0]
                y = buffer[row + _PY] - position[sample, 1]
                apart = weight_before * share * (x * x + y * y) / 2
                total = (
                    weight_before * spread[sample]
                    + run_weight * buffer[row + _A]
                    + apart
                )
                spread[sample] = total / (weight_before + run_weight)
                position[sample, 0] += share * x
                position[sample, 1] += share * y
            total_weight[i] += run_weight
