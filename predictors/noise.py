"""How noisy is a track? What a robot can tell from the shared positions alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

MIN_VARIANCE_M2 = 1e-6
"""(1 mm)^2: below it a filter would trust rounding."""
MAX_VARIANCE_M2 = 1e4
UNKNOWN_VARIANCE_M2 = 0.25
"""For a track of fewer than three samples, which says nothing of its noise."""


def interpolation_variance_m2(*, t: Floats, xy: Floats, offsets: Ints) -> Floats:
    """Return a first estimate of the error variance per axis of each track, (N,) m^2.

    Every inner sample is compared with the line between its neighbours. For independent errors
    of variance r and a straight walk the difference has variance r (1 + a^2 + b^2), with a and b
    the weights of the neighbours; a curved walk adds to it, so that this errs on the high side.

    Parameters
    ----------
    t : (M,) s
    xy : (M, 2) m
    offsets : (N + 1,) int
    """
    n_tracks = offsets.size - 1
    owner = np.repeat(np.arange(n_tracks), np.diff(offsets))
    inner = np.flatnonzero(owner[:-2] == owner[2:]) + 1 if t.size > 2 else np.zeros(0, int)  # noqa: PLR2004
    before = (t[inner + 1] - t[inner]) / (t[inner + 1] - t[inner - 1])
    after = 1.0 - before
    line = before[:, None] * xy[inner - 1] + after[:, None] * xy[inner + 1]
    squared = ((xy[inner] - line) ** 2).sum(axis=1) / (1.0 + before**2 + after**2)
    count = np.bincount(owner[inner], minlength=n_tracks)
    total = np.bincount(owner[inner], weights=squared, minlength=n_tracks)
    variance = np.full(n_tracks, UNKNOWN_VARIANCE_M2)
    np.divide(total, 2.0 * count, out=variance, where=count > 0)
    clipped: Floats = np.clip(variance, MIN_VARIANCE_M2, MAX_VARIANCE_M2)
    return clipped


def innovation_variance_m2(
    *, squared_m2: Floats, predicted_m2: Floats, count: Ints, before: Floats
) -> Floats:
    """Return the error variance that explains a filter's innovations, (N,) m^2.

    The variance of an innovation is h P h + r (Mehra, IEEE Trans. Autom. Control, 1970): what
    the prediction does not account for is the measurement.

    Parameters
    ----------
    squared_m2 : (N,)
        Sum of squared innovations over both axes of the accepted samples.
    predicted_m2 : (N,)
        Sum of h P h over the accepted samples (one axis).
    count : (N,) int
        Accepted samples.
    before : (N,)
        Variance that the filter ran with; kept where no sample was accepted.
    """
    found = np.array(before, dtype=np.float64)
    np.divide(0.5 * squared_m2 - predicted_m2, count, out=found, where=count > 0)
    # The innovations of a noiseless, well-predicted track explain less than nothing.
    clipped: Floats = np.clip(found, np.maximum(MIN_VARIANCE_M2, 0.1 * before), MAX_VARIANCE_M2)
    return clipped
