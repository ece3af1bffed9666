"""The moving average against a loop, its window against the law, and the odd tracks."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import context, smooth_walks

from attacks.reconstruction.learning import learn_variance
from attacks.reconstruction.moving_average import (
    REFERENCE_STD_M,
    MovingAverage,
    centred_means,
    half_windows,
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
    release, _ = smooth_walks(1, 2, 3, 50, 7, 200, 1)
    xy = release.xy + far_m
    half = np.array([0, 4, 1, 6, 100, 20, 3])
    ours = centred_means(xy=xy, offsets=release.offsets, half=half)
    assert np.allclose(ours, by_loop(xy, release.offsets, half), atol=1e-9, rtol=1e-14)


def test_the_whole_attack_is_the_loop():
    release, _ = smooth_walks(60, 3, 2, 1, 150)
    half = half_windows(release, learn_variance(context())(release), width_s=1.5, bias_order=2)
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
    assert (np.abs((2 * half + 1) * interval_s - wanted_s) <= interval_s * (1 + 1e-9)).all()
