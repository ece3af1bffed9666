import numpy as np
import pytest

from isac_track.datasets import load
from isac_track.datasets.summary import summarise
from isac_track.types import Tracks


def tracks_of(*walks):
    """One track a walk, given as [(t, x), ...]; y is 0."""
    rows = np.array([row for walk in walks for row in walk], dtype=float)
    names = tuple(str(index) for index in range(len(walks)))
    return Tracks(
        t=rows[:, 0],
        xy=np.column_stack([rows[:, 1], np.zeros(len(rows))]),
        offsets=np.cumsum([0, *map(len, walks)]),
        source=names,
        group=names,
    )


def test_by_hand():
    # Steps of 1 m in 1 s, none in 1 s, 1 m in 2 s: 2 m in 4 s.
    summary = summarise(tracks_of([(0, 0), (1, 1), (2, 1), (4, 2)]))
    assert len(summary) == 1
    assert summary.samples[0] == 4
    assert summary.duration_s[0] == 4
    assert summary.speed_mean_mps[0] == 0.5
    # Over time: (0.5^2 + 0.5^2 + 0 * 2) / 4.
    assert summary.speed_sd_mps[0] == pytest.approx(np.sqrt(0.125))
    assert summary.slow_share[0] == pytest.approx(1 / 3)
    assert summary.still_share[0] == pytest.approx(1 / 3)
    assert summary.total_still_share == pytest.approx(1 / 3)
    assert not summary.frozen[0]


def test_per_track_and_no_step_from_one_track_to_the_next():
    walking = [(step, 1.3 * step) for step in range(11)]
    frozen = [(step, 0.0) for step in range(10)] + [(10, 0.3)]
    slow = [(step, 0.1 * step) for step in range(6)]
    summary = summarise(tracks_of(walking, frozen, slow))
    np.testing.assert_allclose(summary.speed_mean_mps, [1.3, 0.03, 0.1])
    np.testing.assert_allclose(summary.slow_share, [0, 0.9, 1])
    np.testing.assert_allclose(summary.still_share, [0, 0.9, 0])
    np.testing.assert_array_equal(summary.frozen, [False, True, False])
    assert summary.total_still_share == pytest.approx(9 / 25)
    assert summary.n_groups == 3


def test_a_single_sample_has_no_speed():
    summary = summarise(tracks_of([(0, 0)], [(0, 0), (1, 1)]))
    np.testing.assert_array_equal(summary.speed_mean_mps, [np.nan, 1])
    np.testing.assert_array_equal(summary.still_share, [np.nan, 0])
    np.testing.assert_array_equal(summary.frozen, [False, False])
    assert summary.total_still_share == 0


def test_lasting_forgives_the_rounding_of_the_clock():
    end = 0.4 + 21.6  # a little short of 22 s behind the start, in floating point
    assert summarise(tracks_of([(0.4, 0), (np.nextafter(end, 0), 1)])).n_lasting(21.6) == 1
    assert summarise(tracks_of([(0.4, 0), (end - 0.04, 1)])).n_lasting(21.6) == 0


@pytest.mark.usefixtures("ucy")
def test_students03():
    loaded = load("students03")
    summary = summarise(loaded.tracks)
    assert summary.n_lasting(21.6) == 106
    assert summary.n_lasting(12) == 276
    assert summary.total_still_share == pytest.approx(0.187, abs=5e-4)
    assert (summary.still_share > 0).sum() == 63
    assert [loaded.tracks.source[row] for row in np.flatnonzero(summary.frozen)] == [
        "289", "453", "454", "468", "473",
    ]  # fmt: skip


def test_the_bundled_crowd_has_no_frozen_tracks():
    summary = summarise(load("plaza").tracks)
    assert summary.frozen.sum() == 0
    assert summary.n_lasting(21.6) > 200
