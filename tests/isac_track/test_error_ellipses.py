"""Errors with a shape: sensing, adding rules and mechanisms against closed forms."""

from dataclasses import replace
from pkgutil import resolve_name
from typing import get_args

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from isac_track import plugins
from isac_track.config import SensingSettings
from isac_track.kalman import Batch
from isac_track.measurement import (
    SPEED_OF_LIGHT_MPS,
    covariance_after,
    cross_range_ratio,
    error_ellipses,
    least_share,
    mass_within,
    principal_axes,
    round_errors,
    scalar_covariance,
    share_within,
    square_roots,
)
from isac_track.mechanisms.controls import Correlated, Offset, Thin
from isac_track.mechanisms.paper import Clean, Fid, Fixed, Raw, fid_d_sigma
from isac_track.mechanisms.protections import Forecast, Laplace, Ou
from isac_track.mechanisms.withholding import Window
from isac_track.sensing import draw_channel, sense
from isac_track.types import ErrorLaw
from predictors.filterpy_engine import planar_states

SCALAR = SensingSettings()
N_SAMPLES = 4000
LAWS = get_args(ErrorLaw)


def sensed(settings, *, away_m=25.0, n_samples=N_SAMPLES):
    """A person who stays at a distance of the station, south-west of it."""
    side_m = away_m / np.sqrt(2.0)
    station_m = np.array([settings.bs_x_m, settings.bs_y_m])
    xy = np.tile(station_m - side_m, (n_samples, 1))
    channel = draw_channel(
        walked_m=np.zeros(n_samples),
        n_samples=np.array([[n_samples]]),
        keys=[("ellipse",)],
        settings=settings,
        seed=3,
    )
    return sense(
        t=0.1 * np.arange(n_samples),
        xy=xy,
        offsets=np.array([0, n_samples]),
        channel=channel,
        settings=settings,
    )


def shaped(**changes):
    return replace(SCALAR, measurement="range_bearing", **changes)


def raw_errors(batch):
    return batch.sigma_raw[:, None] * batch.unit_error


def along_and_across(vectors):
    """Components along the line of sight and across it, of `sensed`."""
    return vectors @ (np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0))


@pytest.fixture(scope="module")
def ellipse():
    return sensed(shaped(law="isotropic"))


@pytest.mark.parametrize("scaling", ["trace", "information"])
@pytest.mark.parametrize("law", LAWS)
def test_at_equal_axes_everything_is_that_of_the_scalar_error(law, scaling):
    ratio = cross_range_ratio(
        distance_m=np.ones(1), bandwidth_mhz=100.0, n_antennas=8
    ).item()
    scalar = sensed(replace(SCALAR, law=law), away_m=1.0 / ratio, n_samples=50)
    equal = sensed(shaped(law=law, scaling=scaling), away_m=1.0 / ratio, n_samples=50)
    for name in ("xy", "unit_error", "sigma_raw", "information", "fid"):
        np.testing.assert_allclose(
            getattr(equal, name), getattr(scalar, name), rtol=1e-9, atol=1e-12
        )
    for mechanism in (Fixed(0.4), Fixed(0.4, adding="independent"), Fid(5.0)):
        expected, got = (
            mechanism.share(batch, np.random.default_rng(2))
            for batch in (scalar, equal)
        )
        np.testing.assert_allclose(got.xy, expected.xy, atol=1e-12)
        np.testing.assert_allclose(got.sigma, expected.sigma)
        assert expected.cov is None


