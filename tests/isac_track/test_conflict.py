"""The robot's task beyond the metric suite: refusals, batches, probabilities."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.stats import ncx2

from isac_track.conflict import (
    conflict_probability,
    disc_probability,
    distance_mae_m,
    false_alarm_rate,
    minimum_separation,
    missed_conflict_rate,
    prediction_grid,
    robot_path,
)
from isac_track.rng import stream


def raises(message):
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


class TestPredictionGrid:
    @pytest.mark.parametrize(
        ("window", "steps", "grid"),
        [
            (3, 3, [[10.0, 11.5, 13.0], [3.0, 5.0, 7.0]]),
            (2, 1, [[10.0], [3.0]]),  # smallest window and horizon
        ],
    )
    def test_by_hand(self, window, steps, grid):
        t = np.array([0.0, 7.0, 8.0, 10.0, 1.0, 3.0])
        result = prediction_grid(
            t=t, offsets=np.array([0, 4, 6]), window=window, horizon_steps=steps
        )
        assert result.tolist() == grid

    @pytest.mark.parametrize(("window", "steps"), [(1, 12), (16, 0), (0, 0), (-1, 3)])
    def test_window_and_horizon(self, window, steps):
        with raises("the window must be at least 2 samples and the horizon 1 step"):
            prediction_grid(
                t=np.arange(3.0),
                offsets=np.array([0, 3]),
                window=window,
                horizon_steps=steps,
            )

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
            elapsed_s=np.array(
                [[[0.0, 8.0], [4.0, 99.0]], *[[[0.0, 1.0], [1.5, 3.0]]] * 2]
            ),
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


def test_rates_and_the_distance_error_are_plain_numbers_of_scenes_that_match():
    for rate in (missed_conflict_rate, false_alarm_rate):
        assert (
            type(rate(conflict=np.array([True, False]), predicted=np.ones(2, bool)))
            is float
        )
        with raises("conflict and predicted must have one shape"):
            rate(conflict=np.ones(3, bool), predicted=np.ones(1, bool))
    true_m, predicted_m = np.array([2.0]), np.array([1.25])
    error_m = distance_mae_m(
        true_separation_m=true_m, predicted_separation_m=predicted_m
    )
    assert (error_m, type(error_m)) == (0.75, float)
    with raises("true and predicted separations must have one shape"):
        distance_mae_m(true_separation_m=np.ones(3), predicted_separation_m=np.ones(1))


class TestProbabilityOfAConflict:
    def test_isotropic_is_the_noncentral_chi_square(self):
        rng = stream(0, "test", "disc")
        mean = rng.uniform(-3, 3, (4000, 2))
        std = 10 ** rng.uniform(-1.5, 1, 4000)
        cov = np.eye(2) * std[:, None, None] ** 2
        probability = disc_probability(mean=mean, cov=cov, radius_m=0.9)
        expected = ncx2.cdf(0.81 / std**2, 2, (mean**2).sum(axis=1) / std**2)
        # The error is largest for a narrow Gaussian on the edge of the disc.
        assert np.abs(probability - expected).max() < 0.03
        assert np.abs(probability - expected)[std > 0.1].max() < 1e-3

    @pytest.mark.parametrize("angle", [0.0, 0.4, 2.1])
    def test_an_oblong_gaussian_is_monte_carlo(self, angle):
        turn = np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )
        cov = turn @ np.diag([0.8, 0.05]) @ turn.T
        mean = np.array([0.7, -0.4])
        draws = stream(0, "test", "oblong").multivariate_normal(mean, cov, 400_000)
        share = (np.hypot(*draws.T) < 0.9).mean()
        probability = disc_probability(mean=mean, cov=cov, radius_m=0.9)
        assert probability == pytest.approx(share, abs=4 * 0.5 / np.sqrt(400_000))

    @pytest.mark.parametrize(
        ("mean", "variance", "expected"),
        [([0.5, 0.0], 0.0, 1.0), ([1.5, 0.0], 0.0, 0.0), ([0.0, 0.0], 1e6, 0.0)],
    )
    def test_certain_and_impossible(self, mean, variance, expected):
        cov = variance * np.eye(2)
        probability = disc_probability(mean=np.array(mean), cov=cov, radius_m=0.9)
        assert probability == pytest.approx(expected, abs=1e-6)

    def test_a_scene_takes_its_likeliest_step_and_its_agents_together(self):
        rng = stream(0, "test", "scene")
        shape = (40, 3, 12)
        robot = rng.normal(0, 0.5, (40, 3, 1, 2)) + np.zeros((*shape, 2))
        velocity = rng.normal(0, 1.2, (40, 3, 1, 2))
        mean = (
            rng.normal(0, 1.5, (40, 3, 1, 2))
            + velocity * 0.083 * np.arange(12)[:, None]
        )
        std = 0.2 + 0.05 * np.arange(12)
        cov = np.broadcast_to(np.eye(2) * std[:, None, None] ** 2, (*shape, 2, 2))
        probability = conflict_probability(
            robot=robot, mean=mean, cov=cov, radius_m=0.9
        )
        every_step = disc_probability(mean=mean - robot, cov=cov, radius_m=0.9)
        expected = 1 - np.prod(1 - every_step.max(axis=2), axis=1)
        assert np.allclose(probability, expected, atol=1e-8)

    @pytest.mark.parametrize("spread", [0.03, 0.3, 3.0])
    def test_the_likeliest_step_is_not_missed(self, spread):
        rng = stream(0, "test", "likeliest", str(spread))
        shape = (300, 1, 6)
        robot = np.zeros((*shape, 2))
        factor = (
            spread
            * rng.normal(0, 1, (*shape, 2, 2))
            * rng.uniform(0, 1, (*shape, 1, 2))
        )
        cov = factor @ np.swapaxes(factor, -1, -2)
        # Most lie within six standard deviations of the disc; others count as 0.
        mean = rng.normal(0, 0.7 + spread, (*shape, 2))
        probability = conflict_probability(
            robot=robot, mean=mean, cov=cov, radius_m=0.9
        )
        every_step = disc_probability(mean=mean, cov=cov, radius_m=0.9)
        widest = np.sqrt(np.maximum(np.trace(cov, axis1=-2, axis2=-1), 1e-6))
        every_step[np.hypot(*np.moveaxis(mean, -1, 0)) >= 0.9 + 6 * widest] = 0.0
        assert np.allclose(probability, every_step.max(axis=(1, 2)), rtol=0, atol=1e-15)

    def test_five_standard_deviations_away_are_not_nothing(self):
        """The agent is north of the robot, and only its distance is uncertain."""
        mean, cov = np.array([0.0, 0.9 + 4.8 * 2.0]), np.diag([0.0, 4.0])
        probability = conflict_probability(
            robot=np.zeros((1, 1, 1, 2)),
            mean=mean[None, None, None],
            cov=cov[None, None, None],
            radius_m=0.9,
        )
        assert probability == pytest.approx(
            disc_probability(mean=mean, cov=cov, radius_m=0.9), rel=1e-6
        )
        assert probability > 1e-7
