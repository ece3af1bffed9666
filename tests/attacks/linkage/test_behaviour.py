"""Features of walks whose features are known, and a metric that learns what lasts."""

import numpy as np
import pytest
from helpers.walks import Person, context, walk_release

from attacks.linkage.behaviour import FEATURES, Behaviour, features, learnt_metric
from attacks.linkage.learning import log_rank
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream

NAMES = list(FEATURES)


def feature(release, name):
    return features(release)[:, NAMES.index(name)]


def line(speed_m_s, *, length_s=12.0, sway_m=0.0, sway_hz=0.85, noise_m=0.0, seed=0):
    """A straight walk that sways to its side."""
    rng = stream(seed, "test", "behaviour")
    t = np.cumsum(rng.uniform(1 / 16, 1 / 8, 200))
    t = t[t < t[0] + length_s]
    xy = np.stack([speed_m_s * t, sway_m * np.sin(2 * np.pi * sway_hz * t)], axis=1)
    return t, xy + noise_m * rng.standard_normal(xy.shape)


def test_features_of_a_straight_walk():
    release = walk_release([line(1.3), line(0.0)])
    for name in (
        "mean speed",
        "slowest tenth",
        "median speed",
        "fastest tenth",
        "progress",
    ):
        assert np.allclose(feature(release, name), [1.3, 0.0], atol=0.03), name
    assert np.allclose(feature(release, "stops"), [0.0, 1.0])
    assert np.allclose(feature(release, "turning"), np.log(0.03), atol=0.1)


def test_features_of_a_curve():
    t = np.arange(0.0, 12.0, 0.1)
    curve = 4.0 * np.stack([np.cos(0.3 * t), np.sin(0.3 * t)], axis=1)
    release = walk_release([(t, curve), (t, curve * [1, -1])])
    rate = 0.3 / (1 + (0.4 / 1.2) ** 2)
    assert np.allclose(feature(release, "turning"), np.log(rate + 0.03), atol=0.1)
    assert np.allclose(feature(release, "net turn"), np.log(rate + 0.02), atol=0.1)


def test_sway_shows_in_its_band():
    release = walk_release(
        [
            line(1.2, sway_m=0.05, sway_hz=hz, seed=k)
            for k, hz in enumerate((0.55, 0.85, 1.2))
        ]
    )
    sway = features(release)[:, -4:]
    assert sway.argmax(axis=1).tolist() == [0, 1, 2]
    still = features(walk_release([line(1.2)]))[:, -4:]
    assert (sway.max(axis=1) > still.max() + 2.0).all()


def test_noise_hides_the_sway():
    for sway_m, first in ((0.05, 0), (0.0, 50)):
        walks = [
            line(1.2, sway_m=sway_m, noise_m=1.0, seed=first + k) for k in range(20)
        ]
        assert np.abs(features(walk_release(walks))[:, -4:]).max() < 0.2


def crowd(n, *, seed):
    """Two days of people who turn as is their habit and hurry as it happens."""
    rng = stream(seed, "test", "crowd")
    habit = np.exp(rng.uniform(np.log(0.02), np.log(1.0), n))

    def walk(turn):
        person = Person(rng, turn_rad_s=turn, speed_m_s=rng.uniform(0.8, 1.6))
        return person.seen(rng, start_s=0.0, length_s=12.0)

    days = [walk_release([walk(turn) for turn in habit]) for _ in range(2)]
    return (*days, np.arange(n))


def test_it_learns_what_lasts():
    train = LinkageTrainingSet(*crowd(80, seed=1))
    probe, gallery, mate = crowd(80, seed=2)
    blind = log_rank(Behaviour().fit(context())(probe, gallery), mate=mate)
    learnt = log_rank(Behaviour().fit(context(train))(probe, gallery), mate=mate)
    assert learnt < blind - 0.2


def learn_metric(n, *, seed, shrinkage):
    """A learnt metric, and the features of either day that it was learnt from."""
    probe, gallery, mate = crowd(n, seed=seed)
    train = LinkageTrainingSet(probe, gallery, mate)
    return learnt_metric(train, shrinkage=shrinkage), features(probe), features(gallery)


@pytest.mark.parametrize("shrinkage", [0.0, 0.7, 1.0])
def test_the_metric_is_a_metric(shrinkage):
    metric, _, _ = learn_metric(30, seed=3, shrinkage=shrinkage)
    assert np.allclose(metric, metric.T)
    assert np.linalg.eigvalsh(metric).min() > -1e-6 * np.abs(metric).max()


def test_shrunk_to_the_diagonal_it_is_the_formula():
    metric, a, b = learn_metric(60, seed=4, shrinkage=1.0)
    within = ((a - b) ** 2).mean(axis=0)
    total = 2.0 * np.concatenate([a, b]).var(axis=0)
    varies = within > 0.02**2
    assert varies.sum() > 6
    by_hand = np.diag(np.maximum(1.0 / within[varies] - 1.0 / total[varies], 0.0))
    assert np.allclose(metric[np.ix_(varies, varies)], by_hand)


def test_unshrunk_it_sees_how_features_go_together():
    metric, _, _ = learn_metric(60, seed=4, shrinkage=0.0)
    pair = NAMES.index("mean speed"), NAMES.index("median speed")
    assert abs(metric[pair]) > 0.1 * np.sqrt(
        metric[pair[0], pair[0]] * metric[pair[1], pair[1]]
    )
