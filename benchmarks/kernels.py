"""Filter and smoother beside their peers: ``python -m benchmarks.kernels``.

Prints the tables of ``docs/kernels.md``. All libraries filter and smooth the same simulated
walks, with irregular steps and a noise of its own per sample; results are compared before
anything is timed. Peers get their transition and noise matrices ready-made, outside the clock;
slow ones run on the first few walks only, which changes no time per sample.
"""

# Peers are imported where they are used: any of them may be missing.
# ruff: noqa: PLC0415 - as said
from __future__ import annotations

import argparse
import os
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from importlib.util import find_spec
from platform import processor, python_version
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track import kalman
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.types import Floats

Q = 0.3
STEP_S = 0.08
TOLERANCE = 1e-9
H = np.kron(np.eye(2), [[1.0, 0.0]])


def first(batch: kalman.Batch, n_tracks: int) -> kalman.Batch:
    """Return the first few tracks."""
    end = batch.offsets[n_tracks]
    return kalman.Batch(
        *(batch.t[:end], batch.xy[:end], batch.variance[:end]),
        *(batch.offsets[: n_tracks + 1], batch.prior_std),
    )


def prior(batch: kalman.Batch, xy: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of (x, vx, y, vy) before the first sample of a track."""
    mean = np.array([xy[0, 0], 0.0, xy[0, 1], 0.0])
    return mean, np.kron(np.eye(2), np.diag(batch.prior_std) ** 2)


def walks(*, n_tracks: int, n_samples: int, constant: bool) -> kalman.Batch:
    """Simulate; steps and noise are constant or differ from sample to sample."""
    rng = stream(0, "benchmark", "kernels")
    shape = (n_tracks, n_samples)
    # whole milliseconds: Stone Soup's clock has microseconds
    steps = np.full(shape, STEP_S) if constant else rng.integers(50, 130, shape) / 1000
    variance = np.full(shape, 0.04) if constant else rng.uniform(0.01, 0.5, shape)
    steps[:, 0] = 0.0
    f, q = matrices(steps)
    state = rng.normal(0, 1, (n_tracks, 4))
    xy = np.empty((*shape, 2))
    for k in range(n_samples):
        state = (f[:, k] @ state[..., None])[..., 0]
        if k > 0:
            noise = np.linalg.cholesky(q[:, k]) @ rng.standard_normal((n_tracks, 4, 1))
            state += noise[..., 0]
        xy[:, k] = state[:, [0, 2]] + np.sqrt(variance[:, k, None]) * rng.standard_normal(
            (n_tracks, 2)
        )
    return kalman.Batch(
        t=np.cumsum(steps, axis=1).round(6).ravel(),
        xy=xy.reshape(-1, 2),
        variance=variance.ravel(),
        offsets=np.arange(n_tracks + 1) * n_samples,
        prior_std=(3.0, 1.5),
    )


def matrices(steps: Floats) -> tuple[Floats, Floats]:
    """Return F and Q, (..., 4, 4), of (x, vx, y, vy) over steps of any shape."""
    one = np.ones_like(steps)
    axis = np.stack([one, steps, 0 * one, one], -1).reshape(*steps.shape, 2, 2)
    noise = [steps**3 / 3, steps**2 / 2, steps**2 / 2, steps]
    axis_noise = Q * np.stack(noise, -1).reshape(*steps.shape, 2, 2)
    return np.kron(np.eye(2), axis), np.kron(np.eye(2), axis_noise)


def ours(batch: kalman.Batch) -> tuple[Floats, Floats]:
    """Filter and smooth; (M, 2) positions and their variance per axis, (M,)."""
    return kalman.smooth_positions(batch, q=Q)


def filterpy(batch: kalman.Batch) -> Callable[[], tuple[Floats, Floats]]:
    """One KalmanFilter a track: predict, update, then its rts_smoother."""
    from filterpy.kalman import KalmanFilter

    def run() -> tuple[Floats, Floats]:
        means, covs = [], []
        for f, q, xy, noise in per_track:
            kf = KalmanFilter(dim_x=4, dim_z=2)
            kf.H = H
            kf.x, kf.P = prior(batch, xy)
            mean, cov = np.empty((len(xy), 4)), np.empty((len(xy), 4, 4))
            for k in range(len(xy)):
                kf.predict(F=f[k], Q=q[k])
                kf.R = noise[k]
                kf.update(xy[k])
                mean[k], cov[k] = kf.x, kf.P
            mean, cov, _, _ = kf.rts_smoother(mean, cov, f, q)
            means.append(mean)
            covs.append(cov)
        return np.concatenate(means), np.concatenate(covs)[:, :2, :2]

    per_track = [
        (*matrices(np.diff(t, prepend=t[0])), xy, r[:, None, None] * np.eye(2))
        for t, xy, r in split(batch)
    ]
    return run


def pykalman(batch: kalman.Batch) -> Callable[[], tuple[Floats, Floats]]:
    """One KalmanFilter a track, with matrices per step; its smooth does both passes."""
    from pykalman import KalmanFilter

    filters = []
    for t, xy, r in split(batch):
        f, q = matrices(np.diff(t))
        mean, cov = prior(batch, xy)
        kf = KalmanFilter(
            transition_matrices=f,
            observation_matrices=H,
            transition_covariance=q,
            observation_covariance=r[:, None, None] * np.eye(2),
            initial_state_mean=mean,
            initial_state_covariance=cov,
        )
        filters.append((kf, xy))

    def run() -> tuple[Floats, Floats]:
        means, covs = zip(*(kf.smooth(xy) for kf, xy in filters), strict=True)
        return np.concatenate(means), np.concatenate(covs)[:, :2, :2]

    return run


def stonesoup(batch: kalman.Batch) -> Callable[[], tuple[Floats, Floats]]:
    """Predictor, updater and smoother over detections that carry their noise."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.smoother.kalman import KalmanSmoother
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.types.track import Track
    from stonesoup.updater.kalman import KalmanUpdater

    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(Q), ConstantVelocity(Q)])
    predictor, updater = KalmanPredictor(model), KalmanUpdater(None)
    smoother = KalmanSmoother(model)
    start = datetime(2000, 1, 1, tzinfo=UTC)
    tracks = [
        [
            Detection(
                xy[k][:, None],
                timestamp=start + timedelta(seconds=float(t[k])),
                measurement_model=LinearGaussian(4, (0, 2), r[k] * np.eye(2)),
            )
            for k in range(t.size)
        ]
        for t, xy, r in split(batch)
    ]

    def run() -> tuple[Floats, Floats]:
        means, covs = [], []
        for (_, xy, _), detections in zip(split(batch), tracks, strict=True):
            mean, cov = prior(batch, xy)
            prediction = GaussianStatePrediction(
                mean[:, None],
                cov,
                timestamp=detections[0].timestamp,
                transition_model=model,
            )
            track = Track()
            for k, detection in enumerate(detections):
                if k > 0:
                    prediction = predictor.predict(track[-1], timestamp=detection.timestamp)
                track.append(updater.update(SingleHypothesis(prediction, detection)))
            for state in smoother.smooth(track):
                means.append(np.asarray(state.state_vector).ravel())
                covs.append(np.asarray(state.covar)[:2, :2])
        return np.array(means, dtype=np.float64), np.array(covs, dtype=np.float64)

    return run


