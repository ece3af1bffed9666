"""Mechanisms of the literature: laws, correlations and promises, against closed forms."""

import numpy as np
import pytest
from helpers.sensed import rng as draws
from helpers.sensed import sensed as sensed_walks
from scipy import integrate, optimize, stats

from isac_track.mechanisms.literature import (
    INFORMATION_AREA,
    Fourier,
    GpPrior,
    LeastInformation,
    Qclm,
    Remap,
)
from isac_track.types import Sensed

SLOW = [Qclm, GpPrior, Fourier, LeastInformation]
STD_M = 1.3


def same_instants(instants, *, n_walks=700):
    """Walks that stand at the origin, sensed without an error at the same instants."""
    n = n_walks * instants.size
    return Sensed(
        t=np.tile(instants, n_walks),
        xy=np.zeros((n, 2)),
        unit_error=np.zeros((n, 2)),
        sigma_raw=np.full(n, 0.1),
        information=np.ones(n),
        fid=np.ones(n),
        offsets=np.arange(n_walks + 1) * instants.size,
        law="isotropic",
    )


def gaussian_correlation(lag_s):
    return np.exp(-np.square(lag_s / 7.0))


def information_density(frequency):
    return 2.0 / (1.0 + np.sqrt(1.0 + 4.0 * frequency**4))


def information_correlation(lag_s, corner_per_s):
    value, _ = integrate.quad(
        information_density, 0.0, np.inf, weight="cos", wvar=corner_per_s * lag_s
    )
    return value / INFORMATION_AREA


def added(mechanism, instants):
    release = mechanism.share(same_instants(instants), draws())
    return release.xy.reshape(-1, instants.size, 2).transpose(0, 2, 1)


@pytest.mark.parametrize(("make", "kurtosis"), [(Qclm, 6.0), (GpPrior, 3.0)])
def test_a_walks_correlation_is_that_of_the_noise(make, kurtosis):
    instants = np.array([-20.0, 0.0, 0.08, 1.0, 5.0, 9.0])
    errors = added(make(STD_M), instants).reshape(-1, instants.size) / STD_M
    expected = gaussian_correlation(instants[:, None] - instants)
    # The squares of unit variables vary by their kurtosis; products no more.
    room = 5.0 * np.sqrt(kurtosis / len(errors))
    assert np.abs(errors.T @ errors / len(errors) - expected).max() < room
    law = stats.laplace(scale=np.sqrt(0.5)) if make is Qclm else stats.norm
    assert stats.kstest(errors[:, 0], law.cdf).pvalue > 1e-4


def test_least_informative_noise_has_its_spectrum():
    """Against the integral of S_n, the root of S_n (S_n + S_x) = level S_x."""
    mechanism = LeastInformation(STD_M)
    corner = mechanism.corner_per_s
    level = mechanism.q / corner**4
    area, _ = integrate.quad(information_density, 0.0, np.inf)
    assert area == pytest.approx(INFORMATION_AREA, rel=1e-8)
    assert level * corner * area / np.pi == pytest.approx(STD_M**2)
    for frequency in (0.1, 0.7, 5.0):
        walk = mechanism.q / frequency**4
        noise = level * information_density(frequency / corner)
        assert noise * (noise + walk) == pytest.approx(level * walk)
    instants = np.array([0.0, 0.5, 2.0, 6.0])
    errors = added(mechanism, instants).reshape(-1, instants.size) / STD_M
    got = errors.T @ errors / len(errors)
    expected = [information_correlation(lag, corner) for lag in instants]
    assert got[0] == pytest.approx(expected, abs=5.0 * np.sqrt(2.0 / len(errors)))
    assert information_correlation(mechanism.tau_s, corner) == pytest.approx(
        np.exp(-1.0), rel=1e-6
    )


def test_no_noise_of_its_variance_tells_less():
    """The rate over a grid of frequencies, minimised numerically, is no lower."""
    mechanism = LeastInformation(STD_M)
    frequency = np.linspace(0.02, 6.0, 60)
    walk = mechanism.q / frequency**4
    ours = information_density(frequency / mechanism.corner_per_s)
    ours *= STD_M**2 / ours.sum()

    def rate(log_noise):
        noise = np.exp(log_noise)
        noise *= STD_M**2 / noise.sum()
        return np.log1p(walk / noise).sum()

    # On a grid the level differs from that of the integral: solve it anew.
    def excess(level):
        return spectrum(level).sum() - STD_M**2

    def spectrum(level):
        return 0.5 * (np.sqrt(walk**2 + 4.0 * level * walk) - walk)

    level = optimize.brentq(excess, 1e-9, 1e3)
    best = rate(np.log(spectrum(level)))
    for start in (np.zeros(60), np.log(ours), -np.log(frequency)):
        searched = optimize.minimize(rate, start, method="L-BFGS-B")
        assert searched.fun >= best - 1e-6
        assert searched.fun == pytest.approx(best, rel=1e-3)


