"""Local parabolas: the Savitzky-Golay filter on the mean interval of every track."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.parameters import positive
from attacks.reconstruction.learning import around, smoother
from attacks.reconstruction.moving_average import half_windows
from isac_track.types import Floats, Ints, Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from isac_track.protocols import AttackContext, Reconstructor


@dataclass(frozen=True, slots=True)
class Savgol:
    """Least-squares parabolas over a moving window, wider where a track is noisier.

    At the middle of a window of width h a parabola (and a cubic, which is the same there) is off
    by a multiple of h^4 times the fourth derivative of the walk; errors of standard deviation s
    leave a variance of 9 s^2 dt / (4 h). Their mean square is least at an h that grows as
    s^(2/9). With s from the innovations of each track, its window is
    ``width_s * (s / 0.5 m)^(2/9)``, rounded to an odd number of samples and no longer than the
    track. A track of one or two samples is returned as it is.

    A track is interpolated onto as many instants at its mean interval, and back.

    References
    ----------
    Savitzky, Golay, "Smoothing and differentiation of data by simplified least squares
    procedures", Analytical Chemistry 36(8), 1964, 1627-1639.
    """

    width_s: float | None = None
    """s, at errors of 0.5 m per axis; None: learnt from the training set, or `DEFAULT_WIDTH_S`
    without one."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_WIDTH_S: ClassVar[float] = 6.5

    def __post_init__(self) -> None:
        positive(width_s=self.width_s)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the filter of releases like those in the training set."""
        candidates = around(self.DEFAULT_WIDTH_S, factor=2.0)
        return smoother(context, smooth, given=self.width_s, candidates=candidates)


def smooth(release: Release, variance: Floats, width_s: float) -> Reconstruction:
    """Return every track filtered over windows fit for its noise."""
    half = half_windows(release, variance, width_s=width_s, bias_order=4)
    # A parabola through three samples smooths nothing.
    half = np.minimum(np.maximum(half, 2), (np.diff(release.offsets) - 1) // 2)
    return Reconstruction(parabolas(t=release.t, xy=release.xy, offsets=release.offsets, half=half))


def parabolas(*, t: Floats, xy: Floats, offsets: Ints, half: Ints) -> Floats:
    """Return positions filtered with a window of ``2 half + 1`` samples for each track, (M, 2) m.

    On the grid equal to ``scipy.signal.savgol_filter(..., 2 * half + 1, 2, mode="interp")``. No
    window may exceed its track; a track with `half`, (N,), 0 stays as it is.
    """
    out = np.empty_like(xy)
    arrays = (np.ascontiguousarray(each) for each in (t, xy, offsets, half))
    import_module("attacks.reconstruction._window_loops").fit_parabolas(*arrays, out)
    return out