def simdkalman(batch: kalman.Batch) -> Callable[[], tuple[Floats, Floats]]:
    """All tracks at once; one step and one noise for all, both axes as series of their own."""
    from simdkalman import KalmanFilter

    n_tracks = len(batch)
    f, q = matrices(np.array(STEP_S))
    kf = KalmanFilter(
        state_transition=f[:2, :2],
        process_noise=q[:2, :2],
        observation_model=H[:1, :2],
        observation_noise=batch.variance[0],
    )
    start = batch.xy[batch.offsets[:-1]]
    from_start = batch.xy.reshape(n_tracks, -1, 2) - start[:, None]
    series = from_start.swapaxes(1, 2).reshape(2 * n_tracks, -1)

    def run() -> tuple[Floats, Floats]:
        states = kf.smooth(
            series,
            initial_value=np.zeros(2),
            initial_covariance=np.diag(batch.prior_std) ** 2,
            observations=False,
        ).states
        mean = states.mean.reshape(n_tracks, 2, -1, 2).swapaxes(1, 2)
        mean[..., 0] += start[:, None]
        return mean.reshape(-1, 4), states.cov[::2].reshape(-1, 2, 2)

    return run


def split(batch: kalman.Batch) -> list[tuple[Floats, Floats, Floats]]:
    """Return (t, xy, variance) of each track."""
    inner = batch.offsets[1:-1]
    parts = (np.split(array, inner) for array in (batch.t, batch.xy, batch.variance))
    return list(zip(*parts, strict=True))


