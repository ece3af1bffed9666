"""Noise levels on both sides of a silence: plain loops, and planted worlds."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import context, hits, odd_release, walk_release
from scipy.stats import norm

from attacks.linkage.kinematic import Kinematic, continuations
from attacks.linkage.learning import log_rank
from attacks.linkage.noise_levels import (
    ASSUMED,
    NoiseModel,
    end_levels,
    fitted_model,
    log_ratios,
)
from attacks.reconstruction.kalman_rts import RadialRTS
from attacks.remembered import record_shared, select_tracks
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, derived

N = 40
SCENE = frozenset({Knowledge.SCENE})
RECENT_S = 2.0
LEVEL_M = (0.05, 1.5)  # Least and largest standard deviation in the planted worlds.


def standing(rng, noise_m, *, from_s, n_samples=50):
    """People who all stand in one place, at 10 Hz: positions tell nobody apart."""
    t = from_s + np.arange(n_samples) / 10.0
    return walk_release(
        [(t, each * rng.standard_normal((n_samples, 2))) for each in noise_m]
    )


def planted(seed, *, persists=True, n=N):
    """Probe and gallery of people who stand in one place, and the mates.

    Each has a noise level, which is drawn anew after the silence where it does not
    persist.
    """
    rng = stream(seed, "test", "noise levels")
    before_m, after_m = np.exp(rng.uniform(*np.log(LEVEL_M), (2, n)))
    order = rng.permutation(n)
    probe = standing(rng, before_m, from_s=0.0)
    gallery = standing(rng, (before_m if persists else after_m)[order], from_s=6.0)
    return probe, gallery, np.argsort(order)


def fitted(linker, train=None):
    granted = SCENE if train is None else SCENE | {Knowledge.TRAIN}
    return linker.fit(context(train, granted=granted))


def level_by_hand(t, xy, silence_s):
    """Log level and its variance of one track, triple by triple."""
    squares_m2, weights = [], []
    for k in range(2, len(t)):
        ratio = (t[k] - t[k - 1]) / (t[k - 1] - t[k - 2])
        off_m = (xy[k] - xy[k - 1]) - ratio * (xy[k - 1] - xy[k - 2])
        squares_m2.append(0.5 * (off_m @ off_m) / (1.0 + (1.0 + ratio) ** 2 + ratio**2))
        weights.append(np.exp(-min(abs(t[k - 1] - silence_s), 60.0) / RECENT_S))
    mean_m2 = np.average(squares_m2, weights=weights)
    return (
        np.log(max(mean_m2, 1e-4)),
        3.0 * np.sum(np.square(weights)) / np.sum(weights) ** 2,
    )


@pytest.mark.parametrize("direction", [1, -1])
def test_levels_are_those_of_a_loop_over_triples(direction):
    release = odd_release(4)
    levels = end_levels(release, direction)
    for row, (first, end) in enumerate(pairwise(release.offsets)):
        t, xy = release.t[first:end], release.xy[first:end]
        if len(t) < 3:
            assert levels.variance[row] == 1e6
            continue
        by_hand = level_by_hand(t, xy, t[-1] if direction > 0 else t[0])
        assert levels.log_m2[row] == pytest.approx(by_hand[0], rel=1e-9)
        assert levels.variance[row] == pytest.approx(by_hand[1], rel=1e-9)


def test_samples_near_the_silence_count_most():
    rng = stream(0, "test", "fading level")
    t = np.arange(100) / 10.0
    noise_m = np.repeat([0.1, 1.0], 50)[:, None] * rng.standard_normal((100, 2))
    release = walk_release([(t, noise_m)])
    begins, ends = (
        np.exp(0.5 * end_levels(release, direction).log_m2[0]) for direction in (-1, 1)
    )
    assert begins < 0.4
    assert ends > 0.8


def test_ratios_are_those_of_two_normal_densities():
    probe, gallery, _ = planted(0)
    model = NoiseModel(correlation=0.7, variance=1.3)
    ratios = log_ratios(probe, gallery, model)
    ends, starts = end_levels(probe, 1), end_levels(gallery, -1)
    for i, j in np.ndindex(ratios.shape):
        difference = ends.log_m2[i] - starts.log_m2[j]
        measured = ends.variance[i] + starts.variance[j]
        person, strangers = (
            norm(scale=np.sqrt(measured + 2.0 * 1.3 * share)).logpdf(difference)
            for share in (1.0 - 0.7, 1.0)
        )
        assert ratios[i, j] == pytest.approx(person - strangers, rel=1e-9, abs=1e-12)


def test_a_model_without_correlation_and_a_track_without_a_level_tell_nothing():
    probe, gallery, _ = planted(0)
    assert log_ratios(probe, gallery, NoiseModel(0.0, 1.0)) == pytest.approx(
        0.0, abs=1e-12
    )
    short = walk_release([(np.arange(2.0), np.ones((2, 2)))])
    assert log_ratios(short, gallery, NoiseModel(0.9, 1.0)) == pytest.approx(
        0.0, abs=1e-4
    )


@pytest.mark.parametrize(("law", "expected"), [("radial", 3.0), ("gaussian", 1.9)])
def test_the_variance_of_an_estimate_is_that_of_the_error_law(law, expected):
    rng = stream(0, "test", "variance of levels", law)
    n_tracks, n_samples = 3000, 40
    errors_m = rng.standard_normal((n_tracks, n_samples, 2))
    if law == "radial":
        length_m = np.hypot(*np.moveaxis(errors_m, -1, 0))
        errors_m *= (rng.standard_normal((n_tracks, n_samples)) / length_m)[..., None]
    # All long before a silence that is far away: of equal weights, but for half a
    # percent.
    t = np.arange(n_samples) * 1e-3
    levels = end_levels(walk_release([(t, each) for each in errors_m]), 1)
    assert levels.log_m2.var() * (n_samples - 2) == pytest.approx(expected, rel=0.1)


def test_a_model_is_fitted_to_how_levels_vary_and_persist():
    rng = stream(0, "test", "fitted model")
    n, spread, correlation = 600, 0.8, 0.6
    covariance = spread**2 * np.array([[1.0, correlation], [correlation, 1.0]])
    levels_m = np.exp(0.5 * rng.multivariate_normal([0.0, 0.0], covariance, n).T)
    sides = (standing(rng, each, from_s=0.0, n_samples=40) for each in levels_m)
    model = fitted_model(LinkageTrainingSet(*sides, np.arange(n)))
    # Errors are Gaussian, whose levels are known better than those of the law that is
    # assumed.
    assert model.variance == pytest.approx(spread**2, rel=0.15)
    assert model.correlation == pytest.approx(correlation, abs=0.1)


def test_without_training_it_assumes_the_model_that_it_names():
    assert ASSUMED.correlation == 0.5  # exp(-0.7)
    assert ASSUMED.variance == pytest.approx(np.log(10.0 ** (4.0 / 10.0)) ** 2)


class TestWorldsWherePositionsTellNothing:
    @pytest.mark.parametrize("is_taught", [False, True])
    def test_a_lasting_noise_level_links_people_by_itself(self, is_taught):
        probe, gallery, mate = planted(1)
        train = LinkageTrainingSet(*planted(2)) if is_taught else None
        ignorant = fitted(Kinematic(noise_correlation=0.0), train)(probe, gallery)
        knowing = fitted(Kinematic(), train)(probe, gallery)
        assert hits(knowing, mate) > 3.0 / N  # three times chance
        # A mean log rank less by 0.7: mates stand twice as far in front.
        assert log_rank(knowing, mate=mate) < log_rank(ignorant, mate=mate) - 0.7

    def test_levels_that_do_not_persist_are_learnt_to_tell_nothing(self):
        correlations = [
            fitted_model(
                LinkageTrainingSet(*planted(seed, persists=False, n=200))
            ).correlation
            for seed in range(5)
        ]
        assert np.mean(correlations) < 0.1
        assert max(correlations) <= 0.2
        persistent = fitted_model(LinkageTrainingSet(*planted(0, n=200)))
        assert persistent.correlation >= 0.9

    def test_how_far_levels_persist_is_learnt(self):
        train = LinkageTrainingSet(*planted(2))
        probe, gallery, mate = planted(1)
        learnt = fitted(Kinematic(), train)(probe, gallery)
        blind = fitted(Kinematic())(probe, gallery)
        assert log_rank(learnt, mate=mate) < log_rank(blind, mate=mate)

    def test_a_correlation_of_nothing_leaves_levels_out(self):
        probe, gallery, _ = planted(1)
        without = fitted(Kinematic(noise_correlation=0.0))(probe, gallery)
        q, floor_m2 = Kinematic.DEFAULT_Q, Kinematic.DEFAULT_FLOOR_M2
        assert np.array_equal(without, continuations(probe, gallery, q, floor_m2))


def test_a_common_shift_and_another_order_change_nothing():
    probe, gallery, _ = planted(1)
    ratios = log_ratios(probe, gallery, ASSUMED)
    way_m = np.array([300.0, -70.0])
    shifted = (replace(each, xy=each.xy + way_m) for each in (probe, gallery))
    assert log_ratios(*shifted, ASSUMED) == pytest.approx(ratios, abs=1e-6)
    rng = stream(0, "test", "order")
    rows, columns = rng.permutation(N), rng.permutation(N)
    turned = log_ratios(probe.tracks(rows), gallery.tracks(columns), ASSUMED)
    assert turned == pytest.approx(ratios[np.ix_(rows, columns)], rel=1e-9)
    # A pair's score depends on nobody else.
    alone = log_ratios(probe.tracks([3]), gallery.tracks([5]), ASSUMED)
    assert alone[0, 0] == pytest.approx(ratios[3, 5], rel=1e-9)


def test_behind_a_reconstruction_levels_are_those_of_what_was_shared():
    probe, gallery, mate = planted(1)

    def smoothed(shared):
        smooth = RadialRTS().fit(context(granted=()))(shared)
        return derived(shared, xy=smooth.xy), shared

    noted = [record_shared(*smoothed(each)) for each in (probe, gallery)]
    ratios = log_ratios(probe, gallery, ASSUMED)
    assert np.array_equal(log_ratios(*noted, ASSUMED), ratios)
    rows = np.array([7, 2])
    assert np.array_equal(
        log_ratios(select_tracks(noted[0], rows), noted[1], ASSUMED), ratios[rows]
    )
    # What is left after smoothing links fewer.
    forgotten = [smoothed(each)[0] for each in (probe, gallery)]
    assert log_rank(ratios, mate=mate) < log_rank(
        log_ratios(*forgotten, ASSUMED), mate=mate
    )


@pytest.mark.parametrize("correlation", [-0.1, 1.0, np.nan])
def test_a_correlation_is_from_nothing_to_below_all(correlation):
    with pytest.raises(ValueError, match="noise_correlation must be from 0 to below 1"):
        Kinematic(noise_correlation=correlation)