def test_at_equal_trace_only_the_shape_differs(ellipse):
    scalar = sensed(replace(SCALAR, law="isotropic"))
    np.testing.assert_allclose(ellipse.sigma_raw, scalar.sigma_raw)
    ratio = 4.0 * 100e6 * 25.0 / (SPEED_OF_LIGHT_MPS * np.sqrt(63.0))
    growth = ((ratio + 1.0 / ratio) / 2.0) ** 2
    np.testing.assert_allclose(ellipse.information, growth * scalar.information)
    error = along_and_across(raw_errors(ellipse)) / scalar.sigma_raw[:, None]
    # Six standard errors of a mean square.
    tolerance = 6.0 * np.sqrt(2.0 / N_SAMPLES)
    along = 2.0 / (1.0 + ratio**2)
    assert (error[:, 0] ** 2).mean() == pytest.approx(along, rel=tolerance)
    assert (error[:, 1] ** 2).mean() == pytest.approx(along * ratio**2, rel=tolerance)
    assert abs(np.corrcoef(error.T)[0, 1]) < 6.0 / np.sqrt(N_SAMPLES)
    assert (error**2).sum(axis=1).mean() == pytest.approx(2.0, rel=tolerance)


@pytest.mark.parametrize("law", LAWS)
def test_at_equal_information_the_error_grows_by_the_ratio(law):
    scalar = sensed(replace(SCALAR, law=law), n_samples=20)
    wide = sensed(shaped(law=law, scaling="information", n_antennas=3), n_samples=20)
    ratio = 4.0 * 100e6 * 25.0 / (SPEED_OF_LIGHT_MPS * np.sqrt(8.0))
    np.testing.assert_allclose(wide.information, scalar.information)
    np.testing.assert_allclose(wide.fid, scalar.fid)
    np.testing.assert_allclose(
        wide.sigma_raw, scalar.sigma_raw * (ratio + 1.0 / ratio) / 2.0
    )


@pytest.mark.parametrize("law", LAWS)
def test_linear_adding_lengthens_both_axes_by_the_same(law):
    raw = sensed(shaped(law=law), n_samples=30)
    share = 1.0 if law == "isotropic" else 0.5
    release = Fixed(0.4).share(raw, np.random.default_rng(1))
    before, axes = np.linalg.eigh(raw.cov)
    after = np.einsum("mai,mab,mbj->mij", axes, release.cov, axes)
    grown = np.sqrt(before) + np.sqrt(share) * 0.4
    np.testing.assert_allclose(
        after, grown[:, :, None] ** 2 * np.eye(2), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        share * release.sigma**2, (grown**2).mean(axis=1), rtol=1e-9
    )
    # The standardised error is that of the sensors.
    truth = raw.xy - raw_errors(raw)
    np.testing.assert_allclose(
        round_errors(cov=release.cov, error=release.xy - truth),
        round_errors(cov=raw.cov, error=raw_errors(raw)),
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("mechanism", "std_m"),
    [
        (Fixed(0.3, adding="independent"), 0.3),
        (Fixed(0.3, adding="independent", law="radial"), np.sqrt(0.5) * 0.3),
        (Ou(0.3, tau_s=0.01), 0.3),
        (Laplace(0.3), 0.3),
        (Correlated(0.3, tau_s=0.01, adding="independent"), 0.3),
    ],
)
def test_an_independent_error_is_round(ellipse, mechanism, std_m):
    release = mechanism.share(ellipse, np.random.default_rng(4))
    np.testing.assert_allclose(
        release.cov - ellipse.cov, np.eye(2) * std_m**2 + 0 * ellipse.cov
    )
    added = along_and_across(release.xy - ellipse.xy)
    tolerance = 8.0 * np.sqrt(5.0 / N_SAMPLES)  # a Laplace error has a kurtosis of 6
    np.testing.assert_allclose((added**2).mean(axis=0), std_m**2, rtol=tolerance)


ISOTROPIC = [
    name
    for name, origin in plugins.names("mechanisms").items()
    if name != "forecast" and getattr(resolve_name(origin), "law", None) == "isotropic"
]


@pytest.mark.parametrize("name", ISOTROPIC)
def test_added_noise_has_a_law_of_its_own(name):
    """Behind radial errors, too, it is N(0, std) on either axis."""
    raw = sensed(shaped(), n_samples=60)
    (plugin,) = plugins.parse("mechanisms", f"{name}:0.5")
    release = plugin.instance.share(raw, np.random.default_rng(4))
    added = release.sigma**2 - raw.sigma_raw**2
    np.testing.assert_allclose(
        release.cov - raw.cov, added[:, None, None] * np.eye(2), atol=1e-9
    )
    assert added.max() > 0.01