def renyi_loss(prior, noise, moment, *, apart_m, order):
    """Renyi divergence of a release given two places at a moment, by dense algebra."""
    along = prior[:, moment] / prior[moment, moment]
    rest = prior - np.outer(along, prior[:, moment])
    gap = apart_m * along
    return 0.5 * order * gap @ np.linalg.solve(rest + noise, gap)


def test_noise_like_the_prior_gives_away_no_more_than_a_single_report():
    instants = np.linspace(0.0, 12.0, 25)
    shape = gaussian_correlation(instants[:, None] - instants)
    mechanism = GpPrior(STD_M)
    wanted = mechanism.loss(apart_m=2.0, order=3.0)
    for prior_std_m in (0.5, 4.0, 30.0):
        prior = prior_std_m**2 * shape
        losses = [
            renyi_loss(prior, STD_M**2 * shape, moment, apart_m=2.0, order=3.0)
            for moment in (0, 12, 24)
        ]
        assert losses == pytest.approx([wanted] * 3, rel=1e-4)
        white = STD_M**2 * np.eye(instants.size)
        assert renyi_loss(prior, white, 12, apart_m=2.0, order=3.0) > 5.0 * wanted


def test_no_noise_with_the_loss_of_gp_prior_has_less_variance():
    instants = np.array([0.0, 2.0, 5.0, 9.0])
    prior = 9.0 * gaussian_correlation(instants[:, None] - instants)
    limit = GpPrior(STD_M).loss(apart_m=1.0)
    rows = np.tril_indices(4)

    def noise(values):
        half = np.zeros((4, 4))
        half[rows] = values
        return half @ half.T

    def rooms(values):
        return [
            limit - renyi_loss(prior, noise(values), moment, apart_m=1.0, order=2.0)
            for moment in range(4)
        ]

    for start in (np.eye(4), 2.0 * np.tril(np.ones((4, 4)))):
        searched = optimize.minimize(
            lambda values: np.sum(np.square(values)),
            start[rows],
            constraints={"type": "ineq", "fun": rooms},
            options={"maxiter": 300},
        )
        assert min(rooms(searched.x)) > -1e-6
        assert searched.fun == pytest.approx(4.0 * STD_M**2, rel=1e-3)


def test_fourier_scales_have_the_least_variance_for_their_promise():
    mechanism = Fourier(STD_M, coefficients=3)
    cost = np.array([1.0, 2.0, 2.0, 2.0]) * mechanism.shift

    def promise(log_scale):
        return np.sum(cost / np.exp(log_scale))

    def variance(log_scale):
        return 2.0 * np.exp(2.0 * log_scale) @ np.array([1.0, 2.0, 2.0, 2.0])

    wanted = promise(np.log(mechanism.scale_m))
    searched = optimize.minimize(
        variance,
        np.zeros(4),
        constraints={"type": "eq", "fun": lambda log: promise(log) - wanted},
    )
    assert searched.fun == pytest.approx(STD_M**2, rel=1e-5)
    assert np.exp(searched.x) == pytest.approx(mechanism.scale_m, rel=1e-2)


def test_a_shift_changes_the_coefficients_by_no_more_than_epsilon():
    """The largest log ratio of the Laplace densities, by numerical projection."""
    mechanism = Fourier(STD_M)
    t = np.linspace(-30.0, 30.0, 6001)[:-1]
    ratios = []
    for moment in (0.0, 3.7, 11.0):
        lag = (t - moment + 30.0) % 60.0 - 30.0
        shift = gaussian_correlation(lag)
        total = abs(shift.mean()) / mechanism.scale_m[0]
        for k, scale in enumerate(mechanism.scale_m[1:], start=1):
            turn = 2.0 * np.pi * k * t / 60.0
            pair = np.mean(shift * np.cos(turn)), np.mean(shift * np.sin(turn))
            total += np.sqrt(2.0) * np.abs(pair).sum() / scale
        ratios.append(total)
    assert max(ratios) <= mechanism.epsilon_per_m * (1.0 + 1e-6)
    assert max(ratios) > 0.7 * mechanism.epsilon_per_m


