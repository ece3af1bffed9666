"""The place of a recording: its middle against a search, and effects of moving it."""

import numpy as np
import pytest
from helpers.recordings import build_tracks
from scipy.optimize import minimize

from isac_track.config import StageSettings
from isac_track.geometry import geometry
from isac_track.place import (
    geometric_median,
    geometric_medians,
    placed,
    placed_together,
)
from isac_track.rng import stream
from isac_track.types import derived

STAGES = StageSettings()
FILE = STAGES.changed({"sensing.place": "file"})
START_M = np.array([STAGES.scenes.robot_x_m, STAGES.scenes.robot_y_m])
UTM_M = np.array([512_345.67, 5_476_543.21])
TURN = np.array([[np.cos(2.1), -np.sin(2.1)], [np.sin(2.1), np.cos(2.1)]])
MIRROR = np.array([[-1.0, 0.0], [0.0, 1.0]])


def clouds():
    """Sets of points: skewed, only two, mostly in one place, and on a line."""
    rng = stream(0, "test", "clouds")
    skewed = rng.exponential(3.0, (101, 2))
    standing = np.concatenate([np.full((9, 2), 1.5), rng.normal(0, 5, (4, 2))])
    line = np.linspace(0, 7, 8)[:, None] * np.array([[0.6, 0.8]])
    return {"skewed": skewed, "two": skewed[:2], "standing": standing, "line": line}


def crowd(n=60):
    """Walks of different lengths: some people stand long, some pass by."""
    walks = []
    for person in range(n):
        rng = stream(0, "test", "place", person)
        steps = rng.normal(0.0, 0.3, (int(rng.integers(4, 90)), 2)) + rng.normal(
            0, 0.2, 2
        )
        walks.append(rng.exponential(6.0, 2) + steps.cumsum(axis=0))
    return build_tracks(*walks)


@pytest.mark.parametrize("name", clouds())
def test_the_median_has_the_least_sum_of_distances(name):
    points = clouds()[name]

    def total_m(at):
        return np.hypot(*(points - at).T).sum()

    geometric = geometric_median(points)
    starts = [points.mean(axis=0), np.median(points, axis=0), *points[:4]]
    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 10_000}
    best = min(
        minimize(total_m, at, method="Nelder-Mead", options=options).fun
        for at in starts
    )
    # Rounding the distances off adds at most so much for each point.
    assert total_m(geometric) <= best + 1e-3 * len(points)
    assert total_m(geometric) == pytest.approx(best, rel=1e-4)


def test_the_median_of_few_points_by_hand():
    assert geometric_median(np.array([[1.0, 2.0]])).tolist() == [1.0, 2.0]
    # Of any two points, all between have the same sum: the middle is unique.
    assert geometric_median(np.array([[0.0, 0.0], [4.0, 2.0]])) == pytest.approx(
        [2.0, 1.0]
    )
    # Three corners of a regular triangle: its centre.
    corners = np.exp(2j * np.pi * np.arange(3) / 3)
    assert np.allclose(
        geometric_median(np.column_stack([corners.real, corners.imag])), 0.0
    )
    # More than half of the points in one place: there.
    points = np.array([[3.0, 3.0]] * 4 + [[0.0, 9.0], [50.0, 1.0], [2.0, -7.0]])
    assert geometric_median(points) == pytest.approx([3.0, 3.0], abs=1e-3)


@pytest.mark.parametrize("name", clouds())
@pytest.mark.parametrize("matrix", [TURN, MIRROR, MIRROR @ TURN])
def test_the_median_moves_with_the_points(name, matrix):
    points = clouds()[name]
    moved = geometric_median(points @ matrix.T + UTM_M)
    # A coordinate of five million metres is rounded to a nanometre.
    assert moved == pytest.approx(geometric_median(points) @ matrix.T + UTM_M, abs=3e-8)


def test_medians_of_many_tracks_are_those_of_each():
    tracks = crowd()
    medians = geometric_medians(tracks.xy, tracks.offsets)
    assert np.allclose(
        medians, [geometric_median(track.xy) for track in tracks], atol=1e-9
    )


