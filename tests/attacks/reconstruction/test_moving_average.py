"""The moving average against a loop, its window against the law, and the odd tracks."""

from itertools import pairwise

import numpy as np
import pytest

from attacks.reconstruction.moving_average import CANDIDATES, MovingAverage, centred_means
from attacks.reconstruction.windows import REFERENCE_STD_M, half_windows, mean_intervals_s
from isac_track.noise import innovation_variance_m2
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Release


def walks(*sizes, noise_m=0.4, seed=0, turn=0.4):
    """A release of smooth walks at irregular steps, and the truth."""
    rng = stream(seed, "test", "average", *sizes)
    t, truth = [], []
    for size in sizes:
        clock = rng.uniform(0, 1e3) + np.cumsum(rng.uniform(0.06, 0.13, size))
        along = clock - clock[0]
        t.append(clock)
        truth.append(
            rng.normal(0, 5, 2) + np.stack([1.2 * along, np.sin(turn * along) / turn], axis=1)
        )
    truth = np.concatenate(truth)
    return release_of(t, truth + noise_m * rng.standard_normal(truth.shape)), truth


def release_of(t, xy):
    sizes = [clock.size for clock in t]
    return Release(
        t=np.concatenate(t),
        xy=xy,
        sigma=None,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )


def context(train=None, epsilon_m=0.3):
    return AttackContext(
        rng=stream(0, "test"),
        epsilon_m=epsilon_m,
        granted=frozenset() if train is None else frozenset({Knowledge.TRAIN}),
        train=train,
    )


def by_loop(xy, offsets, half):
    out = np.empty_like(xy)
    for row, (lo, hi) in enumerate(pairwise(offsets)):
        for k in range(lo, hi):
            side = min(half[row], k - lo, hi - 1 - k)
            out[k] = xy[k - side : k + side + 1].mean(axis=0)
    return out


@pytest.mark.parametrize("far_m", [0.0, 1e6])
def test_it_is_the_loop(far_m):
    release, _ = walks(1, 2, 3, 50, 7, 200, 1)
    xy = release.xy + far_m
    half = np.array([0, 4, 1, 6, 100, 20, 3])
    ours = centred_means(xy=xy, offsets=release.offsets, half=half)
    assert np.allclose(ours, by_loop(xy, release.offsets, half), atol=1e-9, rtol=1e-14)


def test_the_whole_attack_is_the_loop():
    release, _ = walks(60, 3, 2, 1, 150)
    half = half_windows(release, width_s=1.5, bias_order=2)
    ours = MovingAverage(width_s=1.5).fit(context())(release)
    assert np.allclose(ours.xy, by_loop(release.xy, release.offsets, half), atol=1e-9)


def test_a_straight_walk_at_even_steps_stays():
    t = [np.arange(40) * 0.1, np.arange(9) * 0.2]
    along = np.concatenate(t)
    release = release_of(t, np.stack([along, 3 - 2 * along], axis=1))
    half = np.array([8, 4])
    ours = centred_means(xy=release.xy, offsets=release.offsets, half=half)
    assert np.allclose(ours, release.xy, atol=1e-12)


@pytest.mark.parametrize(("bias_order", "exponent"), [(2, 2 / 5), (4, 2 / 9)])
def test_the_window_follows_its_law(bias_order, exponent):
    release, _ = walks(400, 600, 80)
    half = half_windows(release, width_s=2.0, bias_order=bias_order)
    noise = np.sqrt(innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets))
    wanted_s = 2.0 * (noise / REFERENCE_STD_M) ** exponent
    got_s = (2 * half + 1) * mean_intervals_s(release)
    assert (np.abs(got_s - wanted_s) <= mean_intervals_s(release) * (1 + 1e-9)).all()


def test_the_best_window_grows_by_the_two_fifths_power():
    """On a parabola the width of least error, found by trial, follows the stated law."""
    rng = stream(0, "test", "parabola")
    t = np.arange(20000) * 0.05
    truth = np.stack([np.sin(0.6 * t), np.cos(0.6 * t)], axis=1) / 0.6**2  # 1 m/s^2 throughout
    widths = np.arange(1, 60)
    best = []
    for noise_m in (0.05, 0.8):
        xy = truth + noise_m * rng.standard_normal(truth.shape)
        offsets = np.array([0, t.size])
        errors = [
            np.square(centred_means(xy=xy, offsets=offsets, half=np.array([half])) - truth).mean()
            for half in widths
        ]
        best.append(2 * widths[np.argmin(errors)] + 1)
    assert np.log(best[1] / best[0]) / np.log(16) == pytest.approx(0.4, abs=0.06)


def test_it_helps_and_training_picks_the_width_for_the_walk():
    straight, truth = walks(*[200] * 6, turn=0.05)
    restless, bends = walks(*[200] * 6, turn=2.5)
    calm = MovingAverage().fit(context(TrainingSet(release=straight, truth=truth)))
    quick = MovingAverage().fit(context(TrainingSet(release=restless, truth=bends)))
    assert calm.keywords["width_s"] > quick.keywords["width_s"]
    assert {calm.keywords["width_s"], quick.keywords["width_s"]} <= set(CANDIDATES)
    for attack, release, walk in ((calm, straight, truth), (quick, restless, bends)):
        assert rmse(attack(release).xy, walk) < 0.6 * rmse(release.xy, walk)
    assert MovingAverage().fit(context()).keywords["width_s"] == MovingAverage.DEFAULT_WIDTH_S


def rmse(xy, truth):
    return np.sqrt(np.square(xy - truth).mean())


def test_a_gap_and_tiny_steps_are_no_trouble():
    t = [np.r_[np.arange(20) * 0.1, 32 + np.arange(20) * 0.1], np.arange(3000) * 1e-3]
    rng = stream(0, "test", "gap")
    release = release_of(t, rng.standard_normal((3040, 2)))
    assert np.isfinite(MovingAverage().fit(context())(release).xy).all()


@pytest.mark.parametrize("width_s", [0.0, -1.0, np.nan, np.inf])
def test_a_width_must_be_positive(width_s):
    with pytest.raises(ValueError, match="width_s must be positive"):
        MovingAverage(width_s=width_s)
