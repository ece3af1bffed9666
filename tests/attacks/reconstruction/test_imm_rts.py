"""Interacting models as an attack: equal modes are one model, and two moods are two."""

from dataclasses import replace

import numpy as np
from helpers.walks import context, release_of, smooth_walks

from attacks.reconstruction import kalman_rts
from attacks.reconstruction.imm_rts import ImmRTS, smooth
from isac_track.rng import stream
from isac_track.types import Knowledge

STAY_S = (4.0, 1.5)


def restless_walks(*sizes, noise_m, seed=0):
    """A release of walks that turn sharply every two seconds, and the truth."""
    rng = stream(seed, "test", "moods", *sizes)
    walks = []
    for size in sizes:
        step = rng.uniform(0.06, 0.13, size)
        heading = 1.5 * rng.standard_normal(size)[(np.cumsum(step) // 2.0).astype(int)]
        velocity = 1.3 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        walks.append((np.cumsum(step), np.cumsum(velocity * step[:, None], axis=0)))
    truth = release_of(walks)
    xy = truth.xy + noise_m * rng.standard_normal(truth.xy.shape)
    return replace(truth, xy=xy), truth.xy


def test_modes_that_are_alike_are_one_model():
    release, _ = smooth_walks(60, 1, 2, 3, 150)
    variance = np.full(release.t.size, 0.16)
    both = smooth(release, variance, (0.04, 0.04), stay_s=STAY_S)
    one = kalman_rts.smooth(release, variance, q=0.04)
    assert np.allclose(both.xy, one.xy, atol=1e-7)
    assert np.allclose(both.std, one.std, atol=1e-7)


def test_it_beats_one_model_where_walks_have_two_moods():
    release, truth = restless_walks(*[300] * 8, noise_m=0.05)
    variance = np.full(release.t.size, 0.05**2)
    both = smooth(release, variance, (0.01, 2.0), stay_s=STAY_S)
    best = min(
        np.square(kalman_rts.smooth(release, variance, q=q).xy - truth).mean()
        for q in (0.001, 0.01, 0.04, 0.16, 0.64, 2.0)
    )
    assert np.square(both.xy - truth).mean() < 0.8 * best


def test_the_attack_smooths_with_its_own_times():
    release, _ = smooth_walks(60)
    told = replace(release, sigma=np.full(60, 0.5))
    attack = ImmRTS(q=0.01, q_turn=0.5, walk_s=6.0, turn_s=1.0)
    found = attack.fit(context(granted={Knowledge.SIGMA}))(told)
    same = smooth(told, np.full(60, 0.125), (0.01, 0.5), stay_s=(6.0, 1.0))
    assert np.array_equal(found.xy, same.xy)
    assert not np.array_equal(found.xy, replace(attack, walk_s=1.0).fit(context())(told).xy)
