"""Interacting models as an attack: equal modes are one model, and two moods are two."""

from dataclasses import replace

import numpy as np
from helpers.walks import context, smooth_walks

from attacks.reconstruction import kalman_rts
from attacks.reconstruction.imm_rts import ImmRTS, smooth
from isac_track.types import Knowledge

STAY_S = (4.0, 1.5)


def test_modes_that_are_alike_are_one_model():
    release, _ = smooth_walks(60, 1, 2, 3, 150)
    variance = np.full(release.t.size, 0.16)
    both = smooth(release, variance, (0.04, 0.04), stay_s=STAY_S)
    one = kalman_rts.smooth(release, variance, q=0.04)
    assert np.allclose(both.xy, one.xy, atol=1e-7)
    assert np.allclose(both.std, one.std, atol=1e-7)


def test_the_attack_smooths_with_its_own_times():
    release, _ = smooth_walks(60)
    told = replace(release, sigma=np.full(60, 0.5))
    attack = ImmRTS(q=0.01, q_turn=0.5, walk_s=6.0, turn_s=1.0)
    found = attack.fit(context(granted={Knowledge.SIGMA}))(told)
    same = smooth(told, np.full(60, 0.125), (0.01, 0.5), stay_s=(6.0, 1.0))
    assert np.array_equal(found.xy, same.xy)
    assert not np.array_equal(found.xy, replace(attack, walk_s=1.0).fit(context())(told).xy)
