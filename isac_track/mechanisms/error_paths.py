"""Paths of slow errors along a walk: drawn for a release, or once for a session."""

from importlib import import_module
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.random import Generator

from isac_track.rng import stream
from isac_track.sensing import track_directions
from isac_track.types import ErrorLaw, Floats, Ints, positive

Reuse: TypeAlias = Literal["release", "session"]
"""Errors are drawn anew for every release, or once for each walk and session."""
# Correlation times that a process remembers: after them 1e-10 of a value is left.
_MEMORY_BLOCKS = 24
# Points of a session's path within one correlation time; between them it is a line.
_POINTS = 512


def correlated_errors(
    *, t: Floats, offsets: Ints, law: ErrorLaw, tau_s: float, rng: Generator
) -> Floats:
    """Draw standardised errors that change slowly along each track, (M, 2).

    Every sample has the law of `isac_track.sensing.unit_errors`. Two samples c, d of a
    track have E[c . d] = exp(-|t_c - t_d| / tau_s) E[|c|^2]; tracks are independent.

    - `isotropic`: two Ornstein-Uhlenbeck (OU) processes.
    - `radial`: an OU process of time constant 2 tau_s times a direction that moves on
      the circle as Brownian motion, with E[cos turn] = exp(-dt / 2 tau_s).
    - `fixed_direction`: an OU process of time constant tau_s times a direction that is
      drawn once a track.

    All are exact at any instants, and use three draws a sample. `t` are (M,) s,
    increasing within a track, `offsets` (N + 1,), `tau_s` is positive. An unknown law
    is a ValueError.
    """
    if law not in get_args(ErrorLaw):
        raise ValueError(
            f"unknown error law {law!r}; known: {', '.join(get_args(ErrorLaw))}"
        )
    draws = rng.standard_normal((t.size, 3))
    first = offsets[:-1]
    dt_s = np.diff(t, prepend=t[:1])
    # In correlation times. Stationary from the first sample on, which depends on none.
    lags = dt_s / (2.0 * tau_s if law == "radial" else tau_s)
    lags[first] = np.inf
    decay, noise = np.exp(-lags), np.sqrt(-np.expm1(-2.0 * lags))
    if law == "isotropic":
        return _filter_in_place(decay, noise[:, None] * draws[:, 1:])
    amplitude = _filter_in_place(decay, noise[:, None] * draws[:, :1])
    if law == "fixed_direction":
        return amplitude * track_directions(draws[:, 1:], offsets=offsets)
    # The step from one track to the next may be negative.
    turn = np.sqrt(np.abs(dt_s) / tau_s) * draws[:, 1]
    turn[first] = np.arctan2(draws[first, 2], draws[first, 1])
    # A decay of 1 sums the turns; 0 starts a new track.
    no_decay = np.ones(t.size)
    no_decay[first] = 0.0
    angle = _filter_in_place(no_decay, turn[:, None])
    return np.asarray(amplitude * np.hstack([np.cos(angle), np.sin(angle)]))


def _filter_in_place(decay: Floats, step: Floats) -> Floats:
    """Overwrite steps, (M, D), with x_k = decay_k x_(k-1) + step_k, and return them."""
    import_module("isac_track.kalman._error_loops").recursion(decay, step)
    return step


def session_errors(*, t: Floats, offsets: Ints, walk: Ints, tau_s: float) -> Floats:
    """Return standardised Ornstein-Uhlenbeck errors that depend on the walk, (M, 2).

    An instant of a walk has the same error in every release: the path of errors follows
    from the number of the walk alone. Its values at multiples of `tau_s` are those of a
    stationary process. Between them lies a bridge, exact at 512 points and linear
    between these, with unit variance everywhere. `t` are (M,) s, `offsets` (N + 1,),
    `walk`, (N,), are the numbers.
    """
    errors = np.empty((t.size, 2))
    for number, first, end in zip(
        walk.tolist(), offsets[:-1], offsets[1:], strict=True
    ):
        place = t[first:end] / tau_s
        block = np.floor(place).astype(np.int64)
        known: dict[int, Floats] = {}
        for block_number in np.unique(block).tolist():
            path = _bridge(number, block_number, known)
            inside = np.flatnonzero(block == block_number)
            point = (place[inside] - block_number) * _POINTS
            left = np.minimum(point.astype(np.int64), _POINTS - 1)
            weight = (point - left)[:, None]
            mixed = (1.0 - weight) * path[left] + weight * path[left + 1]
            # The line between two points with correlation f has the variance
            # 1 - 2 w (1 - w) (1 - f).
            lost = -2.0 * np.expm1(-1.0 / _POINTS) * weight * (1.0 - weight)
            errors[first + inside] = mixed / np.sqrt(1.0 - lost)
    return errors


def _bridge(walk: int, block: int, known: dict[int, Floats]) -> Floats:
    """Return the path of a walk over one correlation time, (512 + 1, 2).

    `known` holds the draws of the blocks so far; new draws are added to it.
    """
    for number in range(block - _MEMORY_BLOCKS, block + 2):
        if number not in known:
            draws = stream(0, "session errors", walk, number).standard_normal(2)
            known[number] = draws
    start, end = _block_value(block, known), _block_value(block + 1, known)
    # Draw a free path from the start, then correct its miss of the end (Matheron's
    # rule).
    f = np.exp(-1.0 / _POINTS)
    grid = np.arange(_POINTS + 1) / _POINTS
    growth = np.exp(grid)[:, None]
    steps = stream(0, "session bridge", walk, block).standard_normal((_POINTS, 2))
    steps *= np.sqrt(-np.expm1(-2.0 / _POINTS))
    free = start / growth
    free[1:] += (
        np.cumsum(steps * f ** -np.arange(1.0, _POINTS + 1)[:, None], axis=0)
        / growth[1:]
    )
    pull = np.exp(-(1.0 - grid)) * np.expm1(-2.0 * grid) / np.expm1(-2.0)
    return np.asarray(free + pull[:, None] * (end - free[-1]))


def _block_value(block: int, known: dict[int, Floats]) -> Floats:
    """Return the stationary process after the draws up to a block, (2,).

    It is the value at which the path over that block begins.
    """
    decay = np.exp(-np.arange(_MEMORY_BLOCKS, dtype=float))
    scale = np.sqrt(-np.expm1(-2.0))
    draws = np.stack([known[block - age] for age in range(_MEMORY_BLOCKS)])
    return np.asarray(scale * (decay @ draws))


def check_slow(tau_s: float, reuse: str) -> None:
    """Raise ValueError for a time that is not positive, or an unknown reuse."""
    positive("tau_s", tau_s)
    if reuse not in ("release", "session"):
        raise ValueError(f"reuse must be release or session, got {reuse!r}")
