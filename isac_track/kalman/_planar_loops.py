"""Compiled loops of `isac_track.kalman` for errors with a shape.

The axes are coupled: the state is (x, its derivatives, y, its derivatives), with a full
covariance. A measurement is taken in along each principal axis of its error, as two
numbers with independent errors, one after the other. The filter to the last state does
so in Joseph's form, for either number of states. The smoother turns its state into the
principal axes of each sample: the motion is the same in all directions.
"""

from math import log, pi
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

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats, Floats, Floats]
"""Times, positions, mean variances, offsets, variances of the prior per axis; principal
axes, (M, 2, 2) with a column for each, and their variances as shares of the mean.
"""
_BATCH = together(
    read(1), read(2), read(1), read(1, "int64"), read(1), read(3), read(2)
)
_LOG_2PI = log(2 * pi)
# Fields of a smoother's row, in the principal axes of the sample's error: position, its
# covariances with position and velocity, the turn from the sample before, and of either
# axis the gain, the innovation over its variance, and the inverse of this variance.
_X, _Y, _XX, _XY, _YY, _XVX, _XVY, _YVX, _YVY, _COSINE, _SINE = range(11)
_GX, _GY, _ROW = 11, 17, 23
_Symmetric: TypeAlias = tuple[float, ...]
"""Lower triangle of a covariance of (x, vx, y, vy), row by row, in registers."""


@part_of_loop
def _measure(
    x: Floats, p: Floats, gain: Floats, hx: float, hy: float, z: float, r: float
) -> tuple[float, float]:
    """Take in a measurement of hx x + hy y with variance r, in Joseph's form.

    Returns the innovation and the inverse of its variance.
    """
    n = x.size
    d = n // 2
    spread = r
    for a in range(n):
        gain[a] = p[a, 0] * hx + p[a, d] * hy
    spread += hx * gain[0] + hy * gain[d]
    inverse = 1.0 / spread
    error = z - hx * x[0] - hy * x[d]
    for a in range(n):
        gain[a] *= inverse
        x[a] += gain[a] * error
    # P - K h' P, then the same from the right, which keeps it positive.
    for b in range(n):
        across = hx * p[0, b] + hy * p[d, b]
        for a in range(n):
            p[a, b] -= gain[a] * across
    for a in range(n):
        beside = hx * p[a, 0] + hy * p[a, d] - r * gain[a]
        for b in range(n):
            p[a, b] -= beside * gain[b]
    for a in range(n):
        for b in range(a):
            p[a, b] = p[b, a] = (p[a, b] + p[b, a]) / 2.0
    return error, inverse


@part_of_loop
def _move(x: Floats, p: Floats, f: Floats, q: Floats, work: Floats) -> None:
    """Predict: x = F x and P = F P F' + Q, with F and Q per axis."""
    n = x.size
    d = n // 2
    for axis in range(2):
        for a in range(d):  # F is upper triangular
            total = 0.0
            for b in range(a, d):
                total += f[a, b] * x[axis * d + b]
            x[axis * d + a] = total
    for a in range(n):
        first = a - a % d
        for b in range(n):
            total = 0.0
            for c in range(a % d, d):
                total += f[a % d, c] * p[first + c, b]
            work[a, b] = total
    for a in range(n):
        for b in range(n):
            first = b - b % d
            total = q[a % d, b % d] if a // d == b // d else 0.0
            for c in range(b % d, d):
                total += work[a, first + c] * f[b % d, c]
            p[a, b] = total


@part_of_loop
def _fill_step(dt: float, density: float, f: Floats, q: Floats) -> None:
    """Fill F and Q of white noise on the last derivative, (d, d) each."""
    d = len(f)
    f[:] = 0.0
    for a in range(d):
        term = 1.0
        for b in range(a, d):
            f[a, b] = term
            term *= dt / (b - a + 1)
    for a in range(d):
        for b in range(d):
            left, right = d - 1 - a, d - 1 - b
            term = density * dt ** (left + right + 1) / (left + right + 1)
            for factor in range(2, left + 1):
                term /= factor
            for factor in range(2, right + 1):
                term /= factor
            q[a, b] = term


