"""Forecasts of a predictor from runs of samples of a release."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from isac_track.protocols import Predictor
from isac_track.types import Floats, Ints, Knowledge, Prediction, Release, stretches

# Samples of histories that are copied at a time for a forecast.
_CHUNK: Final = 2_000_000


def forecast_runs(
    release: Release,
    *,
    first: Ints,
    end: Ints,
    track: Ints,
    t_future: Floats,
    predictor: Predictor,
) -> Prediction:
    """Return a predictor's forecasts of U tracks at times (U, H) s.

    A track is made of runs of samples of the release: run a holds the samples
    ``first[a]:end[a]`` and belongs to ``track[a]``, which rises from 0 to U - 1 without
    a gap. A predictor sees the declared standard deviations if it requires them. The
    result has a covariance if the predictor returns any.
    """
    if not track.size:  # A robot that was sent nobody.
        return Prediction(np.zeros((*t_future.shape, 2)), None)
    parts = []
    for tracks in _chunks(np.bincount(track, weights=end - first).astype(np.int64)):
        runs = slice(*np.searchsorted(track, [tracks.start, tracks.stop]))
        answer = _track_runs(release, first[runs], end[runs], track[runs], predictor)
        parts.append(predictor.predict(answer, t_future[tracks]))
    cov = [part.cov for part in parts if part.cov is not None]
    mean = np.concatenate([part.mean for part in parts])
    return Prediction(mean, np.concatenate(cov) if len(cov) == len(parts) else None)


def _track_runs(
    release: Release, first: Ints, end: Ints, track: Ints, predictor: Predictor
) -> Release:
    """Return runs of samples as tracks that a robot receives."""
    sample, _ = stretches(first, end - first)
    sizes = np.bincount(track - track[0], weights=end - first).astype(np.int64)
    if Knowledge.SIGMA not in predictor.requires:
        release = release.without_sigma()
    return Release(
        t=release.t[sample],
        xy=release.xy[sample],
        sigma=None if release.sigma is None else release.sigma[sample],
        cov=None if release.cov is None else release.cov[sample],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(str(number) for number in range(sizes.size)),
    )


def _chunks(sizes: Ints) -> Iterator[slice]:
    """Yield slices of tracks with about `_CHUNK` samples, and at least one track."""
    before, start = np.cumsum(sizes) - sizes, 0
    while start < sizes.size:
        stop = max(int(np.searchsorted(before, before[start] + _CHUNK)), start + 1)
        yield slice(start, stop)
        start = stop
