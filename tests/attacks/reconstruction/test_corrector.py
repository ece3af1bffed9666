"""The corrector learns errors of the smoother from others, or changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import context, flat_release, odd_release, smooth_walks

from attacks.reconstruction.corrector import _EDGES_S, Corrector, _sample_features
from attacks.reconstruction.kalman_rts import RadialRTS, information
from attacks.reconstruction.learning import exposure_loss
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Reconstruction

SIZES = (60,) * 12
BEHIND_M = 0.4


def late_walks(seed, *sizes):
    """Return walks in frames of their own, shown with a lag, and the truth."""
    release, truth = smooth_walks(*sizes, noise_m=0.05, seed=seed)
    z = truth @ [1.0, 1j]
    row = np.repeat(np.arange(len(sizes)), sizes)
    step = np.concatenate(
        [np.gradient(z[row == number]) for number in range(len(sizes))]
    )
    turn = np.exp(2j * np.pi * stream(seed, "test", "headings").random(len(sizes)))[row]
    seen, walked = (
        turn * (release.xy @ [1.0, 1j] - BEHIND_M * step / abs(step)),
        turn * z,
    )
    return replace(release, xy=plane(seen)), plane(walked)


def plane(z):
    return np.stack([z.real, z.imag], axis=1)


def loss(reconstruction, truth, release):
    return exposure_loss(
        xy=reconstruction.xy, truth=truth, offsets=release.offsets, epsilon_m=0.3
    )


@pytest.mark.parametrize(
    "granted", [(), (Knowledge.SIGMA,)], ids=["informed", "oracle"]
)
def test_a_lag_is_corrected_in_every_direction_of_walking(granted):
    train, release = late_walks(1, *SIZES), late_walks(2, *SIZES)
    if granted:
        train, release = (
            (replace(shown, sigma=np.full(shown.t.size, 0.4)), truth)
            for shown, truth in (train, release)
        )
    known = context(TrainingSet(*train), granted=(Knowledge.TRAIN, *granted))
    smooth = RadialRTS().fit(known)(release[0])
    correct = Corrector().fit(known)(release[0])
    # The smoother cannot know of the lag: d^2 / (d^2 + 0.3^2) is 0.64 at 0.4 m.
    assert loss(smooth, release[1], release[0]) > 0.6
    assert loss(correct, release[1], release[0]) < 0.15
    np.testing.assert_array_equal(correct.std, smooth.std)


def test_of_few_walks_nothing_is_learnt():
    release, truth = late_walks(1, 60, 60, 60, 60)
    known = context(TrainingSet(release, truth))
    smooth, correct = (
        attack.fit(known)(release) for attack in (RadialRTS(), Corrector())
    )
    np.testing.assert_array_equal(correct.xy, smooth.xy)


def test_what_is_learnt_by_heart_is_not_believed():
    """Trees could learn random lags of the training walks, but of no others."""
    release, truth = late_walks(1, *SIZES)
    lag = stream(1, "test", "by heart").choice([-1.0, 1.0], len(SIZES)) * 0.3
    shifted = truth + np.repeat(lag, SIZES)[:, None]
    known = context(TrainingSet(replace(release, xy=shifted), truth))
    smooth, correct = (
        attack.fit(known)(release) for attack in (RadialRTS(), Corrector())
    )
    np.testing.assert_array_equal(correct.xy, smooth.xy)


def test_short_tracks_and_standing_people_are_not_corrected():
    known = context(TrainingSet(*late_walks(1, *SIZES)))
    odd = odd_release()
    lone = np.diff(odd.offsets) == 1
    still = flat_release(np.arange(40.0) / 10, np.full((40, 2), 7.0), np.array([0, 40]))
    smooth, correct = RadialRTS().fit(known), Corrector().fit(known)
    assert np.isfinite(correct(odd).xy).all()
    assert not np.array_equal(correct(odd).xy, smooth(odd).xy)
    rows = odd.offsets[:-1][lone]
    np.testing.assert_array_equal(correct(odd).xy[rows], smooth(odd).xy[rows])
    np.testing.assert_allclose(correct(still).xy, still.xy, atol=1e-9)


def test_the_features_are_those_of_the_docstring():
    release, _ = smooth_walks(1, 2, 50, 30)
    smoothed = Reconstruction(release.xy[:, ::-1] * 0.9, np.full(release.t.size, 0.2))
    features, ahead = _sample_features(release, smoothed)
    weight = information(release, RadialRTS.USUAL_PASSES)
    z, residual = smoothed.xy @ [1.0, 1j], (release.xy - smoothed.xy) @ [1.0, 1j]
    edges_s = np.concatenate([-_EDGES_S[::-1], _EDGES_S])
    for k in range(release.t.size):
        (row,) = (
            i for i in range(4) if release.offsets[i] <= k < release.offsets[i + 1]
        )
        own = np.arange(release.offsets[row], release.offsets[row + 1])
        after_s = release.t[own] - release.t[k]
        for i in range(edges_s.size - 1):
            within = own[(after_s >= edges_s[i]) & (after_s < edges_s[i + 1])]
            expected = np.full(5, np.nan)
            if within.size:
                mean = (
                    (weight * residual)[within].sum() / weight[within].sum(),
                    z[within].mean() - z[k],
                )
                pulled, walked = (value * np.conj(ahead[k]) for value in mean)
                expected[:4] = pulled.real, pulled.imag, walked.real, walked.imag
                expected[4] = np.log(weight[within].sum())
            np.testing.assert_allclose(
                features[k, 5 * i : 5 * i + 5], expected, atol=1e-9
            )
