"""Ragged batches for the filters, ways to take them apart, and what holds of every result."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import strategies as st

from isac_track.rng import stream

Q = 0.3
PER_SAMPLE = ("t", "xy", "variance")
PER_TRACK = ("initial_mean", "initial_cov")


def batch(*, sizes=(40, 1, 7, 2), d=2, seed=0, cov=None, step_s=(0.02, 0.9), variance=(0.01, 0.6)):
    """Walks with irregular steps and noise, each with a correlated prior of its own, or `cov`."""
    rng = stream(seed, "test", "kernels")
    t = [rng.uniform(-50, 50) + rng.uniform(*step_s, size).cumsum() for size in sizes]
    xy = [rng.uniform(-5, 5, 2) + rng.normal(0, 0.3, (size, 2)).cumsum(axis=0) for size in sizes]
    if cov is None:
        root = rng.normal(0, 1, (len(sizes), d, d))
        cov = root @ root.swapaxes(1, 2) + 0.5 * np.eye(d)
    return {
        "t": np.concatenate(t),
        "xy": np.concatenate(xy),
        "variance": rng.uniform(*variance, sum(sizes)),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "q": Q,
        "initial_mean": rng.normal(0, 2, (len(sizes), 2, d)),
        "initial_cov": np.broadcast_to(cov, (len(sizes), d, d)),
    }


def rows_of(case, order):
    """Return the samples of some tracks, in that order."""
    return np.concatenate([np.arange(*case["offsets"][i : i + 2]) for i in order])


def some_tracks(case, order):
    """Return a batch of some of the tracks, in that order."""
    order = list(order)
    sizes = np.diff(case["offsets"])[order]
    chosen = {name: case[name][rows_of(case, order)] for name in PER_SAMPLE}
    chosen |= {name: case[name][order] for name in PER_TRACK}
    return case | chosen | {"offsets": np.concatenate([[0], np.cumsum(sizes)])}


def no_tracks(case):
    """Return a batch without a track."""
    empty = {name: case[name][:0] for name in PER_SAMPLE + PER_TRACK}
    return case | empty | {"offsets": np.array([0])}


def prefixes(case):
    """Return a batch with a track for each sample: its own track up to it."""
    bounds = [(lo, k + 1) for lo, hi in pairwise(case["offsets"]) for k in range(lo, hi)]
    rows = np.concatenate([np.arange(*bound) for bound in bounds])
    track = np.repeat(np.arange(case["offsets"].size - 1), np.diff(case["offsets"]))
    chosen = {name: case[name][rows] for name in PER_SAMPLE}
    chosen |= {name: case[name][track] for name in PER_TRACK}
    return case | chosen | {"offsets": np.cumsum([0, *(hi - lo for lo, hi in bounds)])}


def one_by_one(case):
    """Yield the samples of each track and its arguments for the oracles."""
    for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
        track = {name: case[name][lo:hi] for name in PER_SAMPLE}
        track |= {"q": case["q"], "mean": case["initial_mean"][i], "cov": case["initial_cov"][i]}
        if "rates" in case:
            track |= {"rates": case["rates"], "probability": case["initial_probability"]}
        yield slice(lo, hi), track


def close(value, expected, tolerance=1e-9):
    np.testing.assert_allclose(value, expected, rtol=0, atol=tolerance)


def sound(mean, cov, tolerance=1e-12):
    """Finite, symmetric, positive; rounding errors of singular correlations are tolerated."""
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
    """Tracks over five decades of noise and four of steps, without a prior."""
    sizes = draw(st.lists(st.integers(1, 9), min_size=n_tracks, max_size=n_tracks))
    total = sum(sizes)
    places = st.lists(st.floats(-50, 50), min_size=total, max_size=total)
    return {
        "t": (gap * draw(powers(-3, 1, total))).cumsum(),
        "variance": draw(powers(-3, 2, total)) ** 2,
        "xy": np.stack([draw(places), draw(places)], axis=1),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "q": draw(powers(-3, 1, 1))[0],
    }
