"""Floor and price of stationary noise, against dense algebra and the compiled filter."""

from dataclasses import replace

import numpy as np
import pytest
import shaped_noise

from isac_track.kalman import Batch, spectra
from isac_track.kalman.slow_errors import SlowError, filter_tracks
from isac_track.kalman.spectra import World, matern_density, predicted_rms_m
from isac_track.mechanisms.shaped import OPTIMA, Shaped

# Samples as far apart as the robot averages them, and as they are sensed.
EVEN = World(dt_s=0.2, step_s=0.2, seen_s=30.0, raw_m=0.3)
OU = matern_density(std_m=0.6, theta_s=5.0, order=1.0)


def test_matern_spectra_are_ornstein_uhlenbeck_and_gaussian_at_the_ends():
    frequency = spectra.frequencies()
    expected = 2.0 * 0.6**2 * 5.0 / (1.0 + (5.0 * frequency) ** 2)
    assert pytest.approx(expected) == OU
    smooth = matern_density(std_m=0.6, theta_s=5.0, order=1e6)
    gaussian = np.exp(-np.square(5.0 * frequency))
    assert smooth / smooth[0] == pytest.approx(gaussian, abs=1e-4)
    for order in (1.0, 2.5, spectra.SMOOTH_ORDER):
        density = matern_density(std_m=0.6, theta_s=5.0, order=order)
        assert spectra.std_of_density(density) == pytest.approx(0.6, rel=2e-3)


def dense_posterior(*, world):
    """Instants of a long walk, and the covariance of its smoothed positions."""
    t = np.arange(-50.0, 50.01, world.dt_s)
    early = np.minimum(t[:, None], t) + 50.0
    late = np.maximum(t[:, None], t) + 50.0
    walk = 1e4 + 1e2 * np.outer(t + 50.0, t + 50.0)
    walk += world.q * early**2 * (3.0 * late - early) / 6.0
    noise = 0.6**2 * np.exp(-np.abs(t[:, None] - t) / 5.0)
    noise = (noise + world.raw_m**2 * np.eye(t.size)) / world.releases
    return t, walk - walk @ np.linalg.solve(walk + noise, walk)


def test_a_smoothers_error_is_that_of_dense_algebra_with_an_anchor_and_without():
    world = replace(EVEN, releases=3)
    plain, anchored = spectra.smoothed_rms_m(OU, world=world)
    t, posterior = dense_posterior(world=world)
    start, lags = int(np.argmin(np.abs(t + 15.0))), np.arange(151)
    variance, between = posterior[start, start], posterior[start, start + lags]
    assert plain**2 == pytest.approx(variance, rel=0.01)
    left = variance - between**2 / (posterior[start + lags, start + lags] + 1e-4)
    lag_s = lags * world.dt_s
    chance = 2.0 * (30.0 - lag_s) / 30.0**2
    assert anchored**2 == pytest.approx(np.trapezoid(chance * left, lag_s), rel=0.02)
    alone, _ = spectra.smoothed_rms_m(OU, world=world, releases=1)
    assert alone > plain > anchored
    # The error of either axis is Gaussian: 1 - exp(-eps^2 / 2 V) within eps.
    shares = spectra.known_shares(OU, epsilon_m=0.3, world=world)
    assert shares[0] == pytest.approx(-np.expm1(-0.045 / variance), rel=0.01)
    inside = -np.expm1(-0.045 / left)
    assert shares[1] == pytest.approx(np.trapezoid(chance * inside, lag_s), rel=0.02)


def test_a_robots_error_is_that_of_the_compiled_filter():
    t = np.arange(0.0, 30.01, 0.2)
    batch = Batch(
        t,
        np.zeros((t.size, 2)),
        np.full(t.size, 0.3**2),
        np.array([0, t.size]),
        (100.0, 10.0),
    )
    cov = filter_tracks(batch, SlowError(0.6, 5.0), q=EVEN.q).last.cov[0]
    ahead = np.array([1.0, 3.0, 0.0])
    expected = ahead @ cov @ ahead + EVEN.q * 3.0**3 / 3.0
    assert predicted_rms_m(OU, world=EVEN) ** 2 == pytest.approx(expected, rel=2e-3)


def test_price_and_floor_grow_with_the_noise_and_are_concave_in_it():
    unit = shaped_noise.band_densities((0.0, 0.2, 0.6, 3.0))
    draw = np.random.default_rng(0)
    for _ in range(10):
        first, second = draw.exponential(1.0, (2, 3)) @ unit
        for measure in (predicted_rms_m, spectra.floor_m):
            low, high = measure(first) ** 2, measure(first + second) ** 2
            middle = measure(first + 0.5 * second) ** 2
            assert low <= high
            assert middle >= 0.5 * (low + high) - 1e-9


def test_the_optimum_of_the_table_is_that_of_the_search_and_beats_every_ou():
    floor, std_m, theta_s = OPTIMA[3]
    order = spectra.SMOOTH_ORDER
    best = shaped_noise.best_order(floor=floor, order=order)
    assert best.parameters[0] == pytest.approx(theta_s, rel=0.01)
    assert spectra.std_of_density(best.density) == pytest.approx(std_m, rel=0.002)
    ou = shaped_noise.best_order(floor=floor, order=1.0)
    assert best.robot_m < 0.96 * ou.robot_m
    shared = Shaped(floor)
    density = matern_density(
        std_m=shared.std_m, theta_s=0.5 * shared.tau_s, order=order
    )
    assert spectra.floor_m(density) == pytest.approx(floor, rel=0.005)
    between = Shaped(0.5)
    density = matern_density(
        std_m=between.std_m, theta_s=0.5 * between.tau_s, order=order
    )
    assert spectra.floor_m(density) == pytest.approx(0.5, rel=0.02)


def test_a_certificate_closes_at_the_optimum_and_not_above_it():
    edges, floor = (0.0, 0.3, 1.0, 4.0), 0.3
    smooth = shaped_noise.best_order(floor=floor, order=spectra.SMOOTH_ORDER)
    best = shaped_noise.best_bands(near=smooth, floor=floor, edges=edges)
    closed = shaped_noise.certify(
        floor=floor, edges=edges, best_m=best.robot_m, gap=0.01
    )
    assert closed.is_closed
    assert closed.bound_m == pytest.approx(0.99 * best.robot_m)
    unit = shaped_noise.band_densities(edges)
    draw = np.random.default_rng(0)
    for _ in range(60):  # Nothing that keeps the floor is below the bound.
        mixed = np.exp(draw.normal([0.0, -2.0, -4.0], 1.5)) @ unit
        density = spectra.scaled_to(mixed, floor=floor)
        assert predicted_rms_m(density) > closed.bound_m
    worse = shaped_noise.certify(
        floor=floor, edges=edges, best_m=1.05 * best.robot_m, gap=0.01, most_nodes=40
    )
    assert not worse.is_closed
    assert worse.bound_m < best.robot_m


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: World(q=0.0), "q must be positive"),
        (lambda: World(releases=0), "releases must be 1 or more"),
        (
            lambda: spectra.scaled_to(
                matern_density(std_m=1.0, theta_s=0.001, order=1.0), floor=1e5
            ),
            "no noise of this shape",
        ),
        (lambda: Shaped(1e-3), "floor_m must be 0, or"),
        (lambda: Shaped(1.0, reuse="never"), "reuse"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
