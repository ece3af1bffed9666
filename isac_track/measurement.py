"""Covariance of a position measured by range and bearing, beside the scalar error.

The scalar error of the suite has the same variance on both axes. A radar measures the
range by its bandwidth and the bearing by its array, so that the error is an ellipse
that points to the station.
"""

from importlib import import_module
from typing import Final

import numpy as np

from isac_track.config import Scaling, SensingSettings
from isac_track.types import ErrorLaw, Floats

NEAREST_M: Final = 1.0
"""reading: reference distance of the path loss, below which the model does not hold.

The far field of an antenna of some wavelengths (9 cm each) begins there, and nobody
walks through its mast.
"""
SPEED_OF_LIGHT_MPS: Final = 299_792_458.0
_LEAST_ANTENNAS: Final = 2
_ANGLES: Final = 64
_NODES: Final = 48
_REACH: Final = 8.5  # Standard deviations; nothing lies beyond.
_LEAST_SHARE: Final = 1e-9  # Variance along a flat axis, of the mean variance.


def axis_share(law: ErrorLaw) -> float:
    """Return the variance per axis of an error of standard deviation 1."""
    return 1.0 if law == "isotropic" else 0.5


def axis_variance(*, sigma_m: Floats, law: ErrorLaw) -> Floats:
    """Return the variance per axis of an error law, (M,) m -> (M,) m^2."""
    return np.asarray(sigma_m**2 * axis_share(law))


def cross_range_ratio(
    *, distance_m: Floats, bandwidth_mhz: float, n_antennas: int
) -> Floats:
    """Return the ratio of cross-range to range standard deviation, (M,).

    At equal SNR the information on the range is ``8 pi^2 (B^2 / 12) (2 / c)^2`` and on
    the bearing of a uniform linear array at half a wavelength ``2 pi^2 (n^2 - 1) / 12``
    (Kay, *Estimation Theory*, 1993, examples 3.13 and 3.15). The array faces the
    person. Cross-range is bearing times distance, so that the ratio is ``4 B d / (c
    sqrt(n^2 - 1))``. `distance_m` is (M,) m. ValueError below two antennas.
    """
    if n_antennas < _LEAST_ANTENNAS:
        raise ValueError(f"a bearing needs 2 antennas or more, got {n_antennas}")
    slope_per_m = 4.0 * bandwidth_mhz * 1e6 / SPEED_OF_LIGHT_MPS
    return np.asarray(slope_per_m * distance_m / np.sqrt(n_antennas**2 - 1.0))


def range_variance(*, variance_m2: Floats, ratio: Floats, scaling: Scaling) -> Floats:
    """Return the variance along the range, (M,) m^2; across it is ratio^2 times larger.

    `variance_m2`, (M,) m^2, is that of the scalar error per axis. ValueError for an
    unknown scaling.
    """
    square = ratio**2
    if scaling == "information":
        return np.asarray(variance_m2 * (1.0 + 1.0 / square) / 2.0)
    if scaling == "trace":
        return np.asarray(variance_m2 * 2.0 / (1.0 + square))
    raise ValueError(f"unknown scaling {scaling!r}; known: information, trace")


def range_bearing_covariance(
    *,
    xy: Floats,
    station_m: tuple[float, float],
    variance_m2: Floats,
    bandwidth_mhz: float,
    n_antennas: int,
    scaling: Scaling,
) -> Floats:
    """Return the covariance of positions measured by range and bearing, (M, 2, 2) m^2.

    `xy`, (M, 2) m, are the true positions and `station_m` the place of the station.
    `variance_m2`, (M,) m^2, is the variance per axis of the scalar error that the
    ellipse replaces.
    """
    away = xy - np.array(station_m)
    distance_m = np.hypot(away[:, 0], away[:, 1])
    # At the station itself any direction will do.
    angle = np.arctan2(away[:, 1], away[:, 0])
    ratio = cross_range_ratio(
        distance_m=np.maximum(distance_m, NEAREST_M),
        bandwidth_mhz=bandwidth_mhz,
        n_antennas=n_antennas,
    )
    along = range_variance(variance_m2=variance_m2, ratio=ratio, scaling=scaling)
    across = along * ratio**2
    outward = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sideways = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return np.asarray(
        along[:, None, None] * outward[:, :, None] * outward[:, None, :]
        + across[:, None, None] * sideways[:, :, None] * sideways[:, None, :]
    )


def scalar_covariance(variance_m2: Floats) -> Floats:
    """Return covariances with equal axes, (M,) m^2 -> (M, 2, 2) m^2."""
    return np.asarray(variance_m2[:, None, None] * np.eye(2))


