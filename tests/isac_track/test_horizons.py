"""Future conflicts, and scenes with a further horizon: by hand and by brute force."""

import re

import numpy as np
import pytest

from isac_track.config import StageSettings
from isac_track.conflict import (
    count_steps,
    is_conflict,
    minimum_separation,
    missed_future_rate,
    robot_path,
    seconds_grid,
    time_to_conflict_s,
)
from isac_track.errors import SettingsError
from isac_track.resample import walk
from isac_track.scenes import (
    cut,
    make_scenes,
    robot_positions,
    track_order,
    with_horizons,
)
from isac_track.types import Release, Tracks
from predictors.constant_position import ConstantPosition
from predictors.kalman import KalmanCV, KalmanIMM
from predictors.least_squares import LeastSquares

SETTINGS = StageSettings()
N_SCENES = 80
HORIZON_S = 3.0


@pytest.fixture(scope="module")
def known(tracks):
    return with_horizons(
        cut(tracks, settings=SETTINGS, seed=0), tracks, settings=SETTINGS
    )


def build_scenes(known, *, n_scenes=N_SCENES, seed=0):
    order = track_order(n_tracks=len(known), n_scenes=n_scenes, agents=4, seed=seed)
    return make_scenes(known, order=order, first=0, settings=SETTINGS, seed=seed)


@pytest.fixture(scope="module")
def later(known):
    return build_scenes(known.further[HORIZON_S])


def distances(scenes):
    """Distances of every agent at every step, (S, A, H); the robot walks straight."""
    way = scenes.robot_destination - scenes.robot_start
    heading = way / np.linalg.norm(way, axis=1, keepdims=True)
    apart = []
    for scene in range(len(scenes)):
        for agent in range(4):
            row = 4 * scene + agent
            elapsed = scenes.t_future[row] - scenes.t_future[row, 0]
            robot = scenes.robot_start[scene] + 1.4 * elapsed[:, None] * heading[scene]
            apart.append(np.linalg.norm(robot - scenes.xy_future[row], axis=1))
    return np.array(apart).reshape(len(scenes), 4, -1)


class TestGrid:
    def test_every_track_has_steps_of_its_own_and_repeats_its_last(self):
        # Mean intervals 0.5 s and 0.8 s: 1 + round(3 / 0.5) = 7 steps, 1 + round(3.75)
        # = 5.
        t = np.array([0.0, 0.5, 1.0, 7.0, 7.8, 8.6])
        grid, n_steps = seconds_grid(
            t=t, offsets=np.array([0, 3, 6]), window=16, horizon_s=3.0
        )
        assert n_steps.tolist() == [7, 5]
        assert count_steps(grid).tolist() == [7, 5]
        np.testing.assert_allclose(grid[0], 1.0 + 0.5 * np.arange(7))
        np.testing.assert_allclose(grid[1], 8.6 + 0.8 * np.array([0, 1, 2, 3, 4, 4, 4]))

    def test_there_is_a_future_step_even_where_an_interval_is_longer_than_the_horizon(
        self,
    ):
        grid, n_steps = seconds_grid(
            t=np.array([0.0, 9.0]), offsets=np.array([0, 2]), window=2, horizon_s=1.0
        )
        assert n_steps.tolist() == [2]
        assert grid.tolist() == [[9.0, 18.0]]

    def test_a_repeated_last_instant_changes_neither_separation_nor_label_nor_time(
        self, later
    ):
        robot = robot_positions(later, settings=SETTINGS.conflict)
        agents = later.xy_future.reshape(robot.shape)
        elapsed = (later.t_future - later.t_future[:, :1]).reshape(robot.shape[:3])
        robot, agents, elapsed = (
            np.concatenate([values, values[:, :, -1:].repeat(9, axis=2)], axis=2)
            for values in (robot, agents, elapsed)
        )
        apart = minimum_separation(robot=robot, agents=agents)
        assert np.array_equal(apart, later.separation)
        first = time_to_conflict_s(
            robot=robot, agents=agents, elapsed_s=elapsed, safety_radius_m=0.9
        )
        assert np.array_equal(first, later.time_to_conflict_s, equal_nan=True)

    @pytest.mark.parametrize(
        "predictor", [LeastSquares(), KalmanCV(), KalmanIMM(), ConstantPosition()]
    )
    def test_predictors_foresee_the_same_at_a_repeated_instant(self, later, predictor):
        names = tuple(f"{row}" for row in range(later.offsets.size - 1))
        release = Release(later.t, later.xy, None, later.offsets, names)
        repeated = np.concatenate([later.t_future, later.t_future[:, -1:]], axis=1)
        short, long = (
            predictor.predict(release, t) for t in (later.t_future, repeated)
        )
        assert np.array_equal(long.mean[:, :-1], short.mean)
        assert np.array_equal(long.mean[:, -1], short.mean[:, -1])
        if short.cov is not None:
            assert np.array_equal(long.cov[:, -1], short.cov[:, -1])


