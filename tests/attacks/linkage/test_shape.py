"""What a path's shape tells, blind and after learning."""

import numpy as np
from helpers.walks import context, hits, two_releases

from attacks.linkage.learning import log_rank
from attacks.linkage.shape import Shape
from isac_track.protocols import LinkageTrainingSet


def test_a_glimpse_of_the_walk_is_enough():
    probe, _, _ = two_releases(12, length_s=10.0)
    whole, _, _ = two_releases(12, length_s=4.0, shift_s=2.0)
    scores = Shape().fit(context())(probe, whole)
    assert hits(scores, np.arange(12)) == 1.0


def test_noise_takes_few_polynomials():
    probe, gallery, mate = two_releases(60, seed=8, noise_m=2.5, turn_rad_s=0.2)
    few, many = (
        log_rank(Shape(rank=rank).fit(context())(probe, gallery), mate=mate) for rank in (5, 24)
    )
    assert few < many - 0.1


def test_a_given_floor_is_not_learnt():
    probe, gallery, _ = two_releases(12)
    train = LinkageTrainingSet(*two_releases(40, seed=7))
    given = Shape(floor_m2=0.5)
    blind, informed = (given.fit(context(known))(probe, gallery) for known in (None, train))
    assert np.array_equal(blind, informed)
    assert not np.array_equal(blind, Shape().fit(context(train))(probe, gallery))
