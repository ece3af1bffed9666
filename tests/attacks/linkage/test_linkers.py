"""Every linkage attack: the right person first, any frame, any track, no memory."""

from functools import partial

import numpy as np
import pytest
from helpers.walks import context, hits, moved, odd_release, two_releases, walk_release

from attacks.linkage.alignment import Profile, Shape
from attacks.linkage.behaviour import Behaviour
from attacks.linkage.dtw import DTW
from attacks.linkage.gait import Gait
from attacks.linkage.histogram import Histogram
from attacks.linkage.kinematic import Kinematic
from attacks.linkage.learning import LEAST_MATES, log_rank
from attacks.linkage.likelihood_ratio import LikelihoodRatio
from attacks.reconstruction import kalman_rts
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Knowledge

BY_MOTION = [
    Profile(),
    DTW(),
    Shape(),
    Behaviour(),
    Gait(),
    Histogram(),
    LikelihoodRatio(),
]
ALL = [*BY_MOTION, Kinematic()]


def name(attack):
    return type(attack).__name__


def fitted(attack, train=None):
    granted = set(attack.requires) | (set() if train is None else {Knowledge.TRAIN})
    return attack.fit(context(train, granted=granted))


@pytest.fixture(scope="module")
def easy():
    return two_releases(12)


@pytest.mark.parametrize(
    "attack", BY_MOTION, ids=name
)  # of Kinematic, see its own tests
def test_a_walk_is_its_own_best_match(attack, easy):
    probe, _, _ = easy
    scores = fitted(attack)(probe, moved(probe, seed=5))
    assert hits(scores, np.arange(len(probe))) == 1.0


@pytest.mark.parametrize(
    "attack", [Profile(), Shape(), DTW(), LikelihoodRatio()], ids=name
)
def test_a_mirror_image_is_somebody_else(attack, easy):
    probe, _, _ = easy
    score = fitted(attack)
    same = np.diag(score(probe, moved(probe)))
    mirrored = np.diag(score(probe, moved(probe, mirrored=True)))
    assert (same > mirrored + 0.5).all()


@pytest.mark.parametrize("is_radial", [False, True], ids=["isotropic", "radial"])
@pytest.mark.parametrize("attack", ALL, ids=name)
def test_a_pair_of_odd_tracks_has_a_score_of_its_own_also_after_training(
    attack, is_radial, monkeypatch
):
    """But for the error law, which shows in all tracks of a release together."""
    monkeypatch.setattr(kalman_rts, "looks_radial", lambda _release: is_radial)
    probe, gallery = odd_release(0), odd_release(1, n=9)
    train = LinkageTrainingSet(
        odd_release(2, n=24), odd_release(3, n=24), np.arange(24)
    )
    score = fitted(attack, train)
    scores = score(probe, gallery)
    assert np.isfinite(scores).all()
    for row, column in ((0, 0), (1, 2), (5, 8), (13, 8)):
        close = partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6)
        close(score(probe.tracks([row]), gallery), scores[[row]])
        close(score(probe, gallery.tracks([column])), scores[:, [column]])


@pytest.mark.parametrize(("attack", "sway"), [(Profile(), 0.02), (Shape(), 0.01)])
def test_it_learns_how_small_a_misfit_counts(attack, sway):
    # People who differ by millimetres: the default floors blur them.
    habits = {"sway": sway, "turn_rad_s": 0.01, "speed_m_s": 1.2}
    train = LinkageTrainingSet(*two_releases(40, seed=7, **habits))
    probe, gallery, mate = two_releases(40, seed=8, **habits)
    blind, learnt = (fitted(attack, known)(probe, gallery) for known in (None, train))
    assert log_rank(learnt, mate=mate) < log_rank(blind, mate=mate) - 0.1


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_nobody_to_link_is_no_error(attack, easy):
    nobody = walk_release([])
    score = fitted(attack)
    assert score(easy[0], nobody).shape == (12, 0)
    assert score(nobody, easy[1]).shape == (0, 12)


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_too_few_mates_teach_nothing(attack, easy):
    probe, gallery, mate = easy
    few = np.where(np.arange(12) < LEAST_MATES - 1, mate, -1)
    blind = fitted(attack)(probe, gallery)
    for known in (few, np.full(12, -1)):
        taught = fitted(attack, LinkageTrainingSet(probe, gallery, known))(
            probe, gallery
        )
        assert np.array_equal(taught, blind)


def test_a_given_floor_is_not_learnt():
    probe, gallery, _ = two_releases(12)
    train = LinkageTrainingSet(*two_releases(40, seed=7))
    given = Shape(floor_m2=0.5)
    blind, informed = (
        given.fit(context(known))(probe, gallery) for known in (None, train)
    )
    assert np.array_equal(blind, informed)
    assert not np.array_equal(blind, Shape().fit(context(train))(probe, gallery))


RANGES = {
    Profile: ("factor", "turn_m", "floor", "reach_s"),
    Shape: ("floor_m2", "rank", "reach_s"),
    DTW: ("factor", "penalty", "floor", "band"),
    Histogram: ("factor", "speeds"),
    Behaviour: ("shrinkage",),
    Kinematic: ("q", "floor_m2"),
}


@pytest.mark.parametrize(
    ("attack", "field"),
    [(attack, field) for attack, fields in RANGES.items() for field in fields],
)
def test_a_parameter_out_of_range_is_named(attack, field):
    integer = field in {"rank", "speeds"}
    for value in (-1,) if integer else (-1, float("nan")):
        with pytest.raises(ValueError, match=field):
            attack(**{field: value})