@part_of_loop
def _surprise(p: Floats, ex: float, ey: float, r: Floats) -> float:
    """Return the normalised square of an innovation with the error covariance r."""
    d = len(p) // 2
    s00, s01, s11 = p[0, 0] + r[0, 0], p[0, d] + r[0, 1], p[d, d] + r[1, 1]
    det = s00 * s11 - s01 * s01
    return float((s11 * ex * ex - 2.0 * s01 * ex * ey + s00 * ey * ey) / det)


@compiled(_BATCH, FLOAT, FLOAT, INT, together(written(2), written(3), written(1)))
def last_states(
    batch: _Batch,
    density: float,
    gate: float,
    patience: int,
    out: tuple[Floats, Floats, Floats],
) -> None:
    """Filter to the last state of every track: mean, (N, n), covariance, (N, n, n)."""
    t, xy, variance, offsets, prior, axes, shares = batch
    mean, cov, log_likelihood = out
    d = prior.size
    n = 2 * d
    x, p, work = np.empty(n), np.empty((n, n)), np.empty((n, n))
    f, q, r, gain = np.empty((d, d)), np.empty((d, d)), np.empty((2, 2)), np.empty(n)
    for i in range(offsets.size - 1):
        x[:], p[:] = 0.0, 0.0
        for axis in range(2):
            x[axis * d] = xy[offsets[i], axis]
            for a in range(d):
                p[axis * d + a, axis * d + a] = prior[a]
        total, misses = 0.0, 0
        for k in range(offsets[i], offsets[i + 1]):
            if k > offsets[i]:
                _fill_step(t[k] - t[k - 1], density, f, q)
                _move(x, p, f, q, work)
            r[:] = 0.0
            for axis in range(2):
                own = variance[k] * shares[k, axis]
                hx, hy = axes[k, 0, axis], axes[k, 1, axis]
                r[0, 0] += own * hx * hx
                r[0, 1] += own * hx * hy
                r[1, 1] += own * hy * hy
            square = _surprise(p, xy[k, 0] - x[0], xy[k, 1] - x[d], r)
            if misses < patience and not square <= gate:
                misses += 1
                continue
            misses = 0
            total += square / 2.0 + _LOG_2PI
            for axis in range(2):
                hx, hy = axes[k, 0, axis], axes[k, 1, axis]
                z = hx * xy[k, 0] + hy * xy[k, 1]
                own = variance[k] * shares[k, axis]
                _, inverse = _measure(x, p, gain, hx, hy, z, own)
                total -= log(inverse) / 2.0
        mean[i], cov[i] = x, p
        log_likelihood[i] = -total