def sensed_covariance(
    *, xy: Floats, sigma_m: Floats, settings: SensingSettings
) -> Floats:
    """Return the covariance of raw errors by `settings`, (M, 2, 2) m^2.

    `sigma_m`, (M,) m, is the standard deviation of the scalar error at the true
    positions `xy`, (M, 2) m.
    """
    variance_m2 = axis_variance(sigma_m=sigma_m, law=settings.law)
    if settings.measurement == "scalar":
        return scalar_covariance(variance_m2)
    return range_bearing_covariance(
        xy=xy,
        station_m=(settings.bs_x_m, settings.bs_y_m),
        variance_m2=variance_m2,
        bandwidth_mhz=settings.bandwidth_mhz,
        n_antennas=settings.n_antennas,
        scaling=settings.scaling,
    )


def shaped_sigma(*, xy: Floats, sigma_m: Floats, settings: SensingSettings) -> Floats:
    """Return the standard deviation of raw errors with their shape, (M,) m.

    It is that of a round error with the same mean square; parameters are those of
    `sensed_covariance`.
    """
    if settings.measurement == "scalar":
        return sigma_m
    cov = sensed_covariance(xy=xy, sigma_m=sigma_m, settings=settings)
    return np.asarray(np.sqrt(mean_variance(cov) / axis_share(settings.law)))


def mean_variance(cov: Floats) -> Floats:
    """Return the mean variance of both axes, (M, 2, 2) m^2 -> (M,) m^2."""
    return np.asarray((cov[:, 0, 0] + cov[:, 1, 1]) / 2.0)


def mean_information(cov: Floats) -> Floats:
    """Return the mean information of both axes, (M, 2, 2) m^2 -> (M,) 1/m^2."""
    return np.asarray(mean_variance(cov) / np.linalg.det(cov))


def principal_axes(cov: Floats) -> tuple[Floats, Floats]:
    """Return the principal axes of covariances and the variances along them, (M, 2).

    The axes, (M, 2, 2), are the columns of a rotation, the longer axis first. `cov` is
    (M, 2, 2).
    """
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    angle = np.arctan2(2.0 * xy, xx - yy) / 2.0
    cosine, sine = np.cos(angle), np.sin(angle)
    axes = np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)
    longer = (xx + yy) / 2.0 + np.hypot(xx - yy, 2.0 * xy) / 2.0
    # The product of both is the determinant; a difference would lose digits.
    shorter = np.zeros_like(longer)
    np.divide(xx * yy - xy * xy, longer, out=shorter, where=longer > 0.0)
    return axes, np.stack([longer, shorter], axis=1)


def least_share(cov: Floats) -> Floats:
    """Return the least information of any direction, as a share of the mean, (M,).

    It is 1 for a round error and tends to 0 for a long ellipse, (M, 2, 2) m^2. An error
    of no size is round.
    """
    mean, det = mean_variance(cov), np.linalg.det(cov)
    apart = np.sqrt(np.maximum(np.square(mean) - det, 0.0))
    share = np.divide(mean - apart, mean, out=np.ones_like(mean), where=mean > 0.0)
    return np.asarray(share)


def share_within(cov: Floats, *, epsilon_m: float) -> Floats:
    """Return how probably Gaussian errors lie within a distance, (M,).

    The mean of 1 - exp(-epsilon^2 / 2 (a cos^2 + b sin^2)) over all angles, where a and
    b are the variances along both axes of `cov`, (M, 2, 2) m^2, both positive.
    """
    mean = mean_variance(cov)
    apart = np.sqrt(np.maximum(np.square(mean) - np.linalg.det(cov), 0.0))
    share = np.zeros_like(mean)
    for cosine in np.cos(2.0 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES):
        variance = np.maximum(mean + apart * cosine, np.finfo(np.float64).tiny)
        share -= np.expm1(-(epsilon_m**2) / (2.0 * variance))
    return np.asarray(share / _ANGLES)


def mass_within(away: Floats, cov: Floats, *, radius_m: float) -> Floats:
    """Return the mass of Gaussians in discs, (...,).

    A disc of `radius_m` lies at `away`, (..., 2) m, from the mean of its Gaussian, whose
    covariance is `cov`, (..., 2, 2) m^2, positive. Across the longer axis the integral
    is a sum over Gauss and Legendre's nodes, along it in closed form.
    """
    # A filter imports this file, too, and does without SciPy.
    ndtr = import_module("scipy.special").ndtr

    shape = np.broadcast_shapes(away.shape[:-1], cov.shape[:-2])
    away = np.broadcast_to(away, (*shape, 2)).reshape(-1, 2)
    axes, variances = principal_axes(
        np.broadcast_to(cov, (*shape, 2, 2)).reshape(-1, 2, 2)
    )
    along, across = np.einsum("mai,ma->im", axes, away)
    long, short = np.sqrt(variances).T
    # The chord at radius * sin(angle) across has the half length radius * cos(angle).
    low, high = (
        np.arcsin(np.clip((side * _REACH * short - across) / radius_m, -1.0, 1.0))
        for side in (-1.0, 1.0)
    )
    mass = np.zeros(len(away))
    for node, weight in zip(*np.polynomial.legendre.leggauss(_NODES), strict=True):
        angle = (low + high + node * (high - low)) / 2.0
        half = radius_m * np.cos(angle)
        place = (across + radius_m * np.sin(angle)) / short
        density = np.exp(-0.5 * place**2) / (np.sqrt(2.0 * np.pi) * short)
        chord = ndtr((along + half) / long) - ndtr((along - half) / long)
        mass += weight * (high - low) / 2.0 * half * density * chord
    return mass.reshape(shape)