def best(run: Callable[[], object], *, repeats: int) -> float:
    """Return the shortest of several wall times, s."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        run()
        times.append(perf_counter() - start)
    return min(times)


def check(name: str, result: tuple[Floats, Floats], batch: kalman.Batch) -> float:
    """Return the largest difference from ours; stop if it is not a rounding error."""
    mean, cov = result
    positions = (mean[:, ::2], cov[:, 0, 0])
    worst = max(
        float(np.abs(theirs - mine).max())
        for theirs, mine in zip(positions, ours(batch), strict=True)
    )
    if not worst <= TOLERANCE:
        raise SystemExit(f"{name} and the kernels differ by {worst:.1e}: nothing to compare")
    return worst


def compare(title: str, batch: kalman.Batch, peers: dict[str, tuple[Any, int]]) -> None:
    """Print a table of times per filtered-and-smoothed sample."""
    # many repeats: ours take milliseconds, and other work on the machine comes in bursts
    mine = best(lambda: ours(batch), repeats=50) / batch.t.size
    print(f"\n{title}: {len(batch):,} walks, {batch.t.size:,} samples\n")
    print("| library | us per sample | ratio | largest difference |")
    print("|---|---:|---:|---:|")
    print(f"| isac_track.kalman | {1e6 * mine:.4f} | 1 | |")
    for name, (build, n_tracks) in peers.items():
        if find_spec(name) is None:
            print(f"| {name} | missing: `pip install {name}` | | |")
            continue
        part = first(batch, n_tracks)
        run = build(part)
        worst = check(name, run(), part)
        theirs = best(run, repeats=3) / part.t.size
        label = f"{name} {version(name)}"
        print(f"| {label} | {1e6 * theirs:.3g} | {theirs / mine:,.0f} | {worst:.0e} |")


def all_models(batch: kalman.Batch) -> None:
    """Print a table of our own times: every model, every function."""
    accelerated = replace(batch, prior_std=(3.0, 1.5, 1.0))
    moods = kalman.Moods((0.05, Q), (4.0, 4.0))
    runs: dict[str, Callable[[], object]] = {
        "cv, last state": lambda: kalman.kalman_last(batch, q=Q),
        "cv, smoothed positions": lambda: kalman.smooth_positions(batch, q=Q),
        "ca, last state": lambda: kalman.kalman_last(accelerated, q=Q),
        "imm, last state": lambda: kalman.imm_last(batch, moods),
        "imm, smoothed positions": lambda: kalman.imm_smoother(batch, moods),
    }
    print("\nEvery model, us per sample\n")
    print("| what | time |")
    print("|---|---:|")
    for name, run in runs.items():
        print(f"| {name} | {1e6 * best(run, repeats=10) / batch.t.size:.3f} |")


def main() -> None:
    """Check, time and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--walks", type=int, default=1000, help="default: %(default)s")
    parser.add_argument("--samples", type=int, default=366, help="each; default: %(default)s")
    options = parser.parse_args()
    kalman.prepare()
    load = os.getloadavg()[0]
    print(f"Python {python_version()}, {processor() or 'processor unknown'}, ", end="")
    print(f"{os.cpu_count()} cores, load {load:.1f}; one process, one thread")
    size = {"n_tracks": options.walks, "n_samples": options.samples}
    variable = walks(**size, constant=False)
    few = {
        "filterpy": (filterpy, min(20, options.walks)),
        "pykalman": (pykalman, min(20, options.walks)),
        "stonesoup": (stonesoup, min(4, options.walks)),
    }
    compare("Variable steps and noise", variable, few)
    every = {"simdkalman": (simdkalman, options.walks)}
    compare("Constant steps and noise", walks(**size, constant=True), every)
    all_models(variable)
    print(f"\nload at the end {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
