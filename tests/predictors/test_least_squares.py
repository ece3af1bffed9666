"""The paper's predictor against numpy.polyfit, track by track."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import smooth_walks

from predictors.least_squares import LeastSquares


def make_future(release, n_steps=12):
    last = release.t[release.offsets[1:] - 1]
    return last[:, None] + 0.083 * np.arange(n_steps)


@pytest.mark.parametrize("window", [2, 5, 16])
def test_it_is_polyfit_over_the_last_samples(window):
    release, _ = smooth_walks(40, 16, 7, 2)
    t_future = make_future(release)
    mean = LeastSquares(window=window).predict(release, t_future).mean
    for row, track in enumerate(release):
        t, xy = track.t[-window:], track.xy[-window:]
        for axis in range(2):
            line = np.polyfit(t, xy[:, axis], 1)
            assert np.allclose(
                mean[row, :, axis], np.polyval(line, t_future[row]), atol=1e-8
            )


def test_one_sample_stands_still():
    release, _ = smooth_walks(1, 20)
    mean = LeastSquares().predict(release, make_future(release)).mean
    assert np.allclose(mean[0], release.xy[0])


def test_late_clocks_lose_no_precision():
    early, _ = smooth_walks(30)
    late = replace(early, t=early.t + 1e6)
    a = LeastSquares().predict(early, make_future(early)).mean
    b = LeastSquares().predict(late, make_future(late)).mean
    assert np.allclose(a, b, atol=1e-6)


def test_the_window_must_hold_a_line():
    with pytest.raises(ValueError, match="window must be at least 2"):
        LeastSquares(window=1)