def test_fourier_noise_is_laplace_in_its_coefficients_and_steady_in_time():
    instants = np.linspace(0.0, 60.0, 49)[:-1]
    mechanism = Fourier(STD_M)
    errors = added(mechanism, instants).reshape(-1, instants.size)
    room = 5.0 * np.sqrt(6.0 / len(errors))
    assert np.mean(errors**2, axis=0) / STD_M**2 == pytest.approx(1.0, abs=room)
    third = errors @ np.cos(2.0 * np.pi * 3.0 * instants / 60.0)
    third *= np.sqrt(2.0) / instants.size
    law = stats.laplace(scale=mechanism.scale_m[3])
    assert stats.kstest(third, law.cdf).pvalue > 1e-4
    at_tau = np.mean(errors[:, 0] * added_at(mechanism, mechanism.tau_s))
    assert at_tau / STD_M**2 == pytest.approx(np.exp(-1.0), abs=room)


def added_at(mechanism, instant):
    return added(mechanism, np.array([instant, 60.0])).reshape(-1, 2)[:, 0]


@pytest.mark.parametrize("make", SLOW)
def test_reuse_decides_whether_a_second_release_has_the_same_error(make):
    sensed = sensed_walks(sizes=(30, 1, 50), law="isotropic")
    for reuse in ("release", "session"):
        mechanism = make(2.0, reuse=reuse)
        first, second = (
            mechanism.share(sensed, np.random.default_rng(seed)).xy for seed in (0, 1)
        )
        assert np.array_equal(first, second) == (reuse == "session")


@pytest.mark.parametrize("make", [Qclm, GpPrior, LeastInformation])
def test_an_instant_has_one_error_in_every_window(make):
    """Blocks of a path meet without a jump, and depend on no other instant."""
    t = np.arange(0.0, 200.0, 0.5)
    whole, part = same_instants(t, n_walks=2), same_instants(t[150:], n_walks=2)
    mechanism = make(2.0, reuse="session")
    path = mechanism.share(whole, draws()).xy.reshape(2, t.size, 2)
    assert np.array_equal(
        path[:, 150:], mechanism.share(part, draws()).xy.reshape(2, -1, 2)
    )
    jumps = np.abs(np.diff(path, axis=1))
    assert jumps.max() < 6.0 * jumps.mean() * (3.0 if make is Qclm else 1.0)


def test_a_remap_is_the_best_linear_estimate_from_the_reports_so_far():
    """Against the posterior mean of the joint Gaussian density, by dense algebra."""
    sensed = sensed_walks(sizes=(12,), law="isotropic", sigma_raw=0.4)
    mechanism = Remap(0.8)
    release = mechanism.share(sensed, draws())
    reports = Remap(0.8, q=1e9).share(sensed, draws())  # Any motion: no prior left.
    t = sensed.t - sensed.t[0]
    early = np.minimum(t[:, None], t)
    late = np.maximum(t[:, None], t)
    walk = 100.0**2 + 100.0 * np.outer(t, t)
    walk += mechanism.q * early**2 * (3.0 * late - early) / 6.0
    noise = (0.8**2 + 0.4**2) * np.eye(t.size)
    first = reports.xy[0]
    for last in (3, 11):
        known = slice(0, last + 1)
        gain = np.linalg.solve((walk + noise)[known, known], walk[known, last])
        wanted = first + gain @ (reports.xy[known] - first)
        assert release.xy[last] == pytest.approx(wanted, abs=2e-3)
    assert mechanism.epsilon_per_m == pytest.approx(np.sqrt(3.0) / 0.8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Qclm(-1.0), "std_m"),
        (lambda: GpPrior(1.0, tau_s=0.0), "tau_s must be positive"),
        (lambda: GpPrior(1.0, reuse="never"), "reuse"),
        (lambda: Fourier(1.0, coefficients=0), "coefficients must be 1 or more"),
        (lambda: Fourier(1.0, coefficients=10**9), "coefficients must be 10000"),
        (lambda: Fourier(1.0, period_s=-1.0), "period_s"),
        (lambda: LeastInformation(1.0, q=0.0), "q must be positive"),
        (lambda: Remap(float("nan")), "std_m"),
    ],
)
def test_wrong_parameters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("make", [*SLOW, Remap])
def test_no_level_adds_nothing_and_promises_nothing(make):
    sensed = sensed_walks(sizes=(1, 2), law="isotropic")
    release = make(0.0).share(sensed, draws())
    assert np.isfinite(release.xy).all()
    assert make is Remap or np.array_equal(release.xy, sensed.xy)
    if hasattr(make, "epsilon_per_m"):
        assert make(0.0).epsilon_per_m == np.inf
