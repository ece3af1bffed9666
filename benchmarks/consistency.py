"""NIS and NEES of the trackers on data: `python -m benchmarks.consistency`.

Both have two degrees of freedom: their mean is 2 where model and noise are right, more
where the tracker is too sure of itself. NIS is that of the filter's one-step
predictions, NEES that of the forecast at the end of the horizon against the true
future, which no tuning has seen.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from isac_track import datasets, kalman, plugins
from isac_track.config import StageSettings
from isac_track.errors import DataError
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from predictors.kalman import KalmanCA, KalmanCV, KalmanIMM

if TYPE_CHECKING:
    from isac_track.types import Floats, Release

LEVELS = ("raw", "fixed:0.7,adding=independent", "fid:1,adding=independent")
N_SCENES = 100


def main() -> int:
    """Print the table; return 0."""
    head = f"{'data':<11}{'sharing':<30}{'tracker':<12}"
    print(f"{head}{'NIS':>6}{'NEES now':>10}{'at 0.92 s':>11}")
    stages = StageSettings()
    for name in ("plaza", "students03", "zara01"):
        try:
            recorded = datasets.load(name, download=False).tracks
        except DataError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        tracks = cut(recorded, settings=stages, seed=0)
        order = track_order(n_tracks=len(tracks), n_scenes=N_SCENES, agents=4, seed=0)
        scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=0)
        sensed = sense_scenes(scenes, settings=stages.sensing, seed=0)
        for level in plugins.parse_all("mechanisms", LEVELS):
            shared = level.instance.share(
                sensed, stream(0, "consistency")
            ).without_sigma()
            for tracker in (KalmanCV(), KalmanCA(), KalmanIMM()):
                forecast = tracker.predict(shared, scenes.t_future)
                gap, cov = forecast.mean - scenes.xy_future, forecast.cov
                assert cov is not None
                nees: Floats = np.einsum(
                    "nha,nhab,nhb->nh", gap, np.linalg.inv(cov), gap
                )
                nis = ""
                if not isinstance(tracker, KalmanIMM):
                    nis = f"{_nis(tracker, shared):.2f}"
                print(
                    f"{name:<11}{level.spec:<30}{type(tracker).__name__:<12}{nis:>6}"
                    f"{nees[:, 0].mean():>10.2f}{nees[:, -1].mean():>11.2f}"
                )
    return 0


def _nis(tracker: KalmanCV, shared: Release) -> float:
    """Return the mean NIS after the start-up of 32 samples."""
    batch, d = tracker.batch(shared), tracker.states
    sizes = np.diff(batch.offsets)
    parts = []
    for k in range(32, int(sizes.max(initial=0))):
        now = batch.offsets[:-1][sizes > k] + k
        rows = (now[:, None] - k + np.arange(k)).ravel()
        t, xy, variance = batch.t[rows], batch.xy[rows], batch.variance[rows]
        begun = kalman.Batch(
            t, xy, variance, k * np.arange(now.size + 1), batch.prior_std
        )
        last = kalman.kalman_last(begun, q=tracker.q)
        step = batch.t[now] - batch.t[now - 1]
        h = step[:, None] ** np.arange(d) / np.array([1.0, 1.0, 2.0])[:d]
        grown = tracker.q * step ** (2 * d - 1) / (3.0 if d == 2 else 20.0)
        spread = np.einsum("nd,nde,ne->n", h, last.cov, h) + grown + batch.variance[now]
        gap = batch.xy[now] - np.einsum("nd,nad->na", h, last.mean)
        parts.append((gap**2).sum(axis=1) / spread)
    return float(np.concatenate(parts).mean())


if __name__ == "__main__":
    sys.exit(main())
