"""Smooth a track by the mean, or by a parabola, over a moving window."""

from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import numpy as np

from attacks.parameters import candidate_values, require_positive
from attacks.reconstruction.learning import candidates_around, make_smoother
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Ints, Knowledge, Reconstruction, Release

# Noise per axis at which a window has its nominal width; it only sets the scale.
REFERENCE_STD_M = 0.5


@dataclass(frozen=True, slots=True)
class MovingAverage:
    """Centred moving average, wider where a track is noisier.

    The mean over a window of width h of a walk of acceleration a is off by a h^2 / 24:
    the best window is ``width_s * (s / 0.5 m)^(2/5)`` (`half_windows`). Near the ends
    of a track both sides are as short as the shorter side: a lopsided mean would lag
    behind the walk.
    """

    # At errors of 0.5 m per axis; None: learnt, or `DEFAULT_WIDTH_S`.
    width_s: float | None = None

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_WIDTH_S: ClassVar[float] = 2.8

    def __post_init__(self) -> None:
        require_positive(width_s=self.width_s)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the filter of releases like those in the training set."""
        widths_s = candidate_values(
            self.width_s, candidates_around(self.DEFAULT_WIDTH_S, factor=2.0)
        )
        return make_smoother(context, self.smooth, candidates=widths_s)

    @staticmethod
    def smooth(release: Release, variance: Floats, width_s: float) -> Reconstruction:
        """Return the average of every track over windows fit for its noise."""
        half = half_windows(release, variance, width_s=width_s, bias_order=2)
        return Reconstruction(filtered(release, half, loop="centred_means"))


@dataclass(frozen=True, slots=True)
class Savgol(MovingAverage):
    """Least-squares parabolas over a moving window, wider where a track is noisier.

    A parabola equals a cubic at the middle of a window. At a width of h it is off by a
    multiple of h^4 times the fourth derivative of the walk. The best window is
    ``width_s * (s / 0.5 m)^(2/9)`` (`half_windows`), no longer than the track.
    A track of one or two samples is returned as it is.

    A track is interpolated onto as many instants at its mean interval, and back. On
    that grid it is ``scipy.signal.savgol_filter(..., window, 2, mode="interp")``.

    References
    ----------
    Savitzky, Golay, "Smoothing and differentiation of data by simplified least squares
    procedures", Analytical Chemistry 36(8), 1964, 1627-1639.
    """

    DEFAULT_WIDTH_S: ClassVar[float] = 6.5

    @staticmethod
    def smooth(release: Release, variance: Floats, width_s: float) -> Reconstruction:
        """Return every track filtered over windows fit for its noise."""
        half = half_windows(release, variance, width_s=width_s, bias_order=4)
        # A parabola through three samples would not smooth.
        half = np.minimum(np.maximum(half, 2), (np.diff(release.offsets) - 1) // 2)
        return Reconstruction(filtered(release, half, loop="fit_parabolas"))


def half_windows(
    release: Release, variance: Floats, *, width_s: float, bias_order: int
) -> Ints:
    """Return the samples on either side of the middle of each track's window, (N,).

    Errors are independent with standard deviation s; the bias on a smooth walk is b h^p
    for a window of width h (p the `bias_order`). The mean square error, a s^2 / h + b^2
    h^(2p), is least if h grows as s^(2 / (2p + 1)) (Fan, Gijbels, *Local Polynomial
    Modelling*, 1996, 3.2.3). It is `width_s` at `REFERENCE_STD_M`. Windows are rounded
    to an odd number of samples of the track's mean interval. `variance`, (M,) m^2, is s
    squared, constant along a track.
    """
    first, last = release.offsets[:-1], release.offsets[1:] - 1
    growth = (variance[first] / REFERENCE_STD_M**2) ** (1.0 / (2 * bias_order + 1))
    interval_s = np.ones(first.size)  # of a single sample any will do
    lasts_s = release.t[last] - release.t[first]
    np.divide(lasts_s, last - first, out=interval_s, where=last > first)
    half = np.rint((width_s * growth / interval_s - 1.0) / 2.0)
    longest = np.diff(release.offsets)  # wider than any window that fits
    return np.minimum(half, longest).clip(0).astype(np.int64)


def filtered(release: Release, half: Ints, *, loop: str) -> Floats:
    """Return positions, (M, 2) m, filtered over windows of ``2 half + 1`` samples.

    `half`, (N,), is given for each track, `loop` is a function of `_window_loops`. No
    window of parabolas may exceed its track.
    """
    out = np.empty_like(release.xy)
    arrays = map(np.ascontiguousarray, (release.t, release.xy, release.offsets, half))
    getattr(import_module("attacks.reconstruction._window_loops"), loop)(*arrays, out)
    return out
