"""The smoother as an attack: filterpy's RTS, what is learnt, and what is claimed."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import kernel_oracles as oracle

from attacks.reconstruction.kalman_rts import CANDIDATES, PRIOR_STD, KalmanRTS
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.sharing import Raw
from isac_track.types import Knowledge, Release

MECHANISM, SIGMA, TRAIN = Knowledge.MECHANISM, Knowledge.SIGMA, Knowledge.TRAIN


def walks(*sizes, q=0.04, noise_m=(0.2, 0.8), seed=0):
    """A release of exact constant-velocity walks, noise drawn per sample, and the truth."""
    rng = stream(seed, "test", "rts", *sizes)
    n = len(sizes)
    dt = rng.uniform(1 / 16, 1 / 8, (n, max(sizes)))
    # What a step adds: velocity q dt, position q dt^3 / 3, together q dt^2 / 2.
    kick = np.sqrt(q * dt)[..., None] * rng.standard_normal((*dt.shape, 2))
    rest = np.sqrt(q * dt**3 / 12)[..., None] * rng.standard_normal((*dt.shape, 2))
    velocity = rng.normal(0, 1, (n, 1, 2)) + np.cumsum(kick, axis=1)
    way = dt[..., None] * (velocity - kick / 2) + rest
    path = rng.normal(0, 5, (n, 1, 2)) + np.cumsum(way, axis=1)
    clock = rng.uniform(0, 1e4, (n, 1)) + np.cumsum(dt, axis=1)
    there = np.arange(max(sizes)) < np.array(sizes)[:, None]
    truth = path[there]
    std = rng.uniform(*noise_m, len(truth))
    release = Release(
        t=clock[there],
        xy=truth + std[:, None] * rng.standard_normal(truth.shape),
        sigma=std * np.sqrt(2.0),  # of the length, as under the radial law
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )
    return release, truth


def context(*granted, train=None):
    return AttackContext(
        rng=stream(0, "test"),
        epsilon_m=0.3,
        granted=frozenset(granted),
        mechanism=Raw(),
        train=train,
    )


def chosen(train, release):
    """The candidate that gives the very result of an attack which learns."""
    learnt = KalmanRTS().fit(context(MECHANISM, TRAIN, train=train))(release)
    same = [
        q
        for q in CANDIDATES
        if np.array_equal(KalmanRTS(q=q).fit(context())(release).xy, learnt.xy)
    ]
    assert len(same) == 1
    return same[0]


def test_with_the_true_noise_it_is_filterpys_smoother():
    release, _ = walks(80, 1, 2, 30)
    found = KalmanRTS(q=0.04).fit(context(SIGMA))(release)
    for lo, hi in pairwise(release.offsets):
        theirs = oracle.filterpy_track(
            t=release.t[lo:hi],
            xy=release.xy[lo:hi],
            variance=release.sigma[lo:hi] ** 2 / 2,
            q=0.04,
            mean=np.stack([release.xy[lo], np.zeros(2)], axis=1),
            cov=np.diag(PRIOR_STD) ** 2,
        )
        mean, cov, _, _ = theirs["kf"].rts_smoother(
            theirs["mean"], theirs["cov"], theirs["fs"], theirs["qs"]
        )
        np.testing.assert_allclose(found.xy[lo:hi], mean[:, [0, 2]], rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.std[lo:hi], np.sqrt(cov[:, 0, 0]), rtol=1e-6)


def test_blind_the_level_of_a_track_is_its_innovations():
    # Constant noise: the blind smoother is nearly as good as the one that is told.
    release, truth = walks(*[200] * 30, noise_m=(0.5, 0.5))
    blind = KalmanRTS(q=0.04).fit(context())(release)
    told = KalmanRTS(q=0.04).fit(context(SIGMA))(release)
    rmse = [np.sqrt(np.mean((one.xy - truth) ** 2)) for one in (blind, told)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.02)
    assert rmse[0] < 0.3 * 0.5


def test_what_it_claims_is_what_it_is_off_by():
    release, truth = walks(*[150] * 100)
    found = KalmanRTS(q=0.04).fit(context(SIGMA))(release)
    scaled = np.mean(((found.xy - truth) / found.std[:, None]) ** 2)
    assert scaled == pytest.approx(1.0, abs=0.06)  # 100 tracks of some 15 free errors per axis


def test_a_calm_and_a_restless_training_set_teach_different_walks():
    release, _ = walks(60, 60)
    calm = TrainingSet(*walks(*[300] * 20, q=0.002, seed=1))
    restless = TrainingSet(*walks(*[300] * 20, q=0.6, seed=1))
    assert chosen(calm, release) == CANDIDATES[0]
    assert chosen(restless, release) == CANDIDATES[-1]


def test_the_true_walk_is_learnt_to_within_one_candidate():
    release, _ = walks(60, 60)
    train = TrainingSet(*walks(*[300] * 60, q=0.04, seed=2))
    assert chosen(train, release) in (0.02, 0.04, 0.08)


def test_a_given_q_is_kept_and_the_blind_take_the_default():
    release, _ = walks(60, 60)
    restless = TrainingSet(*walks(*[300] * 20, q=0.6, seed=1))
    given = KalmanRTS(q=0.02).fit(context(TRAIN, train=restless))(release)
    np.testing.assert_array_equal(given.xy, KalmanRTS(q=0.02).fit(context())(release).xy)
    default = KalmanRTS().fit(context())(release)
    expected = KalmanRTS(q=KalmanRTS.DEFAULT_Q).fit(context())(release)
    np.testing.assert_array_equal(default.xy, expected.xy)


@pytest.mark.parametrize("q", [0.0, -1.0, np.nan, np.inf])
def test_impossible_parameters_are_refused(q):
    with pytest.raises(ValueError, match="q must be"):
        KalmanRTS(q=q)
