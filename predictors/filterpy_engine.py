"""The trackers run by filterpy itself, a loop per track: the readable reference.

The compiled kernels of `isac_track.kalman` give the same numbers much faster;
``kalman_cv:engine=filterpy`` runs this instead. Traps of filterpy 2.0.0 are heeded
here: F, Q and H are written out, H is set once, x stays one-dimensional, Q is that of
continuous white noise (which composes over steps), M is row-stochastic, a rejected
sample never reaches `update`.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import block_diag, expm

from isac_track.kalman import MAX_REJECTIONS, Batch, Moods
from isac_track.kalman.slow_errors import SlowError
from isac_track.types import Floats


def last_states(
    batch: Batch, *, q: float, gate: float, error: SlowError | None = None
) -> tuple[Floats, Floats]:
    """Filter every track and return its last state: mean (N, 2, d) and covariance (N, d, d).

    Parameters are those of `isac_track.kalman.kalman_last`. A slow `error` is the last
    state.
    """
    n, d = len(batch), len(batch.prior_std) + (error is not None)
    mean, cov = np.empty((n, 2, d)), np.empty((n, d, d))
    for track, (kf, _) in enumerate(_filtered(batch, (q,), gate, error=error)):
        mean[track], cov[track] = kf.x.reshape(2, d), kf.P[:d, :d]
    return mean, cov


def last_modes(
    batch: Batch, moods: Moods, *, gate: float
) -> tuple[Floats, Floats, Floats]:
    """Run an interacting-multiple-model filter over every track and return its last modes.

    Every mode is a constant-velocity model with its own q; they change as a
    continuous-time Markov chain, so that M belongs to the step that follows. Otherwise
    as `isac_track.kalman.imm_last`.
    """
    n = len(batch)
    mean, cov, probability = (
        np.empty((n, 2, 2, 2)),
        np.empty((n, 2, 4, 4)),
        np.empty((n, 2)),
    )
    for track, (imm, modes) in enumerate(_filtered(batch, moods.q, gate, moods)):
        for number, mode in enumerate(modes):
            mean[track, number], cov[track, number] = mode.x.reshape(2, 2), mode.P
        probability[track] = imm.mu
    return mean, cov, probability


def _filtered(
    batch: Batch,
    q: tuple[float, ...],
    gate: float,
    moods: Moods | None = None,
    error: SlowError | None = None,
) -> Iterator[tuple[Any, list[Any]]]:
    """Yield the filter of each track after its last sample, and its modes: one without moods."""
    for lo, hi in pairwise(batch.offsets):
        modes = [_filter(batch.xy[lo], batch.prior_std, error) for _ in q]
        steps = np.diff(batch.t[lo:hi], append=batch.t[hi - 1])
        whole = modes[0]
        if moods:
            leave, come = 1.0 / np.array(moods.stay_s)
            rates = np.array([[-leave, leave], [come, -come]])
            # The mixing for a step is computed with M at the end of the update before
            # it, and the first sample is updated without a step before it: M is the
            # identity there.
            whole = IMMEstimator(modes, moods.probability, np.eye(2))
        misses = 0
        for k, z in enumerate(batch.xy[lo:hi]):
            if k > 0:
                for mode, density in zip(modes, q, strict=True):
                    mode.F, mode.Q = _model(
                        steps[k - 1], density, len(batch.prior_std), error
                    )
                whole.predict()
            for mode in modes:
                mode.R = np.eye(2) * batch.variance[lo + k]
            if moods:
                whole.M = expm(rates * steps[k])
            if (
                min(_distance2(mode, z) for mode in modes) > gate
                and misses < MAX_REJECTIONS
            ):
                misses += 1
                if moods:
                    whole.mu = (
                        whole.cbar.copy()
                    )  # update(None) would weigh the modes all the same
                    whole._compute_mixing_probabilities()  # noqa: SLF001 - there is no public way
                continue
            misses = 0
            whole.update(z)
        yield whole, modes


def _model(
    dt: float, q: float, d: int, error: SlowError | None
) -> tuple[Floats, Floats]:
    motion = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])[:d, :d]
    noise = Q_continuous_white_noise(dim=d, dt=dt, spectral_density=q)
    if error:
        motion = block_diag(motion, np.exp(-dt / error.tau_s))
        noise = block_diag(
            noise, -np.square(error.std_m) * np.expm1(-2.0 * dt / error.tau_s)
        )
    return np.kron(np.eye(2), motion), np.kron(np.eye(2), noise)


def _filter(
    start: Floats, prior_std: tuple[float, ...], error: SlowError | None
) -> Any:  # noqa: ANN401 - no types
    """Return a filter of positions, at rest at `start`."""
    std = [*prior_std, float(error.std_m)] if error else list(prior_std)
    position = np.eye(1, len(std))
    kf = KalmanFilter(dim_x=2 * len(std), dim_z=2)
    kf.H = np.kron(
        np.eye(2), position + np.eye(1, len(std), len(std) - 1) if error else position
    )
    kf.x = start @ np.kron(np.eye(2), position)
    kf.P = np.kron(np.eye(2), np.diag(std) ** 2)
    return kf


def _distance2(mode: Any, z: Floats) -> float:  # noqa: ANN401 - filterpy has no types
    innovation = z - mode.H @ mode.x
    return float(
        innovation @ np.linalg.solve(mode.H @ mode.P @ mode.H.T + mode.R, innovation)
    )
