"""Compiled loops of `isac_track.kalman`: filters to the last state, and the smoother.

The forms avoid subtracting nearly equal numbers, so that the covariance stays positive
over ten decades of noise and step without a square-root filter.

The smoother has eight tracks side by side in one buffer, so that one vector instruction
moves several of them: three times as fast as one track after the other. A row of the
buffer is a sample; a field of the row holds eight numbers, one for each track. The
inner loops run over the tracks, from 0 to `LANES`. They only touch fixed distances in a
row and its neighbour, which a compiler needs to see to vectorise them.

Tracks differ in length. Beyond its end a track has samples that change nothing, bit by
bit: no time passes, and the variance is a power of two so large that the gain vanishes.
So a track's result does not depend on its neighbours.
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

_Batch: TypeAlias = tuple[Floats, Floats, Floats, Ints, Floats]
"""Times, positions, variances, offsets, variances of the prior."""
_Last: TypeAlias = tuple[Floats, Floats, Floats]
"""Mean, covariance and log-likelihood of every track after its last sample."""
_BATCH = together(read(1), read(2), read(1), read(1, "int64"), read(1))
_LAST = _BATCH, FLOAT, FLOAT, INT, together(written(3), written(3), written(1))
_LOG_2PI = log(2 * pi)
_BIG = 1e100
# To multiply by these takes a tenth of the time of a division.
_THIRD, _SIXTH, _TWELFTH = 1 / 3, 1 / 6, 1 / 12

LANES = 8
# m^2, so far off that the weight of a sample is that of its variance alone.
_FAR = 2.0**600
_NOTHING = 2.0**200  # m^2, variance of the samples beyond the end of a track.

# Starts of the fields of a row: sample, sigma^2 of the error's length, and the state
# with its covariance [[a, b], [b, c]].
_T, _X, _Y, _SQUARE, *_STATE = range(0, 12 * LANES, LANES)
_PX, _VX, _PY, _VY, _A, _B, _C, _DET = _STATE
_ROW = 12 * LANES


@compiled(*_LAST)
def cv_last(batch: _Batch, q: float, gate: float, patience: int, out: _Last) -> None:
    """Filter to the last state of every track.

    The filter carries the determinant of the covariance [[a, b], [b, c]]. Every update
    is then a sum of positive terms, even if a single measurement outweighs all that was
    known before.
    """
    (t, xy, variance, offsets, prior), (mean, cov, log_likelihood) = batch, out
    for i in range(offsets.size - 1):
        px, py = xy[offsets[i], 0], xy[offsets[i], 1]
        vx = vy = b = 0.0
        a, c = prior[0], prior[1]
        det = a * c
        # The scale is a product of innovation variances: one logarithm serves many
        # samples.
        scale, total, misses = 1.0, 0.0, 0
        before = t[offsets[i]]
        for k in range(offsets[i], offsets[i + 1]):
            # 0 at the first sample, where the prediction changes nothing.
            dt = t[k] - before
            before = t[k]
            grown = q * dt
            det += grown * (a + dt * (b + dt * (c / 3 + grown / 12)))
            a += dt * (2 * b + dt * (c + grown / 3))
            b += dt * (c + grown / 2)
            c += grown
            px, py = px + dt * vx, py + dt * vy

            r = variance[k]
            s = a + r
            inverse = 1 / s
            ex, ey = xy[k, 0] - px, xy[k, 1] - py
            d2 = (ex * ex + ey * ey) * inverse
            if misses < patience and not d2 <= gate:
                misses += 1
                continue
            misses = 0
            gain_p, gain_v, shrink = a * inverse, b * inverse, r * inverse
            px, vx = px + gain_p * ex, vx + gain_v * ex
            py, vy = py + gain_p * ey, vy + gain_v * ey
            c = (det + c * r) * inverse
            a, b, det = a * shrink, b * shrink, det * shrink
            total += d2 / 2 + _LOG_2PI
            scale *= s
            if scale > _BIG or scale < 1 / _BIG:
                total += log(scale)
                scale = 1.0
        mean[i, 0, 0], mean[i, 0, 1] = px, vx
        mean[i, 1, 0], mean[i, 1, 1] = py, vy
        cov[i, 0, 0], cov[i, 1, 1] = a, c
        cov[i, 0, 1] = cov[i, 1, 0] = b
        log_likelihood[i] = -total - log(scale)


@part_of_loop
def _innovation_square(t: Floats, xy: Floats, k: int) -> float:
    """Return the squared innovation at sample k >= 2, scaled to a single error."""
    ratio = (t[k] - t[k - 1]) / (t[k - 1] - t[k - 2])
    ex = xy[k, 0] - xy[k - 1, 0] - ratio * (xy[k - 1, 0] - xy[k - 2, 0])
    ey = xy[k, 1] - xy[k - 1, 1] - ratio * (xy[k - 1, 1] - xy[k - 2, 1])
    scaled: float = (ex * ex + ey * ey) / (
        1 + (1 + ratio) * (1 + ratio) + ratio * ratio
    )
    return scaled


@compiled(read(1), read(2), read(1, "int64"), written(1))
def innovation_level(t: Floats, xy: Floats, offsets: Ints, level: Floats) -> None:
    """Average the scaled squared innovations of each track: see `isac_track.noise`."""
    for i in range(offsets.size - 1):
        first, end = offsets[i], offsets[i + 1]
        total = 0.0
        for k in range(first + 2, end):
            total += _innovation_square(t, xy, k)
        level[i] = total / (2 * max(end - first - 2, 1))


@compiled(read(1), read(2), read(1, "int64"), read(1), written(2), written(2))
def innovations_by_interval(
    t: Floats, xy: Floats, offsets: Ints, edges: Floats, count: Floats, total: Floats
) -> None:
    """Add scaled squared innovations of each track, (N, B), by the interval before.

    That is the first of the two intervals of the three samples.
    """
    for i in range(offsets.size - 1):
        for k in range(offsets[i] + 2, offsets[i + 1]):
            interval_s = t[k - 1] - t[k - 2]
            cell = 0
            while cell < edges.size and edges[cell] <= interval_s:
                cell += 1
            count[i, cell] += 1.0
            total[i, cell] += _innovation_square(t, xy, k)


_Factors: TypeAlias = tuple[float, float, float, float, float, float]
"""Covariance L D L': the diagonal of D, then L below its own, row by row."""