@part_of_loop
def _turn(c: float, s: float, p: _Symmetric) -> _Symmetric:
    """Return T p T' for a turn of both axes with this cosine and sine."""
    p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = p
    cc, ss, cs = c * c, s * s, c * s
    along, across = c * p10 - s * p21, c * p30 - s * p32
    behind, beside = s * p10 + c * p21, s * p30 + c * p32
    return (
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
def _predict(
    a: float, g: float, noise: tuple[float, float, float], p: _Symmetric
) -> _Symmetric:
    """Return F p F' + Q, with a displacement `a` and a rest `g` of each velocity."""
    p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = p
    qpp, qpv, qvv = noise
    return (
        p00 + a * (2.0 * p10 + a * p11) + qpp,
        g * (p10 + a * p11) + qpv,
        g * g * p11 + qvv,
        p20 + a * (p30 + p21 + a * p31),
        g * (p21 + a * p31),
        p22 + a * (2.0 * p32 + a * p33) + qpp,
        g * (p30 + a * p31),
        g * g * p31,
        g * (p32 + a * p33) + qpv,
        g * g * p33 + qvv,
    )


@part_of_loop
def _take_x(r: float, inverse: float, p: _Symmetric) -> _Symmetric:
    """Return the covariance after a measurement of x with variance r.

    Entries of x are multiplied by r / (p + r), which equals 1 - p / (p + r): a
    difference of nearly equal numbers would lose digits.
    """
    p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = p
    k1, k2, k3, shrink = p10 * inverse, p20 * inverse, p30 * inverse, r * inverse
    return (
        p00 * shrink,
        p10 * shrink,
        p11 - k1 * p10,
        p20 * shrink,
        p21 - k2 * p10,
        p22 - k2 * p20,
        p30 * shrink,
        p31 - k3 * p10,
        p32 - k3 * p20,
        p33 - k3 * p30,
    )


@part_of_loop
def _swap(p: _Symmetric) -> _Symmetric:
    """Return a covariance with both axes in the other order."""
    p00, p10, p11, p20, p21, p22, p30, p31, p32, p33 = p
    return p22, p32, p33, p20, p30, p00, p21, p31, p10, p11


@part_of_loop
def _forward(
    xy: Floats,
    noise: Floats,
    axes: Floats,
    shares: Floats,
    start_m2: tuple[float, float],
    steps: Floats,
    rows: Floats,
) -> None:
    """Filter a track in the principal axes of each sample's error, from row to row."""
    a, b = start_m2
    p: _Symmetric = (a, 0.0, b, 0.0, 0.0, a, 0.0, 0.0, 0.0, b)
    x = axes[0, 0, 0] * xy[0, 0] + axes[0, 1, 0] * xy[0, 1]
    y = axes[0, 0, 1] * xy[0, 0] + axes[0, 1, 1] * xy[0, 1]
    vx = vy = 0.0
    for k in range(len(xy)):
        row = rows[k]
        row[_COSINE], row[_SINE] = 1.0, 0.0
        if k > 0:
            move, left = steps[k, 0], steps[k, 1]
            p = _predict(move, left, (steps[k, 2], steps[k, 3], steps[k, 4]), p)
            x, y, vx, vy = x + move * vx, y + move * vy, left * vx, left * vy
            c = axes[k, 0, 0] * axes[k - 1, 0, 0] + axes[k, 1, 0] * axes[k - 1, 1, 0]
            s = axes[k, 0, 1] * axes[k - 1, 0, 0] + axes[k, 1, 1] * axes[k - 1, 1, 0]
            row[_COSINE], row[_SINE] = c, s
            p = _turn(c, s, p)
            x, y, vx, vy = (
                c * x - s * y,
                s * x + c * y,
                c * vx - s * vy,
                s * vx + c * vy,
            )
        zx = axes[k, 0, 0] * xy[k, 0] + axes[k, 1, 0] * xy[k, 1]
        zy = axes[k, 0, 1] * xy[k, 0] + axes[k, 1, 1] * xy[k, 1]
        r = noise[k] * shares[k, 0]
        inverse = 1.0 / (p[0] + r)
        g0, g1, g2, g3 = p[0] * inverse, p[1] * inverse, p[3] * inverse, p[6] * inverse
        e = zx - x
        row[_GX], row[_GX + 1], row[_GX + 2], row[_GX + 3] = g0, g1, g2, g3
        row[_GX + 4], row[_GX + 5] = e * inverse, inverse
        x, vx, y, vy = x + g0 * e, vx + g1 * e, y + g2 * e, vy + g3 * e
        p = _take_x(r, inverse, p)
        r = noise[k] * shares[k, 1]
        inverse = 1.0 / (p[5] + r)
        g0, g1, g2, g3 = p[3] * inverse, p[4] * inverse, p[5] * inverse, p[8] * inverse
        e = zy - y
        row[_GY], row[_GY + 1], row[_GY + 2], row[_GY + 3] = g0, g1, g2, g3
        row[_GY + 4], row[_GY + 5] = e * inverse, inverse
        x, vx, y, vy = x + g0 * e, vx + g1 * e, y + g2 * e, vy + g3 * e
        p = _swap(_take_x(r, inverse, _swap(p)))
        row[_X], row[_Y] = x, y
        row[_XX], row[_XY], row[_YY] = p[0], p[3], p[5]
        row[_XVX], row[_XVY], row[_YVX], row[_YVY] = p[1], p[6], p[4], p[8]


@part_of_loop
def _quadratic_form(
    u: tuple[float, float, float, float],
    v: tuple[float, float, float, float],
    m: _Symmetric,
) -> float:
    """Return u m v'."""
    u0, u1, u2, u3 = u
    v0, v1, v2, v3 = v
    m00, m10, m11, m20, m21, m22, m30, m31, m32, m33 = m
    ahead: float = u0 * (m00 * v0 + m10 * v1 + m20 * v2 + m30 * v3)
    ahead += u1 * (m10 * v0 + m11 * v1 + m21 * v2 + m31 * v3)
    ahead += u2 * (m20 * v0 + m21 * v1 + m22 * v2 + m32 * v3)
    return ahead + u3 * (m30 * v0 + m31 * v1 + m32 * v2 + m33 * v3)


@part_of_loop
def _back_x(
    g: tuple[float, float, float, float], inverse: float, m: _Symmetric
) -> _Symmetric:
    """Carry the adjoint's variance back over a measurement of x with the gain g."""
    g0, g1, g2, g3 = g
    m00, m10, m11, m20, m21, m22, m30, m31, m32, m33 = m
    b0 = m00 * g0 + m10 * g1 + m20 * g2 + m30 * g3
    b1 = m10 * g0 + m11 * g1 + m21 * g2 + m31 * g3
    b2 = m20 * g0 + m21 * g1 + m22 * g2 + m32 * g3
    b3 = m30 * g0 + m31 * g1 + m32 * g2 + m33 * g3
    total = g0 * b0 + g1 * b1 + g2 * b2 + g3 * b3 + inverse
    return (
        m00 - 2.0 * b0 + total,
        m10 - b1,
        m11,
        m20 - b2,
        m21,
        m22,
        m30 - b3,
        m31,
        m32,
        m33,
    )


@part_of_loop
def _back_step(a: float, g: float, m: _Symmetric) -> _Symmetric:
    """Carry the adjoint's variance back over a step: F' m F."""
    m00, m10, m11, m20, m21, m22, m30, m31, m32, m33 = m
    return (
        m00,
        g * m10 + a * m00,
        g * g * m11 + a * (2.0 * g * m10 + a * m00),
        m20,
        g * m21 + a * m20,
        m22,
        g * m30 + a * m20,
        g * g * m31 + a * (g * (m30 + m21) + a * m20),
        g * m32 + a * m22,
        g * g * m33 + a * (2.0 * g * m32 + a * m22),
    )


@part_of_loop
def _backward(steps: Floats, rows: Floats) -> None:
    """Smooth a track: a row's positions and their covariance become smoothed.

    Modified Bryson-Frazier, as in `_error_loops`: x + = -P l and P + = -P m P, with the
    adjoint l and its variance m.
    """
    l0 = l1 = l2 = l3 = 0.0
    m: _Symmetric = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for step in range(len(rows)):
        k = len(rows) - 1 - step
        row = rows[k]
        px = row[_XX], row[_XVX], row[_XY], row[_XVY]
        py = row[_XY], row[_YVX], row[_YY], row[_YVY]
        row[_X] -= px[0] * l0 + px[1] * l1 + px[2] * l2 + px[3] * l3
        row[_Y] -= py[0] * l0 + py[1] * l1 + py[2] * l2 + py[3] * l3
        row[_XX] -= _quadratic_form(px, px, m)
        row[_XY] -= _quadratic_form(px, py, m)
        row[_YY] -= _quadratic_form(py, py, m)
        g = row[_GY + 2], row[_GY + 3], row[_GY], row[_GY + 1]
        l2 -= g[2] * l0 + g[3] * l1 + g[0] * l2 + g[1] * l3 + row[_GY + 4]
        m = _swap(_back_x(g, row[_GY + 5], _swap(m)))
        g = row[_GX], row[_GX + 1], row[_GX + 2], row[_GX + 3]
        l0 -= g[0] * l0 + g[1] * l1 + g[2] * l2 + g[3] * l3 + row[_GX + 4]
        m = _back_x(g, row[_GX + 5], m)
        c, s, a, left = row[_COSINE], row[_SINE], steps[k, 0], steps[k, 1]
        l0, l2, l1, l3 = (
            c * l0 + s * l2,
            c * l2 - s * l0,
            c * l1 + s * l3,
            c * l3 - s * l1,
        )
        l1, l3 = left * l1 + a * l0, left * l3 + a * l2
        m = _back_step(a, left, _turn(c, -s, m))


@part_of_loop
def _reweigh(
    xy: Floats,
    variance: Floats,
    axes: Floats,
    shares: Floats,
    blur: float,
    rows: Floats,
    noise: Floats,
) -> None:
    """Weigh the samples of a track anew by the rows that the last pass left.

    A residual counts in units of the error ellipse.
    """
    for k in range(len(xy)):
        row, square = rows[k], 2.0 * variance[k]
        gx = axes[k, 0, 0] * xy[k, 0] + axes[k, 1, 0] * xy[k, 1] - row[_X]
        gy = axes[k, 0, 1] * xy[k, 0] + axes[k, 1, 1] * xy[k, 1] - row[_Y]
        near = (gx * gx + row[_XX]) / shares[k, 0] + (gy * gy + row[_YY]) / shares[k, 1]
        near += blur * square
        noise[k] = near * (square / (near + square))


@part_of_loop
def _add_to_mixture(
    rows: Floats,
    axes: Floats,
    weight: float,
    weight_before: float,
    position: Floats,
    cov: Floats,
) -> None:
    """Add a smoothed track with a `weight` to the mixture of the tracks before."""
    total = weight_before + weight
    share = weight / total
    apart = weight_before * share / total
    before = weight_before / total
    for k in range(len(rows)):
        row = rows[k]
        c, s = axes[k, 0, 0], axes[k, 1, 0]
        d, e = axes[k, 0, 1], axes[k, 1, 1]
        gx = c * row[_X] + d * row[_Y] - position[k, 0]
        gy = s * row[_X] + e * row[_Y] - position[k, 1]
        xx, xy, yy = row[_XX], row[_XY], row[_YY]
        own_xx = c * (c * xx + 2.0 * d * xy) + d * d * yy
        own_xy = c * (s * xx + e * xy) + d * (s * xy + e * yy)
        own_yy = s * (s * xx + 2.0 * e * xy) + e * e * yy
        cov[k, 0, 0] = before * cov[k, 0, 0] + share * own_xx + apart * gx * gx
        cov[k, 0, 1] = before * cov[k, 0, 1] + share * own_xy + apart * gx * gy
        cov[k, 1, 1] = before * cov[k, 1, 1] + share * own_yy + apart * gy * gy
        cov[k, 1, 0] = cov[k, 0, 1]
        position[k, 0] += share * gx
        position[k, 1] += share * gy


@compiled(
    _BATCH,
    read(1),
    read(2),
    read(1, "int64"),
    read(1),
    INT,
    FLOAT,
    together(written(2), written(3), written(1)),
)
def smooth_tracks(
    batch: _Batch,
    motion: Floats,
    steps: Floats,
    track: Ints,
    weight: Floats,
    passes: int,
    anneal: float,
    out: tuple[Floats, Floats, Floats],
) -> None:
    """Smooth R tracks under a motion in `passes` passes, as `_error_loops` does.

    `motion` are its numbers there, and `steps`, (M, 5), what `fill_steps` makes of it;
    `track` and `weight` are (R,). Positions and covariances join the mixture in `out`,
    whose last array sums the weights of each track.
    """
    _, xy, variance, offsets, prior, axes, shares = batch
    position, cov, total_weight = out
    longest = 0
    for i in track:
        longest = max(longest, offsets[i + 1] - offsets[i])
    buffer, weighed = np.empty((longest, _ROW)), np.empty(longest)
    for run in range(track.size):
        i = track[run]
        first, end = offsets[i], offsets[i + 1]
        rows, noise = buffer[: end - first], weighed[: end - first]
        noise[:] = variance[first:end]
        places, own_axes, own = xy[first:end], axes[first:end], shares[first:end]
        blur = 1.0
        for turn in range(passes):
            if turn > 0:
                _reweigh(places, variance[first:end], own_axes, own, blur, rows, noise)
                blur *= anneal
            _forward(
                places,
                noise,
                own_axes,
                own,
                (prior[0], motion[0]),
                steps[first:end],
                rows,
            )
            _backward(steps[first:end], rows)
        _add_to_mixture(
            rows,
            own_axes,
            weight[run],
            total_weight[i],
            position[first:end],
            cov[first:end],
        )
        total_weight[i] += weight[run]
