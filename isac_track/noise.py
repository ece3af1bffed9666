"""How noisy is a track? What anybody can tell from the shared positions alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.kalman.batch import floats, ragged_times

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

MIN_VARIANCE_M2 = 1e-6
"""(1 mm)^2: below it a filter would trust rounding."""
UNKNOWN_VARIANCE_M2 = 0.25
"""For a track of fewer than three samples, which says nothing of its noise."""
_LEAST_SAMPLES = 3


def innovation_variance_m2(*, t: Floats, xy: Floats, offsets: Ints) -> Floats:
    """Return the error variance per axis of each track, (N,) m^2, from its innovations.

    The innovations are those of the shortest constant-velocity predictor, which carries the
    line through two samples on to the third: a + b times the later less b times the earlier.
    For independent errors of variance r and a straight walk they have the variance
    r (1 + (1 + b)^2 + b^2), with b the ratio of the two steps; the mean of their squares over the
    track, so scaled, estimates r. A filter's own innovations would mix in its process noise and,
    behind a gate, shrink with what the gate cuts off; at ten samples a second a walk of
    1 m/s^2 adds but a centimetre to these.

    Parameters
    ----------
    t : (M,) s
    xy : (M, 2) m
    offsets : (N + 1,) int

    Raises
    ------
    ValueError
        If shapes disagree, a number is not finite or times do not increase.
    """
    t, offsets = ragged_times(t, offsets)
    xy = floats("xy", xy, (t.size, 2))
    sizes = np.diff(offsets)
    # Every sample but the first two of each track.
    k = np.flatnonzero(np.arange(t.size) - np.repeat(offsets[:-1], sizes) >= _LEAST_SAMPLES - 1)
    ratio = (t[k] - t[k - 1]) / (t[k - 1] - t[k - 2])
    error = xy[k] - xy[k - 1] - ratio[:, None] * (xy[k - 1] - xy[k - 2])
    square = (error**2).sum(axis=1) / (1 + (1 + ratio) ** 2 + ratio**2)
    track = np.repeat(np.arange(sizes.size), np.maximum(sizes - 2, 0))
    total = np.bincount(track, weights=square, minlength=sizes.size)
    variance = total / (2 * np.maximum(sizes - 2, 1))
    variance[sizes < _LEAST_SAMPLES] = UNKNOWN_VARIANCE_M2
    found: Floats = np.maximum(variance, MIN_VARIANCE_M2)
    return found
