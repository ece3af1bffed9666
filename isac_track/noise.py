"""How noisy is a track? What anybody can tell from the shared positions alone."""

from importlib import import_module

import numpy as np

from isac_track.types import Floats, Ints, check_offsets, check_times

MIN_VARIANCE_M2 = 1e-6  # (1 mm)^2: below it a filter would trust rounding.
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
    1 m/s^2 adds but a centimetre to these. ValueError if the shapes of `t`, (M,) s, `xy`, (M, 2) m,
    and `offsets`, (N + 1,), disagree, a number is not finite or times do not increase.
    """
    if offsets.dtype.kind not in "iu":
        raise ValueError("offsets must be integers")
    offsets = np.ascontiguousarray(offsets, dtype=np.int64)
    t, xy = (np.ascontiguousarray(one, dtype=np.float64) for one in (t, xy))
    check_offsets(offsets, t.size)
    check_times(t, offsets)
    if xy.shape != (t.size, 2):
        raise ValueError(f"xy must have shape {(t.size, 2)}, got {xy.shape}")
    if not np.isfinite(xy).all():
        raise ValueError("xy must be finite")
    variance = np.empty(offsets.size - 1)
    import_module("isac_track.kalman._linear_loops").innovation_level(t, xy, offsets, variance)
    variance[np.diff(offsets) < _LEAST_SAMPLES] = UNKNOWN_VARIANCE_M2
    return np.asarray(np.maximum(variance, MIN_VARIANCE_M2))
