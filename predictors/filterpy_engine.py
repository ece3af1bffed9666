"""The trackers run by filterpy itself, a loop per track: the readable reference.

The compiled kernels of `isac_track.kalman` give the same numbers much faster;
``kalman_cv:engine=filterpy`` runs this instead. Traps of filterpy 2.0.0 are heeded here: F, Q and
H are written out, H is set once, x stays one-dimensional, Q is that of continuous white noise
(which composes over steps), M is row-stochastic, a rejected sample never reaches `update`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import block_diag, expm

from isac_track.kalman import MAX_REJECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.types import Floats, Ints


def last_states(
    *,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: float,
    initial_mean: Floats,
    initial_cov: Floats,
    gate: float,
) -> tuple[Floats, Floats]:
    """Filter every track and return its last state: mean (N, 2, d) and covariance (N, d, d).

    Parameters are those of `isac_track.kalman.kalman_last`; d = 2 is constant velocity, d = 3
    constant acceleration.
    """
    n_tracks, _, d = initial_mean.shape
    mean = np.empty((n_tracks, 2, d))
    cov = np.empty((n_tracks, d, d))
    for track, (times, positions, noise) in enumerate(_tracks(t, xy, variance, offsets)):
        kf = _filter(initial_mean[track], initial_cov[track])
        misses = 0
        for k, z in enumerate(positions):
            if k > 0:
                dt = times[k] - times[k - 1]
                kf.predict(F=_motion(dt, d), Q=_process_noise(dt, q, d))
            innovation = z - kf.H @ kf.x
            spread = kf.P[0, 0] + noise[k]
            if innovation @ innovation / spread > gate and misses < MAX_REJECTIONS:
                misses += 1
                continue
            misses = 0
            kf.update(z, R=noise[k])
        mean[track] = kf.x.reshape(2, d)
        cov[track] = kf.P[:d, :d]
    return mean, cov


def last_modes(
    *,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: Floats,
    rates: Floats,
    initial_mean: Floats,
    initial_cov: Floats,
    initial_probability: Floats,
    gate: float,
) -> tuple[Floats, Floats, Floats]:
    """Run an interacting-multiple-model filter over every track and return its last modes.

    Every mode is a constant-velocity model with its own q; the modes change as a
    continuous-time Markov chain, so that M belongs to the step that follows.

    Parameters are those of `isac_track.kalman.imm_last`.

    Returns
    -------
    mean : (N, J, 2, 2)
        (position, velocity) per axis
    cov : (N, J, 4, 4)
        Of (x, vx, y, vy).
    probability : (N, J)
    """
    n_tracks, n_modes = initial_mean.shape[0], q.size
    mean = np.empty((n_tracks, n_modes, 2, 2))
    cov = np.empty((n_tracks, n_modes, 4, 4))
    probability = np.empty((n_tracks, n_modes))
    for track, (times, positions, noise) in enumerate(_tracks(t, xy, variance, offsets)):
        modes = [_filter(initial_mean[track], initial_cov[track]) for _ in range(n_modes)]
        steps = np.diff(times, append=times[-1])
        # The mixing for a step is computed with M at the end of the update before it, and the
        # first sample is updated without a step before it: M is the identity there.
        imm = IMMEstimator(modes, initial_probability.copy(), np.eye(n_modes))
        misses = 0
        for k, z in enumerate(positions):
            if k > 0:
                for mode, density in zip(modes, q, strict=True):
                    mode.F = _motion(steps[k - 1], 2)
                    mode.Q = _process_noise(steps[k - 1], density, 2)
                imm.predict()
            imm.M = expm(rates * steps[k])
            for mode in modes:
                mode.R = np.eye(2) * noise[k]
            if min(_distance2(mode, z) for mode in modes) > gate and misses < MAX_REJECTIONS:
                misses += 1
                imm.mu = imm.cbar.copy()  # update(None) would weigh the modes all the same
                imm._compute_mixing_probabilities()  # noqa: SLF001 - filterpy has no public way
                continue
            misses = 0
            imm.update(z)
        for number, mode in enumerate(modes):
            mean[track, number], cov[track, number] = mode.x.reshape(2, 2), mode.P
        probability[track] = imm.mu
    return mean, cov, probability


def _tracks(
    t: Floats, xy: Floats, variance: Floats, offsets: Ints
) -> Iterator[tuple[Floats, Floats, Floats]]:
    for lo, hi in pairwise(offsets):
        yield t[lo:hi], xy[lo:hi], variance[lo:hi]


def _motion(dt: float, d: int) -> Floats:
    one = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])[:d, :d]
    return np.asarray(block_diag(one, one))


def _process_noise(dt: float, q: float, d: int) -> Floats:
    one = Q_continuous_white_noise(dim=d, dt=dt, spectral_density=q)
    return np.asarray(block_diag(one, one))


def _filter(mean: Floats, cov: Floats) -> Any:  # noqa: ANN401 - filterpy has no types
    """Return a filter of (2, d) states of one covariance, (d, d), that measures positions."""
    d = mean.shape[1]
    kf = KalmanFilter(dim_x=2 * d, dim_z=2)
    kf.x = mean.reshape(-1).copy()
    kf.P = block_diag(cov, cov)
    kf.H = np.zeros((2, 2 * d))
    kf.H[0, 0] = kf.H[1, d] = 1.0
    return kf


def _distance2(mode: Any, z: Floats) -> float:  # noqa: ANN401
    innovation = z - mode.H @ mode.x
    spread = mode.H @ mode.P @ mode.H.T + mode.R
    return float(innovation @ np.linalg.solve(spread, innovation))
