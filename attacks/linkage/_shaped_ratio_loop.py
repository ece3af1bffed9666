"""Compiled loop of the likelihood ratio behind errors with a shape.

A pair's result does not depend on other walks.
"""

from math import cos, exp, log, log1p, pi, sin, sqrt
from typing import TypeAlias

import numpy as np

from isac_track.compiling import compiled, part_of_loop, read, together, written
from isac_track.types import Floats

_Side: TypeAlias = tuple[Floats, Floats, Floats]
"""Information of walks at each lag, (L, N, 2 K, 2 K), pull, (L, N, 2 K), evidence."""
_SIDE = together(read(4), read(3), read(2))
_TURNS = 24
_STEP = 2.0 * pi / _TURNS
_SHARP = 50.0  # Concentration beyond which the peak is too narrow for these turns.
_GOLDEN = 0.6180339887498949
_N_GOLDEN = 14
_NEAR = 1e-3  # rad, step of the second derivative at the peak.


@part_of_loop
def _exponent(
    turn: float,
    first: tuple[Floats, Floats],
    second: tuple[Floats, Floats],
    prior: Floats,
    work: tuple[Floats, Floats],
) -> float:
    """Return v' M^-1 v / 2 - ln |M| / 2 with the second walk turned by an angle."""
    (a1, h1), (a2, h2), (m, v) = first, second, work
    n = v.size
    c, s = cos(turn), sin(turn)
    for a in range(0, n, 2):
        v[a] = h1[a] + c * h2[a] - s * h2[a + 1]
        v[a + 1] = h1[a + 1] + s * h2[a] + c * h2[a + 1]
        for b in range(0, a + 2, 2):
            e, f, g, h = a2[a, b], a2[a, b + 1], a2[a + 1, b], a2[a + 1, b + 1]
            p, q, r, t = c * e - s * g, c * f - s * h, s * e + c * g, s * f + c * h
            m[a, b] = a1[a, b] + c * p - s * q
            m[a, b + 1] = a1[a, b + 1] + s * p + c * q
            m[a + 1, b] = a1[a + 1, b] + c * r - s * t
            m[a + 1, b + 1] = a1[a + 1, b + 1] + s * r + c * t
        m[a, a] += prior[a // 2]
        m[a + 1, a + 1] += prior[a // 2]
    total = 0.0
    for a in range(n):  # Cholesky's factor, and the solution on the way
        for b in range(a):
            entry = m[a, b]
            for d in range(b):
                entry -= m[a, d] * m[b, d]
            m[a, b] = entry / m[b, b]
        square, rest = m[a, a], v[a]
        for d in range(a):
            square -= m[a, d] * m[a, d]
            rest -= m[a, d] * v[d]
        m[a, a] = sqrt(square)
        v[a] = rest / m[a, a]
        total += v[a] * v[a] / 2.0 - log(m[a, a])
    return total


@part_of_loop
def _log_mean(
    first: tuple[Floats, Floats],
    second: tuple[Floats, Floats],
    prior: Floats,
    work: tuple[Floats, Floats],
    values: Floats,
) -> float:
    """Return the log of the mean over all turns of the second walk.

    It is the mean of a number of turns, or Laplace's method about a narrow peak.
    """
    best = 0
    for j in range(_TURNS):
        values[j] = _exponent(j * _STEP, first, second, prior, work)
        if values[j] > values[best]:
            best = j
    beside = values[best - 1] + values[(best + 1) % _TURNS]
    sharpness = (2.0 * values[best] - beside) / (2.0 - 2.0 * cos(_STEP))
    if sharpness <= _SHARP:
        total = 0.0
        for j in range(_TURNS):
            total += exp(values[j] - values[best])
        return float(values[best] + log(total / _TURNS))
    low, high = (best - 1) * _STEP, (best + 1) * _STEP
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left = _exponent(left, first, second, prior, work)
    at_right = _exponent(right, first, second, prior, work)
    for _ in range(_N_GOLDEN):
        if at_left > at_right:
            high, right, at_right = right, left, at_left
            left = high - _GOLDEN * (high - low)
            at_left = _exponent(left, first, second, prior, work)
        else:
            low, left, at_left = left, right, at_right
            right = low + _GOLDEN * (high - low)
            at_right = _exponent(right, first, second, prior, work)
    peak = (low + high) / 2.0
    middle = _exponent(peak, first, second, prior, work)
    before = _exponent(peak - _NEAR, first, second, prior, work)
    after = _exponent(peak + _NEAR, first, second, prior, work)
    bend = max((2.0 * middle - before - after) / _NEAR**2, 1.0)
    # A parabola through the three values; the last term is that of a Bessel function.
    top = middle + ((after - before) / (2.0 * _NEAR)) ** 2 / (2.0 * bend)
    return float(top - log(2.0 * pi * bend) / 2.0 + log1p(1.0 / (8.0 * bend)))


@compiled(_SIDE, _SIDE, read(2), read(1), written(2))
def shaped_ratios(
    probe: _Side, gallery: _Side, prior: Floats, log_lag: Floats, out: Floats
) -> None:
    """Fill `out`, (P, G), with log ratios averaged over all turns and lags.

    `prior`, (L, K), is the information of the walks' prior, and `log_lag`, (L,), the
    log weight of each lag.
    """
    (p_information, p_pull, p_evidence), n_lags = probe, log_lag.size
    g_information, g_pull, g_evidence = gallery
    n = p_pull.shape[2]
    work, values = (np.empty((n, n)), np.empty(n)), np.empty(_TURNS)
    terms = np.empty(n_lags)
    for i, j in np.ndindex(len(out), out.shape[1]):
        best = -np.inf
        for lag in range(n_lags):
            first = p_information[lag, i], p_pull[lag, i]
            second = g_information[lag, j], g_pull[lag, j]
            terms[lag] = log_lag[lag] + p_evidence[lag, i] + g_evidence[lag, j]
            terms[lag] += _log_mean(first, second, prior[lag], work, values)
            best = max(best, terms[lag])
        total = 0.0
        for lag in range(n_lags):
            total += exp(terms[lag] - best)
        out[i, j] = best + log(total)
