from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from helpers import oracles
from helpers.strategies import batches, points, reproducible
from hypothesis import assume, given
from hypothesis import strategies as st

from isac_track.conflict import (
    distance_mae_m,
    false_alarm_rate,
    is_conflict,
    minimum_separation,
    missed_conflict_rate,
    prediction_grid,
    robot_path,
)

decisions = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=12)


class TestPredictionGrid:
    def test_by_hand(self):
        t = np.array([0.0, 7.0, 8.0, 10.0, 1.0, 3.0])
        grid = prediction_grid(t=t, offsets=np.array([0, 4, 6]), window=3, horizon_steps=3)
        np.testing.assert_allclose(grid, [[10.0, 11.5, 13.0], [3.0, 5.0, 7.0]])

    @pytest.mark.parametrize(("window", "steps"), [(1, 12), (16, 0), (0, 0), (-1, 3)])
    def test_window_and_horizon(self, window, steps):
        message = "^the window must be at least 2 samples and the horizon 1 step$"
        with pytest.raises(ValueError, match=message):
            prediction_grid(
                t=np.arange(3.0), offsets=np.array([0, 3]), window=window, horizon_steps=steps
            )

    def test_smallest_window_and_horizon(self):
        t, offsets = np.array([0.0, 5.0, 6.0]), np.array([0, 3])
        grid = prediction_grid(t=t, offsets=offsets, window=2, horizon_steps=1)
        assert grid.tolist() == [[6.0]]

    def test_a_single_sample_has_no_grid(self):
        message = "^a track of one sample has no sampling interval to predict on$"
        with pytest.raises(ValueError, match=message):
            prediction_grid(
                t=np.arange(4.0), offsets=np.array([0, 3, 4]), window=16, horizon_steps=12
            )


class TestRobotPath:
    def test_walks_then_waits(self):
        path = robot_path(
            start=np.array([[1.0, 1.0]]),
            destination=np.array([[4.0, 5.0]]),
            speed_mps=2.0,
            elapsed_s=np.array([[[0.0, 1.0, 2.5, 100.0]]]),
        )
        np.testing.assert_allclose(path, [[[[1, 1], [2.2, 2.6], [4, 5], [4, 5]]]])

    def test_a_robot_without_a_way_has_no_heading(self):
        start = np.array([[0.0, 0.0], [1.0, 1.0]])
        message = "^a robot's destination must differ from its start$"
        with pytest.raises(ValueError, match=message):
            robot_path(
                start=start,
                destination=np.array([[5.0, 0.0], [1.0, 1.0]]),
                speed_mps=1.4,
                elapsed_s=np.zeros((2, 1, 1)),
            )

    def test_a_way_along_one_axis_is_enough(self):
        path = robot_path(
            start=np.array([[0.0, 0.0], [0.0, 0.0]]),
            destination=np.array([[0.5, 0.0], [0.0, -0.5]]),
            speed_mps=0.25,
            elapsed_s=np.ones((2, 1, 1)),
        )
        assert path[:, 0, 0].tolist() == [[0.25, 0.0], [0.0, -0.25]]


