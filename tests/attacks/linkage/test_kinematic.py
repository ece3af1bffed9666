"""States across a gap against filterpy, and what is learnt."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.walks import Person, context, walk_release

from attacks.linkage.kinematic import Kinematic, continuations, mate_gap_range_s
from attacks.linkage.learning import log_rank
from isac_track.kalman import Batch
from isac_track.noise import innovation_variance_m2
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge
from predictors.filterpy_engine import last_states

Q = 0.07
FLOOR_M2 = 0.02


def gap(n=10, *, seed=0, gap_s=2.0, noise_m=0.1, same_start=True, **habits):
    """Windows of 4 s before and after a silent gap, in one frame and on one clock."""
    rng = stream(seed, "test", "gap")
    people = [Person(rng, **habits) for _ in range(n)]
    for person in people:
        person.xy = person.xy + rng.uniform(-4, 4, 2)
    order = rng.permutation(n)
    window = {"length_s": 4.0, "noise_m": noise_m}
    probe = [person.seen(rng, start_s=1.0, **window) for person in people]
    again_s = 5.0 + gap_s
    gallery = [
        people[k].seen(
            rng, start_s=again_s + (0.0 if same_start else rng.uniform(0, 2)), **window
        )
        for k in order
    ]
    return walk_release(probe), walk_release(gallery), np.argsort(order)


def scene(train=None):
    granted = {Knowledge.SCENE} if train is None else {Knowledge.SCENE, Knowledge.TRAIN}
    return context(train, granted=granted)


def innovation_variance(release):
    return innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)


def filtered(t, xy, variance_m2):
    """filterpy's state (x, vx, y, vy) after the last sample, and its covariance."""
    batch = Batch(
        t, xy, np.full(len(t), variance_m2), np.array([0, len(t)]), (100.0, 1.4)
    )
    mean, cov = last_states(batch, q=Q, gate=np.inf)
    return mean.ravel(), np.kron(np.eye(2), cov[0])


def test_it_is_filterpy_across_the_gap():
    probe, gallery, _ = gap(4, same_start=False)
    scores = continuations(probe, gallery, q=Q, floor_m2=FLOOR_M2)
    past, future = (
        [
            filtered(
                sign * track.t[::sign], track.xy[::sign], np.maximum(variance, FLOOR_M2)
            )
            for track, variance in zip(side, innovation_variance(side), strict=True)
        ]
        for side, sign in ((probe, 1), (gallery, -1))
    )
    turn = np.diag([1.0, -1, 1, -1])
    for i, j in np.ndindex(scores.shape):
        (mean, cov), (later, later_cov) = past[i], future[j]
        f, grown = oracle.motion(gallery[j].t[0] - probe[i].t[-1], Q)
        cov = f @ cov @ f.T + grown + turn @ later_cov @ turn
        off = f @ mean - turn @ later
        square = off @ np.linalg.solve(cov, off)
        by_hand = -0.5 * np.linalg.slogdet(cov)[1] - 4.5 * np.log1p(square / 5)
        assert scores[i, j] == pytest.approx(by_hand, rel=1e-6)


def test_a_common_motion_changes_nothing():
    probe, gallery, _ = gap(6)
    score = Kinematic().fit(scene())
    cos, sin = np.cos(0.7), np.sin(0.7)

    def move(release):
        xy = release.xy @ np.array([[cos, sin], [-sin, cos]]) + np.array([30.0, -7.0])
        return replace(release, t=release.t + 1234.5, xy=xy)

    scores = score(probe, gallery)
    assert np.allclose(score(move(probe), move(gallery)), scores, rtol=1e-6, atol=1e-6)
    # Of one alone it changes everything: the frame is the knowledge.
    assert not np.allclose(score(move(probe), gallery), scores, atol=1.0)


def test_rivals_are_those_of_one_rotation():
    probe, gallery, mate = gap(6)
    late = replace(
        gallery, t=gallery.t + np.repeat([0.0, 20.0] * 3, np.diff(gallery.offsets))
    )
    on_time = np.arange(6) % 2 == 0
    known = np.where(on_time[mate], mate, -1)
    assert known.max() >= 0
    scores = continuations(
        probe,
        late,
        Q,
        FLOOR_M2,
        gap_s=mate_gap_range_s(LinkageTrainingSet(probe, late, known)),
    )
    assert np.array_equal(np.isfinite(scores), np.tile(on_time, (6, 1)))


def test_it_learns_how_much_people_turn():
    # People who hold their course, and a long gap: less process noise than usual.
    habits = {"sway": 0.0, "turn_rad_s": 0.0, "gap_s": 5.0, "noise_m": 0.3}
    train = LinkageTrainingSet(*gap(60, seed=4, **habits))
    probe, gallery, mate = gap(60, seed=5, **habits)
    blind = Kinematic().fit(scene())(probe, gallery)
    learnt = Kinematic().fit(scene(train))(probe, gallery)
    assert log_rank(learnt, mate=mate) < log_rank(blind, mate=mate)
