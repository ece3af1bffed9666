"""No attack beats the posterior covariance under an exact linear-Gaussian model.

Walks are drawn from the benchmark's own model: constant velocity, white-noise
acceleration of Q = 0.04 m^2/s^3, 8 to 16 Hz, isotropic Gaussian errors of 0.1 to 1.5 m
that differ between tracks and within. The smoother that knows all of this then has the
least mean square error of all estimators, 2 P, with P its posterior variance per axis.

RMSE over the benchmark's, as measured (99 % interval: 2.5 % to either side), oracle and
blind: kalman_rts 1.00 and 1.07, gaussian_process 1.02 and 1.09, radial_rts 1.08 and
1.12; savgol 1.17, moving_average 1.39, averaging 4.8 and identity
5.4.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.walks import context, cv_walks, flat_release

from attacks.reconstruction.kalman_rts import KalmanRTS
from isac_track import plugins
from isac_track.kalman import Batch, smooth_positions
from isac_track.protocols import TrainingSet, grants
from isac_track.rng import stream
from isac_track.sharing import Raw
from isac_track.types import Knowledge

Q = 0.04
N_TRACKS = 800
MANY_TRACKS = 2400
"""Their mean square error is known to 1 % (one standard error)."""
N_REPEATS = 2
PRIOR_STD = (100.0, 10.0)


@cache
def walks(n_tracks=N_TRACKS, seed=0):
    """Return truth, clock, offsets and stds of tracks of 100 to 200 samples."""
    rng = stream(seed, "test", "benchmark", n_tracks)
    t, truth, offsets = cv_walks(
        *rng.integers(100, 201, n_tracks).tolist(), q=Q, seed=seed
    )
    std = np.repeat(
        np.exp(rng.uniform(np.log(0.15), np.log(1.0), n_tracks)), np.diff(offsets)
    )
    return truth, t, offsets, std * rng.uniform(2 / 3, 3 / 2, t.size)


def make_release(n_tracks=N_TRACKS, seed=0, again=0):
    truth, t, offsets, std = walks(n_tracks, seed)
    noise = stream(seed, "test", "benchmark", "noise", seed, again).standard_normal(
        truth.shape
    )
    return flat_release(t, truth + std[:, None] * noise, offsets, sigma=std)


@cache
def posterior(n_releases=1, n_tracks=N_TRACKS):
    """P of every sample, (M,), given so many releases of the walk."""
    truth, t, offsets, std = walks(n_tracks)
    batch = Batch(t, truth, std**2 / n_releases, offsets, PRIOR_STD)
    _, variance = smooth_positions(batch, q=Q)
    return variance


def make_context(granted, n_train=32):
    knowledge = {}
    if Knowledge.TRAIN in granted:
        train = make_release(n_train, seed=1)
        if Knowledge.SIGMA not in granted:
            train = train.without_sigma()
        knowledge["train"] = TrainingSet(train, walks(n_train, seed=1)[0])
    if Knowledge.REPEATS in granted:
        knowledge["repeats"] = tuple(
            make_release(again=1 + turn) for turn in range(N_REPEATS)
        )
    return context(granted=granted, mechanism=Raw(), **knowledge)


def gaps(attack, granted, n_releases):
    """Return mean square errors of tracks, and the benchmark's, both (N,) m^2."""
    truth, _, offsets, _ = walks()
    release = make_release()
    if Knowledge.SIGMA not in granted:
        release = release.without_sigma()
    reconstruction = attack.fit(make_context(granted))(release)
    sizes = np.diff(offsets)
    square = ((reconstruction.xy - truth) ** 2).sum(axis=1)
    expected = 2.0 * posterior(n_releases)
    return tuple(
        np.add.reduceat(values, offsets[:-1]) / sizes for values in (square, expected)
    )


def over_benchmark(square, expected):
    """RMSE over the benchmark's with a 99 % interval over tracks (delta method)."""
    ratio = square.sum() / expected.sum()
    residual = (square - ratio * expected) / expected.mean()
    half = 2.58 * residual.std(ddof=1) / np.sqrt(square.size)
    return np.sqrt([ratio, ratio - half, ratio + half])


BEYOND = {Knowledge.ANCHOR, Knowledge.COMPANIONS}
"""Knowledge beyond releases of the walk, which the benchmark lacks: not granted."""
ROWS = [
    pytest.param(plugin.instance, adversary, granted - BEYOND, id=f"{name}-{adversary}")
    for name, origin in plugins.names("attacks").items()
    if origin.startswith("attacks.reconstruction.")
    for plugin in plugins.parse("attacks", name)
    for adversary, granted in grants(plugin.instance).items()
]


@pytest.mark.parametrize(("attack", "adversary", "granted"), ROWS)
def test_no_attack_beats_the_benchmark(attack, adversary, granted):
    del adversary  # names the row
    # Further releases add information: the benchmark of the mean of all of them, which
    # has a part of the variance, is the one that holds. That of a single release does
    # not.
    n_releases = 1 + N_REPEATS if Knowledge.REPEATS in granted else 1
    ratio, low, high = over_benchmark(*gaps(attack, granted, n_releases))
    assert high > 1.0
    assert high - low < 0.06 * ratio


def test_an_attack_that_knew_the_truth_a_little_would_be_seen():
    square, expected = gaps(KalmanRTS(q=Q), {Knowledge.SIGMA, Knowledge.TRAIN}, 1)
    assert over_benchmark(square, expected)[2] > 1.0
    # Each error is a twentieth smaller.
    assert over_benchmark(0.95**2 * square, expected)[2] < 1.0


@pytest.mark.parametrize("granted", [(), (Knowledge.TRAIN,)], ids=["told", "learnt"])
def test_the_smoother_with_all_knowledge_attains_it(granted):
    """The law is Gaussian per axis: twice the radial share, given or learnt."""
    granted = {Knowledge.SIGMA, *granted}
    attack = KalmanRTS(q=Q)
    truth, _, _, std = walks(MANY_TRACKS)
    release = make_release(MANY_TRACKS)
    if Knowledge.TRAIN not in granted:
        # As a radial error of that variance would be declared.
        release = replace(release, sigma=std * np.sqrt(2.0))
    reconstruction = attack.fit(make_context(granted, n_train=512))(release)
    expected = posterior(n_tracks=MANY_TRACKS)
    ratio = np.sqrt(np.mean((reconstruction.xy - truth) ** 2) / expected.mean())
    assert ratio == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(reconstruction.std**2, expected, rtol=0.02)
