"""How wide should a smoothing window be? As wide as the noise of each track asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.noise import innovation_variance_m2

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints, Release

REFERENCE_STD_M = 0.5
"""Noise per axis at which a window has its nominal width; no matter but a scale."""


def half_windows(release: Release, *, width_s: float, bias_order: int) -> Ints:
    """Return the samples on either side of the middle of each track's window, (N,).

    A window of width h over independent errors of standard deviation s leaves the variance
    a s^2 / h; a linear filter whose bias on a smooth walk is b h^p then has the mean square error
    a s^2 / h + b^2 h^(2p). Its derivative vanishes at
    h^(2p + 1) = a s^2 / (2 p b^2): the best width grows as s^(2 / (2p + 1)), from `width_s` at
    `REFERENCE_STD_M`. It is rounded to an odd number of samples of the track's mean interval.

    Parameters
    ----------
    release : Release
        s is estimated from its positions, track by track.
    width_s : float
        s, of a track of the reference noise.
    bias_order : int
        p: 2 for a centred mean, 4 for a local parabola or cubic.

    References
    ----------
    Fan, Gijbels, *Local Polynomial Modelling and Its Applications*, 1996: section 3.2.3.
    """
    variance = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    growth = (variance / REFERENCE_STD_M**2) ** (1.0 / (2 * bias_order + 1))
    samples = width_s * growth / mean_intervals_s(release)
    longest = np.diff(release.offsets)  # wider than any window that fits
    half: Ints = np.minimum(np.rint((samples - 1.0) / 2.0), longest).clip(0).astype(np.int64)
    return half


def mean_intervals_s(release: Release) -> Floats:
    """Return the mean time between the samples of each track, (N,) s; 1 s for a single sample."""
    first, last = release.offsets[:-1], release.offsets[1:] - 1
    mean = np.ones(first.size)
    np.divide(release.t[last] - release.t[first], last - first, out=mean, where=last > first)
    return mean
