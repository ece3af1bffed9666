"""Our filter and smoother beside those of four libraries; see `benchmarks.beside`.

All get the same walks, slow ones fewer of them. The libraries get their transition and
noise matrices ready-made, outside the clock. simdkalman has a single step and a single
noise for all walks.
"""

# Peers are imported where they are used: any of them may be missing.
# ruff: noqa: PLC0415 - as said
from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track import kalman
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from isac_track.types import Floats

    States = list[Floats]
    """(M, 2) positions and their variance per axis, (M,)."""
    Track = tuple[Floats, Floats, Floats, Floats, Floats, tuple[Floats, Floats]]
    """t, (K, 2) positions, F and Q of each step, R of each sample, mean and prior."""

Q = 0.3
STEP_S = 0.08
N_SAMPLES = 366
H = np.kron(np.eye(2), [[1.0, 0.0]])


def rows() -> Iterator[tuple[str, str, Callable[[], States], Callable[[], States]]]:
    """Yield work, library, our function and theirs: both smooth the same walks."""
    for name, build, n_tracks in (
        ("filterpy", filterpy, 20),
        ("pykalman", pykalman, 20),
        ("stonesoup", stonesoup, 4),
        ("simdkalman", simdkalman, 1000),
    ):
        batch = walks(n_tracks=n_tracks, constant=name == "simdkalman")
        work = f"smoothing, {n_tracks:,} x {N_SAMPLES} samples"
        ours = partial(smooth, batch)
        yield work, name, ours, build(batch) if find_spec(name) else ours


def smooth(batch: kalman.Batch) -> States:
    """Filter and smooth with our code."""
    return list(kalman.smooth_positions(batch, q=Q))


def walks(*, n_tracks: int, constant: bool) -> kalman.Batch:
    """Simulate walks; steps and noise are constant or differ from sample to sample."""
    rng, shape = stream(0, "benchmark", "kernels"), (n_tracks, N_SAMPLES)
    # whole milliseconds: Stone Soup's clock has microseconds
    steps = np.full(shape, STEP_S) if constant else rng.integers(50, 130, shape) / 1000
    variance = np.full(shape, 0.04) if constant else rng.uniform(0.01, 0.5, shape)
    steps[:, 0] = 0.0
    velocity = np.sqrt(Q * steps)[..., None] * rng.standard_normal((*shape, 2))
    xy = np.cumsum(np.cumsum(velocity, axis=1) * steps[..., None], axis=1)
    xy += np.sqrt(variance)[..., None] * rng.standard_normal((*shape, 2))
    return kalman.Batch(
        t=np.cumsum(steps, axis=1).round(6).ravel(),
        xy=xy.reshape(-1, 2),
        variance=variance.ravel(),
        offsets=np.arange(n_tracks + 1) * N_SAMPLES,
        prior_std=(3.0, 1.5),
    )


def matrices(steps: Floats) -> tuple[Floats, Floats]:
    """Return F and Q, (..., 4, 4), of (x, vx, y, vy) over steps of any shape."""
    ones = np.ones_like(steps)
    axis = np.stack([ones, steps, 0 * ones, ones], -1).reshape(*steps.shape, 2, 2)
    noise = Q * np.stack([steps**3 / 3, steps**2 / 2, steps**2 / 2, steps], -1)
    f = np.kron(np.eye(2), axis)
    q = np.kron(np.eye(2), noise.reshape(axis.shape))
    return np.asarray(f, np.float64), np.asarray(q, np.float64)


def per_track(batch: kalman.Batch) -> Iterator[Track]:
    """Yield the samples, matrices and prior of each track."""
    cov = np.kron(np.eye(2), np.diag(batch.prior_std) ** 2)
    for low, high in pairwise(batch.offsets):
        t, xy = batch.t[low:high], batch.xy[low:high]
        r = batch.variance[low:high, None, None] * np.eye(2)
        f, q = matrices(np.diff(t, prepend=t[0]))
        yield t, xy, f, q, r, (np.kron(xy[0], [1.0, 0.0]), cov)


def together(run: Callable[[Any], tuple[Any, Any]], ready: list[Any]) -> States:
    """Return the states of all tracks, one after the other."""
    means, covs = zip(*map(run, ready), strict=True)
    mean, cov = np.concatenate(means), np.concatenate(covs)
    return [
        mean.reshape(-1, 4)[:, ::2].astype(np.float64),
        cov[:, 0, 0].astype(np.float64),
    ]


