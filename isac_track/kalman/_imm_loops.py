"""Compiled loops of `isac_track.kalman`: interacting constant-velocity models.

The state is (x, vx, y, vy). Mixing couples the axes, hence the full 4 x 4 covariance
per mode. A mode is either of the two models, 0 or 1; the moods are their parameters.
"""

from math import exp, log, pi, sqrt
from typing import TypeAlias

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

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats, Floats, Floats]
"""Times, positions, mean variances, offsets, prior, principal axes and their shares.

The prior is (variance of a position, variance of a velocity) per axis. Principal axes,
(M, 2, 2) with a column for each, and their variances as shares of the mean, (M, 2), are
those of errors with a shape; both are empty for round errors.
"""
_Moods: TypeAlias = tuple[Floats, Floats, Floats]
"""Spectral densities, probabilities, and transition probabilities, (M, 2, 2).

``[k, m, n]`` is the probability of mode n at sample k after mode m at the sample
before.
"""
_LOG_2PI = log(2 * pi)
_BIG = 1e100
_STATES = 4
# Types of these tuples for the compiler. `_OUT` is mean, covariance and probability of
# either mode for each row, and the log-likelihood of each track.
_BATCH = together(
    read(1), read(2), read(1), read(1, "int64"), read(1), read(3), read(2)
)
_MOODS = together(read(1), read(1), read(3))
_OUT = together(written(3), written(4), written(2), written(1))


_State: TypeAlias = tuple[float, ...]
"""Mean of (x, vx, y, vy) under a mode, and the lower triangle of its covariance.

Row by row, in registers: arrays would be read and written for every sample.
"""


@part_of_loop
def _mix(w: float, v: float, first: _State, second: _State) -> _State:
    """Return the state of a mixture of two Gaussians with the weights `w` and `v`."""
    x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = first
    ox, ovx, oy, ovy, o00, o10, o11, o20, o21, o22, o30, o31, o32, o33 = second
    d0, d1, d2, d3 = x - ox, vx - ovx, y - oy, vy - ovy
    # The means differ by d: with w + v = 1 that adds w v d d' to the covariance.
    product = w * v
    g0, g1, g2, g3 = product * d0, product * d1, product * d2, product * d3
    x, vx, y, vy = w * x + v * ox, w * vx + v * ovx, w * y + v * oy, w * vy + v * ovy
    p00, p10 = w * p00 + v * o00 + g0 * d0, w * p10 + v * o10 + g1 * d0
    p11, p20 = w * p11 + v * o11 + g1 * d1, w * p20 + v * o20 + g2 * d0
    p21, p22 = w * p21 + v * o21 + g2 * d1, w * p22 + v * o22 + g2 * d2
    p30, p31 = w * p30 + v * o30 + g3 * d0, w * p31 + v * o31 + g3 * d1
    p32, p33 = w * p32 + v * o32 + g3 * d2, w * p33 + v * o33 + g3 * d3
    return x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33


@part_of_loop
def _predict(dt: float, q: float, state: _State) -> _State:
    """Return the state of a mode moved by `dt`: F x, F P F' + Q."""
    x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = state
    y_vx = p21 + dt * p31
    p20 += dt * (p30 + y_vx)
    p21, p30 = y_vx, p30 + dt * p31
    x_vx, y_vy = p10 + dt * p11, p32 + dt * p33
    # Entries of Q per axis: position with velocity, and position with itself.
    q_cross, q_position = q * dt * dt / 2, q * dt * dt * dt / 3
    p00 = p00 + dt * (p10 + x_vx) + q_position
    p22 = p22 + dt * (p32 + y_vy) + q_position
    p10, p32, p11, p33 = x_vx + q_cross, y_vy + q_cross, p11 + q * dt, p33 + q * dt
    x, y = x + dt * vx, y + dt * vy
    return x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33


@part_of_loop
def _turn(c: float, s: float, state: _State) -> _State:
    """Return the state of a mode with both axes turned by this cosine and sine."""
    x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = state
    cc, ss, cs = c * c, s * s, c * s
    along, across = c * p10 - s * p21, c * p30 - s * p32
    behind, beside = s * p10 + c * p21, s * p30 + c * p32
    return (
        c * x - s * y,
        c * vx - s * vy,
        s * x + c * y,
        s * vx + c * vy,
        cc * p00 - 2.0 * cs * p20 + ss * p22,
        c * along - s * across,
        cc * p11 - 2.0 * cs * p31 + ss * p33,
        cs * (p00 - p22) + (cc - ss) * p20,
        c * behind - s * beside,
        ss * p00 + 2.0 * cs * p20 + cc * p22,
        s * along + c * across,
        cs * (p11 - p33) + (cc - ss) * p31,
        s * behind + c * beside,
        ss * p11 + 2.0 * cs * p31 + cc * p33,
    )


