"""It must agree with a dense solve, on odd tracks, too."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import smooth_walks, walk_release
from scipy.linalg import block_diag

from attacks.reconstruction.gaussian_process import TREND_STD, smooth
from isac_track.rng import stream


def dense(release, variance, *, kernel):
    """Return the posterior by Rasmussen, Williams, eq. 2.23-2.24.

    K (K + R)^-1 is written as 1 - R (K + R)^-1.
    As it stands in the book the posterior variance is the difference of two numbers of
    1e4.
    """
    length, scale = kernel
    xy, std = np.empty_like(release.xy), np.empty(release.t.size)
    for lo, hi in pairwise(release.offsets):
        t = release.t[lo:hi] - release.t[lo]
        gap = np.abs(t[:, None] - t)
        z = np.sqrt(3) * gap / length
        shape = (1 + z) * np.exp(-z)
        prior = (
            TREND_STD[0] ** 2 + TREND_STD[1] ** 2 * np.outer(t, t) + scale**2 * shape
        )
        noise = np.diag(variance[lo:hi])
        share = noise @ np.linalg.inv(prior + noise)
        xy[lo:hi] = release.xy[lo:hi] - share @ (release.xy[lo:hi] - release.xy[lo])
        std[lo:hi] = np.sqrt(np.diag(noise - share @ noise))
    return xy, std


def with_a_gap_and_tiny_steps():
    clocks = (
        np.r_[np.arange(20) * 0.1, 32 + np.arange(20) * 0.1],
        np.arange(100) * 1e-3,
    )
    rng = stream(0, "test", "gap")
    return walk_release([(t, rng.standard_normal((t.size, 2))) for t in clocks])


@pytest.mark.parametrize(
    ("release", "kernel"),
    [
        (smooth_walks(12, 1, 40, 2, 3, 40, 25)[0], (3.0, 1.2)),
        (with_a_gap_and_tiny_steps(), (12.0, 2.5)),
    ],
    ids=["walks", "gap and tiny steps"],
)
def test_it_is_the_dense_solve(release, kernel):
    variance = stream(0, "test", "levels").uniform(0.05, 0.5, release.t.size)
    xy, std = dense(release, variance, kernel=kernel)
    guess = smooth(release, variance, kernel)
    assert np.allclose(guess.xy, xy, atol=1e-6, rtol=0)
    assert np.allclose(guess.std, std, atol=1e-6, rtol=0)


def test_with_shapes_it_is_the_dense_solve_of_both_axes():
    release, _ = smooth_walks(12, 1, 30, 2)
    rng, kernel = stream(0, "test", "shapes"), (3.0, 1.2)
    factor = rng.uniform(0.1, 0.6, (release.t.size, 2, 2))
    release = replace(release, cov=factor @ factor.swapaxes(1, 2) + 0.02 * np.eye(2))
    variance = np.trace(release.cov, axis1=1, axis2=2) / 2.0
    guess = smooth(release, variance, kernel)
    for lo, hi in pairwise(release.offsets):
        t = release.t[lo:hi] - release.t[lo]
        z = np.sqrt(3) * np.abs(t[:, None] - t) / kernel[0]
        prior = TREND_STD[0] ** 2 + TREND_STD[1] ** 2 * np.outer(t, t)
        prior = prior + kernel[1] ** 2 * (1 + z) * np.exp(-z)
        noise = block_diag(*release.cov[lo:hi])
        share = noise @ np.linalg.inv(np.kron(prior, np.eye(2)) + noise)
        start = np.tile(release.xy[lo], hi - lo)
        xy = release.xy[lo:hi].ravel() - share @ (release.xy[lo:hi].ravel() - start)
        assert np.allclose(guess.xy[lo:hi].ravel(), xy, atol=1e-6, rtol=0)
        spread = np.diag(noise - share @ noise).reshape(-1, 2).mean(axis=1)
        assert np.allclose(guess.std[lo:hi], np.sqrt(spread), atol=1e-6, rtol=0)


def test_round_shapes_change_nothing():
    release, _ = smooth_walks(12, 1, 30, 2)
    variance = stream(0, "test", "levels").uniform(0.05, 0.5, release.t.size)
    shaped = replace(release, cov=variance[:, None, None] * np.eye(2))
    got, expected = (smooth(each, variance, (3.0, 1.2)) for each in (shaped, release))
    assert np.allclose(got.xy, expected.xy, atol=1e-10, rtol=0)
    assert np.allclose(got.std, expected.std, atol=1e-10, rtol=0)
