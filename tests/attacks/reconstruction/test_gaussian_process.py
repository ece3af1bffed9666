"""Two engines and a dense solve must agree; training; the odd tracks."""

from itertools import pairwise

import numpy as np
import pytest

from attacks.reconstruction.gaussian_process import (
    CANDIDATES,
    TREND_STD,
    GaussianProcess,
    smooth,
    solve_sklearn,
)
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Release

KINDS = pytest.mark.parametrize("smoothness", ["matern32", "matern52"])


def walks(*sizes, noise_m=0.4, turn=0.4, seed=0):
    """A release of smooth walks at irregular steps, and the truth."""
    rng = stream(seed, "test", "process", *sizes)
    t, truth = [], []
    for size in sizes:
        clock = rng.uniform(0, 1e3) + np.cumsum(rng.uniform(0.06, 0.13, size))
        along = clock - clock[0]
        t.append(clock)
        truth.append(
            rng.normal(0, 5, 2) + np.stack([1.2 * along, np.sin(turn * along) / turn], axis=1)
        )
    truth = np.concatenate(truth)
    return release_of(t, truth + noise_m * rng.standard_normal(truth.shape)), truth


def release_of(t, xy):
    sizes = [clock.size for clock in t]
    return Release(
        t=np.concatenate(t),
        xy=xy,
        sigma=None,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )


def context(train=None):
    return AttackContext(
        rng=stream(0, "test"),
        epsilon_m=0.3,
        granted=frozenset() if train is None else frozenset({Knowledge.TRAIN}),
        train=train,
    )


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


@KINDS
def test_both_engines_are_the_dense_solve(smoothness):
    release, _ = walks(12, 1, 40, 2, 3, 40, 25)
    variance = stream(0, "test", "levels").uniform(0.05, 0.5, release.t.size)
    settings = {"kernel": (3.0, 1.2), "smoothness": smoothness}
    xy, std = dense(release, variance, **settings)
    for engine in (smooth, solve_sklearn):
        guess = engine(release, variance, **settings)
        assert np.allclose(guess.xy, xy, atol=1e-6, rtol=0)
        assert np.allclose(guess.std, std, atol=1e-6, rtol=0)


@KINDS
def test_the_engine_is_a_parameter(smoothness):
    release, _ = walks(30, 4)
    ours, theirs = (
        GaussianProcess(smoothness=smoothness, engine=engine).fit(context())(release)
        for engine in ("state_space", "sklearn")
    )
    assert np.allclose(ours.xy, theirs.xy, atol=1e-6)
    assert np.allclose(ours.std, theirs.std, atol=1e-6)


@KINDS
def test_a_gap_and_tiny_steps_are_the_dense_solve(smoothness):
    t = [np.r_[np.arange(20) * 0.1, 32 + np.arange(20) * 0.1], np.arange(100) * 1e-3]
    rng = stream(0, "test", "gap")
    release = release_of(t, rng.standard_normal((140, 2)))
    variance = np.full(140, 0.2)
    settings = {"kernel": (12.0, 2.5), "smoothness": smoothness}
    xy, std = dense(release, variance, **settings)
    guess = smooth(release, variance, **settings)
    assert np.allclose(guess.xy, xy, atol=1e-6)
    assert np.allclose(guess.std, std, atol=1e-6)


def test_the_claimed_deviation_holds():
    """On walks drawn from the prior itself, with the noise known, errors are what it claims."""
    rng = stream(0, "test", "drawn")
    t = np.arange(60) * 0.1
    z = np.sqrt(3) * np.abs(t[:, None] - t) / 3.0
    root = np.linalg.cholesky((1 + z) * np.exp(-z) + 1e-12 * np.eye(t.size))
    truth = np.concatenate([root @ rng.standard_normal((t.size, 2)) for _ in range(200)])
    release = release_of([t] * 200, truth + 0.4 * rng.standard_normal(truth.shape))
    guess = smooth(release, np.full(truth.shape[0], 0.16), kernel=(3.0, 1.0), smoothness="matern32")
    score = np.square((guess.xy - truth) / guess.std[:, None]).mean()
    assert score == pytest.approx(1.0, abs=0.08)


def test_training_chooses_and_the_blind_take_the_default():
    straight, truth = walks(*[200] * 4, turn=0.05)
    restless, bends = walks(*[200] * 4, turn=2.5)
    calm = GaussianProcess().fit(context(TrainingSet(release=straight, truth=truth)))
    quick = GaussianProcess().fit(context(TrainingSet(release=restless, truth=bends)))
    assert calm.keywords["kernel"] != quick.keywords["kernel"]
    assert {calm.keywords["kernel"], quick.keywords["kernel"]} <= set(CANDIDATES)
    assert GaussianProcess().fit(context()).keywords["kernel"] == GaussianProcess.DEFAULT
    given = GaussianProcess(length_s=2.0, scale_m=0.5)
    chosen = given.fit(context(TrainingSet(release=straight, truth=truth))).keywords["kernel"]
    assert chosen == (2.0, 0.5)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"length_s": 1.0}, "both length_s and scale_m"),
        ({"length_s": 0.0, "scale_m": 1.0}, "length_s must be positive"),
        ({"length_s": 1.0, "scale_m": np.nan}, "scale_m must be positive"),
        ({"smoothness": "rbf"}, "smoothness must be one of"),
        ({"engine": "gpy"}, "engine must be one of"),
    ],
)
def test_parameters_are_checked(parameters, message):
    with pytest.raises(ValueError, match=message):
        GaussianProcess(**parameters)
