"""The noise of each sample as an adversary estimates it: blind, declared, by FID."""

import numpy as np
import pytest
from helpers.walks import context, walk_release

from attacks.reconstruction.learning import learn_variance
from isac_track.noise import (
    MIN_VARIANCE_M2,
    UNKNOWN_VARIANCE_M2,
    innovation_variance_m2,
)
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.sensing import fisher_information_density, unit_errors
from isac_track.sharing import Clean, Fid, Fixed, Raw
from isac_track.types import Knowledge, Sensed

MECHANISM, SIGMA, TRAIN = Knowledge.MECHANISM, Knowledge.SIGMA, Knowledge.TRAIN
SHORT_S, LONG_S = 0.08, 0.2
GAP = 4.6
RAW_M = 0.3
ETA = (GAP / RAW_M) ** 2 / 0.125
"""At RAW_M information lasts for 0.125 s: only intervals of 0.08 s exceed eta."""
ADDED_M = 0.5 * (1.5 - np.exp(-(0.125 / SHORT_S - 1.0)))
"""The standard deviation that the rule then adds, 0.465 m."""
VARIANCE_M2 = {  # per axis, radial: (short intervals, long ones)
    "linear": ((RAW_M + ADDED_M) ** 2 / 2, RAW_M**2 / 2),
    "independent": ((RAW_M**2 + ADDED_M**2) / 2, RAW_M**2 / 2),
}


RULES = pytest.mark.parametrize("adding", ["linear", "independent"])
TRAINING_M = np.geomspace(0.08, 1.2, 24)