@part_of_loop
def _turn_both(
    c: float, s: float, first: _State, second: _State
) -> tuple[_State, _State]:
    return _turn(c, s, first), _turn(c, s, second)


@part_of_loop
def _update(zx: float, zy: float, rx: float, ry: float, state: _State) -> _State:
    """Return the state of a mode after a measurement, x first, then y.

    Entries of the measured position are multiplied by r / (p + r), which equals 1 - p /
    (p + r): a difference of nearly equal numbers would lose digits.
    """
    x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = state
    inverse = 1 / (p00 + rx)
    error, k1, k2, k3 = (zx - x), p10 * inverse, p20 * inverse, p30 * inverse
    x, vx = x + p00 * inverse * error, vx + k1 * error
    y, vy = y + k2 * error, vy + k3 * error
    p11, p21, p22 = p11 - k1 * p10, p21 - k2 * p10, p22 - k2 * p20
    p31, p32, p33 = p31 - k3 * p10, p32 - k3 * p20, p33 - k3 * p30
    shrink = rx * inverse
    p00, p10, p20, p30 = p00 * shrink, p10 * shrink, p20 * shrink, p30 * shrink

    inverse = 1 / (p22 + ry)
    error, k0, k1, k3 = (zy - y), p20 * inverse, p21 * inverse, p32 * inverse
    x, vx = x + k0 * error, vx + k1 * error
    y, vy = y + p22 * inverse * error, vy + k3 * error
    p00, p10, p11 = p00 - k0 * p20, p10 - k1 * p20, p11 - k1 * p21
    p30, p31, p33 = p30 - k3 * p20, p31 - k3 * p21, p33 - k3 * p32
    shrink = ry * inverse
    p20, p21, p22, p32 = p20 * shrink, p21 * shrink, p22 * shrink, p32 * shrink
    return x, vx, y, vy, p00, p10, p11, p20, p21, p22, p30, p31, p32, p33


@part_of_loop
def _surprise(
    zx: float, zy: float, rx: float, ry: float, state: _State
) -> tuple[float, float]:
    """Return the innovation's covariance determinant and normalised square."""
    s00, s01, s11 = state[4] + rx, state[7], state[9] + ry
    e0, e1 = zx - state[0], zy - state[2]
    det = s00 * s11 - s01 * s01
    return det, (s11 * e0 * e0 - 2 * s01 * e0 * e1 + s00 * e1 * e1) / det


@part_of_loop
def _measurement(
    k: int, batch: _Batch
) -> tuple[float, float, float, float, float, float]:
    """Return a position, its variances, and the cosine and sine of their axes.

    An error with a shape is given in its principal axes, where both are independent.
    """
    _, xy, variance, _, _, axes, shares = batch
    zx, zy, r = xy[k, 0], xy[k, 1], variance[k]
    if len(axes) == 0:
        return zx, zy, r, r, 1.0, 0.0
    c, s = axes[k, 0, 0], axes[k, 1, 0]
    return c * zx + s * zy, c * zy - s * zx, r * shares[k, 0], r * shares[k, 1], c, s


@part_of_loop
def _weigh(
    mu_0: float, mu_1: float, det_0: float, d2_0: float, det_1: float, d2_1: float
) -> tuple[float, float, float, float]:
    """Return the modes' probabilities after a sample, and parts of its likelihood.

    The likelihood is exp(-d2 / 2) / 2 pi times the root of a factor; d2 and this factor
    are returned. They are relative to the nearer mode: far outliers would underflow in
    both modes.
    """
    if mu_1 > 0 and (d2_1 < d2_0 or not mu_0 > 0):
        det, d2 = det_1, d2_1
        mu_0 *= exp(min((d2 - d2_0) / 2, 0.0)) * sqrt(det / det_0)
    else:
        det, d2 = det_0, d2_0
        mu_1 *= exp(min((d2 - d2_1) / 2, 0.0)) * sqrt(det / det_1)
    total = mu_0 + mu_1
    return mu_0 / total, mu_1 / total, d2, total * total / det


@part_of_loop
def _write(state: _State, x: Floats, p: Floats) -> None:
    """Write a state to arrays: mean, (4,), and covariance, (4, 4)."""
    entry = _STATES
    for a in range(_STATES):
        x[a] = state[a]
        for b in range(a + 1):
            p[a, b] = p[b, a] = state[entry]
            entry += 1


