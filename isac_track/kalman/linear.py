"""Kalman filter and smoother of many tracks at once: the front of the compiled loops.

Two models, each per axis: constant velocity, ``cv``, with state (position, velocity), and
constant acceleration, ``ca``, with state (position, velocity, acceleration). What is held
constant is driven by continuous white noise of spectral density q, so that predictions over
irregular steps compose. Both axes have the same measurement variance and no correlation;
they share one covariance. For interacting models see `isac_track.kalman.imm`.

Nothing here imports numba before the first call; that call compiles (`kalman.prepare`).

References
----------
Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001:
sections 5.2 (filter), 6.2 (models), 8.6 (smoother). Rauch, Tung, Striebel, AIAA J. 3(8), 1965.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from isac_track.kalman.arguments import covariances, floats, positive, ragged_times, variances

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

Model: TypeAlias = Literal["cv", "ca"]

MAX_REJECTIONS = 3
"""After so many rejected samples in a row the next is accepted whatever it says: a gate may
drop outliers, it may not lose a track."""

_STATES = {"cv": 2, "ca": 3}


@dataclass(frozen=True, eq=False, slots=True)
class LastState:
    """States of N tracks after their last sample; d states per axis."""

    mean: Floats
    """(N, 2, d) m, m/s, m/s^2: per axis position, velocity, then acceleration (``ca``)."""
    cov: Floats
    """(N, d, d) covariance of either axis; the axes are independent."""
    log_likelihood: Floats
    """(N,) log density of a track's accepted samples, 1/m^2 each."""


def kalman_last(
    *,
    model: Model,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float = np.inf,
) -> LastState:
    """Return the state of every track after its last sample.

    Parameters
    ----------
    model : {"cv", "ca"}
    t : (M,) s
        Strictly increasing within a track.
    xy : (M, 2) m
    variance : (M,) m^2
        Measurement variance per axis, positive.
    offsets : (N + 1,) int
        Track i owns the samples ``offsets[i]:offsets[i + 1]``; none is empty.
    q : float
        Spectral density of the driving white noise, positive: of the acceleration (m^2/s^3) for
        ``cv``, of the jerk (m^2/s^5) for ``ca``.
    initial_mean : (N, 2, d)
    initial_cov : (N, d, d)
        Prior state at the time of a track's first sample, which is then measured like any
        other. Symmetric positive definite.
    gate : float, optional
        A sample whose normalised innovation squared exceeds it is not used, unless
        `MAX_REJECTIONS` samples before it were not. Chi-square with 2 degrees of freedom: 13.8
        keeps all but one sample in a thousand. Default: all are used.

    Raises
    ------
    ValueError
        If shapes disagree, a number is not finite, a track is empty, times do not increase or a
        variance is not positive.
    """
    if model not in _STATES:
        raise ValueError(f"model must be one of {get_args(Model)}, got {model!r}")
    d = _STATES[model]
    arrays = _arguments(t, xy, variance, offsets, q, initial_mean, initial_cov, d=d)
    out = LastState(*(np.empty((arrays[3].size - 1, *size)) for size in ((2, d), (d, d), ())))
    loops = import_module("isac_track.kalman._linear_loops")
    getattr(loops, f"{model}_last")(
        *(*arrays, positive("gate", gate, finite=False), MAX_REJECTIONS),
        *(out.mean, out.cov, out.log_likelihood),
    )
    return out


def smooth_positions(
    *,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    passes: int = 1,
    anneal: float = 0.0,
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    One pass is a Rauch-Tung-Striebel smoother of the model ``cv``; velocities are left out.
    Further passes are for errors of the radial law, whose length is |N(0, sigma)| in any
    direction. Its density in the plane, exp(-r^2 / 2 sigma^2) / r up to a constant, is infinite at
    zero: a sample that lies close to the walk is very likely almost exact. The posterior mode
    solves a smoother with the weights 1 / r^2 + 1 / sigma^2 per axis, r the sample's distance from
    the smoothed position; they are iterated as 1 / (r^2 + delta^2) + 1 / sigma^2. With
    delta^2 = 2 P + anneal^(m - 1) sigma^2 after the m-th pass a residual counts as no smaller than
    the position itself is known (P is its variance per axis), and the first passes are nearly those
    of Gaussian errors, lest the walk be drawn to samples that only happen to lie where it starts.

    Parameters
    ----------
    t, xy, variance, offsets, q, initial_mean, initial_cov
        As for `kalman_last`; sigma^2 is twice the variance per axis.
    passes : int, optional
        Smoothers, at least 1; the first is that of Gaussian errors.
    anneal : float, optional
        In [0, 1).

    Raises
    ------
    ValueError
        As `kalman_last`, and for `passes` or `anneal` out of range.

    References
    ----------
    Iterative re-weighting: Huber and Ronchetti, *Robust Statistics*, 2009, ch. 7.8; the mode of a
    scale mixture: Dempster, Laird, Rubin, *Multivariate Analysis V*, 1980.
    """
    if passes < 1 or not 0 <= anneal < 1:
        raise ValueError(f"need passes >= 1 and 0 <= anneal < 1, got {passes} and {anneal}")
    t, xy, variance, offsets, q, *prior = _arguments(
        t, xy, variance, offsets, q, initial_mean, initial_cov, d=2
    )
    position, spread = np.empty((t.size, 2)), np.empty(t.size)
    import_module("isac_track.kalman._lane_loops").smooth_positions(
        *(t, xy, 2.0 * variance, offsets, np.argsort(np.diff(offsets), kind="stable"), q, *prior),
        *(passes, float(anneal), position, spread),
    )
    return position, spread


def _arguments(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    *,
    d: int,
) -> tuple[Floats, Floats, Floats, Ints, float, Floats, Floats]:
    t, offsets = ragged_times(t, offsets)
    n_tracks = offsets.size - 1
    return (
        t,
        floats("xy", xy, (t.size, 2)),
        variances(variance, t.size),
        offsets,
        positive("q", q),
        floats("initial_mean", initial_mean, (n_tracks, 2, d)),
        covariances("initial_cov", initial_cov, (n_tracks, d, d)),
    )
