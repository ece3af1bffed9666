"""It learns what a smoother cannot see, from others, and lets alone what it cannot mend."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import context, flat_release, odd_release, smooth_walks

from attacks.reconstruction.corrector import _EDGES_S, Corrector, _looked_at
from attacks.reconstruction.kalman_rts import RadialRTS, information
from attacks.reconstruction.learning import exposure_loss
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Reconstruction

SIZES = (60,) * 12
BEHIND_M = 0.4


def late_walks(seed, *sizes):
    """Walks that swing, each in a frame of its own, shown behind where they are, and the truth."""
    release, truth = smooth_walks(*sizes, noise_m=0.05, seed=seed)
    z = truth @ [1.0, 1j]
    row = np.repeat(np.arange(len(sizes)), sizes)
    step = np.concatenate([np.gradient(z[row == one]) for one in range(len(sizes))])
    turn = np.exp(2j * np.pi * stream(seed, "test", "headings").random(len(sizes)))[row]
    seen, walked = (
        turn * (release.xy @ [1.0, 1j] - BEHIND_M * step / abs(step)),
        turn * z,
    )
    return replace(release, xy=plane(seen)), plane(walked)


def plane(z):
    return np.stack([z.real, z.imag], axis=1)


def loss(found, truth, release):
    return exposure_loss(
        xy=found.xy, truth=truth, offsets=release.offsets, epsilon_m=0.3
    )


@pytest.mark.parametrize(
    "granted", [(), (Knowledge.SIGMA,)], ids=["informed", "oracle"]
)
def test_who_lags_behind_is_moved_ahead_whichever_way_they_go(granted):
    taught, release = late_walks(1, *SIZES), late_walks(2, *SIZES)
    if granted:
        taught, release = (
            (replace(one, sigma=np.full(one.t.size, 0.4)), truth)
            for one, truth in (taught, release)
        )
    known = context(TrainingSet(*taught), granted=(Knowledge.TRAIN, *granted))
    smooth, correct = (one.fit(known)(release[0]) for one in (RadialRTS(), Corrector()))
    # The smoother cannot know of the lag: d^2 / (d^2 + 0.3^2) is 0.64 at 0.4 m.
    assert loss(smooth, release[1], release[0]) > 0.6
    assert loss(correct, release[1], release[0]) < 0.15
    np.testing.assert_array_equal(correct.std, smooth.std)


def test_of_few_walks_nothing_is_learnt():
    release, truth = late_walks(1, 60, 60, 60, 60)
    known = context(TrainingSet(release, truth))
    smooth, correct = (one.fit(known)(release) for one in (RadialRTS(), Corrector()))
    np.testing.assert_array_equal(correct.xy, smooth.xy)


def test_what_is_learnt_by_heart_is_not_believed():
    """Lags that nothing foretells: trees could tell the walks taught, but no others."""
    release, truth = late_walks(1, *SIZES)
    lag = stream(1, "test", "by heart").choice([-1.0, 1.0], len(SIZES)) * 0.3
    shifted = truth + np.repeat(lag, SIZES)[:, None]
    known = context(TrainingSet(replace(release, xy=shifted), truth))
    smooth, correct = (one.fit(known)(release) for one in (RadialRTS(), Corrector()))
    np.testing.assert_array_equal(correct.xy, smooth.xy)


def test_short_tracks_and_people_who_stand_are_left_where_they_are():
    known = context(TrainingSet(*late_walks(1, *SIZES)))
    odd = odd_release()
    lone = np.diff(odd.offsets) == 1
    still = flat_release(np.arange(40.0) / 10, np.full((40, 2), 7.0), np.array([0, 40]))
    smooth, correct = RadialRTS().fit(known), Corrector().fit(known)
    assert np.isfinite(correct(odd).xy).all()
    assert not np.array_equal(correct(odd).xy, smooth(odd).xy)
    where = odd.offsets[:-1][lone]
    np.testing.assert_array_equal(correct(odd).xy[where], smooth(odd).xy[where])
    np.testing.assert_allclose(correct(still).xy, still.xy, atol=1e-9)


def test_what_it_looks_at_is_what_the_words_say():
    release, _ = smooth_walks(1, 2, 50, 30)
    found = Reconstruction(release.xy[:, ::-1] * 0.9, np.full(release.t.size, 0.2))
    about, ahead = _looked_at(release, found)
    weight = information(release, RadialRTS.USUAL_PASSES)
    z, left = found.xy @ [1.0, 1j], (release.xy - found.xy) @ [1.0, 1j]
    edges_s = np.concatenate([-_EDGES_S[::-1], _EDGES_S])
    for k in range(release.t.size):
        (row,) = (
            i for i in range(4) if release.offsets[i] <= k < release.offsets[i + 1]
        )
        own = np.arange(release.offsets[row], release.offsets[row + 1])
        after_s = release.t[own] - release.t[k]
        for i in range(edges_s.size - 1):
            there = own[(after_s >= edges_s[i]) & (after_s < edges_s[i + 1])]
            expected = np.full(5, np.nan)
            if there.size:
                mean = (
                    (weight * left)[there].sum() / weight[there].sum(),
                    z[there].mean() - z[k],
                )
                pulled, walked = (one * np.conj(ahead[k]) for one in mean)
                expected[:4] = pulled.real, pulled.imag, walked.real, walked.imag
                expected[4] = np.log(weight[there].sum())
            np.testing.assert_allclose(about[k, 5 * i : 5 * i + 5], expected, atol=1e-9)
