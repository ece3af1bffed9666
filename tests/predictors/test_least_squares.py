"""The paper's predictor against numpy.polyfit, track by track."""

import numpy as np
import pytest

from isac_track.rng import stream
from isac_track.types import Release
from predictors.least_squares import LeastSquares


def release_of(*sizes, t0=0.0):
    rng = stream(0, "test", "least squares", *sizes)
    t = [t0 + np.cumsum(rng.uniform(0.06, 0.13, size)) for size in sizes]
    return Release(
        t=np.concatenate(t),
        xy=rng.standard_normal((sum(sizes), 2)),
        sigma=None,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )


def future_of(release, n_steps=12):
    last = release.t[release.offsets[1:] - 1]
    return last[:, None] + 0.083 * np.arange(n_steps)


@pytest.mark.parametrize("window", [2, 5, 16])
def test_it_is_polyfit_over_the_last_samples(window):
    release = release_of(40, 16, 7, 2)
    t_future = future_of(release)
    found = LeastSquares(window=window).predict(release, t_future).mean
    for row, track in enumerate(release):
        t, xy = track.t[-window:], track.xy[-window:]
        for axis in range(2):
            line = np.polyfit(t, xy[:, axis], 1)
            assert np.allclose(found[row, :, axis], np.polyval(line, t_future[row]), atol=1e-8)


def test_a_straight_walk_is_foreseen_exactly():
    release = release_of(30)
    xy = np.stack([1.2 * release.t + 3, 5 - 0.4 * release.t], axis=1)
    straight = Release(t=release.t, xy=xy, sigma=None, offsets=release.offsets, pseudonym=("a",))
    t_future = future_of(straight)
    expected = np.stack([1.2 * t_future[0] + 3, 5 - 0.4 * t_future[0]], axis=1)
    assert np.allclose(LeastSquares().predict(straight, t_future).mean[0], expected)


def test_one_sample_stands_still():
    release = release_of(1, 20)
    found = LeastSquares().predict(release, future_of(release)).mean
    assert np.allclose(found[0], release.xy[0])


def test_late_clocks_lose_no_precision():
    early, late = release_of(30), release_of(30, t0=1e6)
    a = LeastSquares().predict(early, future_of(early)).mean
    b = LeastSquares().predict(late, future_of(late)).mean
    assert np.allclose(a, b, atol=1e-6)


def test_the_window_must_hold_a_line():
    with pytest.raises(ValueError, match="window must be at least 2"):
        LeastSquares(window=1)
