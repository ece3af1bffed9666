"""Scenes: the properties that the paper states, checked scene by scene."""

import re

import numpy as np
import pytest

from isac_track.config import StageSettings
from isac_track.conflict import minimum_separation
from isac_track.errors import DataError
from isac_track.resample import resample, walk
from isac_track.scenes import (
    cut,
    history_samples,
    make_scenes,
    robot_positions,
    track_order,
)
from isac_track.types import Release
from predictors.least_squares import LeastSquares

SETTINGS = StageSettings()
N_SCENES = 60


@pytest.fixture(scope="module")
def known(tracks):
    return cut(tracks, settings=SETTINGS, seed=0)


@pytest.fixture(scope="module")
def scenes(known):
    order = track_order(n_tracks=len(known), n_scenes=N_SCENES, agents=4, seed=0)
    return make_scenes(known, order=order, first=0, settings=SETTINGS, seed=0)


def separations(scenes, scene, agent):
    """Distances at every step of a robot that walks straight, on the agent's clock."""
    way = scenes.robot_destination[scene] - scenes.robot_start[scene]
    row = scene * 4 + agent
    elapsed = scenes.t_future[row] - scenes.t_future[row, 0]
    robot = scenes.robot_start[scene] + 1.4 * elapsed[:, None] * way / np.linalg.norm(
        way
    )
    return np.linalg.norm(robot - scenes.xy_future[row], axis=1)