def filterpy(batch: kalman.Batch) -> Callable[[], States]:
    """Smooth with a KalmanFilter a track: predict, update, then its rts_smoother."""
    from filterpy.kalman import KalmanFilter

    def run(track: Track) -> tuple[Floats, Floats]:
        _, xy, f, q, r, (start, prior) = track
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.H, kf.x, kf.P = H, start, prior
        mean, cov = np.empty((len(xy), 4)), np.empty((len(xy), 4, 4))
        for k, seen in enumerate(xy):
            kf.predict(F=f[k], Q=q[k])
            kf.update(seen, R=r[k])
            mean[k], cov[k] = kf.x, kf.P
        smooth_mean, smooth_cov, *_ = kf.rts_smoother(mean, cov, f, q)
        return smooth_mean, smooth_cov

    return partial(together, run, list(per_track(batch)))


def pykalman(batch: kalman.Batch) -> Callable[[], States]:
    """Smooth with a KalmanFilter a track, with matrices a step, in both passes."""
    from pykalman import KalmanFilter

    filters = []
    for _, xy, f, q, r, (start, prior) in per_track(batch):
        first = {"initial_state_mean": start, "initial_state_covariance": prior}
        filters.append((KalmanFilter(f[1:], H, q[1:], r, **first), xy))
    return partial(together, lambda ready: ready[0].smooth(ready[1]), filters)


def stonesoup(batch: kalman.Batch) -> Callable[[], States]:
    """Smooth detections that carry their noise with predictor, updater and smoother."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition import linear
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.smoother.kalman import KalmanSmoother
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.types.track import Track as Steps
    from stonesoup.updater.kalman import KalmanUpdater

    model = linear.CombinedLinearGaussianTransitionModel(
        [linear.ConstantVelocity(Q)] * 2
    )
    predictor, updater = KalmanPredictor(model), KalmanUpdater(None)
    smoother, epoch = KalmanSmoother(model), datetime(2000, 1, 1, tzinfo=UTC)

    def detections(track: Track) -> list[Any]:
        t, xy, _, _, r, _ = track
        models = [LinearGaussian(4, (0, 2), covariance) for covariance in r]
        times = [epoch + timedelta(seconds=float(seconds)) for seconds in t]
        return [
            Detection(position[:, None], timestamp=time, measurement_model=noise)
            for position, time, noise in zip(xy, times, models, strict=True)
        ]

    def run(ready: tuple[list[Any], tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        (first, *later), (start, prior) = ready
        options = {"timestamp": first.timestamp, "transition_model": model}
        prediction = GaussianStatePrediction(start[:, None], prior, **options)
        track = Steps([updater.update(SingleHypothesis(prediction, first))])
        for detection in later:
            prediction = predictor.predict(track[-1], timestamp=detection.timestamp)
            track.append(updater.update(SingleHypothesis(prediction, detection)))
        states = smoother.smooth(track)
        means = np.array([state.state_vector for state in states])
        return means, np.array([state.covar for state in states])

    ready = [(detections(track), track[-1]) for track in per_track(batch)]
    return partial(together, run, ready)


def simdkalman(batch: kalman.Batch) -> Callable[[], States]:
    """Smooth all tracks at once, each axis as a series of its own."""
    from simdkalman import KalmanFilter

    f, q = matrices(np.array(STEP_S))
    kf = KalmanFilter(f[:2, :2], q[:2, :2], H[:1, :2], batch.variance[0])
    start = batch.xy[batch.offsets[:-1]][:, None]
    centred = batch.xy.reshape(-1, N_SAMPLES, 2) - start
    series = centred.swapaxes(1, 2).reshape(-1, N_SAMPLES)
    first = {
        "initial_value": np.zeros(2),
        "initial_covariance": np.diag(batch.prior_std) ** 2,
    }

    def run() -> States:
        states = kf.smooth(series, **first, observations=False).states
        xy = states.mean[..., 0].reshape(-1, 2, N_SAMPLES).swapaxes(1, 2) + start
        return [xy.reshape(-1, 2), states.cov[::2, :, 0, 0].ravel()]

    return run