@part_of_loop
def _write_both(first: _State, second: _State, x: Floats, p: Floats) -> None:
    _write(first, x[0], p[0])
    _write(second, x[1], p[1])


@part_of_loop
def _filter(
    i: int,
    batch: _Batch,
    moods: _Moods,
    gate: float,
    patience: int,
    out: tuple[Floats, ...],
) -> float:
    """Filter a track and return its log-likelihood.

    A sample whose innovation exceeds the `gate` in both modes is rejected, unless
    `patience` samples in a row before it were. Mean, covariance and probability are
    written for every sample, or, if `out` has a single row, for the last sample only.
    """
    t, xy, _, offsets, prior, axes, _ = batch
    (q, probability, chances), (x, p, mu) = moods, out
    first, is_shaped = offsets[i], len(axes) > 0
    a, c = prior[0], prior[1]  # Of position and velocity; the track starts at rest.
    x0, y0 = xy[first, 0], xy[first, 1]
    state_0: _State = (x0, 0.0, y0, 0.0, a, 0.0, c, 0.0, 0.0, a, 0.0, 0.0, 0.0, c)
    state_1 = state_0
    mu_0, mu_1 = probability[0], probability[1]
    # The scale is not yet in the logarithm, which takes it once for many samples.
    misses, log_likelihood, scale = 0, 0.0, 1.0
    for k in range(first, offsets[i + 1]):
        if k > first:
            dt = t[k] - t[k - 1]
            before_0, before_1 = state_0, state_1
            stay, come = chances[k, 0, 0] * mu_0, chances[k, 1, 0] * mu_1
            leave, remain = chances[k, 0, 1] * mu_0, chances[k, 1, 1] * mu_1
            mu_0, mu_1 = stay + come, leave + remain
            w, v = (stay / mu_0, come / mu_0) if mu_0 > 0 else (1.0, 0.0)
            state_0 = _predict(dt, q[0], _mix(w, v, before_0, before_1))
            w, v = (leave / mu_1, remain / mu_1) if mu_1 > 0 else (0.0, 1.0)
            state_1 = _predict(dt, q[1], _mix(w, v, before_0, before_1))
        zx, zy, rx, ry, cosine, sine = _measurement(k, batch)
        if is_shaped:
            state_0, state_1 = _turn_both(cosine, -sine, state_0, state_1)
        det_0, d2_0 = _surprise(zx, zy, rx, ry, state_0)
        det_1, d2_1 = _surprise(zx, zy, rx, ry, state_1)
        if misses < patience and min(d2_0, d2_1) > gate:
            misses += 1
        else:
            misses = 0
            state_0 = _update(zx, zy, rx, ry, state_0)
            state_1 = _update(zx, zy, rx, ry, state_1)
            mu_0, mu_1, d2, factor = _weigh(mu_0, mu_1, det_0, d2_0, det_1, d2_1)
            log_likelihood -= d2 / 2 + _LOG_2PI
            scale *= factor
            if scale > _BIG or scale < 1 / _BIG:
                log_likelihood += log(scale) / 2
                scale = 1.0
        if is_shaped:
            state_0, state_1 = _turn_both(cosine, sine, state_0, state_1)
        # With a single row for the track only its last sample is written, to row 0.
        row = min(k - first, mu.shape[0] - 1)
        if row == k - first or k + 1 == offsets[i + 1]:
            _write_both(state_0, state_1, x[row], p[row])
            mu[row, 0], mu[row, 1] = mu_0, mu_1
    return log_likelihood + log(scale) / 2


@compiled(_BATCH, _MOODS, FLOAT, INT, _OUT)
def imm_last(
    batch: _Batch, moods: _Moods, gate: float, patience: int, out: tuple[Floats, ...]
) -> None:
    """Filter; row i of the outputs is the state after the last sample of track i."""
    mean, cov, probability, log_likelihood = out
    for i in range(batch[3].size - 1):
        only = mean[i : i + 1], cov[i : i + 1], probability[i : i + 1]
        log_likelihood[i] = _filter(i, batch, moods, gate, patience, only)


@compiled(_BATCH, _MOODS, FLOAT, INT, _OUT)
def imm_states(
    batch: _Batch, moods: _Moods, gate: float, patience: int, out: tuple[Floats, ...]
) -> None:
    """Filter; row k of the states is the state after sample k, of whatever track."""
    (mean, cov, probability, log_likelihood), offsets = out, batch[3]
    for i in range(offsets.size - 1):
        rows = slice(offsets[i], offsets[i + 1])
        track = mean[rows], cov[rows], probability[rows]
        log_likelihood[i] = _filter(i, batch, moods, gate, patience, track)