class TestTimeToConflict:
    # A robot that walks east at 1 m/s past agents who stand still; the radius is 1 m.
    ELAPSED = np.tile(np.arange(4.0), (3, 2, 1))
    ROBOT = robot_path(
        start=np.zeros((3, 2)),
        destination=np.tile([9.0, 0.0], (3, 1)),
        speed_mps=1.0,
        elapsed_s=ELAPSED,
    )

    def agents(self):
        stand = np.array([
            [[2.5, 0.0], [0.0, 5.0]],  # first inside at x = 2: after 2 s
            [[9.0, 9.0], [0.5, 0.0]],  # the second agent is inside now
            # touches the radius at x = 1, which is no conflict
            [[1.0, 1.0], [0.0, 2.0]],
        ])  # fmt: skip
        return np.repeat(stand[:, :, None, :], 4, axis=2)

    def test_it_is_the_first_step_at_which_any_agent_is_inside(self):
        times = time_to_conflict_s(
            robot=self.ROBOT,
            agents=self.agents(),
            elapsed_s=self.ELAPSED,
            safety_radius_m=1.0,
        )
        np.testing.assert_array_equal(times, [2.0, 0.0, np.nan])

    def test_every_agent_has_a_clock_of_its_own(self):
        elapsed = self.ELAPSED * np.array([0.5, 3.0])[:, None]
        agents = self.agents()
        agents[1, 1] = [2.5, 0.0]
        times = time_to_conflict_s(
            robot=self.ROBOT, agents=agents, elapsed_s=elapsed, safety_radius_m=1.0
        )
        np.testing.assert_array_equal(times, [1.0, 6.0, np.nan])

    def test_shapes_must_agree(self):
        with pytest.raises(ValueError, match="must have one shape"):
            time_to_conflict_s(
                robot=self.ROBOT,
                agents=self.agents()[:2],
                elapsed_s=self.ELAPSED,
                safety_radius_m=1.0,
            )

    def test_missed_future_leaves_out_scenes_with_somebody_inside(self):
        conflict = np.array([True, True, True, True, False])
        inside = np.array([True, False, False, False, False])
        predicted = np.array([False, False, True, True, True])
        rate = missed_future_rate(
            conflict=conflict, inside_now=inside, predicted=predicted
        )
        assert rate == pytest.approx(1 / 3)
        nobody = missed_future_rate(
            conflict=inside, inside_now=inside, predicted=predicted
        )
        assert np.isnan(nobody)
        with pytest.raises(ValueError, match="must have one shape"):
            missed_future_rate(
                conflict=conflict, inside_now=inside[:1], predicted=predicted
            )