def test_the_split_is_at_70_percent_of_the_samples_and_loses_none_to_rounding(
    tracks, known
):
    whole = np.diff(resample(tracks, settings=SETTINGS.resample, seed=0).offsets)
    assert np.diff(known.offsets).tolist() == (7 * whole // 10).tolist()
    for n_samples, expected in ((330, 231), (170, 119), (331, 231), (10, 7), (9, 6)):
        assert history_samples(n_samples=n_samples, ratio=0.7) == expected


def test_the_future_is_the_true_walk_at_the_grid(tracks, known):
    for row, track in enumerate(tracks):
        t = known.t[known.offsets[row] : known.offsets[row + 1]]
        step = (t[-1] - t[-16]) / 15
        grid = t[-1] + np.arange(12) * step
        assert np.allclose(known.t_future[row], grid)
        assert np.allclose(known.xy_future[row], walk(track)(grid))


def test_labels_alternate_and_follow_the_conflict_rule(scenes):
    for scene in range(N_SCENES):
        smallest = min(min(separations(scenes, scene, agent)) for agent in range(4))
        assert scenes.separation[scene] == pytest.approx(smallest)
        assert scenes.conflict[scene] == (smallest < 0.9)
    assert scenes.conflict.tolist() == [scene % 2 == 0 for scene in range(N_SCENES)]


def test_the_first_agent_stands_on_the_path_or_passes_just_outside_the_radius(scenes):
    gaps = np.array([separations(scenes, scene, 0) for scene in range(N_SCENES)])
    assert (gaps[::2].min(axis=1) < 1e-9).all()
    steps = set(gaps[::2].argmin(axis=1))
    assert len(steps) > 6  # the step is drawn
    assert 0 not in steps  # step 0 is now
    missed = gaps[1::2].min(axis=1)
    assert (missed > 0.9).all()
    assert (missed < 1.4 + 1e-8).all()
    # Uniform in (0.9, 1.4): mean 1.15 with standard error 0.144 / sqrt(30).
    assert missed.mean() == pytest.approx(1.15, abs=4 * 0.144 / np.sqrt(missed.size))


def test_the_others_stand_in_the_ring_and_keep_clear(scenes):
    for scene in range(N_SCENES):
        for agent in (1, 2, 3):
            row = scene * 4 + agent
            now = np.linalg.norm(scenes.xy_future[row, 0] - scenes.robot_start[scene])
            assert 2.0 <= now <= 6.0
            assert min(separations(scenes, scene, agent)) >= 1.5
    assert scenes.exhausted.sum() == 0


def test_more_redraws_move_nobody_with_a_place(known):
    order = track_order(n_tracks=len(known), n_scenes=30, agents=4, seed=0)
    few, many = (
        make_scenes(
            known,
            order=order,
            first=0,
            settings=SETTINGS.changed(
                {"scenes.clearance_m": 5.4, "scenes.max_redraws": most}
            ),
            seed=0,
        )
        for most in (20, 100)
    )
    assert many.exhausted.sum() < few.exhausted.sum()
    placed = np.repeat(few.exhausted == 0, 4)
    assert placed.any()
    assert np.array_equal(few.xy_future[placed], many.xy_future[placed])


def test_a_track_is_only_shifted(known, scenes):
    for row in range(8):
        source = scenes.track[row]
        before = known.xy[known.offsets[source] : known.offsets[source + 1]]
        after = scenes.xy[scenes.offsets[row] : scenes.offsets[row + 1]]
        shift = after[0] - before[0]
        assert np.allclose(after - shift, before)
        assert np.allclose(scenes.xy_future[row] - shift, known.xy_future[source])


def test_now_is_the_last_history_sample_and_the_robot_does_not_arrive(
    scenes,
):
    last = scenes.offsets[1:] - 1
    assert np.allclose(scenes.xy_future[:, 0], scenes.xy[last])
    assert np.array_equal(scenes.t_future[:, 0], scenes.t[last])
    length = np.linalg.norm(scenes.robot_destination - scenes.robot_start, axis=1)
    elapsed = (
        (scenes.t_future[:, -1] - scenes.t_future[:, 0])
        .reshape(N_SCENES, 4)
        .max(axis=1)
    )
    assert (length > 1.4 * elapsed).all()


def test_a_scene_is_the_same_in_any_block(known, scenes):
    order = track_order(n_tracks=len(known), n_scenes=N_SCENES, agents=4, seed=0)
    part = make_scenes(known, order=order[20:30], first=20, settings=SETTINGS, seed=0)
    assert np.array_equal(part.xy_future, scenes.xy_future[80:120])
    assert np.array_equal(part.robot_start, scenes.robot_start[20:30])
    assert np.array_equal(part.index, np.arange(20, 30))


def test_a_perfect_prediction_has_the_true_separation(scenes):
    robot = robot_positions(scenes, settings=SETTINGS.conflict)
    agents = scenes.xy_future.reshape(robot.shape)
    separation = minimum_separation(robot=robot, agents=agents)
    assert np.allclose(separation, scenes.separation)


@pytest.mark.parametrize(
    ("n_tracks", "agents"), [(13, 4), (8, 4), (9, 2), (5, 4), (6, 4), (7, 4)]
)
def test_tracks_are_taken_in_turn_and_never_twice_in_a_scene(n_tracks, agents):
    order = track_order(n_tracks=n_tracks, n_scenes=200, agents=agents, seed=2)
    flat = order.reshape(-1)
    for start in range(0, flat.size - n_tracks + 1, n_tracks):
        assert sorted(flat[start : start + n_tracks]) == list(range(n_tracks))
    assert all(len(set(row)) == agents for row in order)


def test_every_track_gets_to_be_the_first_agent_and_more_scenes_change_none():
    # A fixed cycle over 106 tracks with 4 agents lets only 53 of them ever be first.
    long = track_order(n_tracks=106, n_scenes=500, agents=4, seed=0)
    assert len(set(long[:, 0])) > 100
    assert np.array_equal(
        long[:30], track_order(n_tracks=106, n_scenes=30, agents=4, seed=0)
    )
    assert not np.array_equal(
        long, track_order(n_tracks=106, n_scenes=500, agents=4, seed=1)
    )


def test_too_few_tracks_are_an_error_with_a_way_out(tracks):
    lasting = tracks.t[tracks.offsets[1:] - 1] - tracks.t[tracks.offsets[:-1]]
    fourth = np.floor(10 * np.sort(lasting)[-4]) / 10
    with pytest.raises(
        DataError, match="no track lasts 60 s; the longest last"
    ) as caught:
        cut(tracks, settings=SETTINGS.changed({"resample.min_duration_s": 60}), seed=0)
    (way_out,) = re.findall(r"--set (\S+)=(\S+) takes 4 or more", str(caught.value))
    assert way_out == ("resample.min_duration_s", f"{fourth:g}")
    assert len(cut(tracks, settings=SETTINGS.changed(dict([way_out])), seed=0)) >= 4
    with pytest.raises(DataError, match="a scene needs 13"):
        cut(tracks, settings=SETTINGS.changed({"scenes.agents": 13}), seed=0)
    with pytest.raises(ValueError, match="3 tracks cannot fill scenes of 4"):
        track_order(n_tracks=3, n_scenes=1, agents=4, seed=0)


def test_tracks_without_a_future_are_counted(tracks):
    late = SETTINGS.changed({"scenes.history_ratio": 0.96})  # 1.2 s of 30 s are left
    known = cut(tracks, settings=late, seed=0)
    assert known.no_future + len(known) == len(tracks)
    later = SETTINGS.changed({"scenes.history_ratio": 0.99})
    with pytest.raises(DataError, match="cover the horizon"):
        cut(tracks, settings=later, seed=0)


def test_students03_has_the_papers_history_and_the_error_of_the_sixteen_sample_line(
    students03,
):
    known = cut(students03.tracks, settings=SETTINGS, seed=0)
    names = tuple(f"{row}" for row in range(len(known)))
    release = Release(
        t=known.t, xy=known.xy, sigma=None, offsets=known.offsets, pseudonym=names
    )
    assert len(known) == 106
    assert np.diff(known.offsets).mean() == pytest.approx(366, abs=4)
    assert 0.083 <= np.mean([np.diff(track.t).mean() for track in release]) <= 0.084
    mean = LeastSquares().predict(release, known.t_future).mean
    error = np.linalg.norm(mean[:, -1] - known.xy_future[:, -1], axis=1).mean()
    assert error == pytest.approx(0.22, rel=0.2)
