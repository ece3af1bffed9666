"""Planted attackers are as weak, or as strong, as they are said to be."""

import numpy as np
import planted_attacks
import pytest
from helpers.walks import context, flat_release

from attacks.reconstruction.kalman_rts import KalmanRTS
from isac_track.rng import stream
from isac_track.sensing import unit_errors


@pytest.fixture(scope="module")
def noisy_walks():
    """Twenty slow bows with radial errors: the release, and the truth."""
    rng = stream(0, "test", "planted")
    t = np.arange(300) / 12.0
    turn = 0.2 * np.sin(t[None] * rng.uniform(0.1, 0.3, (20, 1)))
    heading = rng.uniform(0.0, 6.0, (20, 1)) + np.cumsum(turn / 12.0, axis=1)
    steps = 1.3 / 12.0 * np.stack([np.cos(heading), np.sin(heading)], axis=2)
    truth = np.cumsum(steps, axis=1).reshape(-1, 2)
    error = 0.5 * unit_errors(n_samples=len(truth), law="radial", rng=rng)
    offsets = np.arange(21) * t.size
    return flat_release(np.tile(t, 20), truth + error, offsets), truth


def known_share(attack, noisy_walks):
    release, truth = noisy_walks
    gap = attack.fit(context())(release).xy - truth
    return (np.hypot(*gap.T) < 0.3).mean()


@pytest.fixture(scope="module")
def usual(noisy_walks):
    return known_share(KalmanRTS(), noisy_walks)


@pytest.mark.parametrize("attack", planted_attacks.WEAK, ids=str)
def test_a_weak_attacker_knows_less_than_the_smoother(attack, noisy_walks, usual):
    assert known_share(attack, noisy_walks) < usual


@pytest.mark.parametrize("attack", planted_attacks.STRONG, ids=str)
def test_a_strong_attacker_knows_more(attack, noisy_walks, usual):
    assert known_share(attack, noisy_walks) > usual


def test_there_are_twenty_of_each():
    assert len(set(planted_attacks.WEAK)) == len(set(planted_attacks.STRONG)) == 20
