"""Learning from ranks: by hand, and what is asked for."""

import numpy as np
import pytest
from helpers.walks import context, moved, odd_release, two_releases

from attacks.linkage.learning import (
    MARGIN,
    chosen,
    few_mates,
    learn,
    learn_motion,
    log_rank,
    tracks_of,
)
from attacks.linkage.signals import motions
from isac_track.protocols import LinkageTrainingSet


def test_log_rank_by_hand():
    scores = np.array([[3.0, 1.0, 2.0], [0.0, 5.0, 5.0], [1.0, 2.0, 0.0], [9.0, 9.0, 9.0]])
    mate = np.array([0, 1, 2, -1])
    assert log_rank(scores, mate=mate) == pytest.approx(np.log([1.0, 1.5, 3.0]).mean())


def test_only_a_gain_moves_from_the_default():
    assert chosen([1.0, 1.0 - MARGIN / 2, 2.0]) == 0
    assert chosen([1.0, 1.0 - 2 * MARGIN, 0.5]) == 2
    assert chosen([1.0, 1.5]) == 0


def test_learning_takes_one_parameter_after_the_other():
    asked = []

    def loss(choice):
        asked.append(choice)
        return abs(choice[0] - 5.0) + abs(choice[1] - 2.0)

    assert learn(((1.0, 4.0, 9.0), (7.0,), (3.0, 8.0)), loss=lambda c: loss(c[::2])) == (4, 7, 3)
    # What was found for the first is not asked for again.
    assert asked == [(1.0, 3.0), (4.0, 3.0), (9.0, 3.0), (4.0, 8.0)]


def test_learning_keeps_a_default_that_is_as_good():
    assert learn(((1.0, 2.0), (3.0, 4.0)), loss=lambda choice: 1.0 - sum(choice) / 1e4) == (1, 3)
    assert learn(((1.0,), (3.0,)), loss=lambda _: pytest.fail("nothing to choose")) == (1, 3)


def test_few_mates_are_the_mates():
    probe, gallery, mate = two_releases(12)
    known = np.where(np.arange(12) % 2 == 0, mate, -1)
    few = few_mates(LinkageTrainingSet(probe, gallery, known), most=4)
    assert few.probe.pseudonym == tuple(probe.pseudonym[row] for row in (0, 2, 4, 6))
    assert few.gallery.pseudonym == tuple(gallery.pseudonym[mate[row]] for row in (0, 2, 4, 6))
    assert few.mate.tolist() == [0, 1, 2, 3]


def test_tracks_of_a_release():
    release = moved(odd_release(0))
    some = tracks_of(release, np.array([5, 0, 9]))
    for row, source in enumerate((5, 0, 9)):
        assert np.array_equal(some[row].xy, release[source].xy)
        assert np.array_equal(some[row].t, release[source].t)
    assert some.pseudonym == tuple(release.pseudonym[row] for row in (5, 0, 9))


def test_motion_is_learnt_from_pairs_of_mates_and_blind_it_is_the_default():
    probe, gallery, mate = two_releases(12, noise_m=1.0)
    train = LinkageTrainingSet(probe, gallery, mate)
    few, asked = few_mates(train, most=9), []

    def score(a, b, other):
        factor = next(
            factor
            for factor in (1.0, 2.0)
            if all(
                np.array_equal(each.turn, motions(release, factors=(factor,))[0].turn)
                for each, release in ((a, few.probe), (b, few.gallery))
            )
        )
        asked.append((factor, other))
        return np.eye(9) if (factor, other) == (2.0, 4.0) else np.zeros((9, 9))

    options = ((1.0, 2.0), (4.0, 3.0))
    assert learn_motion(context(), options, most=9, score=score) == (1.0, 4.0)
    assert not asked
    assert learn_motion(context(train), options, most=9, score=score) == (2.0, 4.0)
    assert asked == [(1.0, 4.0), (2.0, 4.0), (2.0, 3.0)]
