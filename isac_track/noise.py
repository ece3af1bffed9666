"""Estimate how noisy a track is from the shared positions alone."""

from importlib import import_module

import numpy as np

from isac_track.types import Floats, Ints, check_offsets, check_times

MIN_VARIANCE_M2 = 1e-6  # (1 mm)^2: below it a filter would trust rounding.
UNKNOWN_VARIANCE_M2 = 0.25
"""For a track of fewer than three samples, which does not show its noise."""


def innovation_variance_m2(
    *, t: Floats, xy: Floats, offsets: Ints, running: bool = False
) -> Floats:
    """Return the error variance per axis of each track, (N,) m^2, from its innovations.

    The innovations are those of the shortest constant-velocity predictor, which extends
    the line through two samples to the third: (1 + b) times the later sample less b
    times the earlier, with b the ratio of the two steps. For independent errors of
    variance r and a straight walk an innovation has the variance r (1 + (1 + b)^2 +
    b^2). The mean of its scaled squares over the track estimates r. The innovations of
    a filter would contain its process noise, and its gate would cut off the largest.
    At ten samples a second an acceleration of 1 m/s^2 adds only a centimetre to these.

    If `running`, the estimate at each sample, (M,), uses only the samples up to it.
    ValueError if the shapes of `t`, (M,) s, `xy`, (M, 2) m, and `offsets`, (N + 1,),
    disagree, a number is not finite or times do not increase.
    """
    if offsets.dtype.kind not in "iu":
        raise ValueError("offsets must be integers")
    offsets = np.ascontiguousarray(offsets, dtype=np.int64)
    t = np.ascontiguousarray(t, dtype=np.float64)
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    check_offsets(offsets, t.size)
    check_times(t, offsets)
    if xy.shape != (t.size, 2):
        raise ValueError(f"xy must have shape {(t.size, 2)}, got {xy.shape}")
    if not np.isfinite(xy).all():
        raise ValueError("xy must be finite")
    if running:
        scaled = scaled_innovations_m2(t=t, xy=xy, offsets=offsets)
        variance = running_means(scaled, offsets, start=UNKNOWN_VARIANCE_M2)
    else:
        variance = np.empty(offsets.size - 1)
        import_module("isac_track.kalman._linear_loops").innovation_level(
            t, xy, offsets, variance
        )
        variance[np.diff(offsets) < 3] = UNKNOWN_VARIANCE_M2  # noqa: PLR2004 - samples of an innovation
    return np.asarray(np.maximum(variance, MIN_VARIANCE_M2))


def scaled_innovations_m2(*, t: Floats, xy: Floats, offsets: Ints) -> Floats:
    """Return the scaled squared innovations of consecutive samples, (M - 2,) m^2.

    Each estimates the variance of `innovation_variance_m2`. Entry k belongs to sample k
    + 2; entries that reach from one track into the next mean nothing. The arrays are
    not checked.
    """
    step = np.diff(t)
    step[offsets[1:-1] - 1] = 1.0  # from one track to the next
    ratio = step[1:] / step[:-1]
    move = np.diff(xy, axis=0)
    square = np.square(move[1:] - ratio[:, None] * move[:-1]).sum(axis=1)
    return np.asarray(0.5 * square / (1.0 + np.square(1.0 + ratio) + np.square(ratio)))


def running_means(inner: Floats, offsets: Ints, *, start: float) -> Floats:
    """Return the mean of a track's innovations up to each sample, (M,).

    `inner`, (M - 2,), is what `scaled_innovations_m2` returns; entries that reach from
    one track into the next are left out. The first two samples of a track get `start`.
    """
    means = np.full(offsets[-1], start)
    total = np.concatenate([[0.0], np.cumsum(inner)])
    first = np.repeat(offsets[:-1], np.diff(offsets))
    last = np.arange(offsets[-1])
    has_mean = last >= first + 2
    first, last = first[has_mean], last[has_mean] - 1
    means[has_mean] = (total[last] - total[first]) / (last - first)
    return means
