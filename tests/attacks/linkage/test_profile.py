"""What speed and turning tell, blind and after learning."""

import numpy as np
from helpers.walks import context, hits, release_of, two_releases

from attacks.linkage.profile import Profile


def circle(radius_m, rad_s):
    t = np.arange(0.0, 12.0, 0.1)
    return t, radius_m * np.stack([np.cos(rad_s * t), np.sin(rad_s * t)], axis=1)


def test_without_turning_it_goes_by_speed_alone():
    scores = Profile(turn_m=1e-6).fit(context())(
        release_of([circle(4.0, 0.3)]), release_of([circle(4.0, -0.3), circle(4.0, 0.2)])
    )
    assert scores[0, 0] > scores[0, 1] + 2.0


def test_it_finds_the_lag():
    probe, gallery, mate = two_releases(12, shift_s=5.0, length_s=12.0)
    assert hits(Profile().fit(context())(probe, gallery), mate) >= 0.9
    assert hits(Profile(reach_s=0.25).fit(context())(probe, gallery), mate) <= 0.6
