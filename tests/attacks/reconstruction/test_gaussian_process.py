"""Two engines and a dense solve must agree; training; the odd tracks."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import context, release_of, smooth_walks

from attacks.reconstruction.gaussian_process import (
    TREND_STD,
    GaussianProcess,
    smooth,
    solve_sklearn,
)
from isac_track.rng import stream

KINDS = pytest.mark.parametrize("smoothness", ["matern32", "matern52"])


def dense(release, variance, *, kernel, smoothness):
    """Rasmussen, Williams, eq. 2.23-2.24, with K (K + R)^-1 written as 1 - R (K + R)^-1.

    As it stands in the book the posterior variance is the difference of two numbers of 1e4.
    """
    length, scale = kernel
    xy, std = np.empty_like(release.xy), np.empty(release.t.size)
    for lo, hi in pairwise(release.offsets):
        t = release.t[lo:hi] - release.t[lo]
        gap = np.abs(t[:, None] - t)
        if smoothness == "matern32":
            z = np.sqrt(3) * gap / length
            shape = (1 + z) * np.exp(-z)
        else:
            z = np.sqrt(5) * gap / length
            shape = (1 + z + z**2 / 3) * np.exp(-z)
        prior = TREND_STD[0] ** 2 + TREND_STD[1] ** 2 * np.outer(t, t) + scale**2 * shape
        noise = np.diag(variance[lo:hi])
        kept = noise @ np.linalg.inv(prior + noise)
        xy[lo:hi] = release.xy[lo:hi] - kept @ (release.xy[lo:hi] - release.xy[lo])
        std[lo:hi] = np.sqrt(np.diag(noise - kept @ noise))
    return xy, std


def with_a_gap_and_tiny_steps():
    clocks = (np.r_[np.arange(20) * 0.1, 32 + np.arange(20) * 0.1], np.arange(100) * 1e-3)
    rng = stream(0, "test", "gap")
    return release_of([(t, rng.standard_normal((t.size, 2))) for t in clocks])


@KINDS
@pytest.mark.parametrize(
    ("release", "kernel", "engines"),
    [
        (smooth_walks(12, 1, 40, 2, 3, 40, 25)[0], (3.0, 1.2), (smooth, solve_sklearn)),
        (with_a_gap_and_tiny_steps(), (12.0, 2.5), (smooth,)),
    ],
    ids=["walks", "gap and tiny steps"],
)
def test_it_is_the_dense_solve(release, kernel, engines, smoothness):
    variance = stream(0, "test", "levels").uniform(0.05, 0.5, release.t.size)
    xy, std = dense(release, variance, kernel=kernel, smoothness=smoothness)
    for engine in engines:
        guess = engine(release, variance, kernel, smoothness=smoothness)
        assert np.allclose(guess.xy, xy, atol=1e-6, rtol=0)
        assert np.allclose(guess.std, std, atol=1e-6, rtol=0)


@KINDS
def test_the_engine_is_a_parameter(smoothness):
    release, _ = smooth_walks(30, 4)
    ours, theirs = (
        GaussianProcess(smoothness=smoothness, engine=engine).fit(context())(release)
        for engine in ("state_space", "sklearn")
    )
    assert np.allclose(ours.xy, theirs.xy, atol=1e-6)
    assert np.allclose(ours.std, theirs.std, atol=1e-6)
