"""Smoothers under several motions: against dense Gaussians of the same covariances."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.kalman_cases import Q, batch
from scipy.special import softmax
from scipy.stats import multivariate_normal

from isac_track.kalman import smooth_positions
from isac_track.kalman.slow_errors import (
    Motions,
    SlowError,
    filter_tracks,
    motion_log_likelihoods,
    smooth_mixture,
    smooth_tracks,
)

MOTIONS = Motions(np.array([0.02, 0.3, 0.1, 0.5]), np.array([0.5, np.inf, 6.0, 90.0]))
ERRORS = [SlowError(0.0, 0.0), SlowError(0.7, 2.0), SlowError(0.4, np.inf)]


def walk_covariance(t, q, tau_s, prior_std):
    """Covariance of positions with an Ornstein-Uhlenbeck velocity, or white noise."""
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    start = prior_std[0] ** 2
    if np.isinf(tau_s):
        driven = q * early**2 * (3 * late - early) / 6
        return start + prior_std[1] ** 2 * np.outer(t, t) + driven
    # Uhlenbeck and Ornstein 1930; the stationary variance of the velocity is q tau / 2.
    fall = np.exp(-t / tau_s)
    ends = fall[:, None] + fall - np.exp(-(late - early) / tau_s) - 1.0
    return start + q * tau_s / 2 * (2 * tau_s * early + tau_s**2 * ends)


def dense(case, error, motions):
    """Positions, (K, M, 2), variances, (K, M), and log densities, (N, K), by motion."""
    n_motions = len(motions)
    place = np.empty((n_motions, *case.xy.shape))
    spread = np.empty((n_motions, case.t.size))
    density = np.empty((len(case), n_motions))
    for row, (lo, hi) in enumerate(pairwise(case.offsets)):
        t, start = case.t[lo:hi] - case.t[lo], case.xy[lo]
        gap = np.abs(t[:, None] - t)
        correlation = np.exp(-gap / error.tau_s) if error.tau_s else np.eye(t.size)
        noise = error.std_m**2 * correlation + np.diag(case.variance[lo:hi])
        for k, (q, tau_s) in enumerate(zip(motions.q, motions.tau_s, strict=True)):
            walk = walk_covariance(t, q, tau_s, case.prior_std)
            gain = np.linalg.solve(walk + noise, walk).T
            place[k, lo:hi] = start + gain @ (case.xy[lo:hi] - start)
            spread[k, lo:hi] = np.diag(walk - gain @ walk)
            law = multivariate_normal(np.zeros(t.size), walk + noise)
            density[row, k] = law.logpdf((case.xy[lo:hi] - start).T).sum()
    return place, spread, density


def by_track(case, weight):
    return np.repeat(weight, np.diff(case.offsets), axis=0).T


@pytest.mark.parametrize("error", ERRORS, ids=str)
@pytest.mark.parametrize("vague", [False, True])
def test_likelihood_and_mixture_are_those_of_dense_gaussians(error, vague):
    case = batch(prior_std=(30.0, 5.0) if vague else (1.3, 0.8), seed=2)
    place, spread, density = dense(case, error, MOTIONS)
    log_density = motion_log_likelihoods(case, error, MOTIONS)
    np.testing.assert_allclose(log_density, density, atol=1e-6, rtol=0)
    weight = softmax(0.1 * density, axis=1)
    position, variance = smooth_mixture(case, error, MOTIONS, weight)
    share = by_track(case, weight)
    mean = (share[:, :, None] * place).sum(axis=0)
    within = (share * spread).sum(axis=0)
    between = (share * np.square(place - mean).mean(axis=2)).sum(axis=0)
    np.testing.assert_allclose(position, mean, atol=1e-6, rtol=0)
    np.testing.assert_allclose(variance, within + between, atol=1e-6, rtol=0)


@pytest.mark.parametrize("passes", [1, 4])
def test_a_single_motion_of_constant_velocity_is_the_usual_smoother(passes):
    case, error = batch(prior_std=(100.0, 10.0)), SlowError(0.0, 0.0)
    options = {"passes": passes, "anneal": 0.15}
    for row, q in enumerate((Q, 0.05)):
        weight = np.zeros((len(case), 2))
        weight[:, row] = 3.0
        motions = Motions(np.array([Q, 0.05]), np.full(2, np.inf))
        ours = smooth_mixture(case, error, motions, weight, **options)
        theirs = smooth_positions(case, q=q, **options)
        for actual, expected in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(actual, expected, atol=1e-8)
    last, _ = filter_tracks(case, ERRORS[1], q=Q)
    alone = motion_log_likelihoods(
        case, ERRORS[1], Motions(np.array([Q]), np.array([np.inf]))
    )
    np.testing.assert_allclose(alone[:, 0], last.log_likelihood, atol=1e-8)


def test_each_track_is_smoothed_by_its_own_motion():
    case, error = batch(prior_std=(3.0, 2.0)), ERRORS[1]
    motions = Motions(np.array([0.01, 0.1, 1.0]), np.full(3, np.inf))
    position, variance = smooth_mixture(
        case, error, motions, np.eye(3)[[0, 1, 2, 1]], passes=3
    )
    for row, q in enumerate((0.01, 0.1, 1.0, 0.1)):
        own = slice(*case.offsets[row : row + 2])
        alone = smooth_tracks(case, error, q=q, passes=3)
        np.testing.assert_array_equal(position[own], alone[0][own])
        np.testing.assert_array_equal(variance[own], alone[1][own])


@pytest.mark.parametrize("x", [1e-6, 1e-3, 0.0299, 0.0301, 0.3, 40.0])
def test_a_velocity_that_lasts_long_is_nearly_constant_and_steps_compose(x):
    """A step of x correlation times gives the same as ten steps of a tenth."""
    tau_s = 5.0
    motions = Motions(np.array([0.3]), np.array([tau_s]))
    ends = []
    for n in (1, 10):
        t = np.linspace(0.0, x * tau_s, n + 1)
        variance = np.full(n + 1, 1e9)  # Samples between carry no information.
        variance[[0, -1]] = 1e-3
        xy = np.zeros((n + 1, 2))
        xy[-1] = 0.3, -0.2
        case = type(batch())(t, xy, variance, np.array([0, n + 1]), (1.0, 1.0))
        position, spread = smooth_mixture(case, ERRORS[0], motions, np.ones((1, 1)))
        ends.append((*position[-1], spread[-1]))
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-6)


def test_speeds_and_times_are_q_and_tau():
    motions = Motions.with_speeds((0.3, 4.0), (1.0, 16.0))
    np.testing.assert_allclose(motions.q, [0.045, 0.125])
    assert len(motions) == 2
    np.testing.assert_allclose(motions.arrays((1.0, 9.0))[:, 0], [0.09, 1.0])


def test_what_cannot_be_is_named():
    for wrong in (
        ([0.1, 0.2], [1.0]),
        ([0.0], [1.0]),
        ([0.1], [-1.0]),
        ([np.inf], [1.0]),
    ):
        with pytest.raises(ValueError, match=r"as many|must be positive"):
            Motions(*map(np.array, wrong))
    case = batch()
    for weight in (np.ones((4, 3)), -np.ones((4, 4)), np.zeros((4, 4))):
        with pytest.raises(ValueError, match="weight"):
            smooth_mixture(case, ERRORS[0], MOTIONS, weight)
    with pytest.raises(ValueError, match="passes >= 1"):
        smooth_mixture(case, ERRORS[0], MOTIONS, np.ones((4, 4)), passes=0)
