"""Compiled loops for a walk behind a slow error and a white error with a shape.

The model is that of `_error_loops`: per axis the state is (p, v, u), position, velocity
and an Ornstein-Uhlenbeck process of variance 1, and a measurement is p + s u plus white
noise. Here the white noise has principal axes of its own at every sample, which couples
both axes: the state has six numbers and a full covariance. A measurement is taken in
along each principal axis, as two numbers with independent errors, in Joseph's form.
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

_Batch: TypeAlias = tuple[Floats, Floats, Ints, Floats, Floats, Floats, Floats]
"""Positions, mean variances, offsets, variances of the prior of p and v, amplitudes;
principal axes, (M, 2, 2) with a column for each, and their shares of the mean variance.
"""
_BATCH = together(
    read(2), read(1), read(1, "int64"), read(1), read(1), read(3), read(2)
)
_LOG_2PI = log(2 * pi)
_D, _N = 3, 6  # States of an axis, and of both.
# Fields of a step, (M, 6): the displacement per velocity, what remains of velocity, the
# increments of pp, pv and vv, and what remains of the slow error.
_MOVE, _LEFT, _QPP, _QPV, _QVV, _MEMORY = range(6)


@part_of_loop
def _begin(start: Floats, prior: Floats, first_m2: float, x: Floats, p: Floats) -> None:
    """Fill the prior of a track: at rest at its first sample, with no slow error."""
    x[:] = 0.0
    p[:] = 0.0
    for axis in range(2):
        x[axis * _D] = start[axis]
        p[axis * _D, axis * _D] = prior[0]
        p[axis * _D + 1, axis * _D + 1] = first_m2
        p[axis * _D + 2, axis * _D + 2] = 1.0


@part_of_loop
def _move(step: Floats, x: Floats, p: Floats) -> None:
    """Predict in place: x = F x and P = F P F' + Q."""
    a, g, f = step[_MOVE], step[_LEFT], step[_MEMORY]
    for first in range(0, _N, _D):
        x[first] += a * x[first + 1]
        x[first + 1] *= g
        x[first + 2] *= f
        for b in range(_N):
            p[first, b] += a * p[first + 1, b]
            p[first + 1, b] *= g
            p[first + 2, b] *= f
    for first in range(0, _N, _D):
        for b in range(_N):
            p[b, first] += a * p[b, first + 1]
            p[b, first + 1] *= g
            p[b, first + 2] *= f
        p[first, first] += step[_QPP]
        p[first, first + 1] += step[_QPV]
        p[first + 1, first] += step[_QPV]
        p[first + 1, first + 1] += step[_QVV]
        p[first + 2, first + 2] += (1.0 - f) * (1.0 + f)


@part_of_loop
def _fill_h(axes: Floats, axis: int, s: float, h: Floats) -> None:
    """Fill what a measurement along a principal axis sees of the state."""
    for side in range(2):
        h[side * _D] = axes[side, axis]
        h[side * _D + 1] = 0.0
        h[side * _D + 2] = axes[side, axis] * s


@part_of_loop
def _measure(
    h: Floats, z: float, r: float, x: Floats, p: Floats, gain: Floats
) -> tuple[float, float]:
    """Take in a measurement of h x with variance r, in Joseph's form.

    Returns the innovation and the inverse of its variance.
    """
    error, spread = z, r
    for a in range(_N):
        gain[a] = 0.0
        for b in range(_N):
            gain[a] += p[a, b] * h[b]
        spread += h[a] * gain[a]
        error -= h[a] * x[a]
    inverse = 1.0 / spread
    for a in range(_N):
        gain[a] *= inverse
        x[a] += gain[a] * error
    _shrink(h, r, gain, p)
    return error, inverse


@part_of_loop
def _shrink(h: Floats, r: float, gain: Floats, p: Floats) -> None:
    """Shrink P in place to P - K h' P, and likewise from the right, in Joseph's form."""
    for b in range(_N):
        across = 0.0
        for a in range(_N):
            across += h[a] * p[a, b]
        for a in range(_N):
            p[a, b] -= gain[a] * across
    for a in range(_N):
        beside = -r * gain[a]
        for b in range(_N):
            beside += p[a, b] * h[b]
        for b in range(_N):
            p[a, b] -= beside * gain[b]
    for a in range(_N):
        for b in range(a):
            p[a, b] = p[b, a] = (p[a, b] + p[b, a]) / 2.0


