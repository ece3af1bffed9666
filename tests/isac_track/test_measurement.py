"""Error ellipses of range and bearing against closed forms."""

import numpy as np
import pytest

from isac_track.measurement import (
    NEAREST_M,
    SPEED_OF_LIGHT_MPS,
    axis_variance,
    cross_range_ratio,
    range_bearing_covariance,
    range_variance,
    scalar_covariance,
)

STATION_M = (5.0, 30.0)


def covariance(xy, *, scaling, n_antennas=8, variance_m2=0.2):
    return range_bearing_covariance(
        xy=np.array(xy, dtype=float),
        station_m=STATION_M,
        variance_m2=np.full(len(xy), variance_m2),
        bandwidth_mhz=100.0,
        n_antennas=n_antennas,
        scaling=scaling,
    )


def test_the_ratio_follows_from_both_bounds():
    distance_m, n = np.array([10.0, 30.0]), 8
    # Cramer-Rao bounds at SNR 1, range: c / 2 times the delay, bearing: radians.
    delay_s = 1.0 / np.sqrt(8.0 * np.pi**2 * (100e6) ** 2 / 12.0)
    # Elements at half a wavelength: phases pi k sin(bearing), k around their middle.
    k = np.arange(n) - (n - 1) / 2.0
    bearing = 1.0 / np.sqrt(2.0 * np.pi**2 * (k**2).mean())
    expected = bearing * distance_m / (delay_s * SPEED_OF_LIGHT_MPS / 2.0)
    ratio = cross_range_ratio(distance_m=distance_m, bandwidth_mhz=100.0, n_antennas=n)
    np.testing.assert_allclose(ratio, expected)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0, 5.0, 10.0])
def test_both_scalings(ratio):
    variance = np.array([0.3])
    square = np.array([ratio]) ** 2
    along = range_variance(
        variance_m2=variance, ratio=np.array([ratio]), scaling="information"
    )
    mean_information = (1.0 / along + 1.0 / (along * square)) / 2.0
    np.testing.assert_allclose(mean_information, 1.0 / variance)
    # The mean squared error grows by (r + 1/r)^2 / 4.
    growth = (along + along * square) / (2.0 * variance)
    np.testing.assert_allclose(growth, ((ratio + 1.0 / ratio) / 2.0) ** 2)
    along = range_variance(
        variance_m2=variance, ratio=np.array([ratio]), scaling="trace"
    )
    np.testing.assert_allclose(along + along * square, 2.0 * variance)


@pytest.mark.parametrize("scaling", ["information", "trace"])
def test_the_long_axis_lies_across_the_line_of_sight(scaling):
    xy = [(5.0, 10.0), (25.0, 30.0), (0.0, 0.0)]
    cov = covariance(xy, scaling=scaling)
    values, vectors = np.linalg.eigh(cov)
    away = np.array(xy) - STATION_M
    distance_m = np.hypot(*away.T)
    ratio = cross_range_ratio(distance_m=distance_m, bandwidth_mhz=100.0, n_antennas=8)
    np.testing.assert_allclose(np.sqrt(values[:, 1] / values[:, 0]), ratio)
    along = np.einsum("na,na->n", vectors[:, :, 1], away) / distance_m
    np.testing.assert_allclose(along, 0.0, atol=1e-9)
    if scaling == "trace":
        np.testing.assert_allclose(np.trace(cov, axis1=1, axis2=2), 0.4)


def test_at_equal_axes_the_ellipse_is_the_scalar_error():
    n = 8
    distance_m = SPEED_OF_LIGHT_MPS * np.sqrt(n**2 - 1.0) / (4.0 * 100e6)
    for scaling in ("information", "trace"):
        cov = covariance([(5.0, 30.0 - distance_m)], scaling=scaling, n_antennas=n)
        np.testing.assert_allclose(cov, scalar_covariance(np.array([0.2])), atol=1e-12)


def test_at_the_station_the_ellipse_is_finite():
    cov = covariance([STATION_M], scaling="information")
    np.testing.assert_allclose(
        cov, covariance([(5.0 + NEAREST_M, 30.0)], scaling="information")
    )


def test_variance_per_axis():
    sigma = np.array([0.4])
    assert axis_variance(sigma_m=sigma, law="isotropic") == pytest.approx(0.16)
    assert axis_variance(sigma_m=sigma, law="radial") == pytest.approx(0.08)


def test_refuses_a_bearing_of_a_single_antenna_and_another_scaling():
    with pytest.raises(ValueError, match="2 antennas"):
        cross_range_ratio(distance_m=np.ones(1), bandwidth_mhz=1.0, n_antennas=1)
    with pytest.raises(ValueError, match="unknown scaling 'mean'"):
        range_variance(variance_m2=np.ones(1), ratio=np.ones(1), scaling="mean")