class TestScenesOfAFurtherHorizon:
    def test_the_future_is_the_true_walk_three_seconds_ahead(self, tracks, known):
        longer = known.further[HORIZON_S]
        for row, track in enumerate(tracks):
            t = known.t[known.offsets[row] : known.offsets[row + 1]]
            step = (t[-1] - t[-16]) / 15
            n_steps = 1 + round(HORIZON_S / step)
            grid = t[-1] + step * np.minimum(
                np.arange(longer.t_future.shape[1]), n_steps - 1
            )
            np.testing.assert_allclose(longer.t_future[row], grid)
            np.testing.assert_allclose(longer.xy_future[row], walk(track)(grid))
        # Grids differ in length.
        assert np.unique(count_steps(longer.t_future)).size > 1

    def test_the_scenes_of_the_papers_horizon_do_not_change(self, tracks, known):
        plain = build_scenes(cut(tracks, settings=SETTINGS, seed=0))
        with_further = build_scenes(known)
        for name in (
            "xy",
            "xy_future",
            "t_future",
            "robot_start",
            "separation",
            "conflict",
        ):
            assert np.array_equal(getattr(plain, name), getattr(with_further, name))

    def test_the_robot_starts_and_heads_the_same_way_with_the_same_people(
        self, known, later
    ):
        own = build_scenes(known)
        assert np.array_equal(own.robot_start, later.robot_start)
        ways = [
            scenes.robot_destination - scenes.robot_start for scenes in (own, later)
        ]
        turns = [np.arctan2(way[:, 1], way[:, 0]) for way in ways]
        np.testing.assert_allclose(*turns)
        assert np.array_equal(own.track, later.track)

    def test_labels_and_times_follow_the_rule_over_the_horizon_judged(self, later):
        apart = distances(later)
        elapsed = (later.t_future - later.t_future[:, :1]).reshape(apart.shape)
        for scene in range(N_SCENES):
            inside = apart[scene] < 0.9
            assert later.separation[scene] == pytest.approx(apart[scene].min())
            assert later.conflict[scene] == inside.any()
            assert later.inside_now[scene] == inside[:, 0].any()
            times = elapsed[scene][inside]
            if inside.any():
                assert later.time_to_conflict_s[scene] == times.min()
            else:
                assert np.isnan(later.time_to_conflict_s[scene])
        assert later.conflict.tolist() == [scene % 2 == 0 for scene in range(N_SCENES)]
        expected = is_conflict(separation_m=later.separation, safety_radius_m=0.9)
        assert np.array_equal(expected, later.conflict)

    def test_the_conflict_step_is_drawn_over_the_whole_horizon(self, known):
        scenes = build_scenes(known.further[HORIZON_S], n_scenes=400)
        apart = distances(scenes)[::2, 0]
        assert (apart.min(axis=1) < 1e-9).all()
        # Of the first agent of every other scene.
        n_steps = count_steps(scenes.t_future)[::8]
        step = apart.argmin(axis=1)
        assert (step >= 1).all()
        assert (step < n_steps).all()
        # Uniform over 1..H-1: (step - 1) / (H - 1) has mean 1/2 - 1 / (2 (H - 1)),
        # variance 1/12.
        share = (step - 0.5) / (n_steps - 1)
        assert share.mean() == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / share.size))

    def test_near_misses_and_clearance_hold_over_the_horizon_judged(self, later):
        apart = distances(later)
        nearest = apart[1::2, 0].min(axis=1)
        assert (nearest > 0.9).all()
        assert (nearest < 1.4 + 1e-8).all()
        placed = later.exhausted == 0
        assert placed.mean() > 0.9
        assert (apart[placed, 1:].min(axis=(1, 2)) >= 1.5).all()

    def test_tracks_that_do_not_cover_it_are_left_out_and_counted(self, tracks):
        # 1.5 s of 30 s are left.
        ratio = SETTINGS.changed({"scenes.history_ratio": 0.95})
        long, short = tracks, tracks[0]
        known = with_horizons(cut(long, settings=ratio, seed=0), long, settings=ratio)
        assert not known.further  # nobody's recording covers 3 s
        later = ratio.changed({"conflict.horizons_s": "1.2,3"})
        known = with_horizons(cut(long, settings=later, seed=0), long, settings=later)
        assert list(known.further) == [1.2]
        # The recording of one person ends earlier, after 26 s of 30 s: 0.7 s are left.
        stop = np.searchsorted(short.t, 26.0)
        parts = [
            (short.t[:stop], short.xy[:stop]),
            *((track.t, track.xy) for track in list(long)[1:]),
        ]
        cutting = Tracks(
            np.concatenate([t for t, _ in parts]),
            np.concatenate([xy for _, xy in parts]),
            np.cumsum([0, *(t.size for t, _ in parts)]),
            long.source,
            long.group,
        )
        known = with_horizons(
            cut(
                cutting,
                settings=SETTINGS.changed({"scenes.history_ratio": 0.88}),
                seed=0,
            ),
            cutting,
            settings=SETTINGS.changed(
                {"scenes.history_ratio": 0.88, "conflict.horizons_s": 3.4}
            ),
        )
        longer = known.further[3.4]
        assert known.source[0] not in longer.source
        assert longer.no_future == known.no_future + len(known) - len(longer)
        for row, name in enumerate(longer.source):
            place = known.source.index(name)
            ours = longer.xy[longer.offsets[row] : longer.offsets[row + 1]]
            theirs = known.xy[known.offsets[place] : known.offsets[place + 1]]
            assert np.array_equal(ours, theirs)
        build_scenes(longer, n_scenes=4)


@pytest.mark.parametrize(
    ("typed", "horizons_s"),
    [
        ("3", (3.0,)),
        ("3, 1.5", (1.5, 3.0)),
        ([2, 2.0], (2.0,)),
        ("none", ()),
        ([], ()),
        (4, (4.0,)),
    ],
)
def test_horizons_are_typed_as_a_list(typed, horizons_s):
    settings = SETTINGS.changed({"conflict.horizons_s": typed})
    assert settings.conflict.horizons_s == horizons_s
    assert SETTINGS.changed(settings.flat()) == settings  # as in the manifest


@pytest.mark.parametrize("typed", ["three", "1,", "0", "-3", [True], None, "nan", 1e3])
def test_no_horizon_is_one_clear_line(typed):
    message = (
        "conflict.horizons_s must be numbers within 0.1 to 60, such as 3 or 1.5,3, or"
        " none"
    )
    with pytest.raises(SettingsError, match=f"^{re.escape(message)}, got "):
        SETTINGS.changed({"conflict.horizons_s": typed})


def test_in_two_of_three_conflicts_of_the_paper_somebody_is_inside_already(students03):
    known = cut(students03.tracks, settings=SETTINGS, seed=0)
    known = with_horizons(known, students03.tracks, settings=SETTINGS)
    own, later = (
        build_scenes(cut_at, n_scenes=1000)
        for cut_at in (known, known.further[HORIZON_S])
    )
    share = own.inside_now[own.conflict].mean()
    assert share == pytest.approx(2 / 3, abs=4 * np.sqrt(2 / 9 / own.conflict.sum()))
    # Three seconds ahead most are still to come.
    assert later.inside_now[later.conflict].mean() < 0.35