@part_of_loop
def _seen(s: float, p: Floats, out: Floats) -> None:
    """Fill the covariance of p + s u of both axes, (2, 2)."""
    for a in range(2):
        for b in range(2):
            i, j = a * _D, b * _D
            out[a, b] = p[i, j] + s * (p[i, j + 2] + p[i + 2, j] + s * p[i + 2, j + 2])


@part_of_loop
def _surprise(
    xy: Floats,
    s: float,
    r: float,
    axes: Floats,
    shares: Floats,
    x: Floats,
    p: Floats,
    seen: Floats,
) -> float:
    """Return the normalised square of an innovation."""
    _seen(s, p, seen)
    for axis in range(2):
        for a in range(2):
            for b in range(2):
                seen[a, b] += r * shares[axis] * axes[a, axis] * axes[b, axis]
    ex, ey = xy[0] - x[0] - s * x[2], xy[1] - x[_D] - s * x[_D + 2]
    det = seen[0, 0] * seen[1, 1] - seen[0, 1] * seen[0, 1]
    square = seen[1, 1] * ex * ex - 2.0 * seen[0, 1] * ex * ey + seen[0, 0] * ey * ey
    return float(square / det)


@compiled(
    _BATCH,
    read(2),
    FLOAT,
    INT,
    together(written(2), written(3), written(1), written(2)),
)
def filter_tracks(
    batch: _Batch,
    steps: Floats,
    gate: float,
    patience: int,
    out: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Filter to the last state of every track, (N, 6), and write causal positions.

    The third number of an axis is the error s u. Rejections are those of
    `_error_loops.filter_tracks`.
    """
    xy, variance, offsets, prior, amplitude, axes, shares = batch
    mean, covariance, log_likelihood, causal = out
    x, p, h, gain = np.empty(_N), np.empty((_N, _N)), np.empty(_N), np.empty(_N)
    seen = np.empty((2, 2))
    for i in range(offsets.size - 1):
        first = offsets[i]
        _begin(xy[first], prior, prior[1], x, p)
        total, misses = 0.0, 0
        for k in range(first, offsets[i + 1]):
            if k > first:
                _move(steps[k], x, p)
            s, r = amplitude[k], variance[k]
            square = _surprise(xy[k], s, r, axes[k], shares[k], x, p, seen)
            if misses < patience and not square <= gate:
                misses += 1
            else:
                misses = 0
                total += square / 2.0 + _LOG_2PI
                for axis in range(2):
                    _fill_h(axes[k], axis, s, h)
                    z = axes[k, 0, axis] * xy[k, 0] + axes[k, 1, axis] * xy[k, 1]
                    _, inverse = _measure(h, z, r * shares[k, axis], x, p, gain)
                    total -= log(inverse) / 2.0
            causal[k, 0], causal[k, 1] = x[0], x[_D]
        s = amplitude[offsets[i + 1] - 1]
        for a in range(_N):
            scale = s if a % _D == _D - 1 else 1.0
            mean[i, a] = scale * x[a]
            for b in range(_N):
                other = s if b % _D == _D - 1 else 1.0
                covariance[i, a, b] = scale * other * p[a, b]
        log_likelihood[i] = -total


@compiled(_BATCH, read(2), FLOAT, written(1))
def log_likelihoods(batch: _Batch, steps: Floats, first_m2: float, out: Floats) -> None:
    """Fill `out`, (N,), with log densities of tracks under a motion.

    `first_m2` is the variance of the first velocity.
    """
    xy, variance, offsets, prior, amplitude, axes, shares = batch
    x, p, h, gain = np.empty(_N), np.empty((_N, _N)), np.empty(_N), np.empty(_N)
    for i in range(offsets.size - 1):
        first = offsets[i]
        _begin(xy[first], prior, first_m2, x, p)
        total = 0.0
        for k in range(first, offsets[i + 1]):
            if k > first:
                _move(steps[k], x, p)
            total += _LOG_2PI
            for axis in range(2):
                _fill_h(axes[k], axis, amplitude[k], h)
                z = axes[k, 0, axis] * xy[k, 0] + axes[k, 1, axis] * xy[k, 1]
                r = variance[k] * shares[k, axis]
                error, inverse = _measure(h, z, r, x, p, gain)
                total += (error * error * inverse - log(inverse)) / 2.0
        out[i] = -total


_Rows: TypeAlias = tuple[Floats, Floats, Floats, Floats, Floats]
"""Of each sample: state, (6,), covariance, (6, 6), and of both axes the gain, (2, 6),
the innovation over its variance, and the inverse of this variance, (2,).
"""


@part_of_loop
def _forward(
    track: _Batch, noise: Floats, steps: Floats, m2: float, rows: _Rows
) -> None:
    """Filter a track from row to row; `m2` is the variance of the first velocity."""
    xy, _, _, prior, amplitude, axes, shares = track
    states, covs, gains, surprises, inverses = rows
    x, p, h = np.empty(_N), np.empty((_N, _N)), np.empty(_N)
    _begin(xy[0], prior, m2, x, p)
    for k in range(len(xy)):
        if k > 0:
            _move(steps[k], x, p)
        for axis in range(2):
            _fill_h(axes[k], axis, amplitude[k], h)
            z = axes[k, 0, axis] * xy[k, 0] + axes[k, 1, axis] * xy[k, 1]
            r = noise[k] * shares[k, axis]
            error, inverse = _measure(h, z, r, x, p, gains[k, axis])
            surprises[k, axis], inverses[k, axis] = error * inverse, inverse
        states[k], covs[k] = x, p


@part_of_loop
def _backward(amplitude: Floats, axes: Floats, steps: Floats, rows: _Rows) -> None:
    """Smooth a track: states and covariances become the smoothed ones.

    Modified Bryson-Frazier, as in `_error_loops`: x + = -P l and P + = -P m P, with the
    adjoint l and its variance m.
    """
    states, covs, gains, surprises, inverses = rows
    n = len(states)
    adjoint, m = np.zeros(_N), np.zeros((_N, _N))
    h, beside, work = np.empty(_N), np.empty(_N), np.empty((2, _N, _N))
    for turn in range(n):
        k = n - 1 - turn
        _smooth_row(adjoint, m, states[k], covs[k], work)
        for second in range(2):
            axis = 1 - second
            _fill_h(axes[k], axis, amplitude[k], h)
            gain, total, pull = gains[k, axis], inverses[k, axis], surprises[k, axis]
            for a in range(_N):
                beside[a] = 0.0
                for b in range(_N):
                    beside[a] += m[a, b] * gain[b]
                total += gain[a] * beside[a]
                pull += gain[a] * adjoint[a]
            for a in range(_N):
                adjoint[a] -= pull * h[a]
                for b in range(_N):
                    m[a, b] += total * h[a] * h[b] - h[a] * beside[b] - beside[a] * h[b]
        _move_back(steps[k], adjoint, m)


@part_of_loop
def _smooth_row(adjoint: Floats, m: Floats, x: Floats, p: Floats, work: Floats) -> None:
    """Smooth a state and its covariance in place: x - P l and P - P m P."""
    for a in range(_N):
        for b in range(_N):
            x[a] -= p[a, b] * adjoint[b]
            work[0, a, b] = 0.0
            for c in range(_N):
                work[0, a, b] += p[a, c] * m[c, b]
    for a in range(_N):
        for b in range(_N):
            work[1, a, b] = 0.0
            for c in range(_N):
                work[1, a, b] += work[0, a, c] * p[c, b]
    p -= work[1]


@part_of_loop
def _move_back(step: Floats, adjoint: Floats, m: Floats) -> None:
    """Move the adjoint to the sample before, in place: F' l and F' m F."""
    a, g, f = step[_MOVE], step[_LEFT], step[_MEMORY]
    for first in range(0, _N, _D):
        adjoint[first + 1] = g * adjoint[first + 1] + a * adjoint[first]
        adjoint[first + 2] *= f
        for b in range(_N):
            m[first + 1, b] = g * m[first + 1, b] + a * m[first, b]
            m[first + 2, b] *= f
    for first in range(0, _N, _D):
        for b in range(_N):
            m[b, first + 1] = g * m[b, first + 1] + a * m[b, first]
            m[b, first + 2] *= f


@part_of_loop
def _reweigh(track: _Batch, blur: float, rows: _Rows, noise: Floats) -> None:
    """Weigh the samples of a track anew by the rows that the last pass left.

    A residual, neither walk nor slow error, counts in units of the error ellipse.
    """
    xy, variance, _, _, amplitude, axes, shares = track
    states, covs = rows[0], rows[1]
    seen = np.empty((2, 2))
    for k in range(len(xy)):
        s, square = amplitude[k], 2.0 * variance[k]
        _seen(s, covs[k], seen)
        ex = xy[k, 0] - states[k, 0] - s * states[k, 2]
        ey = xy[k, 1] - states[k, _D] - s * states[k, _D + 2]
        near = blur * square
        for axis in range(2):
            c, d = axes[k, 0, axis], axes[k, 1, axis]
            gap = c * ex + d * ey
            spread = c * c * seen[0, 0] + 2.0 * c * d * seen[0, 1] + d * d * seen[1, 1]
            near += (gap * gap + spread) / shares[k, axis]
        noise[k] = near * (square / (near + square))


@part_of_loop
def _add_to_mixture(
    rows: _Rows, weight: float, weight_before: float, position: Floats, cov: Floats
) -> None:
    """Add a smoothed track with a `weight` to the mixture of the tracks before."""
    states, covs = rows[0], rows[1]
    total = weight_before + weight
    share, before = weight / total, weight_before / total
    for k in range(len(position)):
        gx, gy = states[k, 0] - position[k, 0], states[k, _D] - position[k, 1]
        apart = before * share
        for a in range(2):
            for b in range(2):
                cov[k, a, b] = before * cov[k, a, b] + share * covs[k, a * _D, b * _D]
        cov[k, 0, 0] += apart * gx * gx
        cov[k, 1, 1] += apart * gy * gy
        cov[k, 0, 1] += apart * gx * gy
        cov[k, 1, 0] = cov[k, 0, 1]
        position[k, 0] += share * gx
        position[k, 1] += share * gy


@compiled(
    _BATCH,
    read(2),
    FLOAT,
    together(read(1, "int64"), read(1)),
    INT,
    FLOAT,
    together(written(2), written(3), written(1)),
)
def smooth_tracks(
    batch: _Batch,
    steps: Floats,
    first_m2: float,
    runs: tuple[Ints, Floats],
    passes: int,
    anneal: float,
    out: tuple[Floats, Floats, Floats],
) -> None:
    """Smooth tracks under a motion in `passes` passes, as `_error_loops` does.

    `runs` are a track and a weight of each. Positions and covariances join the mixture
    in `out`, whose last array sums the weights of each track.
    """
    xy, variance, offsets, prior, amplitude, axes, shares = batch
    position, cov, total_weight = out
    track, weight = runs
    for run in range(track.size):
        i = track[run]
        own = slice(offsets[i], offsets[i + 1])
        places, s, own_axes, own_shares = (
            xy[own],
            amplitude[own],
            axes[own],
            shares[own],
        )
        part = places, variance[own], offsets, prior, s, own_axes, own_shares
        n, noise = len(places), variance[own].copy()
        states, covs, gains = (
            np.empty((n, _N)),
            np.empty((n, _N, _N)),
            np.empty((n, 2, _N)),
        )
        rows = states, covs, gains, np.empty((n, 2)), np.empty((n, 2))
        blur = 1.0
        for turn in range(passes):
            if turn > 0:
                _reweigh(part, blur, rows, noise)
                blur *= anneal
            _forward(part, noise, steps[own], first_m2, rows)
            _backward(s, own_axes, steps[own], rows)
        _add_to_mixture(rows, weight[run], total_weight[i], position[own], cov[own])
        total_weight[i] += weight[run]
