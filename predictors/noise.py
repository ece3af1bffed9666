"""How noisy is a track? What a robot can tell from the shared positions alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

MIN_VARIANCE_M2 = 1e-6
"""(1 mm)^2: below it a filter would trust rounding."""
UNKNOWN_VARIANCE_M2 = 0.25
"""For a track of fewer than three samples, which says nothing of its noise."""


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
    """
    n_tracks = offsets.size - 1
    sizes = np.diff(offsets)
    if t.size < 3:  # noqa: PLR2004 - no innovation at all
        return np.full(n_tracks, UNKNOWN_VARIANCE_M2)
    step = np.diff(t)
    inside = np.ones(t.size - 2, dtype=bool)  # innovation k spans the samples k, k + 1, k + 2
    for lost in (offsets[1:-1] - 1, offsets[1:-1] - 2):
        inside[lost[(lost >= 0) & (lost < inside.size)]] = False
    ratio = np.zeros(inside.size)
    np.divide(step[1:], step[:-1], out=ratio, where=inside)
    innovation = xy[2:] - xy[1:-1] - ratio[:, None] * (xy[1:-1] - xy[:-2])
    scale = 2.0 * (1.0 + (1.0 + ratio) ** 2 + ratio**2)  # two axes
    scaled = np.where(inside, (innovation[:, 0] ** 2 + innovation[:, 1] ** 2) / scale, 0.0)
    owner = np.repeat(np.arange(n_tracks), sizes)[:-2]
    total = np.bincount(owner, weights=scaled, minlength=n_tracks)
    count = np.maximum(sizes - 2, 0)
    variance = np.full(n_tracks, UNKNOWN_VARIANCE_M2)
    np.divide(total, count, out=variance, where=count > 0)
    found: Floats = np.maximum(variance, MIN_VARIANCE_M2)
    return found
