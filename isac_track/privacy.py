"""The paper's privacy descriptors: leakage indicator, PLR, AEL and MEL.

All work on flat ragged arrays (see `isac_track.types`): one value per trajectory comes
back. They describe the samples as shared; they say nothing of what an adversary can
rebuild.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Final

import numpy as np

from isac_track.config import IntervalsOf, PrivacySettings
from isac_track.types import Bools, Floats, Ints, squared_lengths

WIDE_TIMES: Final = 4.0 / 3.0
"""Times epsilon: the distance at which errors that a mechanism parks just outside epsilon show."""
N_DESCRIBED: Final = 7  # Numbers of each trajectory.


@dataclass(frozen=True, eq=False, slots=True)
class Exposure:
    """Leakage of N trajectories."""

    plr: Floats  # (N,) share of leaked samples, 0..1 (eq. plr_definition).
    # (N,) s, mean duration of a trajectory's leaked segments; 0 without one.
    ael_s: Floats
    mel_s: Floats  # (N,) s, duration of its longest leaked segment; 0 without one.
    segments: Ints  # (N,) number of leaked segments.


def leakage_indicator(*, shared_xy: Floats, true_xy: Floats, epsilon_m: float) -> Bools:
    """Return which samples leak: the shared position lies closer than epsilon to the truth.

    Eq. leakage_indicator, of (M, 2) m each. The inequality is strict. ValueError if the
    shapes differ or epsilon is not positive.
    """
    if (
        shared_xy.shape != true_xy.shape
        or shared_xy.ndim != 2  # noqa: PLR2004 - samples by axes
        or shared_xy.shape[1] != 2  # noqa: PLR2004 - of the plane
    ):
        shapes = f"{shared_xy.shape} and {true_xy.shape}"
        raise ValueError(
            f"shared_xy and true_xy must have one shape (M, 2), got {shapes}"
        )
    if not epsilon_m > 0:
        raise ValueError(f"epsilon_m must be positive, got {epsilon_m}")
    return distance_m(shared_xy=shared_xy, true_xy=true_xy) < epsilon_m


def distance_m(*, shared_xy: Floats, true_xy: Floats) -> Floats:
    """Return how far each shared position (M, 2) m lies from the truth, (M,) m."""
    return np.sqrt(squared_lengths(shared_xy - true_xy))


def exposure(
    *, leaked: Bools, t: Floats, offsets: Ints, intervals: IntervalsOf = "segment"
) -> Exposure:
    """Return PLR, AEL and MEL of every trajectory.

    Consecutive leaked samples form a segment, and it lasts as long as its samples do:
    by the intervals of its `segment` half the interval before each and half the one
    after it (at either end of the trajectory the one interval that there is), by those
    of its `trajectory` the mean interval of the whole. AEL is the mean over a
    trajectory's segments, MEL its longest; both are 0 without a leaked sample. A
    trajectory of one sample has no interval: if that sample leaks, AEL and MEL are NaN
    (unknown, not zero).

    `leaked` is the indicator z_i(k), (M,) bool, and `t` are the sampling times, (M,) s;
    trajectory i owns the samples ``offsets[i]:offsets[i + 1]``. It is a ValueError if
    lengths disagree or a trajectory is empty.
    """
    if leaked.shape != t.shape or leaked.ndim != 1:
        raise ValueError(
            f"leaked and t must have one shape (M,), got {leaked.shape}, {t.shape}"
        )
    if offsets[0] != 0 or offsets[-1] != t.size or (np.diff(offsets) < 1).any():
        raise ValueError("offsets must run from 0 to M without an empty trajectory")
    # As of positions that are the truth where they leak, and lie beyond epsilon where
    # not.
    away_m = np.repeat(2.0 * ~leaked[:, None], 2, axis=1)
    plr, ael_s, mel_s, segments, *_ = described(
        xy=away_m,
        truth=np.zeros_like(away_m),
        t=t.astype(np.float64, copy=False),
        offsets=offsets.astype(np.int64, copy=False),
        settings=PrivacySettings(epsilon_m=1.0, intervals=intervals),
    )
    return Exposure(
        plr=plr, ael_s=ael_s, mel_s=mel_s, segments=segments.astype(np.int64)
    )


def described(
    *,
    xy: Floats,
    truth: Floats,
    t: Floats,
    offsets: Ints,
    settings: PrivacySettings,
    moved: tuple[Floats, Floats] | None = None,
    turn: complex = 1.0,
) -> Floats:
    """Return what is known of every trajectory, (`N_DESCRIBED`, N).

    PLR, AEL, MEL, number of segments, mean squared error in m^2, PLR at `WIDE_TIMES`
    epsilon, and the median distance to the truth in m. As `exposure` of
    `leakage_indicator`, in one pass over sound arrays: `xy` and `truth` are (M, 2) m.
    What was `moved`, from positions to others in a frame that is turned by the angle of
    the unit number `turn`, takes these steps from `xy` in the true frame; what was not
    stays as it is, bit by bit.
    """
    to, since = moved or (xy, xy)
    places = tuple(np.ascontiguousarray(one) for one in (xy, truth, to, since))
    times, out = np.ascontiguousarray(t), np.empty((N_DESCRIBED, offsets.size - 1))
    wide_m, by_segment = (
        WIDE_TIMES * settings.epsilon_m,
        float(settings.intervals == "segment"),
    )
    rule = turn.real, turn.imag, settings.epsilon_m, wide_m, by_segment
    import_module("isac_track._privacy_loop").described(
        places, times, offsets, rule, out
    )
    return out


def alignment_error(*, xy: Floats, truth: Floats, offsets: Ints) -> Floats:
    """Return the root-mean-square distance of each trajectory to its true walk, (N,) m, at best.

    That is after the rotation and the translation that bring them closest (Umeyama,
    IEEE TPAMI 13(4), 1991, without scale): what nobody undoes who knows not where, nor
    which way, a walk went. NaN for a single sample. `xy` and `truth` are (M, 2) m,
    `offsets` (N + 1,).
    """
    starts, sizes = offsets[:-1], np.diff(offsets)
    first, second = (
        points - np.repeat(np.add.reduceat(points, starts) / sizes, sizes)
        for points in (one[:, 0] + 1j * one[:, 1] for one in (xy, truth))
    )
    squares = np.add.reduceat(np.abs(first) ** 2 + np.abs(second) ** 2, starts)
    # The sum of products is as long as it is for the best rotation, which makes it
    # real.
    squares -= 2.0 * np.abs(np.add.reduceat(first.conj() * second, starts))
    return np.where(sizes == 1, np.nan, np.sqrt(np.maximum(squares, 0.0) / sizes))


def mean_interval_s(*, t: Floats, offsets: Ints) -> Floats:
    """Return the mean sampling interval of each trajectory, (N,) s; NaN for a single sample."""
    intervals = np.diff(offsets) - 1
    span_s = t[offsets[1:] - 1] - t[offsets[:-1]]
    unknown = np.full(span_s.shape, np.nan)
    return np.asarray(np.divide(span_s, intervals, out=unknown, where=intervals > 0))
