"""Interpolation and adaptive sampling."""

import numpy as np
import pytest
from helpers.recordings import build_tracks
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from isac_track.config import ResampleSettings
from isac_track.resample import SPEED_LIMIT_MPS, resample, sampling_times, walk
from isac_track.rng import stream
from isac_track.types import Tracks


def some_tracks(*durations_s):
    rng = stream(0, "test", "resample")
    sizes = [int(duration_s / 0.4 + 1e-9) + 1 for duration_s in durations_s]
    return build_tracks(
        *(0.1 * rng.standard_normal((size, 2)).cumsum(axis=0) for size in sizes)
    )


def test_the_walk_is_the_not_a_knot_cubic_of_another_implementation():
    (track,) = some_tracks(30.0)
    at = np.linspace(track.t[0], track.t[-1], 501)
    other = make_interp_spline(track.t, track.xy, k=3)  # a B-spline basis, banded solve
    assert isinstance(other, BSpline)
    assert np.allclose(walk(track)(at), other(at), atol=1e-9)


@pytest.mark.parametrize("max_overshoot_m", [0.05, 0.2])
def test_no_piece_leaves_the_chord_or_runs_and_the_others_are_the_spline(
    max_overshoot_m,
):
    rng = stream(0, "test", "overshoot")
    t = np.cumsum(rng.choice([1e-6, 0.4, 1.3], size=200))
    xy = np.cumsum(rng.normal(0.0, 0.2, (200, 2)), axis=0)
    track = Tracks(t=t, xy=xy, offsets=np.array([0, 200]), source=("a",), group=("a",))
    curve, spline = walk(track, max_overshoot_m=max_overshoot_m), CubicSpline(t, xy)
    n_replaced = 0
    for row in range(199):
        share = np.arange(1, 16) / 16
        at = t[row] + share * (t[row + 1] - t[row])
        line = xy[row] + share[:, None] * (xy[row + 1] - xy[row])
        chord = LineString([xy[row], xy[row + 1]])
        assert (
            max(chord.distance(point) for point in curve(at)) <= max_overshoot_m + 1e-7
        )
        n_replaced += not np.array_equal(curve(at), spline(at))
        assert np.allclose(curve(t[row : row + 2]), xy[row : row + 2], atol=1e-9)
        if chord.speed(t[row + 1] - t[row]) > SPEED_LIMIT_MPS:
            assert np.allclose(curve(at), line, atol=1e-7)
    assert n_replaced == curve.n_monotone + curve.n_linear > 50
    assert curve.n_monotone > 0 < curve.n_linear


class LineString:
    """Distance from a segment, by search along it."""

    def __init__(self, ends):
        self.start, self.end = np.array(ends)

    def distance(self, point):
        share = np.linspace(0, 1, 2001)[:, None]
        on_line = self.start + share * (self.end - self.start)
        return np.hypot(*(on_line - point).T).min()

    def speed(self, step_s):
        return np.hypot(*(self.end - self.start)) / step_s


def test_a_steady_walk_is_the_spline_to_the_bit():
    (track,) = some_tracks(30.0)
    at = np.linspace(track.t[0], track.t[-1], 501)
    curve = walk(track)
    assert curve.n_monotone + curve.n_linear == 0
    assert np.array_equal(curve(at), CubicSpline(track.t, track.xy)(at))


@pytest.mark.parametrize("n", [2, 3])
def test_two_or_three_samples_are_joined_by_a_line_or_a_parabola(n):
    t = np.arange(n) * 0.5
    track = build_tracks(np.stack([t ** (n - 1), 3 - t], axis=1), frame_s=0.5)
    at = np.linspace(0, t[-1], 7)
    assert np.allclose(walk(track)(at), np.stack([at ** (n - 1), 3 - at], axis=1))


def test_one_sample_is_no_walk():
    with pytest.raises(ValueError, match="at least two samples"):
        walk(build_tracks([(0, 0)]))


def test_the_rate_is_held_for_a_second_and_lies_in_its_range():
    settings = ResampleSettings()
    t = sampling_times(
        start_s=3.0, end_s=63.0, settings=settings, rng=stream(1, "test", "rate")
    )
    interval = np.diff(t)
    assert t[0] == 3.0
    assert t[-1] <= 63.0
    assert 63.0 - t[-1] <= 1 / settings.rate_min_hz
    assert (interval >= 1 / 16 - 1e-9).all()
    assert (interval <= 1 / 8 + 1e-9).all()
    second = (t[:-1] - 3.0).astype(int)
    spread = [np.ptp(interval[second == number]) for number in range(60)]
    assert max(spread) < 1e-9
    assert np.unique(interval.round(9)).size == 60
    constant_rate = ResampleSettings(rate_min_hz=10.0, rate_max_hz=10.0)
    t = sampling_times(
        start_s=0.0, end_s=5.0, settings=constant_rate, rng=stream(1, "test")
    )
    assert np.allclose(t, np.arange(t.size) / 10)
    assert t.size in (50, 51)  # 50 additions of 0.1 s may end a hair above 5 s


def test_only_tracks_of_the_minimum_duration_are_sampled():
    tracks = some_tracks(21.2, 21.6, 40.0)
    sampled = resample(tracks, settings=ResampleSettings(), seed=0)
    assert sampled.source == ("w1", "w2")
    with pytest.raises(ValueError, match=r"no track lasts 21\.6 s"):
        resample(some_tracks(5.0), settings=ResampleSettings(), seed=0)


def test_a_track_is_sampled_the_same_beside_any_other():
    tracks = some_tracks(30.0, 25.0)
    both = resample(tracks, settings=ResampleSettings(), seed=0)
    alone = resample(tracks[1], settings=ResampleSettings(), seed=0)
    assert np.array_equal(both[1].t, alone.t)
    assert np.array_equal(both[1].xy, alone.xy)
    other_seed = resample(tracks[1], settings=ResampleSettings(), seed=1)
    assert not np.array_equal(alone.t, other_seed.t)
