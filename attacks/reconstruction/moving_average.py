"""The first thing that anybody does to a noisy track: average over neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.parameters import positive
from attacks.reconstruction.learning import around, fitted
from attacks.reconstruction.windows import half_windows
from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Ints, Release

_BIAS_ORDER = 2


@dataclass(frozen=True, slots=True)
class MovingAverage:
    """Centred moving average, wider where a track is noisier.

    On a walk of acceleration a the mean over a window of width h is off by a h^2 / 24, and
    errors of standard deviation s leave it the variance s^2 dt / h. Their mean square
    a^2 h^4 / 576 + s^2 dt / h is least at h^5 = 144 s^2 dt / a^2: the best width grows as
    s^(2/5). With s from the innovations of each track, its window is
    ``width_s * (s / 0.5 m)^(2/5)``.
    """

    width_s: float | None = None
    """s, at errors of 0.5 m per axis; None: learnt from the training set, or `DEFAULT_WIDTH_S`
    without one."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_WIDTH_S: ClassVar[float] = 2.8

    def __post_init__(self) -> None:
        positive(width_s=self.width_s)

    def fit(self, context: AttackContext) -> Callable[[Release], Reconstruction]:
        """Return the average over releases like those in the training set."""
        return fitted(context, smooth, given=self.width_s, candidates=CANDIDATES)


CANDIDATES = around(MovingAverage.DEFAULT_WIDTH_S, factor=2.0)


def smooth(release: Release, width_s: float) -> Reconstruction:
    """Return the average of every track over windows fit for its noise.

    Parameters
    ----------
    release : Release
    width_s : float
        s, at errors of 0.5 m per axis.
    """
    half = half_windows(release, width_s=width_s, bias_order=_BIAS_ORDER)
    return Reconstruction(centred_means(xy=release.xy, offsets=release.offsets, half=half))


def centred_means(*, xy: Floats, offsets: Ints, half: Ints) -> Floats:
    """Return the mean over up to `half` neighbours on each side, (M, 2) m.

    Near the ends of a track both sides are as short as the shorter one, down to the sample
    itself: a lopsided mean would lag behind the walk.

    Parameters
    ----------
    xy : (M, 2) m
    offsets : (N + 1,) int
    half : (N,) int
        Not negative.
    """
    sizes = np.diff(offsets)
    # Sums of small numbers lose less: every track is summed up from its own first position.
    origin = np.repeat(_planar(xy[offsets[:-1]]), sizes)
    total = np.empty(xy.shape[0] + 1, dtype=np.complex128)
    total[0] = 0.0
    np.cumsum(_planar(xy) - origin, out=total[1:])
    row = np.arange(xy.shape[0])
    side = np.minimum(row - np.repeat(offsets[:-1], sizes), np.repeat(offsets[1:] - 1, sizes) - row)
    np.minimum(side, np.repeat(half, sizes), out=side)
    mean = total[row + side + 1]
    mean -= total[row - side]
    mean /= 2 * side + 1
    mean += origin
    planar: Floats = mean.view(np.float64).reshape(-1, 2)
    return planar


def _planar(xy: Floats) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """Return x + iy, (M,): one array to sum and to look up in place of two."""
    return np.ascontiguousarray(xy).view(np.complex128)[:, 0]
