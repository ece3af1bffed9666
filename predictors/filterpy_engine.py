"""The trackers as a loop over filterpy for each track: the readable reference.

The compiled kernels of `isac_track.kalman` give the same numbers much faster;
``kalman_cv:engine=filterpy`` runs this instead. This code avoids traps of filterpy
2.0.0: F, Q and H are written out, H is set once, x stays one-dimensional, Q is that of
continuous white noise (which composes over steps), and a rejected sample never reaches
`update`. M, the probabilities of a change of mode, has rows that sum to 1.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import block_diag, expm

from isac_track.kalman import MAX_REJECTIONS, Batch, ImmStates, Moods, PlanarState
from isac_track.kalman.slow_errors import SlowError
from isac_track.types import Floats


def last_states(
    batch: Batch, *, q: float, gate: float, error: SlowError | None = None
) -> tuple[Floats, Floats]:
    """Return the last state of every track: mean (N, 2, D), covariance (N, D, D).

    Parameters are those of `isac_track.kalman.kalman_last`, whose d states per axis are
    the first of D. A slow `error` is a further state, the last of them.
    """
    state = planar_states(batch, q=q, gate=gate, error=error)
    return state.mean, state.cov[:, 0, :, 0]  # The other axis has the same.


def planar_states(
    batch: Batch, *, q: float, gate: float, error: SlowError | None = None
) -> PlanarState:
    """Return what `last_states` does, for errors with a shape, which couple the axes.

    The likelihood is not computed: it is NaN.
    """
    n, n_states = len(batch), len(batch.prior_std) + (error is not None)
    mean, cov = np.empty((n, 2, n_states)), np.empty((n, 2, n_states, 2, n_states))
    for track, (kf, _) in enumerate(_run_filters(batch, (q,), gate, error=error)):
        mean[track] = kf.x.reshape(2, n_states)
        cov[track] = kf.P.reshape(2, n_states, 2, n_states)
    return PlanarState(mean, cov, np.full(n, np.nan))


def last_modes(batch: Batch, moods: Moods, *, gate: float) -> ImmStates:
    """Return the last states of an interacting-multiple-model filter of every track.

    Every mode is a constant-velocity model with its own q. The modes change as a
    continuous-time Markov chain, so that M belongs to the step that follows. Parameters
    are those of `isac_track.kalman.imm_last`. The likelihood is not computed: it is
    NaN.
    """
    n = len(batch)
    mean, cov = np.empty((n, 2, 2, 2)), np.empty((n, 2, 4, 4))
    probability = np.empty((n, 2))
    for track, (imm, modes) in enumerate(_run_filters(batch, moods.q, gate, moods)):
        for number, mode in enumerate(modes):
            mean[track, number], cov[track, number] = mode.x.reshape(2, 2), mode.P
        probability[track] = imm.mu
    return ImmStates(mean, cov, probability, np.full(n, np.nan))


def _run_filters(
    batch: Batch,
    q: tuple[float, ...],
    gate: float,
    moods: Moods | None = None,
    error: SlowError | None = None,
) -> Iterator[tuple[Any, list[Any]]]:
    """Yield the filter of each track after its last sample, and its list of modes.

    Without moods there is one mode, the filter itself.
    """
    for lo, hi in pairwise(batch.offsets):
        modes = [_make_filter(batch.xy[lo], batch.prior_std, error) for _ in q]
        # The time from each sample to the next: 0 after the last.
        steps = np.diff(batch.t[lo:hi], append=batch.t[hi - 1])
        tracker = modes[0]
        if moods:
            leave, come = 1.0 / np.array(moods.stay_s)
            rates = np.array([[-leave, leave], [come, -come]])
            # An update ends with the mixing for the next step, by M. No step precedes
            # the first sample: M is the identity there.
            tracker = IMMEstimator(modes, moods.probability, np.eye(2))
        misses = 0
        for k, z in enumerate(batch.xy[lo:hi]):
            if k > 0:
                for mode, density in zip(modes, q, strict=True):
                    mode.F, mode.Q = _transition(
                        steps[k - 1], density, len(batch.prior_std), error
                    )
                tracker.predict()
            for mode in modes:
                shape = np.eye(2) if batch.ellipse is None else batch.ellipse[lo + k]
                mode.R = shape * batch.variance[lo + k]
            if moods:
                tracker.M = expm(rates * steps[k])
            nearest = min(_squared_distance(mode, z) for mode in modes)
            if nearest > gate and misses < MAX_REJECTIONS:
                misses += 1
                if moods:
                    # update(None) would change the weights of the modes.
                    tracker.mu = tracker.cbar.copy()
                    tracker._compute_mixing_probabilities()  # noqa: SLF001 - no public way
                continue
            misses = 0
            tracker.update(z)
        yield tracker, modes


def _transition(
    dt: float, q: float, d: int, error: SlowError | None
) -> tuple[Floats, Floats]:
    """Return F and Q of a step of both axes: d states of motion each, and the error."""
    motion = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])[:d, :d]
    noise = Q_continuous_white_noise(dim=d, dt=dt, spectral_density=q)
    if error:
        motion = block_diag(motion, np.exp(-dt / error.tau_s))
        noise = block_diag(
            noise, -np.square(error.std_m) * np.expm1(-2.0 * dt / error.tau_s)
        )
    return np.kron(np.eye(2), motion), np.kron(np.eye(2), noise)


def _make_filter(
    start: Floats, prior_std: tuple[float, ...], error: SlowError | None
) -> Any:  # noqa: ANN401 - no types
    """Return a filter of positions, at rest at `start`."""
    std = [*prior_std, float(error.std_m)] if error else list(prior_std)
    position = np.eye(1, len(std))
    kf = KalmanFilter(dim_x=2 * len(std), dim_z=2)
    # A slow error adds to the measured position.
    measured = position + np.eye(1, len(std), len(std) - 1) if error else position
    kf.H = np.kron(np.eye(2), measured)
    kf.x = start @ np.kron(np.eye(2), position)
    kf.P = np.kron(np.eye(2), np.diag(std) ** 2)
    return kf


def _squared_distance(mode: Any, z: Floats) -> float:  # noqa: ANN401 - no types
    """Return the squared Mahalanobis distance of a sample from its prediction."""
    innovation = z - mode.H @ mode.x
    return float(
        innovation @ np.linalg.solve(mode.H @ mode.P @ mode.H.T + mode.R, innovation)
    )
