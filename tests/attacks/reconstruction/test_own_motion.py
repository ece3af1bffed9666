"""Motions of their own: identified in a planted crowd, useful there, free elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import context, cv_walks, flat_release, moved

from attacks.reconstruction.kalman_rts import KalmanRTS, RadialRTS
from attacks.reconstruction.learning import exposure_loss
from attacks.reconstruction.ou_rts import OuRTS
from attacks.reconstruction.own_motion import MOTIONS, SHARES, probabilities
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import SlowError
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge

N, SIZE = 60, 250
STILL, STANDS, WALKS = 0, 1, 5  # of `MOTIONS`
NOISE_M = 0.7
EPSILON_M = 0.3


def crowd(*kinds, noise_m=NOISE_M, slow_m=0.0, seed=0):
    """Return a release of people, with some kinds of motion in turn, and the truth."""
    rng = stream(seed, "test", "own motion", *kinds)
    step = rng.uniform(1 / 16, 1 / 8, (N, SIZE))
    kind = np.resize(kinds, N)
    q, tau = MOTIONS.q[kind], MOTIONS.tau_s[kind]
    # Euler steps of a tenth of each: exact enough, and not the solution that is tested.
    velocity = np.sqrt(q * tau / 2)[:, None] * rng.standard_normal((N, 2))
    place, path = np.zeros((N, 2)), np.empty((N, SIZE, 2))
    for k in range(SIZE):
        for _ in range(10):
            dt = step[:, k, None] / 10
            place = place + dt * velocity
            kick = np.sqrt(q[:, None] * dt) * rng.standard_normal((N, 2))
            velocity = velocity * (1 - dt / tau[:, None]) + kick
        path[:, k] = place
    t, truth = np.cumsum(step, axis=1).ravel(), path.reshape(-1, 2)
    offsets = np.arange(N + 1) * SIZE
    xy = truth + noise_m * rng.standard_normal(truth.shape)
    if slow_m:
        error = correlated_errors(
            t=t, offsets=offsets, law="isotropic", tau_s=5.0, rng=rng
        )
        xy = xy + slow_m * error
    return flat_release(t, xy, offsets), truth


def plr(attack, release, truth, known=None):
    off_m = np.hypot(*(attack.fit(known or context())(release).xy - truth).T)
    return (off_m.reshape(N, SIZE) < EPSILON_M).mean(axis=1)


def gain(attack, release, truth, known=None):
    """Return the mean gain in PLR over a common motion, and its standard error."""
    common = replace(attack, own_motion=False)
    difference = plr(attack, release, truth, known) - plr(common, release, truth, known)
    return difference.mean(), difference.std(ddof=1) / np.sqrt(N)


def test_standing_and_walking_people_get_different_motions():
    release, _ = crowd(STANDS, WALKS)
    variance = np.full(release.t.size, NOISE_M**2)
    case = Batch(release.t, release.xy, variance, release.offsets, (100.0, 10.0))
    probability = probabilities(case, SlowError(0.0, 0.0))
    np.testing.assert_allclose(probability.sum(axis=1), 1.0)
    assert (probability[::2].argmax(axis=1) <= STANDS).mean() > 0.9
    # Between walkers of neighbouring motions no track decides: their q is within a
    # factor of six.
    q = probability[1::2] @ np.log(MOTIONS.q)
    assert abs(q.mean() - np.log(MOTIONS.q[WALKS])) < np.log(2.0)
    assert (probability[1::2, :4].sum(axis=1) < 0.5).all()


def test_a_lone_sample_tells_nothing():
    case = Batch(
        np.zeros(1), np.ones((1, 2)), np.ones(1), np.array([0, 1]), (100.0, 10.0)
    )
    np.testing.assert_allclose(
        probabilities(case, SlowError(0.0, 0.0)), [SHARES], rtol=1e-9
    )
    assert sum(SHARES) == pytest.approx(1.0)


@pytest.mark.parametrize("slow_m", [0.0, 0.5])
def test_a_crowd_of_two_motions_is_known_better(slow_m):
    release, truth = crowd(
        STANDS, WALKS, slow_m=slow_m, noise_m=0.1 if slow_m else NOISE_M
    )
    attack = OuRTS(std_m=slow_m, tau_s=5.0) if slow_m else RadialRTS()
    mean, error = gain(attack, release, truth)
    assert mean > 0.02 + 2 * error
    # With a common motion, and none fitted, the attack is `KalmanRTS`.
    if not slow_m:
        common = plr(replace(attack, own_motion=False), release, truth)
        np.testing.assert_array_equal(common, plr(KalmanRTS(), release, truth))


def test_behind_a_slow_error_it_is_as_good_as_the_mean_of_a_standing_person():
    release, truth = crowd(STILL, slow_m=0.5, noise_m=0.1)
    mean = release.xy.reshape(N, SIZE, 2).mean(axis=1, keepdims=True)
    off_m = np.linalg.norm(truth.reshape(N, SIZE, 2) - mean, axis=2)
    by_mean = (off_m < EPSILON_M).mean(axis=1)
    smoothed = plr(OuRTS(std_m=0.5, tau_s=5.0), release, truth)
    lost = by_mean - smoothed
    assert lost.mean() < 0.05 + 2 * lost.std(ddof=1) / np.sqrt(N)


@pytest.mark.parametrize("law", ["isotropic", "radial"])
def test_a_crowd_of_one_motion_loses_next_to_nothing(law):
    t, truth, offsets = cv_walks(*[SIZE] * N, q=RadialRTS.DEFAULT_Q)
    rng = stream(0, "test", "own motion", law)
    unit = rng.standard_normal(truth.shape)
    if law == "radial":
        turn = rng.uniform(0.0, 2.0 * np.pi, t.size)
        unit = unit[:, :1] * np.column_stack([np.cos(turn), np.sin(turn)])
    release = flat_release(t, truth + NOISE_M * unit, offsets)
    mean, error = gain(RadialRTS(), release, truth)
    assert mean > -0.01 - 2 * error
    assert mean < 0.01 + 2 * error  # the one motion is the true one: nothing is better


def test_a_given_q_is_that_of_all_tracks():
    release, _ = crowd(STANDS, WALKS)
    for attack in (RadialRTS(q=0.1), OuRTS(q=0.1), OuRTS(q=0.1, std_m=0.4, tau_s=5.0)):
        common = replace(attack, own_motion=False)
        ours, theirs = (
            smoother.fit(context())(release).xy for smoother in (attack, common)
        )
        np.testing.assert_array_equal(ours, theirs)


def test_a_track_depends_on_no_other_and_on_no_frame():
    release, _ = crowd(STANDS, WALKS, slow_m=0.5)
    smooth = OuRTS(std_m=0.5, tau_s=5.0).fit(context())
    # Half of the people: with very few the release does not show whether errors are
    # radial.
    rows = np.arange(N)[::-2]
    whole, part = smooth(release), smooth(release.tracks(rows))
    place_by_track = whole.xy.reshape(N, SIZE, 2)
    np.testing.assert_allclose(
        part.xy.reshape(-1, SIZE, 2), place_by_track[rows], atol=1e-9
    )
    turned = moved(release)
    shift = np.hypot(*(smooth(turned).xy - turned.xy).T)
    np.testing.assert_allclose(shift, np.hypot(*(whole.xy - release.xy).T), atol=1e-6)


def test_with_training_it_learns_the_passes_and_keeps_each_tracks_own_motion():
    release, truth = crowd(STANDS, WALKS)
    known = context(
        TrainingSet(*crowd(STANDS, WALKS, seed=1)), granted={Knowledge.TRAIN}
    )
    taught, alone = (
        RadialRTS().fit(knowledge)(release).xy for knowledge in (known, context())
    )
    np.testing.assert_allclose(taught, alone, atol=1e-9)
    loss = exposure_loss(
        xy=taught, truth=truth, offsets=release.offsets, epsilon_m=EPSILON_M
    )
    common = RadialRTS(own_motion=False).fit(known)(release).xy
    assert loss < exposure_loss(
        xy=common, truth=truth, offsets=release.offsets, epsilon_m=EPSILON_M
    )
