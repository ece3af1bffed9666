"""No attack beats the smoother that knows all, on walks that follow its model.

Walks have constant velocity driven by white acceleration, and Gaussian errors that
differ between tracks and within. Then no estimator has a smaller mean square error than
2 P, with P the smoother's variance of a position per axis.
"""

from functools import cache

import numpy as np
import pytest
from further_attacks.imm_rts import ImmRTS
from further_attacks.posterior import Posterior
from walks import context, flat_release

from attacks.building_blocks import Motion, make_attack, simulate_walks
from isac_track.kalman import Batch, smooth_positions
from isac_track.protocols import TrainingSet, grants
from isac_track.rng import stream
from isac_track.sharing import Raw
from isac_track.types import Knowledge

Q = 0.04
N_TRACKS = 800
PRIOR_STD = (100.0, 10.0)


@cache
def make_walks(n_tracks=N_TRACKS, seed=0):
    """Return a release of tracks of 100 to 200 samples, and the truth."""
    rng = stream(seed, "test", "benchmark", n_tracks)
    sizes = rng.integers(100, 201, n_tracks)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    t = np.cumsum(rng.uniform(1 / 16, 1 / 8, offsets[-1]))
    start, motion = rng.normal(0, 5, (n_tracks, 2)), Motion(Q, 1.0)
    truth = simulate_walks(t=t, offsets=offsets, start=start, motion=motion, rng=rng)
    own_std = np.exp(rng.uniform(np.log(0.15), np.log(1.0), n_tracks))
    std = np.repeat(own_std, sizes) * rng.uniform(2 / 3, 3 / 2, t.size)
    xy = truth + std[:, None] * rng.standard_normal(truth.shape)
    return flat_release(t, xy, offsets, sigma=std), truth


def give(release, granted):
    """Return a release as somebody with that knowledge gets it."""
    return release if Knowledge.SIGMA in granted else release.without_sigma()


def over_benchmark(attack, granted):
    """Return RMSE over the benchmark's with a 99 % interval over tracks."""
    train = None
    if Knowledge.TRAIN in granted:
        others, their_truth = make_walks(32, seed=1)
        train = TrainingSet(give(others, granted), their_truth)
    release, truth = make_walks()
    known = context(train, granted=granted, mechanism=Raw())
    xy = attack.fit(known)(give(release, granted)).xy
    variance = release.sigma**2
    batch = Batch(release.t, truth, variance, release.offsets, PRIOR_STD)
    errors_m2 = ((xy - truth) ** 2).sum(axis=1), 2.0 * smooth_positions(batch, q=Q)[1]
    square, expected = (
        np.add.reduceat(values, release.offsets[:-1]) / np.diff(release.offsets)
        for values in errors_m2
    )
    ratio = square.sum() / expected.sum()
    residual = (square - ratio * expected) / expected.mean()
    half = 2.58 * residual.std(ddof=1) / np.sqrt(square.size)
    return np.sqrt([ratio, ratio - half, ratio + half])


ROWS = [
    pytest.param(attack, granted, id=f"{type(attack).__name__}-{adversary}")
    for attack in (ImmRTS(), Posterior(draws=20, burn_in=5))
    for adversary, granted in grants(attack).items()
]


@pytest.mark.parametrize(("attack", "granted"), ROWS)
def test_no_attack_beats_the_benchmark(attack, granted):
    ratio, low, high = over_benchmark(attack, granted)
    assert high > 1.0
    assert high - low < 0.06 * ratio


def test_an_attack_that_knew_the_truth_a_little_would_be_seen():
    known = {Knowledge.SIGMA, Knowledge.TRAIN}
    ratio, low, high = over_benchmark(make_attack(f"kalman_rts:q={Q}"), known)
    assert low < 1.0 < high
    # Each error is a twentieth smaller.
    assert 0.95 * high < 1.0
    assert ratio > 0.97
