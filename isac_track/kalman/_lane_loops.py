"""Compiled smoother of positions, eight tracks at a time.

Eight tracks lie side by side in one buffer, so that one vector instruction moves several of them:
three times as fast as one track after the other. A row of the buffer is one sample, a field of the
row eight numbers, one a track. The inner loops run over the tracks, from 0 to `LANES`; all
that they touch lies at fixed distances in one row and its neighbour, which is what a compiler needs
to see to vectorise them.

Tracks differ in length. Beyond its end a track has samples that change nothing, bit by bit: no
time passes, and the variance is a power of two so large that its gain vanishes. A track's
result thus does not depend on its neighbours.
"""

# ruff: noqa: PLR0917
from __future__ import annotations

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
    OUT_FLOATS2,
    compiled,
    part_of_loop,
)

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

LANES = 8
_NOTHING = 2.0**200
"""m^2, variance of the samples beyond the end of a track."""

# Where the fields of a row begin.
_T = 0
_X = 1 * LANES
_Y = 2 * LANES
_SQUARE = 3 * LANES  # sigma^2 of the error's length
_VARIANCE = 4 * LANES  # per axis, in this pass
_PX = 5 * LANES
_VX = 6 * LANES
_PY = 7 * LANES
_VY = 8 * LANES
_A = 9 * LANES
_B = 10 * LANES
_C = 11 * LANES
_DET = 12 * LANES
_G00 = 13 * LANES
_G01 = 14 * LANES
_G10 = 15 * LANES
_G11 = 16 * LANES
_C00 = 17 * LANES
_C01 = 18 * LANES
_C11 = 19 * LANES
_ROW = 20 * LANES


@part_of_loop
def _forward(buffer: Floats, n: int, q: float) -> None:
    """Filter as `_linear_loops.cv_last`; row 0 is the prior at the first sample, which is row 1.

    Beside each state gain G and open covariance C of the smoother are laid, multiplied out: little
    cancels. With P the filtered covariance, B = F^-1 Q F^-T and P' = F P F' + Q the smoothed one is
    C + G Ps G', where C = (|Q| P + |P| B) / |P'| (two-dimensional matrices only).
    """
    for k in range(n):
        rows = buffer[k * _ROW : (k + 2) * _ROW]
        for lane in range(LANES):
            at = lane + _ROW
            dt = rows[at + _T] - rows[lane + _T]
            a, b, c = rows[lane + _A], rows[lane + _B], rows[lane + _C]
            det = rows[lane + _DET]
            grown = q * dt
            det_q = grown * grown * dt * dt / 12
            inverse = 1 / (det + grown * (a + dt * (b + dt * c / 3)) + det_q)
            det_share = det * inverse
            det_q *= inverse
            share = grown * inverse
            spread = det_share * grown
            # det / det is not 1 to the last bit, and what changes nothing must.
            nothing = rows[at + _VARIANCE] == _NOTHING
            g00 = det_share + share * (a + dt * b / 2)
            g11 = det_share - share * dt * (b / 2 + dt * c / 6)
            rows[at + _G00] = 1.0 if nothing else g00
            rows[at + _G01] = -dt * (det_share + share * (a / 2 + dt * b / 6))
            rows[at + _G10] = share * (b + dt * c / 2)
            rows[at + _G11] = 1.0 if nothing else g11
            rows[at + _C00] = det_q * a + spread * dt * dt / 3
            rows[at + _C01] = det_q * b - spread * dt / 2
            rows[at + _C11] = det_q * c + spread

            det += grown * (a + dt * (b + dt * (c / 3 + grown / 12)))
            a += dt * (2 * b + dt * (c + grown / 3))
            b += dt * (c + grown / 2)
            c += grown
            vx, vy = rows[lane + _VX], rows[lane + _VY]
            px = rows[lane + _PX] + dt * vx
            py = rows[lane + _PY] + dt * vy
            r = rows[at + _VARIANCE]
            inverse = 1 / (a + r)
            ex, ey = rows[at + _X] - px, rows[at + _Y] - py
            gain_p, gain_v, shrink = a * inverse, b * inverse, r * inverse
            rows[at + _PX] = px + gain_p * ex
            rows[at + _VX] = vx + gain_v * ex
            rows[at + _PY] = py + gain_p * ey
            rows[at + _VY] = vy + gain_v * ey
            rows[at + _C] = (det + c * r) * inverse
            rows[at + _A] = a * shrink
            rows[at + _B] = b * shrink
            rows[at + _DET] = det * shrink


