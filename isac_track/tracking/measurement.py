"""Covariance of a position measured by range and bearing, beside the scalar error.

The scalar error of the suite has the same variance on both axes. A radar measures the
range by its bandwidth and the bearing by its array, so that the error is an ellipse
that points to the station.
"""

from typing import Final, Literal, TypeAlias

import numpy as np

from isac_track.sensing import NEAREST_M, SPEED_OF_LIGHT_MPS
from isac_track.types import ErrorLaw, Floats

Scaling: TypeAlias = Literal["information", "trace"]
"""Quantity that an error ellipse shares with the scalar error of a sample.

``information``: the mean Fisher information of both axes; the mean squared error then
grows with the ratio r of the axes by (r + 1/r)^2 / 4. ``trace``: the mean squared
error, so that only the shape differs.
"""
_LEAST_ANTENNAS: Final = 2


def axis_variance(*, sigma_m: Floats, law: ErrorLaw) -> Floats:
    """Return the variance per axis of an error law, (M,) m -> (M,) m^2."""
    return np.asarray(sigma_m**2 * (1.0 if law == "isotropic" else 0.5))


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