def test_correlated_errors_have_the_declared_shape(ellipse):
    release = Correlated(0.3, tau_s=0.01).share(ellipse, np.random.default_rng(4))
    truth = ellipse.xy - raw_errors(ellipse)
    unit = round_errors(cov=release.cov, error=release.xy - truth)
    np.testing.assert_allclose(
        np.cov(unit.T), np.eye(2), atol=8.0 * np.sqrt(2.0 / N_SAMPLES)
    )


def test_mechanisms_without_an_error_of_their_own(ellipse):
    rng = np.random.default_rng(0)
    assert np.array_equal(Raw().share(ellipse, rng).cov, ellipse.cov)
    assert np.array_equal(Offset(1.0).share(ellipse, rng).cov, ellipse.cov)
    assert not Clean().share(ellipse, rng).cov.any()
    thin = Thin(4).share(ellipse, rng)
    assert np.array_equal(thin.cov, ellipse.cov[3::4])
    window = Window(1.05).share(ellipse, rng)
    assert np.array_equal(window.cov, ellipse.cov[-11:])


def test_a_forecast_filters_with_the_shape():
    first = sensed(shaped(law="isotropic"), n_samples=25)
    release = Forecast(0.2, every_s=1.0).share(first, np.random.default_rng(0))
    whole = Batch(
        t=first.t,
        xy=first.xy,
        variance=np.trace(first.cov, axis1=1, axis2=2) / 2.0,
        offsets=first.offsets,
        prior_std=(100.0, 10.0),
    )
    whole = replace(whole, ellipse=first.cov / whole.variance[:, None, None])
    state = planar_states(whole, q=Forecast(0.2).q, gate=np.inf)
    expected = state.cov[0, :, 0, :, 0] + 0.04 * np.eye(2)
    np.testing.assert_allclose(release.cov[-1], expected, rtol=1e-6)
    assert release.sigma[-1] ** 2 == pytest.approx(np.trace(expected) / 2.0, rel=1e-6)


def test_fid_holds_the_mean_or_the_least_information_against_its_threshold(ellipse):
    eigenvalues = np.linalg.eigvalsh(np.linalg.inv(ellipse.cov))
    share = eigenvalues[:, 0] / eigenvalues.mean(axis=1)
    np.testing.assert_allclose(least_share(ellipse.cov), share)
    np.testing.assert_allclose(
        ellipse.information / eigenvalues.mean(axis=1),
        (ellipse.information / eigenvalues.mean(axis=1))[0],
    )
    eta = float(np.median(ellipse.fid))
    for information, scale in (("trace", 1.0), ("least", share)):
        rule = Fid(eta, adding="independent", information=information)
        release = rule.share(ellipse, np.random.default_rng(0))
        added = fid_d_sigma(fid=ellipse.fid * scale, eta=eta, alpha_m=0.5, beta=1.5)
        np.testing.assert_allclose(release.sigma, np.hypot(ellipse.sigma_raw, added))
    scalar = sensed(SCALAR, n_samples=40)
    trace, least = (
        Fid(5.0, information=name).share(scalar, np.random.default_rng(0))
        for name in ("trace", "least")
    )
    assert np.array_equal(trace.xy, least.xy)
    with pytest.raises(ValueError, match="information must be trace or least"):
        Fid(1.0, information="most")


