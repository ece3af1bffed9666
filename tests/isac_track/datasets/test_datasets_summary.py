from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import build_tracks

from isac_track.datasets import load, n_lasting, still_share, summarise


def along(*xs):
    """Positions (x, 0), a second apart."""
    return [(x, 0.0) for x in xs]


def walk(t, x):
    return replace(build_tracks(along(*x)), t=np.array(t, dtype=float))


def test_by_hand():
    # Steps of 1 m in 1 s, none in 1 s, 1 m in 2 s: 2 m in 4 s.
    summary = summarise(walk([0, 1, 2, 4], [0.0, 1, 1, 2]))
    # Over time: (0.5^2 + 0.5^2 + 0 * 2) / 4.
    assert summary.to_numpy().tolist() == [
        [3, 4.0, 0.5, pytest.approx(np.sqrt(0.125)), 1 / 3, 1 / 3, False]
    ]
    assert still_share(summary) == pytest.approx(1 / 3)


def test_per_track_and_no_step_from_one_track_to_the_next():
    walking, frozen, slow = 1.3 * np.arange(11), [0.0] * 10 + [0.3], 0.1 * np.arange(6)
    tracks = build_tracks(
        *(along(*x) for x in (walking, frozen, slow, [0.0])), frame_s=1.0
    )
    summary = summarise(tracks)
    np.testing.assert_allclose(summary.speed_mean_mps, [1.3, 0.03, 0.1, np.nan])
    np.testing.assert_allclose(summary.slow_share, [0, 0.9, 1, np.nan])
    np.testing.assert_allclose(summary.still_share, [0, 0.9, 0, np.nan])
    np.testing.assert_array_equal(summary.frozen, [False, True, False, False])
    assert still_share(summary) == pytest.approx(9 / 25)


def test_lasting_forgives_the_rounding_of_the_clock():
    end = 0.4 + 21.6  # a little short of 22 s behind the start, in floating point
    assert n_lasting(summarise(walk([0.4, np.nextafter(end, 0)], [0, 1])), 21.6) == 1
    assert n_lasting(summarise(walk([0.4, end - 0.04], [0, 1])), 21.6) == 0


def test_the_bundled_crowd_has_no_frozen_tracks():
    summary = summarise(load("plaza").tracks)
    assert summary.frozen.sum() == 0
    assert n_lasting(summary, 21.6) > 200
