"""Positions in the answers of a network, with their declared or estimated errors."""

from dataclasses import dataclass

import numpy as np

from isac_track.kalman import Batch, smooth_ellipses, smooth_positions
from isac_track.measurement import (
    axis_variance,
    covariance_without,
    error_ellipses,
    mean_variance,
)
from isac_track.noise import MIN_VARIANCE_M2, innovation_variance_m2
from isac_track.patrols.network import Network
from isac_track.types import Floats, Ints, Release


@dataclass(frozen=True, eq=False, slots=True)
class Reports:
    """L positions with their declared or estimated errors."""

    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis.
    # (L, 2, 2) m^2, of declared errors with a shape; `variance` is their mean then.
    cov: Floats | None

    def __getitem__(self, rows: Ints) -> "Reports":
        """Return some of the reports."""
        cov = None if self.cov is None else self.cov[rows]
        return Reports(self.xy[rows], self.variance[rows], cov)

    def batch(self, t: Floats, offsets: Ints, *, prior_std: tuple[float, ...]) -> Batch:
        """Return the reports as tracks of a filter, at the times `t`, (L,) s."""
        ellipse = None if self.cov is None else error_ellipses(self.cov)
        return Batch(t, self.xy, self.variance, offsets, prior_std, ellipse)

    def inflated(self, factor: float) -> "Reports":
        """Return the reports with all variances times a factor."""
        cov = None if self.cov is None else factor * self.cov
        return Reports(self.xy, factor * self.variance, cov)

    def floored(self) -> "Reports":
        """Return the reports with at least `MIN_VARIANCE_M2` along every axis."""
        if self.cov is None:
            variance = np.maximum(self.variance, MIN_VARIANCE_M2)
            return Reports(self.xy, variance, None)
        return _with_cov(self.xy, self.cov)


def _with_cov(xy: Floats, cov: Floats) -> Reports:
    """Return reports with covariances, (L, 2, 2) m^2, none of them flat."""
    cov = covariance_without(cov, std_m=0.0, least_m2=MIN_VARIANCE_M2)
    return Reports(xy, mean_variance(cov), cov)


def smooth_reports(
    batch: Batch, *, q: float, passes: int = 1, anneal: float = 0.0
) -> Reports:
    """Return smoothed positions with their posterior variances, none of them 0.

    Parameters are those of `isac_track.kalman.smooth_positions`.
    """
    if batch.ellipse is not None:
        xy, cov = smooth_ellipses(batch, q=q, passes=passes, anneal=anneal)
        return _with_cov(xy, cov)
    xy, variance = smooth_positions(batch, q=q, passes=passes, anneal=anneal)
    return Reports(xy, np.maximum(variance, MIN_VARIANCE_M2), None)


def average_draws(key: Ints, reports: Reports) -> tuple[Ints, Reports]:
    """Return the ascending keys, and the report of each, of several draws.

    Draws, (L,), are weighted by the inverse of their variance, or covariance.
    """
    keys, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    if (count == 1).all():
        return keys, reports[np.argsort(key)]
    if reports.cov is not None:
        return keys, _average_covs(inverse, reports.floored(), keys.size)
    weight = 1.0 / np.maximum(reports.variance, MIN_VARIANCE_M2)
    total = np.bincount(inverse, weights=weight)
    mean = [
        np.bincount(inverse, weights=weight * axis) / total for axis in reports.xy.T
    ]
    return keys, Reports(np.stack(mean, axis=1), 1.0 / total, None)


def _average_covs(group: Ints, reports: Reports, n_groups: int) -> Reports:
    """Return the average report of each group, weighted by information."""
    assert reports.cov is not None
    weight = np.linalg.inv(reports.cov)
    total, pull = np.zeros((n_groups, 2, 2)), np.zeros((n_groups, 2))
    np.add.at(total, group, weight)
    np.add.at(pull, group, np.einsum("lab,lb->la", weight, reports.xy))
    cov = np.linalg.inv(total)
    return _with_cov(np.asarray(np.einsum("lab,lb->la", cov, pull)), np.asarray(cov))


def sent_reports(network: Network) -> Reports:
    """Return the rows of `network.sent_release`, with declared or estimated errors."""
    return _reports(network, network.sent_release)


def released_reports(network: Network) -> Reports:
    """Return the samples of the release, (M,), with declared or estimated errors."""
    return _reports(network, network.release)


def _reports(network: Network, release: Release) -> Reports:
    if release.sigma is not None and release.cov is not None:
        return Reports(release.xy, mean_variance(release.cov), release.cov)
    return Reports(release.xy, _variance(network, release), None)


def _variance(network: Network, release: Release) -> Floats:
    """Return the variance per axis of each sample, (L,) m^2.

    A declared deviation is split as the sensor's law says. An added isotropic error
    then counts half: on patrols of Students03 that changes known shares by at most 0.4
    points.
    """
    sigma = release.sigma
    if sigma is None:
        variance = innovation_variance_m2(
            t=release.t, xy=release.xy, offsets=release.offsets
        )
        return np.repeat(variance, np.diff(release.offsets))
    return axis_variance(sigma_m=sigma, law=network.sensed.law)
