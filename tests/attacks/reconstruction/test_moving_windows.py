"""The mean against a loop, the filter against scipy's, the windows against the law."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import context, smooth_walks, walk_release
from scipy.signal import savgol_filter

from attacks.reconstruction.learning import learn_variance
from attacks.reconstruction.moving_windows import (
    REFERENCE_STD_M,
    MovingAverage,
    Savgol,
    filtered,
    half_windows,
)
from isac_track.rng import stream


def by_loop(xy, offsets, half):
    out = np.empty_like(xy)
    for row, (lo, hi) in enumerate(pairwise(offsets)):
        for k in range(lo, hi):
            side = min(half[row], k - lo, hi - 1 - k)
            out[k] = xy[k - side : k + side + 1].mean(axis=0)
    return out


@pytest.mark.parametrize("far_m", [0.0, 1e6])
def test_it_is_the_loop(far_m):
    release, _ = smooth_walks(1, 2, 3, 50, 7, 200, 1)
    release = replace(release, xy=release.xy + far_m)
    half = np.array([0, 4, 1, 6, 100, 20, 3])
    ours = filtered(release, half, loop="centred_means")
    assert np.allclose(
        ours, by_loop(release.xy, release.offsets, half), atol=1e-9, rtol=1e-14
    )


def test_the_whole_attack_is_the_loop():
    release, _ = smooth_walks(60, 3, 2, 1, 150)
    half = half_windows(
        release, learn_variance(context())(release), width_s=1.5, bias_order=2
    )
    ours = MovingAverage(width_s=1.5).fit(context())(release)
    assert np.allclose(ours.xy, by_loop(release.xy, release.offsets, half), atol=1e-9)


@pytest.mark.parametrize(("bias_order", "exponent"), [(2, 2 / 5), (4, 2 / 9)])
def test_the_window_follows_its_law(bias_order, exponent):
    release, _ = smooth_walks(400, 600, 80)
    variance = learn_variance(context())(release)
    half = half_windows(release, variance, width_s=2.0, bias_order=bias_order)
    first, last = release.offsets[:-1], release.offsets[1:] - 1
    interval_s = (release.t[last] - release.t[first]) / (last - first)
    wanted_s = 2.0 * (np.sqrt(variance[first]) / REFERENCE_STD_M) ** exponent
    assert (
        np.abs((2 * half + 1) * interval_s - wanted_s) <= interval_s * (1 + 1e-9)
    ).all()


def by_scipy(release, half):
    """Interpolate, filter and interpolate back, one track after the other."""
    out = np.empty_like(release.xy)
    for row, (lo, hi) in enumerate(pairwise(release.offsets)):
        # From the first position: scipy's fit of the ends loses digits with the size of
        # numbers.
        t, xy = release.t[lo:hi] - release.t[lo], release.xy[lo:hi] - release.xy[lo]
        window = 2 * int(half[row]) + 1
        if window == 1:
            out[lo:hi] = release.xy[lo:hi]
            continue
        grid = np.linspace(t[0], t[-1], t.size)
        for axis in range(2):
            even = np.interp(grid, t, xy[:, axis])
            even = savgol_filter(even, window, 2, mode="interp")
            out[lo:hi, axis] = np.interp(t, grid, even) + release.xy[lo, axis]
    return out


@pytest.mark.parametrize(("width_s", "lengths"), [(4.0, 6), (0.3, 2)])
def test_it_is_scipy(width_s, lengths):
    sizes = (400, 1, 2, 3, 4, 5, 6, 7, 8, 9, 60, 61, 150, 400)
    release, _ = smooth_walks(*sizes)
    # Scattered levels of noise, so that there are windows of many lengths.
    scale = np.repeat(np.linspace(0.1, 3.0, len(sizes)), sizes)[:, None]
    release = replace(release, xy=release.xy * scale)
    variance = learn_variance(context())(release)
    half = half_windows(release, variance, width_s=width_s, bias_order=4)
    half = np.minimum(np.maximum(half, 2), (np.array(sizes) - 1) // 2)
    assert len(set(half.tolist())) >= lengths
    ours = Savgol(width_s=width_s).fit(context())(release)
    assert np.allclose(ours.xy, by_scipy(release, half), atol=1e-9, rtol=0)


@pytest.mark.parametrize("half", [1, 2, 3, 20, 49, 50, 80])
def test_windows_of_any_length_are_scipys(half):
    release, _ = smooth_walks(2 * half + 1, 500, 2 * half + 2)
    halves = np.full(3, half)
    ours = filtered(release, halves, loop="fit_parabolas")
    assert np.allclose(ours, by_scipy(release, halves), atol=1e-9, rtol=0)


def test_running_sums_lose_nothing_on_a_long_track():
    t = np.arange(100_000) * 0.1
    rng = stream(0, "test", "long")
    xy = np.stack([50 * np.sin(t / 300), 0.01 * t], axis=1) + rng.standard_normal(
        (t.size, 2)
    )
    release = walk_release([(t, xy)])
    half = np.array([40])
    ours = filtered(release, half, loop="fit_parabolas")
    assert np.allclose(ours, by_scipy(release, half), atol=1e-9, rtol=0)