@part_of_loop
def _orthogonal(dt: float, q: float, factors: _Factors) -> _Factors:
    """Factorise F P F' + Q = M D M' by modified weighted Gram-Schmidt.

    Nothing is subtracted from a covariance. The rows r, s, t of [F L, Lq] are made
    orthogonal under six weights: those of P = L D L', then those of Q = Lq Dq Lq'. The
    factors of this step below the diagonal are M.
    """
    d0, d1, d2, l10, l20, l21 = factors
    d3, d4, d5 = q * dt / 20, q * dt / 48, q * dt / 9
    half = dt * dt / 2
    r0, r1, r2, r3 = 1.0 + dt * l10 + half * l20, dt + half * l21, half, dt * dt
    s0, s1, s2, s3, s4 = l10 + dt * l20, 1.0 + dt * l21, dt, 2.5 * dt, dt
    t0, t1, t2, t3, t4 = l20, l21, 1.0, 10 / 3, 4.0
    w0, w1, w2, w3 = d0 * r0, d1 * r1, d2 * r2, d3 * r3
    first = w0 * r0 + w1 * r1 + w2 * r2 + w3 * r3
    l10 = (w0 * s0 + w1 * s1 + w2 * s2 + w3 * s3) / first
    l20 = (w0 * t0 + w1 * t1 + w2 * t2 + w3 * t3) / first
    s0, s1, s2, s3 = s0 - l10 * r0, s1 - l10 * r1, s2 - l10 * r2, s3 - l10 * r3
    t0, t1, t2, t3 = t0 - l20 * r0, t1 - l20 * r1, t2 - l20 * r2, t3 - l20 * r3
    w0, w1, w2, w3, w4 = d0 * s0, d1 * s1, d2 * s2, d3 * s3, d4 * s4
    second = w0 * s0 + w1 * s1 + w2 * s2 + w3 * s3 + w4 * s4
    l21 = (w0 * t0 + w1 * t1 + w2 * t2 + w3 * t3 + w4 * t4) / second
    t0, t1, t2 = t0 - l21 * s0, t1 - l21 * s1, t2 - l21 * s2
    t3, t4 = t3 - l21 * s3, t4 - l21 * s4
    third = (
        d0 * t0 * t0 + d1 * t1 * t1 + d2 * t2 * t2 + d3 * t3 * t3 + d4 * t4 * t4 + d5
    )
    return first, second, third, l10, l20, l21