@pytest.mark.parametrize("shift_m", [np.array([3.0, -40.0]), UTM_M])
def test_a_shifted_recording_gets_the_same_place_with_its_middle_where_robots_start(
    shift_m,
):
    tracks = crowd()
    ours = placed(tracks, settings=STAGES)
    moved = placed(derived(tracks, xy=tracks.xy + shift_m), settings=STAGES)
    assert np.allclose(moved.xy, ours.xy, atol=1e-8, rtol=0)
    middle_m = geometric_median(geometric_medians(ours.xy, ours.offsets))
    assert middle_m == pytest.approx(START_M, abs=1e-8)
    # All positions are shifted by the same vector, and nothing else changes.
    assert np.ptp(ours.xy - tracks.xy, axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert (ours.t is tracks.t, ours.source) == (True, tracks.source)


@pytest.mark.parametrize("matrix", [TURN, MIRROR])
def test_a_turned_recording_is_placed_around_the_same_point(matrix):
    tracks = crowd()
    ours = placed(tracks, settings=STAGES).xy
    turned = placed(derived(tracks, xy=tracks.xy @ matrix.T), settings=STAGES).xy
    assert np.allclose(turned - START_M, (ours - START_M) @ matrix.T, atol=1e-8)


def test_sessions_share_one_frame_and_a_file_may_keep_its_own():
    first, second = crowd(20), derived(crowd(30), xy=crowd(30).xy + 9.0)
    both = placed_together([first, second], settings=STAGES)
    shifts = [
        session.xy - old.xy for session, old in zip(both, (first, second), strict=True)
    ]
    assert np.allclose(shifts[0][0], shifts[1], atol=1e-9)
    assert placed(first, settings=FILE) is first


@pytest.mark.parametrize("shift_m", [UTM_M, np.array([691_000.5, 9_999_000.25])])
def test_a_file_in_utm_coordinates_is_sensed_the_same_if_its_station_moves_along(
    shift_m,
):
    def near(stages, tracks):
        return geometry(
            placed(tracks, settings=stages), settings=stages.sensing, seed=0
        )

    x_m, y_m = shift_m + np.array([FILE.sensing.bs_x_m, FILE.sensing.bs_y_m])
    moved = FILE.changed({"sensing.bs_x_m": x_m, "sensing.bs_y_m": y_m})
    tracks = crowd()
    ours = near(FILE, tracks)
    theirs = near(moved, derived(tracks, xy=tracks.xy + shift_m))
    assert theirs.distance_m == pytest.approx(ours.distance_m, abs=1e-8)
    assert theirs.sigma_raw_m == pytest.approx(ours.sigma_raw_m, abs=1e-8)
    assert theirs.at_cap == ours.at_cap


def test_a_track_counts_once_however_long_it_is():
    far = np.full((5000, 2), 400.0)
    walks = [np.array([[x, 0.0], [x, 1.0], [x, 2.0]]) for x in np.linspace(-3, 3, 31)]
    xy = placed(build_tracks(*walks, far), settings=STAGES).xy
    assert np.abs(np.median(xy[:-5000], axis=0) - START_M).max() < 1.0


def test_geometry_is_that_of_a_crowd_by_hand():
    # People on a ring around the station have the same distance from it.
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    station_m = np.array([STAGES.sensing.bs_x_m, STAGES.sensing.bs_y_m])
    ring = station_m + 25.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    tracks = build_tracks(*(np.stack([at, at]) for at in ring))
    quiet = {"sensing.large_scale_db": 0.0, "sensing.beam_fluctuation_db": 0.0}
    near = geometry(tracks, settings=STAGES.changed(quiet).sensing, seed=0)
    assert near.distance_m == pytest.approx(25.0)
    assert near.tracks == 200
    assert 0 < near.sigma_raw_m < STAGES.sensing.sigma_cap_m
    # Twice the way there and back: the error grows with the exponent, up to the cap.
    farther = derived(tracks, xy=station_m + 2.0 * (tracks.xy - station_m))
    long = STAGES.changed(
        quiet | {"sensing.sigma_cap_m": 1e6, "sensing.delay_spread_s": 0.0}
    )
    ratio = [
        geometry(recording, settings=long.sensing, seed=0)
        for recording in (farther, tracks)
    ]
    assert ratio[0].sigma_raw_m / ratio[1].sigma_raw_m == pytest.approx(2**2.7)
    weak = STAGES.changed({"sensing.power_dbm": -100.0}).sensing
    assert geometry(tracks, settings=weak, seed=0).at_cap == 1.0
    assert near.at_cap < 0.5
