"""What the metric suite does not see of the robot's task: refusals, and batches of several."""

from __future__ import annotations

import re

import numpy as np
import pytest

from isac_track.conflict import (
    distance_mae_m,
    false_alarm_rate,
    minimum_separation,
    missed_conflict_rate,
    prediction_grid,
    robot_path,
)


def raises(message):
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


class TestPredictionGrid:
    @pytest.mark.parametrize(
        ("window", "steps", "grid"),
        [
            (3, 3, [[10.0, 11.5, 13.0], [3.0, 5.0, 7.0]]),
            (2, 1, [[10.0], [3.0]]),  # the smallest of either
        ],
    )
    def test_by_hand(self, window, steps, grid):
        t = np.array([0.0, 7.0, 8.0, 10.0, 1.0, 3.0])
        found = prediction_grid(
            t=t, offsets=np.array([0, 4, 6]), window=window, horizon_steps=steps
        )
        assert found.tolist() == grid

    @pytest.mark.parametrize(("window", "steps"), [(1, 12), (16, 0), (0, 0), (-1, 3)])
    def test_window_and_horizon(self, window, steps):
        t, offsets = np.arange(3.0), np.array([0, 3])
        with raises("the window must be at least 2 samples and the horizon 1 step"):
            prediction_grid(t=t, offsets=offsets, window=window, horizon_steps=steps)

    def test_a_single_sample_has_no_grid(self):
        t, offsets = np.arange(4.0), np.array([0, 3, 4])
        with raises("a track of one sample has no sampling interval to predict on"):
            prediction_grid(t=t, offsets=offsets, window=16, horizon_steps=12)


class TestRobotPath:
    def test_each_agent_has_its_own_clock_and_each_scene_its_way(self):
        path = robot_path(
            start=np.array([[1.0, 1.0], [0.0, 0.0], [0.0, 0.0]]),
            destination=np.array([[4.0, 5.0], [0.5, 0.0], [0.0, -0.5]]),
            speed_mps=0.25,
            elapsed_s=np.array([[[0.0, 8.0], [4.0, 99.0]], *[[[0.0, 1.0], [1.5, 3.0]]] * 2]),
        )
        expected = [
            [[[1, 1], [2.2, 2.6]], [[1.6, 1.8], [4, 5]]],
            [[[0, 0], [0.25, 0]], [[0.375, 0], [0.5, 0]]],
            [[[0, 0], [0, -0.25]], [[0, -0.375], [0, -0.5]]],
        ]
        np.testing.assert_allclose(path, expected, rtol=1e-12)

    def test_a_robot_without_a_way_has_no_heading(self):
        with raises("a robot's destination must differ from its start"):
            robot_path(
                start=np.array([[0.0, 0.0], [1.0, 1.0]]),
                destination=np.array([[5.0, 0.0], [1.0, 1.0]]),
                speed_mps=1.4,
                elapsed_s=np.zeros((2, 1, 1)),
            )


def test_separation_is_that_of_each_scene():
    robot = np.array([[[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]] * 2)
    away = np.array([[[[3.0, 4.0]] * 3], [[[0.0, 9.0], [0.0, 2.0], [6.0, 8.0]]]])
    assert minimum_separation(robot=robot, agents=robot + away).tolist() == [5.0, 2.0]
    robot, agents = np.zeros((1, 4, 12, 2)), np.zeros((1, 3, 12, 2))
    with raises(f"robot {robot.shape} and agents {agents.shape} must have one shape"):
        minimum_separation(robot=robot, agents=agents)


@pytest.mark.parametrize("rate", [missed_conflict_rate, false_alarm_rate])
def test_rates_are_plain_numbers_of_scenes_that_match(rate):
    assert type(rate(conflict=np.array([True, False]), predicted=np.ones(2, bool))) is float
    with raises("conflict and predicted must have one shape"):
        rate(conflict=np.ones(3, bool), predicted=np.ones(1, bool))


def test_the_distance_error_is_a_plain_number_of_scenes_that_match():
    one, other = np.array([2.0]), np.array([1.25])
    found = distance_mae_m(true_separation_m=one, predicted_separation_m=other)
    assert (found, type(found)) == (0.75, float)
    with raises("true and predicted separations must have one shape"):
        distance_mae_m(true_separation_m=np.ones(3), predicted_separation_m=np.ones(1))