def error_ellipses(cov: Floats) -> Floats:
    """Return covariances in units of their mean variance, (M, 2, 2).

    An error of no size is round. A flat ellipse gets a least width, which a filter
    needs.
    """
    mean = mean_variance(cov)[:, None, None]
    ellipses = np.broadcast_to(np.eye(2), cov.shape).copy()
    np.divide(cov, mean, out=ellipses, where=mean > 0.0)
    ellipses += _LEAST_SHARE * (np.eye(2) - ellipses)
    return ellipses


def shaped_errors(*, cov: Floats, unit_error: Floats, law: ErrorLaw) -> Floats:
    """Return errors of covariances `cov`, (M, 2) m, from standardised errors, (M, 2).

    The factor is Cholesky's, so that a round covariance gives the scalar error.
    """
    factor = np.linalg.cholesky(cov) / np.sqrt(axis_share(law))
    return np.asarray(np.einsum("mab,mb->ma", factor, unit_error))


def square_roots(cov: Floats) -> Floats:
    """Return the symmetric square roots of covariances, (M, 2, 2) m^2 -> m.

    By Cayley and Hamilton's theorem: (C + sqrt(det C) I) / sqrt(tr C + 2 sqrt(det C)).
    """
    middle = np.sqrt(np.maximum(np.linalg.det(cov), 0.0))
    scale = np.sqrt(2.0 * (mean_variance(cov) + middle))[:, None, None]
    total = cov + middle[:, None, None] * np.eye(2)
    root = np.divide(total, scale, out=np.zeros_like(cov), where=scale > 0.0)
    return np.asarray(root)


def grown_covariance(cov: Floats, added_m: Floats) -> Floats:
    """Return covariances whose principal axes grow by `added_m`, (M,) m.

    The standard deviations along both axes of the ellipse grow, (M, 2, 2) m^2.
    """
    extra = added_m[:, None, None]
    return np.asarray(
        cov + 2.0 * extra * square_roots(cov) + np.square(extra) * np.eye(2)
    )


def covariance_without(
    cov: Floats, *, std_m: Floats | float, least_m2: float
) -> Floats:
    """Return covariances less a round error of `std_m` per axis, (M, 2, 2) m^2.

    At least `least_m2` remains along each principal axis.
    """
    axes, variances = principal_axes(cov)
    rest = np.maximum(variances - np.square(std_m)[..., None], least_m2)
    return np.asarray(np.einsum("mai,mi,mbi->mab", axes, rest, axes))


def round_errors(*, cov: Floats, error: Floats) -> Floats:
    """Return errors of covariances `cov` turned into round errors, (M, 2) m -> (M, 2).

    They have the variance 1 along all directions: the inverse of the symmetric square
    root times the error. An error of no size stays 0.
    """
    root = square_roots(cov)
    det = np.linalg.det(root)[:, None]
    (xx, xy), (_, yy) = np.moveaxis(root, 0, -1)
    x, y = error.T
    adjoint = np.stack([yy * x - xy * y, xx * y - xy * x], axis=1)
    unit = np.divide(adjoint, det, out=np.zeros_like(error), where=det > 0.0)
    return np.asarray(unit)


def covariance_after(
    *, raw: Floats, raw_sigma_m: Floats, sigma_m: Floats, law: ErrorLaw
) -> Floats:
    """Return the covariances of raw errors behind a mechanism, (M, 2, 2) m^2.

    A mechanism declared the standard deviations `sigma_m`, (M,) m, and no shape. What
    exceeds `raw_sigma_m` is a round error of its own under `law`; below it the raw
    error of covariance `raw` shrinks.
    """
    square, raw_square = np.square(sigma_m), np.square(raw_sigma_m)
    rest = np.ones_like(square)
    np.divide(square, raw_square, out=rest, where=square < raw_square)
    added = axis_share(law) * np.maximum(square - raw_square, 0.0)
    return np.asarray(rest[:, None, None] * raw + scalar_covariance(added))