@compiled(*_LAST)
def ca_last(batch: _Batch, q: float, gate: float, patience: int, out: _Last) -> None:
    """Filter as `cv_last`, on the factors L D L' of the covariance.

    The position comes first, so that its measurement changes only the first element of
    D. The uncertainty beyond the position stays, and so does its regression on it.
    """
    (t, xy, variance, offsets, prior), (mean, cov, log_likelihood) = batch, out
    for i in range(offsets.size - 1):
        px, py = xy[offsets[i], 0], xy[offsets[i], 1]
        vx = vy = ax = ay = 0.0
        factors = prior[0], prior[1], prior[2], 0.0, 0.0, 0.0
        scale, total, misses = 1.0, 0.0, 0
        for k in range(offsets[i], offsets[i + 1]):
            if k > offsets[i]:
                dt = t[k] - t[k - 1]
                factors = _orthogonal(dt, q, factors)
                px, vx = px + dt * (vx + dt / 2 * ax), vx + dt * ax
                py, vy = py + dt * (vy + dt / 2 * ay), vy + dt * ay

            a, d1, d2, l10, l20, l21 = factors
            r = variance[k]
            s = a + r
            ex, ey = xy[k, 0] - px, xy[k, 1] - py
            inverse = 1 / s
            square = (ex * ex + ey * ey) * inverse
            if misses < patience and not square <= gate:
                misses += 1
                continue
            misses = 0
            ex, ey = a * inverse * ex, a * inverse * ey
            px, vx, ax = px + ex, vx + l10 * ex, ax + l20 * ex
            py, vy, ay = py + ey, vy + l10 * ey, ay + l20 * ey
            factors = a * (r * inverse), d1, d2, l10, l20, l21
            total += square / 2 + _LOG_2PI
            scale *= s
            if scale > _BIG or scale < 1 / _BIG:
                total += log(scale)
                scale = 1.0
        mean[i, 0, 0], mean[i, 0, 1], mean[i, 0, 2] = px, vx, ax
        mean[i, 1, 0], mean[i, 1, 1], mean[i, 1, 2] = py, vy, ay
        d0, d1, d2, l10, l20, l21 = factors
        cov[i, 0, 0], cov[i, 1, 0], cov[i, 2, 0] = d0, l10 * d0, l20 * d0
        cov[i, 1, 1], cov[i, 2, 1] = l10 * l10 * d0 + d1, l20 * l10 * d0 + l21 * d1
        cov[i, 2, 2] = l20 * l20 * d0 + l21 * l21 * d1 + d2
        cov[i, 0, 1], cov[i, 0, 2] = cov[i, 1, 0], cov[i, 2, 0]
        cov[i, 1, 2] = cov[i, 2, 1]
        log_likelihood[i] = -total - log(scale)


@part_of_loop
def _forward(buffer: Floats, n: int, q: float, blur: float) -> None:
    """Filter as `cv_last`; row 0 is the prior at the first sample, which is row 1.

    The weight of a sample is 1 / (r^2 + delta^2) + 1 / sigma^2, from the row as the
    pass before left it. In the first pass the row has the sample itself, known exactly,
    and the variance is half of sigma^2.
    """
    for k in range(n):
        rows = buffer[k * _ROW : (k + 2) * _ROW]
        for lane in range(LANES):
            after = lane + _ROW
            dt = rows[after + _T] - rows[lane + _T]
            a, b, c = rows[lane + _A], rows[lane + _B], rows[lane + _C]
            det = rows[lane + _DET]
            grown = q * dt
            det += grown * (a + dt * (b + dt * (c * _THIRD + grown * _TWELFTH)))
            a += dt * (2 * b + dt * (c + grown * _THIRD))
            b += dt * (c + grown / 2)
            c += grown
            vx, vy = rows[lane + _VX], rows[lane + _VY]
            px, py = rows[lane + _PX] + dt * vx, rows[lane + _PY] + dt * vy
            x, y, square = rows[after + _X], rows[after + _Y], rows[after + _SQUARE]
            rx, ry = x - rows[after + _PX], y - rows[after + _PY]
            # Added, not chosen: a choice would be a branch around the division for
            # each lane.
            far = _FAR if square == _NOTHING else 0.0
            near = rx * rx + ry * ry + 2 * rows[after + _A] + blur * square + far
            r = near * (square / (near + square))
            inverse = 1 / (a + r)
            ex, ey = x - px, y - py
            gain_p, gain_v, shrink = a * inverse, b * inverse, r * inverse
            rows[after + _PX], rows[after + _VX] = px + gain_p * ex, vx + gain_v * ex
            rows[after + _PY], rows[after + _VY] = py + gain_p * ey, vy + gain_v * ey
            rows[after + _C], rows[after + _DET] = (det + c * r) * inverse, det * shrink
            rows[after + _A], rows[after + _B] = a * shrink, b * shrink