def shared(mechanism, *, raw_m=(RAW_M,), n_samples=300, seed=0):
    """Return a training set of straight walks, and the samples after short intervals.

    There is a walk for each raw standard deviation; every ten samples the interval may
    change.
    """
    rng = stream(seed, "test", "fid noise", len(raw_m))
    n = len(raw_m)
    spells = rng.integers(0, 2, (n, -(-n_samples // 10)))
    is_short = np.repeat(spells, 10, axis=1)[:, :n_samples] == 1
    second = min(1, n_samples - 1)
    # The rule takes the next interval for the first sample.
    is_short[:, 0] = is_short[:, second]
    t = np.cumsum(np.where(is_short, SHORT_S, LONG_S), axis=1)
    truth = rng.normal(0, 1, (n, 1, 2)) * t[..., None] + rng.normal(0, 5, (n, 1, 2))
    t, truth = t.reshape(-1), truth.reshape(-1, 2)
    sigma = np.repeat(raw_m, n_samples)
    unit = unit_errors(n_samples=sigma.size, law="radial", rng=rng)
    offsets = np.arange(n + 1) * n_samples
    information = (GAP / sigma) ** 2
    sensed = Sensed(
        t=t,
        xy=truth + sigma[:, None] * unit,
        unit_error=unit,
        sigma_raw=sigma,
        information=information,
        fid=fisher_information_density(information=information, t=t, offsets=offsets),
        offsets=offsets,
    )
    return TrainingSet(mechanism.share(sensed, rng), truth), is_short.reshape(-1)


def released(mechanism, **given):
    return shared(mechanism, **given)[0].release


def blind(release):
    return learn_variance(context())(release)


def test_each_track_has_the_level_of_its_innovations():
    release = released(Raw(), raw_m=(0.1, 0.4, 1.5)).without_sigma()
    level = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    assert blind(release).tolist() == np.repeat(level, 300).tolist()
    assert level == pytest.approx([0.01 / 2, 0.16 / 2, 2.25 / 2], rel=0.3)
    short = released(Raw(), raw_m=(0.1, 0.2), n_samples=2)
    assert blind(short).tolist() == [UNKNOWN_VARIANCE_M2] * 4


@pytest.mark.parametrize(
    ("mechanism", "granted"),
    [
        # The rule takes both kinds of knowledge.
        (Fid(ETA), (TRAIN,)),
        (Fid(ETA), (MECHANISM,)),
        # There is no rule.
        (Raw(), (MECHANISM, TRAIN)),
        (Fixed(0.5, adding="independent"), (MECHANISM, TRAIN)),
    ],
)
def test_without_a_known_rule_and_training_only_positions_count(mechanism, granted):
    victim = released(mechanism, seed=1)
    training, _ = shared(mechanism, raw_m=TRAINING_M)
    known = context(training, granted=granted, mechanism=mechanism)
    assert learn_variance(known)(victim).tolist() == blind(victim).tolist()


def test_of_what_is_declared_the_radial_law_is_supposed():
    victim = released(Raw(), raw_m=(0.3, 1.2))
    variance = learn_variance(context(granted={SIGMA}))(victim)
    assert variance.tolist() == pytest.approx(np.repeat([0.09 / 2, 1.44 / 2], 300))


@pytest.mark.parametrize("length_m", [1.0, np.sqrt(2.0)])
def test_the_law_is_learnt_from_other_people_by_hand(length_m):
    # Squared errors 1 + 4 over declared 4 + 1, on two axes: one half of each; or twice
    # as much.
    walk = np.array([0.0, 1.0]), length_m * np.array([[1.0, 0.0], [0.0, 2.0]])
    release = walk_release([walk], sigma=np.array([2.0, 1.0]))
    train = TrainingSet(release, np.zeros((2, 2)))
    victim = released(Fixed(0.4), raw_m=(0.1, 1.0), seed=1)
    variance = learn_variance(context(train, granted=(SIGMA, TRAIN)))(victim)
    assert variance / victim.sigma**2 == pytest.approx(length_m**2 / 2)


def test_what_was_declared_exact_keeps_a_variance():
    train, _ = shared(Clean())
    variance = learn_variance(context(train, granted=(SIGMA, TRAIN)))(train.release)
    assert (variance == MIN_VARIANCE_M2).all()


def informed(rule, *, seed=0):
    train, _ = shared(rule, raw_m=TRAINING_M, n_samples=600, seed=seed)
    return learn_variance(context(train, granted=(MECHANISM, TRAIN), mechanism=rule))


def per_track(values, chosen):
    """The mean over the chosen samples of each track of 300 samples, (N,)."""
    return np.nanmean(np.where(chosen, values, np.nan).reshape(-1, 300), axis=1)


@RULES
def test_by_the_rule_it_is_inferred_which_samples_were_perturbed_and_by_how_much(
    adding,
):
    rule = Fid(ETA, adding=adding)
    victims, is_short = shared(rule, raw_m=(RAW_M,) * 60, seed=1)
    release = victims.release.without_sigma()
    variance = informed(rule)(release)
    short, long = (per_track(variance, chosen) for chosen in (is_short, ~is_short))
    assert (short > long).mean() > 0.75
    assert (short > long * (1 - 1e-9)).all()  # alike where all or none were perturbed
    true_short, true_long = VARIANCE_M2[adding]
    assert 0.5 < np.log(np.median(short / long)) / np.log(true_short / true_long) < 1.3
    # Blind there is one level for all of a track, and its mean is the same.
    level = blind(release).reshape(60, 300)
    assert (np.ptp(level, axis=1) == 0).all()
    assert variance.reshape(60, 300).mean(axis=1) == pytest.approx(level[:, 0])


@RULES
@pytest.mark.parametrize("raw_m", [0.05, 2.0], ids=["all in full", "none"])
def test_far_from_the_threshold_all_samples_of_a_track_have_one_variance(adding, raw_m):
    rule = Fid(ETA, adding=adding)
    victims, is_short = shared(rule, raw_m=(raw_m,) * 20, seed=1)
    variance = informed(rule)(victims.release.without_sigma())
    ratio = per_track(variance, is_short) / per_track(variance, ~is_short)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


@RULES
@pytest.mark.parametrize("n_samples", [1, 2, 3])
def test_tracks_of_one_and_two_samples_are_no_trouble(adding, n_samples):
    victims = released(Fid(ETA, adding=adding), raw_m=(0.1, 0.3), n_samples=n_samples)
    variance = informed(Fid(ETA, adding=adding))(victims)
    assert variance.shape == (2 * n_samples,)
    assert (variance > 0).all()
