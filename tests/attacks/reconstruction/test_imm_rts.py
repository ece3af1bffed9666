"""Interacting models as an attack: equal modes are one model; training; the odd tracks."""

import numpy as np
import pytest

from attacks.reconstruction import kalman_rts
from attacks.reconstruction.imm_rts import CANDIDATES, ImmRTS, smooth
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Release

STAY_S = (4.0, 1.5)


def walks(*sizes, noise_m=0.4, turns=False, seed=0):
    """A release of walks that are straight or turn sharply every two seconds, and the truth."""
    rng = stream(seed, "test", "moods", *sizes)
    t, truth = [], []
    for size in sizes:
        step = rng.uniform(0.06, 0.13, size)
        t.append(rng.uniform(0, 1e3) + np.cumsum(step))
        heading = np.zeros(size)
        if turns:
            heading = 1.5 * rng.standard_normal(size)[(np.cumsum(step) // 2.0).astype(int)]
        velocity = 1.3 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        truth.append(rng.normal(0, 5, 2) + np.cumsum(velocity * step[:, None], axis=0))
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


def test_modes_that_are_alike_are_one_model():
    release, _ = walks(60, 1, 2, 3, 150)
    variance = np.full(release.t.size, 0.16)
    both = smooth(release, variance, density=(0.04, 0.04), stay_s=STAY_S)
    one = kalman_rts.smooth(release, variance, q=0.04)
    assert np.allclose(both.xy, one.xy, atol=1e-7)
    assert np.allclose(both.std, one.std, atol=1e-7)


def test_it_beats_one_model_where_walks_have_two_moods():
    release, truth = walks(*[300] * 8, noise_m=0.05, turns=True)
    variance = np.full(release.t.size, 0.05**2)
    both = smooth(release, variance, density=(0.01, 2.0), stay_s=STAY_S)
    best = min(
        np.square(kalman_rts.smooth(release, variance, q=q).xy - truth).mean()
        for q in (0.001, 0.01, 0.04, 0.16, 0.64, 2.0)
    )
    assert np.square(both.xy - truth).mean() < 0.8 * best


def test_training_chooses_and_the_blind_take_the_default():
    calm, truth = walks(*[200] * 4)
    low = ImmRTS().fit(context(TrainingSet(release=calm, truth=truth))).keywords["density"]
    restless, bends = walks(*[200] * 4, turns=True)
    high = ImmRTS().fit(context(TrainingSet(release=restless, truth=bends))).keywords["density"]
    assert {low, high} <= set(CANDIDATES)
    assert low < high
    assert ImmRTS().fit(context()).keywords["density"] == ImmRTS.DEFAULT_Q
    given = ImmRTS(q=0.01, q_turn=0.1).fit(context(TrainingSet(release=calm, truth=truth)))
    assert given.keywords["density"] == (0.01, 0.1)


def test_gaps_and_tiny_steps_are_no_trouble():
    t = [np.r_[np.arange(20) * 0.1, 32 + np.arange(20) * 0.1], np.arange(500) * 1e-3, np.zeros(1)]
    rng = stream(0, "test", "gap")
    guess = ImmRTS().fit(context())(release_of(t, rng.standard_normal((541, 2))))
    assert np.isfinite(guess.xy).all()
    assert (guess.std > 0).all()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"q": 0.1}, "both q and q_turn"),
        ({"q": 0.0, "q_turn": 0.1}, "q must be positive"),
        ({"q": 0.1, "q_turn": np.nan}, "q_turn must be positive"),
        ({"walk_s": -1.0}, "walk_s must be positive"),
        ({"turn_s": np.inf}, "turn_s must be positive"),
    ],
)
def test_parameters_are_checked(parameters, message):
    with pytest.raises(ValueError, match=message):
        ImmRTS(**parameters)
