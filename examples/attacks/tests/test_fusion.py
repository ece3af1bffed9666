"""Fusion: its weights against a general solver, what it learns, and from whom."""

from functools import partial

import numpy as np
import pytest
from further_attacks.fusion import Fusion, conditional_logit
from scipy.optimize import minimize
from scipy.special import log_softmax
from walks import context, hits, odd_release, two_releases

from attacks.building_blocks import make_attack
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream

LAW_TEST = "attacks.reconstruction.kalman_rts.looks_radial"
"""What tells the likelihood ratio the error law: no stable name, replaced here alone."""
TRAIN = LinkageTrainingSet(*two_releases(40, seed=1, noise_m=0.3))


def test_the_weights_are_those_of_a_solver_without_gradients():
    rng = stream(0, "choices")
    galleries = [rng.standard_normal((30, n, 3)) for n in (8, 12)]
    mates = [
        (features @ [1.5, -0.5, 0.0] + rng.gumbel(size=features.shape[:2])).argmax(
            axis=1
        )
        for features in galleries
    ]
    prior, ridge = np.array([1.0, 0.0, 0.0]), 2.0

    def loss(weights):
        log_p = [log_softmax(features @ weights, axis=1) for features in galleries]
        own = sum(
            p[np.arange(m.size), m].sum() for p, m in zip(log_p, mates, strict=True)
        )
        return ridge / 2 * ((weights - prior) ** 2).sum() - own

    exact = minimize(
        loss, prior, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9}
    ).x
    weights = conditional_logit(galleries, mates, prior=prior, ridge=ridge)
    np.testing.assert_allclose(weights, exact, atol=1e-3)
    assert weights[0] > 1.0
    assert weights[1] < 0.0


def test_new_people_are_linked_at_least_as_often_as_by_the_likelihood_ratio():
    probe, gallery, mate = two_releases(40, seed=2, noise_m=0.3)
    known = context(TRAIN)
    fused, alone = (
        attack.fit(known)(probe, gallery)
        for attack in (Fusion(), make_attack("likelihood_ratio"))
    )
    assert hits(fused, mate) >= max(hits(alone, mate), 0.5)
    assert not np.allclose(fused, alone)


def test_wrong_mates_teach_other_weights():
    wrong = LinkageTrainingSet(TRAIN.probe, TRAIN.gallery, np.roll(TRAIN.mate, 1))
    probe, gallery, mate = two_releases(40, seed=2, noise_m=0.3)
    right, misled = (
        Fusion().fit(context(train))(probe, gallery) for train in (TRAIN, wrong)
    )
    assert hits(misled, mate) < hits(right, mate)


def test_few_mates_leave_the_likelihood_ratio_as_it_is():
    few = LinkageTrainingSet(
        TRAIN.probe, TRAIN.gallery, np.where(np.arange(40) < 15, TRAIN.mate, -1)
    )
    probe, gallery, _ = two_releases(5, seed=3)
    fused, alone = (
        attack.fit(context(few))(probe, gallery)
        for attack in (Fusion(), make_attack("likelihood_ratio"))
    )
    np.testing.assert_array_equal(fused, alone)


def test_a_ridge_must_be_positive():
    with pytest.raises(ValueError, match="ridge must be positive"):
        Fusion(ridge=0.0)


@pytest.mark.parametrize("is_radial", [False, True], ids=["isotropic", "radial"])
def test_a_pair_of_odd_tracks_has_a_score_of_its_own_also_after_training(
    is_radial, monkeypatch
):
    """But for the error law, which shows in all tracks of a release together."""
    monkeypatch.setattr(LAW_TEST, lambda _release: is_radial)
    probe, gallery = odd_release(0), odd_release(1, n=9)
    train = LinkageTrainingSet(
        odd_release(2, n=24), odd_release(3, n=24), np.arange(24)
    )
    score = Fusion().fit(context(train))
    scores = score(probe, gallery)
    assert np.isfinite(scores).all()
    for row, column in ((0, 0), (1, 2), (5, 8), (13, 8)):
        close = partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6)
        close(score(probe.tracks([row]), gallery), scores[[row]])
        close(score(probe, gallery.tracks([column])), scores[:, [column]])
