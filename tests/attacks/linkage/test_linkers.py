"""What every linkage attack owes: the right person first, any frame, any track, no memory."""

import numpy as np
import pytest
from linkage_walks import (
    context,
    hits,
    moved,
    odd_release,
    release_of,
    training,
    two_releases,
)

from attacks.linkage.behaviour import Behaviour
from attacks.linkage.dtw import DTW
from attacks.linkage.histogram import Histogram
from attacks.linkage.kinematic import Kinematic
from attacks.linkage.profile import Profile
from attacks.linkage.shape import Shape
from attacks.linkage.signals import LEAST_MATES, tracks_of
from isac_track.protocols import LinkageAttack, grants, kind_of
from isac_track.types import Knowledge

BY_MOTION = [Profile(), DTW(), Shape(), Behaviour(), Histogram()]
ALL = [*BY_MOTION, Kinematic()]


def name(attack):
    return type(attack).__name__


def fitted(attack, train=None):
    return attack.fit(context(train, scene=isinstance(attack, Kinematic)))


@pytest.fixture(scope="module")
def easy():
    return two_releases(12)


@pytest.fixture(scope="module")
def lesson():
    return training(*two_releases(30, seed=1, noise_m=0.02))


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_it_is_a_linkage_attack_of_two_rows(attack):
    assert isinstance(attack, LinkageAttack)
    assert kind_of(attack) == "linkage"
    task = frozenset({Knowledge.SCENE}) & attack.requires
    assert list(grants(attack, everyone=task)) == ["blind", "informed"]


@pytest.mark.parametrize("informed", [False, True])
@pytest.mark.parametrize("attack", [Profile(), Shape(), DTW(), Histogram()], ids=name)
def test_an_easy_walk_is_found(attack, informed, easy, lesson):
    probe, gallery, mate = easy
    # Warping reaches no further than its band, and a histogram knows no time: most will do.
    least = 1.0 if isinstance(attack, Profile | Shape) else 0.75
    scores = fitted(attack, lesson if informed else None)(moved(probe, seed=3), moved(gallery))
    assert hits(scores, mate) >= least


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_a_walk_is_its_own_best_match(attack, easy):
    probe, _, _ = easy
    if isinstance(attack, Kinematic):
        pytest.skip("whoever walks on is not where he was: see its own tests")
    scores = fitted(attack)(probe, moved(probe, seed=5))
    assert hits(scores, np.arange(len(probe))) == 1.0


@pytest.mark.parametrize("informed", [False, True])
@pytest.mark.parametrize("attack", BY_MOTION, ids=name)
def test_neither_frame_nor_clock_of_a_walk_counts(attack, informed, easy, lesson):
    probe, gallery, _ = easy
    score = fitted(attack, lesson if informed else None)
    scores = score(probe, gallery)
    assert scores.std() > 0.1
    assert np.allclose(score(moved(probe, seed=1), gallery), scores, rtol=1e-5, atol=1e-5)
    assert np.allclose(score(probe, moved(gallery, seed=2)), scores, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("attack", [Profile(), Shape(), DTW()], ids=name)
def test_a_mirror_image_is_somebody_else(attack, easy):
    probe, _, _ = easy
    score = fitted(attack)
    same = np.diag(score(probe, moved(probe)))
    mirrored = np.diag(score(probe, moved(probe, mirrored=True)))
    assert (same > mirrored + 0.5).all()


@pytest.mark.parametrize("informed", [False, True])
@pytest.mark.parametrize("attack", ALL, ids=name)
def test_odd_tracks_have_finite_scores(attack, informed, lesson):
    probe, gallery = odd_release(0), odd_release(1, n=9)
    before = probe.xy.copy(), gallery.t.copy()
    score = fitted(attack, lesson if informed else None)
    scores = score(probe, gallery)
    assert scores.shape == (14, 9)
    assert scores.dtype == np.float64
    assert np.isfinite(scores).all()
    assert np.array_equal(probe.xy, before[0])
    assert np.array_equal(gallery.t, before[1])
    assert np.array_equal(score(probe, gallery), scores)


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_odd_tracks_can_be_learnt_from(attack):
    probe = odd_release(2, n=24)
    train = training(probe, odd_release(3, n=24), np.arange(24))
    scores = fitted(attack, train)(odd_release(0), odd_release(1))
    assert np.isfinite(scores).all()


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_a_pair_is_scored_for_itself(attack):
    probe, gallery = odd_release(0), odd_release(1, n=9)
    score = fitted(attack)
    scores = score(probe, gallery)
    for row in (0, 1, 5, 13):
        one = score(tracks_of(probe, np.array([row])), gallery)
        assert np.allclose(one[0], scores[row], rtol=1e-6, atol=1e-6)
    for column in (0, 2, 8):
        one = score(probe, tracks_of(gallery, np.array([column])))
        assert one.shape == (14, 1)
        assert np.allclose(one[:, 0], scores[:, column], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_nobody_to_link_is_no_error(attack, easy):
    nobody = release_of([])
    score = fitted(attack)
    assert score(easy[0], nobody).shape == (12, 0)
    assert score(nobody, easy[1]).shape == (0, 12)


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_too_few_mates_teach_nothing(attack, easy):
    probe, gallery, mate = easy
    few = np.where(np.arange(12) < LEAST_MATES - 1, mate, -1)
    blind = fitted(attack)(probe, gallery)
    for known in (few, np.full(12, -1)):
        taught = fitted(attack, training(probe, gallery, known))(probe, gallery)
        assert np.array_equal(taught, blind)


@pytest.mark.parametrize("attack", ALL, ids=name)
def test_strangers_in_the_training_set_are_no_mates(attack):
    probe, gallery, mate = two_releases(24, seed=4)
    known = np.where(np.arange(24) % 2 == 0, mate, -1)
    scores = fitted(attack, training(probe, gallery, known))(probe, gallery)
    assert np.isfinite(scores).all()


@pytest.mark.parametrize(
    ("attack", "field"),
    [
        (Profile, "factor"),
        (Profile, "turn_m"),
        (Profile, "floor"),
        (Profile, "reach_s"),
        (Shape, "floor_m2"),
        (Shape, "rank"),
        (Shape, "reach_s"),
        (DTW, "factor"),
        (DTW, "penalty"),
        (DTW, "floor"),
        (DTW, "band"),
        (Histogram, "factor"),
        (Histogram, "speeds"),
        (Behaviour, "shrinkage"),
        (Kinematic, "q"),
        (Kinematic, "floor_m2"),
    ],
)
@pytest.mark.parametrize("value", [-1, float("nan")])
def test_a_parameter_out_of_range_is_named(attack, field, value):
    if np.isnan(value) and field in {"rank", "speeds"}:
        pytest.skip("an integer")
    with pytest.raises(ValueError, match=field):
        attack(**{field: value})
