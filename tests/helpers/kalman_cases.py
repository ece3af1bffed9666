"""Ragged batches for the filters, ways to take them apart, and checks of results."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import strategies as st

from isac_track.kalman import Batch
from isac_track.rng import stream

Q = 0.3
PRIOR_STD = (1.3, 0.8, 0.6)
VAGUE_STD = (100.0, 10.0, 1.0)
PER_SAMPLE = ("t", "xy", "variance")


def batch(
    *,
    sizes=(40, 1, 7, 2),
    seed=0,
    prior_std=PRIOR_STD[:2],
    step_s=(0.02, 0.9),
    variance=(0.01, 0.6),
):
    """Walks with irregular steps and noise."""
    rng = stream(seed, "test", "kernels")
    t = [rng.uniform(-50, 50) + rng.uniform(*step_s, size).cumsum() for size in sizes]
    xy = [
        rng.uniform(-5, 5, 2) + rng.normal(0, 0.3, (size, 2)).cumsum(axis=0)
        for size in sizes
    ]
    return Batch(
        t=np.concatenate(t),
        xy=np.concatenate(xy),
        variance=rng.uniform(*variance, sum(sizes)),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        prior_std=prior_std,
    )


def pieces(case, bounds):
    """Return a batch whose tracks are the samples between some bounds."""
    rows = np.concatenate([np.arange(lo, hi) for lo, hi in bounds] or [np.arange(0)])
    chosen = {name: getattr(case, name)[rows] for name in PER_SAMPLE}
    return replace(
        case, **chosen, offsets=np.cumsum([0, *(hi - lo for lo, hi in bounds)])
    )


def some_tracks(case, order):
    """Return a batch of some of the tracks, in that order."""
    return pieces(case, [case.offsets[i : i + 2] for i in order])


def prefixes(case):
    """Return a batch with a track for each sample: its own track up to it."""
    return pieces(
        case, [(lo, k + 1) for lo, hi in pairwise(case.offsets) for k in range(lo, hi)]
    )


def track_by_track(case, **model):
    """Yield the samples of each track and its arguments for the oracles."""
    rest = np.zeros((2, len(case.prior_std) - 1))
    for lo, hi in pairwise(case.offsets):
        track = {name: getattr(case, name)[lo:hi] for name in PER_SAMPLE}
        track |= {"mean": np.column_stack([case.xy[lo], rest]), "q": Q}
        yield slice(lo, hi), track | {"cov": np.diag(case.prior_std) ** 2} | model


def close(value, expected, tolerance=1e-9):
    np.testing.assert_allclose(value, expected, rtol=0, atol=tolerance)


def sound(mean, cov, tolerance=1e-12):
    """Finite, symmetric, positive; rounding errors of singular ones are tolerated."""
    assert np.isfinite(mean).all()
    assert np.isfinite(cov).all()
    np.testing.assert_array_equal(cov, cov.swapaxes(-1, -2))
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    assert (variance > 0).all()
    scale = np.sqrt(variance)
    correlation = cov / (scale[..., :, None] * scale[..., None, :])
    assert np.linalg.eigvalsh(correlation).min(initial=0.0) > -tolerance


def powers(low, high, size):
    """Numbers over that many decades."""
    exponents = st.lists(st.floats(low, high), min_size=size, max_size=size)
    return exponents.map(lambda values: 10.0 ** np.array(values))


@st.composite
def hard_tracks(draw, *, n_tracks, gap=1.0):
    """Tracks over five decades of noise and four of steps, and a spectral density."""
    sizes = draw(st.lists(st.integers(1, 9), min_size=n_tracks, max_size=n_tracks))
    total = sum(sizes)
    places = st.lists(st.floats(-50, 50), min_size=total, max_size=total)
    tracks = Batch(
        t=(gap * draw(powers(-3, 1, total))).cumsum(),
        variance=draw(powers(-3, 2, total)) ** 2,
        xy=np.stack([draw(places), draw(places)], axis=1),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        prior_std=(100.0, 2.0),
    )
    return tracks, draw(powers(-3, 1, 1))[0]