@part_of_loop
def _backward(buffer: Floats, n: int, q: float) -> None:
    """Smooth: replace the filtered state of each row by the smoothed state.

    With P the filtered covariance, B = F^-1 Q F^-T and P' = F P F' + Q the smoothed
    covariance is C + G Ps G', with the gain G and C = (|Q| P + |P| B) / |P'|
    (two-dimensional matrices only). Both are multiplied out, so that little cancels,
    and computed anew: stored beside the states they would fill the cache.
    """
    for step in range(1, n):
        first = (n - step) * _ROW
        rows = buffer[first : first + 2 * _ROW]
        for lane in range(LANES):
            after = lane + _ROW
            dt = rows[after + _T] - rows[lane + _T]
            pa, pb, pc = rows[lane + _A], rows[lane + _B], rows[lane + _C]
            det = rows[lane + _DET]
            grown = q * dt
            det_q = grown * grown * dt * dt * _TWELFTH
            inverse = 1 / (det + grown * (pa + dt * (pb + dt * pc * _THIRD)) + det_q)
            det_share = det * inverse
            det_q *= inverse
            share = grown * inverse
            spread = det_share * grown
            # det / det is not 1 to the last bit; filler samples must change nothing.
            nothing = rows[after + _SQUARE] == _NOTHING
            g00 = det_share + share * (pa + dt * pb / 2)
            g11 = det_share - share * dt * (pb / 2 + dt * pc * _SIXTH)
            g00 = 1.0 if nothing else g00
            g11 = 1.0 if nothing else g11
            g01 = -dt * (det_share + share * (pa / 2 + dt * pb * _SIXTH))
            g10 = share * (pb + dt * pc / 2)
            c00 = det_q * pa + spread * dt * dt * _THIRD
            c01 = det_q * pb - spread * dt / 2
            c11 = det_q * pc + spread
            a, b, c = rows[after + _A], rows[after + _B], rows[after + _C]
            fx, fvx = rows[lane + _PX], rows[lane + _VX]
            fy, fvy = rows[lane + _PY], rows[lane + _VY]
            ex, evx = rows[after + _PX] - (fx + dt * fvx), rows[after + _VX] - fvx
            ey, evy = rows[after + _PY] - (fy + dt * fvy), rows[after + _VY] - fvy
            rows[lane + _PX], rows[lane + _PY] = (
                fx + g00 * ex + g01 * evx,
                fy + g00 * ey + g01 * evy,
            )
            rows[lane + _VX] = fvx + g10 * ex + g11 * evx
            rows[lane + _VY] = fvy + g10 * ey + g11 * evy
            h00, h01 = g00 * a + g01 * b, g00 * b + g01 * c
            h10, h11 = g10 * a + g11 * b, g10 * b + g11 * c
            rows[lane + _A] = c00 + h00 * g00 + h01 * g01
            rows[lane + _B] = c01 + h00 * g10 + h01 * g11
            rows[lane + _C] = c11 + h10 * g10 + h11 * g11


@compiled(_BATCH, read(1, "int64"), FLOAT, INT, FLOAT, together(written(2), written(1)))
def smooth_positions(
    batch: _Batch,
    order: Ints,
    q: float,
    passes: int,
    anneal: float,
    out: tuple[Floats, Floats],
) -> None:
    """Smooth the tracks in `order`, `passes` times; the longest comes last."""
    (t, xy, variance, offsets, prior), (position, spread) = batch, out
    longest = offsets[order[-1] + 1] - offsets[order[-1]] if order.size > 0 else 0
    buffer = np.zeros((longest + 1) * _ROW)
    first, size = np.empty((2, LANES), dtype=np.int64)
    # The first group may be incomplete.
    for group in range(-(-order.size % LANES), order.size, LANES):
        for lane in range(LANES):
            i = order[max(group + lane, 0)]  # The shortest track fills empty lanes.
            first[lane], size[lane] = offsets[i], offsets[i + 1] - offsets[i]
            start = first[lane]
            buffer[lane + _T] = t[start]
            buffer[lane + _PX], buffer[lane + _PY] = xy[start, 0], xy[start, 1]
            buffer[lane + _VX] = buffer[lane + _VY] = buffer[lane + _B] = 0.0
            buffer[lane + _A], buffer[lane + _C] = prior[0], prior[1]
            buffer[lane + _DET] = prior[0] * prior[1]
        n = size[LANES - 1]
        # Row by row: lane by lane every store would fetch its own line of memory.
        for k in range(n):
            row = buffer[(k + 1) * _ROW : (k + 2) * _ROW]
            for lane in range(LANES):
                sample = first[lane] + (k if k < size[0] else min(k, size[lane] - 1))
                x, y = xy[sample, 0], xy[sample, 1]
                row[lane + _T], row[lane + _X], row[lane + _Y] = t[sample], x, y
                row[lane + _PX], row[lane + _PY], row[lane + _A] = x, y, 0.0
                row[lane + _SQUARE] = (
                    2.0 * variance[sample] if k < size[lane] else _NOTHING
                )
        blur = 1.0
        for turn in range(passes):
            _forward(buffer, n, q, blur)
            _backward(buffer, n, q)
            if turn > 0:
                blur *= anneal
        for k in range(n):
            row = buffer[(k + 1) * _ROW : (k + 2) * _ROW]
            for lane in range(max(-group, 0), LANES):
                if k < size[lane]:
                    sample = first[lane] + k
                    position[sample, 0] = row[lane + _PX]
                    position[sample, 1] = row[lane + _PY]
                    spread[sample] = row[lane + _A]
