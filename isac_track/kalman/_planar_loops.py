"""Compiled loops of `isac_track.kalman` for errors with a shape.

The axes are coupled: the state is (x, its derivatives, y, its derivatives), with a full
covariance. A measurement is taken in along each principal axis of its error, as two
numbers with independent errors, one after the other.
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
# Fields of a sample's row: state, covariance, then gain, innovation over its variance,
# and the inverse of this variance, for either principal axis.
_COV, _GAIN, _ROW = 4, 20, 32


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
def _forward(
    xy: Floats,
    noise: Floats,
    axes: Floats,
    shares: Floats,
    start_m2: tuple[float, float],
    steps: Floats,
    rows: Floats,
) -> None:
    """Filter a track; a row gets the state and what the backward run reads."""
    x, p, work, gain = np.zeros(4), np.zeros((4, 4)), np.empty((4, 4)), np.empty(4)
    f, q = np.zeros((2, 2)), np.empty((2, 2))
    x[0], x[2] = xy[0, 0], xy[0, 1]
    p[0, 0] = p[2, 2] = start_m2[0]
    p[1, 1] = p[3, 3] = start_m2[1]
    f[0, 0] = 1.0
    for k in range(len(xy)):
        if k > 0:
            f[0, 1], f[1, 1] = steps[k, 0], steps[k, 1]
            q[0, 0], q[0, 1], q[1, 1] = steps[k, 2], steps[k, 3], steps[k, 4]
            q[1, 0] = q[0, 1]
            _move(x, p, f, q, work)
        row = rows[k]
        for axis in range(2):
            hx, hy = axes[k, 0, axis], axes[k, 1, axis]
            z = hx * xy[k, 0] + hy * xy[k, 1]
            error, inverse = _measure(x, p, gain, hx, hy, z, noise[k] * shares[k, axis])
            first = _GAIN + 6 * axis
            row[first : first + 4] = gain
            row[first + 4], row[first + 5] = error * inverse, inverse
        row[:_COV] = x
        for a in range(4):
            row[_COV + 4 * a : _COV + 4 * a + 4] = p[a]


@part_of_loop
def _smooth_row(row: Floats, adjoint: Floats, m: Floats) -> None:
    """Smooth the positions of a row and their covariance: x - P l and P - P m P."""
    beside = np.empty((2, 4))
    before = row[_COV:_GAIN].copy()
    for axis in range(2):
        pull = before[8 * axis : 8 * axis + 4]
        for b in range(4):
            row[2 * axis] -= pull[b] * adjoint[b]
            beside[axis, b] = 0.0
            for a in range(4):
                beside[axis, b] += pull[a] * m[a, b]
    for axis in range(2):
        for other in range(2):
            for b in range(4):
                row[_COV + 8 * axis + 2 * other] -= (
                    beside[axis, b] * before[8 * other + b]
                )


@part_of_loop
def _back_measure(
    measured: Floats, hx: float, hy: float, adjoint: Floats, m: Floats
) -> None:
    """Carry the adjoint and its variance back over a measurement of hx x + hy y."""
    beside = np.zeros(4)
    force, total = measured[4], measured[5]
    for a in range(4):
        for b in range(4):
            beside[a] += m[a, b] * measured[b]
        force += measured[a] * adjoint[a]
        total += measured[a] * beside[a]
    adjoint[0] -= hx * force
    adjoint[2] -= hy * force
    for a in range(4):
        m[a, 0] -= beside[a] * hx
        m[a, 2] -= beside[a] * hy
    for b in range(4):
        m[0, b] -= hx * beside[b]
        m[2, b] -= hy * beside[b]
    m[0, 0] += hx * total * hx
    m[0, 2] += hx * total * hy
    m[2, 0] += hy * total * hx
    m[2, 2] += hy * total * hy


@part_of_loop
def _backward(axes: Floats, steps: Floats, rows: Floats) -> None:
    """Smooth a track: a row's positions and their covariance become the smoothed ones.

    Modified Bryson-Frazier, as in `_error_loops`: x + = -P l and P + = -P m P, with the
    adjoint l and its variance m.
    """
    adjoint, m = np.zeros(4), np.zeros((4, 4))
    for step in range(len(rows)):
        k = len(rows) - 1 - step
        _smooth_row(rows[k], adjoint, m)
        for axis in (1, 0):
            first = _GAIN + 6 * axis
            measured = rows[k, first : first + 6]
            _back_measure(measured, axes[k, 0, axis], axes[k, 1, axis], adjoint, m)
        if k > 0:
            _back_step(adjoint, m, steps[k, 0], steps[k, 1])


@part_of_loop
def _back_step(adjoint: Floats, m: Floats, move: float, left: float) -> None:
    """Carry the adjoint and its variance back over a step: F' l and F' m F."""
    for v in (1, 3):
        adjoint[v] = left * adjoint[v] + move * adjoint[v - 1]
        for a in range(4):
            m[a, v] = left * m[a, v] + move * m[a, v - 1]
    for v in (1, 3):
        for a in range(4):
            m[v, a] = left * m[v, a] + move * m[v - 1, a]


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
        near = blur * square
        for axis in range(2):
            hx, hy = axes[k, 0, axis], axes[k, 1, axis]
            gap = hx * (xy[k, 0] - row[0]) + hy * (xy[k, 1] - row[2])
            spread = hx * hx * row[_COV] + hy * hy * row[_COV + 10]
            spread += hx * hy * (row[_COV + 2] + row[_COV + 8])
            near += (gap * gap + spread) / shares[k, axis]
        noise[k] = near * (square / (near + square))


@part_of_loop
def _add_to_mixture(
    rows: Floats, weight: float, weight_before: float, position: Floats, cov: Floats
) -> None:
    """Add a smoothed track with a `weight` to the mixture of the tracks before."""
    total = weight_before + weight
    share = weight / total
    gap = np.empty(2)
    for k in range(len(rows)):
        for a in range(2):
            gap[a] = rows[k, 2 * a] - position[k, a]
        for a in range(2):
            for b in range(2):
                own = rows[k, _COV + 8 * a + 2 * b]
                apart = weight_before * share * gap[a] * gap[b]
                cov[k, a, b] = (
                    weight_before * cov[k, a, b] + weight * own + apart
                ) / total
            position[k, a] += share * gap[a]


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
            _backward(own_axes, steps[first:end], rows)
        _add_to_mixture(
            rows, weight[run], total_weight[i], position[first:end], cov[first:end]
        )
        total_weight[i] += weight[run]
