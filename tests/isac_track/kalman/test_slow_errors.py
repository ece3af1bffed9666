"""Filter and smoother behind a slow error, against the model's dense posterior."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.kalman_cases import Q, batch
from scipy.stats import multivariate_normal

from isac_track.kalman import kalman_last, smooth_positions
from isac_track.kalman.slow_errors import (
    SlowError,
    added_error,
    filter_tracks,
    smooth_tracks,
)
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.noise import innovation_variance_m2
from isac_track.plugins import parse
from isac_track.rng import stream

ERRORS = [
    SlowError(0.7, 2.0),
    SlowError(0.3, 0.05),
    SlowError(1.5, np.inf),
    SlowError(0.5, 0.0),
]


LONG = 100
"""Samples above which scipy calls the matrix singular; the density is then ignored."""


def dense(case, error, *, q=Q):
    """Positions, variances and log densities of tracks, by a joint Gaussian of each."""
    position, spread, density = np.empty_like(case.xy), np.empty(case.t.size), []
    amplitude = np.broadcast_to(error.std_m, case.t.shape)
    for lo, hi in pairwise(case.offsets):
        t, s, start = case.t[lo:hi] - case.t[lo], amplitude[lo:hi], case.xy[lo]
        first, last = np.minimum.outer(t, t), np.maximum.outer(t, t)
        # Position of integrated Brownian motion, and of the prior at the first sample.
        walk = q * first**2 * (3 * last - first) / 6
        walk += case.prior_std[0] ** 2 + case.prior_std[1] ** 2 * np.outer(t, t)
        gap = last - first
        correlation = np.exp(-gap / error.tau_s) if error.tau_s else np.eye(t.size)
        seen = walk + np.outer(s, s) * correlation + np.diag(case.variance[lo:hi])
        gain = np.linalg.solve(seen, walk).T
        position[lo:hi] = start + gain @ (case.xy[lo:hi] - start)
        spread[lo:hi] = np.diag(walk - gain @ walk)
        law = multivariate_normal(np.zeros(t.size), seen, allow_singular=t.size > LONG)
        density.append(law.logpdf((case.xy[lo:hi] - start).T).sum())
    return position, spread, np.array(density)


@pytest.mark.parametrize("error", ERRORS, ids=str)
@pytest.mark.parametrize("vague", [False, True])
def test_both_are_the_dense_posterior(error, vague):
    case = batch(prior_std=(100.0, 10.0) if vague else (1.3, 0.8))
    position, spread, density = dense(case, error)
    smoothed, variance = smooth_tracks(case, error, q=Q)
    np.testing.assert_allclose(smoothed, position, atol=1e-6, rtol=0)
    np.testing.assert_allclose(variance, spread, atol=1e-6, rtol=0)
    last, causal = filter_tracks(case, error, q=Q)
    np.testing.assert_allclose(last.log_likelihood, density, atol=1e-6, rtol=0)
    ends = case.offsets[1:] - 1
    np.testing.assert_allclose(causal[ends], position[ends], atol=1e-6, rtol=0)
    np.testing.assert_allclose(last.mean[:, :, 0], position[ends], atol=1e-6, rtol=0)
    np.testing.assert_allclose(last.cov[:, 0, 0], spread[ends], atol=1e-6, rtol=0)


def test_a_long_walk_with_a_small_noise_is_the_dense_posterior_too():
    case = batch(
        sizes=(400,), step_s=(0.05, 0.12), variance=(1e-3, 0.02), prior_std=(10.0, 2.0)
    )
    for error in ERRORS:
        position, spread, _ = dense(case, error, q=0.057)
        smoothed, variance = smooth_tracks(case, error, q=0.057)
        np.testing.assert_allclose(smoothed, position, atol=1e-6, rtol=0)
        np.testing.assert_allclose(variance, spread, atol=1e-6, rtol=0)


def test_an_amplitude_for_every_sample_and_exact_places_among_them():
    case = batch(sizes=(30, 12), seed=4)
    amplitude = stream(0, "test", "amplitude").uniform(0.0, 1.5, case.t.size)
    amplitude[[7, 33]] = 0.0
    case.variance.flags.writeable = True
    case.variance[[7, 33]] = 1e-8  # a known place
    position, spread, _ = dense(case, error := SlowError(amplitude, 1.5))
    smoothed, variance = smooth_tracks(case, error, q=Q)
    np.testing.assert_allclose(smoothed, position, atol=1e-6, rtol=0)
    np.testing.assert_allclose(variance, spread, atol=1e-6, rtol=0)


def test_without_an_error_they_are_those_of_a_walk_alone():
    case, none = batch(prior_std=(100.0, 10.0)), SlowError(0.0, 5.0)
    last, _ = filter_tracks(case, none, q=Q, gate=9.0)
    wanted = kalman_last(case, q=Q, gate=9.0)
    np.testing.assert_allclose(last.mean[:, :, :2], wanted.mean, atol=1e-9)
    np.testing.assert_allclose(last.cov[:, :2, :2], wanted.cov, atol=1e-9)
    np.testing.assert_allclose(last.log_likelihood, wanted.log_likelihood, atol=1e-9)
    for passes in (1, 4):
        ours = smooth_tracks(case, none, q=Q, passes=passes, anneal=0.15)
        theirs = smooth_positions(case, q=Q, passes=passes, anneal=0.15)
        for actual, expected in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(actual, expected, atol=1e-9)


@pytest.mark.parametrize("tau_s", [0.0, 0.3, 5.0])
def test_innovations_take_their_share_of_a_slow_error_for_noise(tau_s):
    offsets = np.arange(0, 400 * 30 + 1, 30)
    rng = stream(0, "test", "share")
    t = rng.uniform(0.05, 0.12, offsets[-1]).cumsum()
    unit = rng.standard_normal((t.size, 2))
    if tau_s:
        unit = correlated_errors(
            t=t, offsets=offsets, law="isotropic", tau_s=tau_s, rng=rng
        )
    variance_m2 = innovation_variance_m2(t=t, xy=0.6 * unit, offsets=offsets).mean()
    share = SlowError(0.6, tau_s).innovation_share(t=t, offsets=offsets).mean()
    assert variance_m2 == pytest.approx(0.36 * share, rel=0.05)


@pytest.mark.parametrize(
    ("spec", "wanted"),
    [
        ("raw", (0.0, 0.0)),
        ("fixed:0.8,adding=independent,law=isotropic", (0.8, 0.0)),
        ("fixed:0.8", (0.8 * np.sqrt(0.5), 0.0)),
        ("fid:1", (0.75 * np.sqrt(0.5), 0.0)),
        ("correlated:0.8,tau_s=3", (0.8 * np.sqrt(0.5), 3.0)),
        ("offset:0.8", (0.8 * np.sqrt(0.5), np.inf)),
    ],
)
def test_what_a_mechanism_says_of_its_error(spec, wanted):
    assert added_error(parse("mechanisms", spec)[0].instance) == pytest.approx(wanted)


@pytest.mark.parametrize(
    "wrong", [(-0.1, 5.0), (np.nan, 5.0), (1.0, -1.0), (1.0, np.nan)]
)
def test_errors_that_cannot_be_are_named(wrong):
    with pytest.raises(ValueError, match="must"):
        SlowError(*wrong)


def test_settings_that_cannot_be_are_named():
    for wrong in ({"q": 0.0}, {"q": Q, "gate": np.nan}):
        with pytest.raises(ValueError, match="must be positive"):
            filter_tracks(batch(), ERRORS[0], **wrong)
    with pytest.raises(ValueError, match="passes >= 1"):
        smooth_tracks(batch(), ERRORS[0], q=Q, passes=0)
