"""Probabilities of a planar Gaussian in a disc, against scipy and Monte Carlo."""

import numpy as np
import pytest
from scipy.stats import ncx2

from isac_track.conflict import conflict_probability, disc_probability
from isac_track.rng import stream


def test_isotropic_is_the_noncentral_chi_square():
    rng = stream(0, "test", "disc")
    mean = rng.uniform(-3, 3, (4000, 2))
    std = 10 ** rng.uniform(-1.5, 1, 4000)
    cov = np.eye(2) * std[:, None, None] ** 2
    found = disc_probability(mean=mean, cov=cov, radius_m=0.9)
    expected = ncx2.cdf(0.81 / std**2, 2, (mean**2).sum(axis=1) / std**2)
    # The nodes miss most where a Gaussian of a few centimetres straddles the edge.
    assert np.abs(found - expected).max() < 0.03
    assert np.abs(found - expected)[std > 0.1].max() < 1e-3


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.1])
def test_an_oblong_one_is_monte_carlo(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov = turn @ np.diag([0.8, 0.05]) @ turn.T
    mean = np.array([0.7, -0.4])
    draws = stream(0, "test", "oblong").multivariate_normal(mean, cov, 400_000)
    share = (np.hypot(*draws.T) < 0.9).mean()
    found = disc_probability(mean=mean, cov=cov, radius_m=0.9)
    assert found == pytest.approx(share, abs=4 * 0.5 / np.sqrt(400_000))


def test_certainty_and_its_opposite():
    nothing = np.zeros((2, 2))
    assert disc_probability(mean=np.array([0.5, 0.0]), cov=nothing, radius_m=0.9) == (
        pytest.approx(1.0, abs=1e-6)
    )
    assert disc_probability(mean=np.array([1.5, 0.0]), cov=nothing, radius_m=0.9) == 0.0
    wide = np.eye(2) * 1e6
    assert disc_probability(mean=np.zeros(2), cov=wide, radius_m=0.9) < 1e-5


def test_a_scene_takes_its_likeliest_step_and_its_agents_together():
    rng = stream(0, "test", "scene")
    n_scenes, n_agents, n_steps = 40, 3, 12
    robot = rng.normal(0, 0.5, (n_scenes, n_agents, 1, 2)) + np.zeros((1, 1, n_steps, 2))
    velocity = rng.normal(0, 1.2, (n_scenes, n_agents, 1, 2))
    steps_s = 0.083 * np.arange(n_steps)[:, None]
    mean = rng.normal(0, 1.5, (n_scenes, n_agents, 1, 2)) + velocity * steps_s
    std = 0.2 + 0.05 * np.arange(n_steps)
    cov = np.broadcast_to(np.eye(2) * std[:, None, None] ** 2, (n_scenes, n_agents, n_steps, 2, 2))
    found = conflict_probability(robot=robot, mean=mean, cov=cov, radius_m=0.9)
    every_step = disc_probability(mean=mean - robot, cov=cov, radius_m=0.9)
    expected = 1 - np.prod(1 - every_step.max(axis=2), axis=1)
    assert np.allclose(found, expected, atol=1e-8)


def test_one_certain_agent_is_enough():
    robot = np.zeros((1, 2, 3, 2))
    mean = np.full((1, 2, 3, 2), 9.0)
    mean[0, 1, 2] = 0.1
    cov = np.broadcast_to(np.eye(2) * 1e-4, (1, 2, 3, 2, 2))
    found = conflict_probability(robot=robot, mean=mean, cov=cov, radius_m=0.9)
    assert found == pytest.approx(1.0)