@part_of_loop
def _backward(buffer: Floats, n: int) -> None:
    """Smooth: the filtered state of each row gives way to the smoothed one."""
    for step in range(1, n):
        first = (n - step) * _ROW
        rows = buffer[first : first + 2 * _ROW]
        for lane in range(LANES):
            after = lane + _ROW
            dt = rows[after + _T] - rows[lane + _T]
            g00, g01 = rows[after + _G00], rows[after + _G01]
            g10, g11 = rows[after + _G10], rows[after + _G11]
            a, b, c = rows[after + _A], rows[after + _B], rows[after + _C]
            fx, fvx = rows[lane + _PX], rows[lane + _VX]
            fy, fvy = rows[lane + _PY], rows[lane + _VY]
            ex, evx = rows[after + _PX] - (fx + dt * fvx), rows[after + _VX] - fvx
            ey, evy = rows[after + _PY] - (fy + dt * fvy), rows[after + _VY] - fvy
            rows[lane + _PX] = fx + g00 * ex + g01 * evx
            rows[lane + _VX] = fvx + g10 * ex + g11 * evx
            rows[lane + _PY] = fy + g00 * ey + g01 * evy
            rows[lane + _VY] = fvy + g10 * ey + g11 * evy
            h00, h01 = g00 * a + g01 * b, g00 * b + g01 * c
            h10, h11 = g10 * a + g11 * b, g10 * b + g11 * c
            rows[lane + _A] = rows[after + _C00] + h00 * g00 + h01 * g01
            rows[lane + _B] = rows[after + _C01] + h00 * g10 + h01 * g11
            rows[lane + _C] = rows[after + _C11] + h10 * g10 + h11 * g11


@part_of_loop
def _reweigh(buffer: Floats, n: int, blur: float) -> None:
    """Set the variances of the next pass: 1 / (r^2 + delta^2) + 1 / sigma^2 is the weight."""
    for k in range(1, n + 1):
        row = buffer[k * _ROW : (k + 1) * _ROW]
        for lane in range(LANES):
            rx = row[lane + _X] - row[lane + _PX]
            ry = row[lane + _Y] - row[lane + _PY]
            square = row[lane + _SQUARE]
            near = rx * rx + ry * ry + 2 * row[lane + _A] + blur * square
            weighed = near * (square / (near + square))
            row[lane + _VARIANCE] = _NOTHING if square == _NOTHING else weighed


@part_of_loop
def _fill(
    t: Floats,
    xy: Floats,
    square: Floats,
    first: int,
    size: int,
    n: int,
    mean: Floats,
    cov: Floats,
    lane: int,
    buffer: Floats,
) -> None:
    """Lay a track into its lane: the prior, its samples, then samples that change nothing."""
    buffer[lane + _T] = t[first]
    buffer[lane + _PX], buffer[lane + _VX] = mean[0, 0], mean[0, 1]
    buffer[lane + _PY], buffer[lane + _VY] = mean[1, 0], mean[1, 1]
    a, b, c = cov[0, 0], cov[0, 1], cov[1, 1]
    buffer[lane + _A], buffer[lane + _B], buffer[lane + _C] = a, b, c
    buffer[lane + _DET] = a * c - b * b
    for k in range(n):
        at = (k + 1) * _ROW + lane
        own = first + min(k, size - 1)
        buffer[at + _T] = t[own]
        buffer[at + _X], buffer[at + _Y] = xy[own, 0], xy[own, 1]
        buffer[at + _SQUARE] = square[own] if k < size else _NOTHING
        buffer[at + _VARIANCE] = square[own] / 2 if k < size else _NOTHING


@compiled(
    *(FLOATS1, FLOATS2, FLOATS1, INTS1, INTS1, FLOAT, FLOATS3, FLOATS3, INT, FLOAT),
    *(OUT_FLOATS2, OUT_FLOATS1),
)
def smooth_positions(
    t: Floats,
    xy: Floats,
    square_sigma: Floats,
    offsets: Ints,
    order: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    passes: int,
    anneal: float,
    position: Floats,
    variance: Floats,
) -> None:
    """Smooth the tracks in `order` (neighbours should be of like length), `passes` times."""
    longest = 0
    for i in range(offsets.size - 1):
        longest = max(longest, offsets[i + 1] - offsets[i])
    buffer = np.zeros((longest + 1) * _ROW)
    for group in range(0, order.size, LANES):
        n = 0
        for lane in range(LANES):
            i = order[min(group + lane, order.size - 1)]  # the last track fills empty lanes
            n = max(n, offsets[i + 1] - offsets[i])
        for lane in range(LANES):
            i = order[min(group + lane, order.size - 1)]
            first = offsets[i]
            _fill(
                *(t, xy, square_sigma, first, offsets[i + 1] - first, n),
                *(initial_mean[i], initial_cov[i], lane, buffer),
            )
        blur = 1.0
        for turn in range(passes):
            if turn > 0:
                _reweigh(buffer, n, blur)
                blur *= anneal
            _forward(buffer, n, q)
            _backward(buffer, n)
        for lane in range(min(LANES, order.size - group)):
            i = order[group + lane]
            first = offsets[i]
            for k in range(offsets[i + 1] - first):
                at = (k + 1) * _ROW + lane
                position[first + k, 0] = buffer[at + _PX]
                position[first + k, 1] = buffer[at + _PY]
                variance[first + k] = buffer[at + _A]