class TestSeparation:
    def test_is_aligned_in_time(self):
        robot = np.array([[[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]])
        assert minimum_separation(robot=robot, agents=robot - [1.0, 0.0]).tolist() == [1.0]

    def test_shapes(self):
        robot, agents = np.zeros((1, 4, 12, 2)), np.zeros((1, 3, 12, 2))
        message = f"robot {robot.shape} and agents {agents.shape} must have one shape"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            minimum_separation(robot=robot, agents=agents)


def test_conflict_is_strict_at_the_safety_radius():
    separation_m = np.array([0.0, np.nextafter(0.9, 0), 0.9, np.nextafter(0.9, 1), 4.0])
    decision = is_conflict(separation_m=separation_m, safety_radius_m=0.9)
    assert decision.tolist() == [True, True, False, False, False]


class TestRates:
    def test_by_hand(self):
        conflict = np.array([True, True, True, False, False, False, False])
        predicted = np.array([True, False, False, True, False, False, False])
        assert missed_conflict_rate(conflict=conflict, predicted=predicted) == pytest.approx(2 / 3)
        assert false_alarm_rate(conflict=conflict, predicted=predicted) == pytest.approx(1 / 4)

    def test_without_a_scene_of_the_kind_the_rate_is_undefined(self):
        every, none = np.ones(3, bool), np.zeros(3, bool)
        assert np.isnan(missed_conflict_rate(conflict=none, predicted=every))
        assert np.isnan(false_alarm_rate(conflict=every, predicted=none))

    def test_a_single_conflict(self):
        one = np.array([True])
        assert missed_conflict_rate(conflict=one, predicted=~one) == 1.0
        assert false_alarm_rate(conflict=~one, predicted=one) == 1.0

    @pytest.mark.parametrize("rate", [missed_conflict_rate, false_alarm_rate])
    def test_shapes(self, rate):
        message = "^conflict and predicted must have one shape$"
        with pytest.raises(ValueError, match=message):
            rate(conflict=np.ones(3, bool), predicted=np.ones(1, bool))


class TestDistanceError:
    def test_by_hand(self):
        mean_m = distance_mae_m(
            true_separation_m=np.array([1.0, 2.0, 3.0, 0.0]),
            predicted_separation_m=np.array([1.5, 1.0, 3.0, 0.5]),
        )
        assert mean_m == 0.5
        assert isinstance(mean_m, float)

    def test_of_one_scene(self):
        one, other = np.array([2.0]), np.array([1.25])
        assert distance_mae_m(true_separation_m=one, predicted_separation_m=other) == 0.75

    def test_without_a_scene_it_is_undefined(self):
        none = np.array([])
        assert np.isnan(distance_mae_m(true_separation_m=none, predicted_separation_m=none))

    def test_shapes(self):
        message = "^true and predicted separations must have one shape$"
        with pytest.raises(ValueError, match=message):
            distance_mae_m(true_separation_m=np.ones(3), predicted_separation_m=np.ones(1))


@given(batch=batches(min_samples=2), window=st.integers(2, 14), steps=st.integers(1, 12))
@reproducible
def test_prediction_grid_equals_the_loop(batch, window, steps):
    _, t, offsets = batch
    grid = prediction_grid(t=t, offsets=offsets, window=window, horizon_steps=steps)
    for row, (lo, hi) in enumerate(pairwise(offsets)):
        one = oracles.prediction_grid(t=t[lo:hi], window=window, horizon_steps=steps)
        np.testing.assert_allclose(grid[row], one, rtol=1e-12, atol=1e-12)


@given(
    start=points((3, 2)),
    destination=points((3, 2)),
    speed_mps=st.floats(0.1, 5.0),
    step_s=st.floats(0.01, 20.0),
)
@reproducible
def test_robot_path_equals_the_equation(start, destination, speed_mps, step_s):
    # Closer than a tenth of a millimetre the heading itself is lost to rounding.
    assume((np.abs(start - destination).max(axis=1) > 1e-4).all())
    elapsed_s = step_s * np.arange(24.0).reshape(3, 2, 4)
    path = robot_path(
        start=start, destination=destination, speed_mps=speed_mps, elapsed_s=elapsed_s
    )
    assert path.shape == (3, 2, 4, 2)
    for scene, agent, step in np.ndindex(3, 2, 4):
        point = oracles.robot_point(
            start=start[scene],
            destination=destination[scene],
            speed_mps=speed_mps,
            elapsed_s=elapsed_s[scene, agent, step],
        )
        np.testing.assert_allclose(path[scene, agent, step], point, rtol=1e-9, atol=1e-9)


@given(robot=points((2, 2, 3, 2)), agents=points((2, 2, 3, 2)))
@reproducible
def test_separation_equals_the_loop(robot, agents):
    nearest = minimum_separation(robot=robot, agents=agents)
    looped = [
        oracles.minimum_separation(robot=r, agents=a) for r, a in zip(robot, agents, strict=True)
    ]
    np.testing.assert_allclose(nearest, looped, rtol=1e-12)


@given(scenes=decisions)
@reproducible
def test_rates_equal_the_count(scenes):
    conflict, predicted = np.array(scenes).T
    for ours, loop in (
        (missed_conflict_rate, oracles.missed_conflict_rate),
        (false_alarm_rate, oracles.false_alarm_rate),
    ):
        rate = ours(conflict=conflict, predicted=predicted)
        counted = loop(conflict=conflict, predicted=predicted)
        assert rate == pytest.approx(counted, nan_ok=True)
        assert isinstance(rate, float)