def test_square_roots_and_ellipses():
    rng = np.random.default_rng(7)
    factor = rng.normal(size=(50, 2, 2)) * 10.0 ** rng.uniform(-3, 3, (50, 1, 1))
    cov = factor @ np.swapaxes(factor, 1, 2)
    root = square_roots(cov)
    np.testing.assert_allclose(root @ root, cov, rtol=1e-6)
    np.testing.assert_allclose(root, np.swapaxes(root, 1, 2))
    np.testing.assert_allclose(np.trace(error_ellipses(cov), axis1=1, axis2=2), 2.0)
    axes, variances = principal_axes(cov)
    np.testing.assert_allclose(
        axes * variances[:, None, :] @ np.swapaxes(axes, 1, 2), cov, rtol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_allclose(variances[:, ::-1], np.linalg.eigvalsh(cov), rtol=1e-6)
    nothing = np.zeros((1, 2, 2))
    assert not principal_axes(nothing)[1].any()
    assert not square_roots(nothing).any()
    assert np.array_equal(error_ellipses(nothing)[0], np.eye(2))
    flat = np.linalg.eigvalsh(error_ellipses(np.ones((1, 2, 2))))
    assert flat[0] == pytest.approx([1e-9, 2.0])
    assert least_share(nothing).tolist() == [1.0]
    assert not round_errors(cov=nothing, error=np.zeros((1, 2))).any()


@pytest.mark.parametrize("ratio", [1.0, 3.0, 10.0])
def test_how_much_of_a_normal_law_lies_within_a_circle(ratio):
    """Against the integral over one axis, with the other in closed form."""
    long_m, short_m, epsilon_m = 0.4, 0.4 / ratio, 0.3

    def density(x_m):
        rest_m = np.sqrt(max(epsilon_m**2 - x_m**2, 0.0))
        inside = 1.0 - 2.0 * stats.norm.sf(rest_m / short_m)
        return stats.norm.pdf(x_m, scale=long_m) * inside

    expected = 2.0 * quad(density, 0.0, epsilon_m)[0]
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cov = turn * np.square([long_m, short_m]) @ turn.T
    assert share_within(cov[None], epsilon_m=epsilon_m) == pytest.approx(
        expected, abs=1e-6
    )


@pytest.mark.parametrize("std_m", [0.001, 0.05, 0.3, 4.0])
@pytest.mark.parametrize("ratio", [1.0, 20.0])
def test_the_mass_in_a_disc_is_that_of_an_integral(std_m, ratio):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cov = turn * np.square([std_m, std_m / ratio]) @ turn.T
    away = std_m * np.array([[0.0, 0.0], [0.7, -0.4], [3.0, 1.0]]) + [0.0, 0.28]
    got = mass_within(away, cov[None], radius_m=0.3)
    if ratio == 1.0:  # Noncentral chi-square.
        exact = stats.ncx2.cdf((0.3 / std_m) ** 2, 2, (away**2).sum(axis=1) / std_m**2)
        np.testing.assert_allclose(got, exact, rtol=0, atol=1e-10)
        return
    own = away @ turn

    def strip(y, x0, y0):
        half = np.sqrt(max(0.09 - y**2, 0.0))
        long = stats.norm.cdf([x0 - half, x0 + half], scale=std_m)
        return (long[1] - long[0]) * stats.norm.pdf(y, y0, std_m / ratio)

    for mass, (x0, y0) in zip(got, own, strict=True):
        reach = 9.0 * std_m / ratio
        low, high = max(-0.3, y0 - reach), min(0.3, y0 + reach)
        exact = quad(strip, low, high, (x0, y0), limit=200)[0] if low < high else 0.0
        assert mass == pytest.approx(exact, abs=1e-9)


def test_a_mechanism_without_a_declared_shape_adds_a_round_error(ellipse):
    first = slice(0, 3)
    sigma_m = ellipse.sigma_raw[first] * np.array([1.0, 2.0, 0.5])
    cov = covariance_after(
        raw=ellipse.cov[first],
        raw_sigma_m=ellipse.sigma_raw[first],
        sigma_m=sigma_m,
        law="isotropic",
    )
    added = scalar_covariance(3.0 * ellipse.sigma_raw[1:2] ** 2)
    np.testing.assert_allclose(cov[0], ellipse.cov[0])
    np.testing.assert_allclose(cov[1], ellipse.cov[1] + added[0])
    np.testing.assert_allclose(cov[2], 0.25 * ellipse.cov[2])
