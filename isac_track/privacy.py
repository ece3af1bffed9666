"""The paper's privacy descriptors: leakage indicator, PLR, AEL and MEL.

All work on flat ragged arrays (see `isac_track.types`) and return one value per
trajectory. They describe the samples as shared, not what an adversary can reconstruct.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Final

import numpy as np

from isac_track.config import IntervalsOf, PrivacySettings
from isac_track.types import Bools, Complexes, Floats, Ints, squared_lengths

__all__ = ["Exposure", "alignment_error", "described", "distance_m", "exposure"]
__all__ += ["N_DESCRIBED", "WIDE_TIMES", "leakage_indicator", "mean_interval_s"]

WIDE_TIMES: Final = 4.0 / 3.0
"""Factor on epsilon that shows errors placed just outside of epsilon."""
N_DESCRIBED: Final = 7
"""Number of descriptors of each trajectory that `described` returns."""


@dataclass(frozen=True, eq=False, slots=True)
class Exposure:
    """Leakage of N trajectories.

    Attributes
    ----------
    plr : Floats
        Share of leaked samples, (N,), 0..1 (eq. plr_definition).
    ael_s : Floats
        Mean duration of a trajectory's leaked segments, (N,) s; 0 without any.
    mel_s : Floats
        Duration of its longest leaked segment, (N,) s; 0 without any.
    segments : Ints
        Number of leaked segments, (N,).
    """

    plr: Floats
    ael_s: Floats
    mel_s: Floats
    segments: Ints


def leakage_indicator(*, shared_xy: Floats, true_xy: Floats, epsilon_m: float) -> Bools:
    """Return which samples leak: shared closer than epsilon to the truth, (M,).

    Eq. leakage_indicator, for positions of (M, 2) m. The inequality is strict.
    ValueError if the shapes differ or epsilon is not positive.

    Examples
    --------
    Shared positions 0.1 m, 0.3 m and 0.5 m off the truth:

    >>> import numpy as np
    >>> from isac_track.privacy import leakage_indicator
    >>> truth = np.zeros((3, 2))
    >>> shared = np.array([[0.1, 0.0], [0.0, 0.3], [0.3, 0.4]])
    >>> leakage_indicator(shared_xy=shared, true_xy=truth, epsilon_m=0.3)
    array([ True, False, False])
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
    """Return how far each shared position, (M, 2) m, lies from the truth, (M,) m."""
    return np.sqrt(squared_lengths(shared_xy - true_xy))


def exposure(
    *, leaked: Bools, t: Floats, offsets: Ints, intervals: IntervalsOf = "segment"
) -> Exposure:
    """Return PLR, AEL and MEL of every trajectory.

    Consecutive leaked samples form a segment, whose duration is the sum over its
    samples. With `intervals` *segment* the duration of a sample is half the interval
    before it plus half the interval after it; at either end of the trajectory it is the
    only interval there. With *trajectory* it is the trajectory's mean interval. AEL is
    the mean over a trajectory's segments, MEL its longest; both are 0 without a leaked
    sample. A trajectory of one sample has no interval: if that sample leaks, AEL and
    MEL are NaN (unknown, not zero).

    `leaked` is the indicator z_i(k), (M,) bool, and `t` are the sampling times, (M,) s;
    trajectory i owns the samples ``offsets[i]:offsets[i + 1]``. ValueError if lengths
    disagree or a trajectory is empty.

    Examples
    --------
    Five samples, each of 1 s. The first two and the last leak: segments of 2 s and 1 s.

    >>> import numpy as np
    >>> from isac_track.privacy import exposure
    >>> leaks = exposure(
    ...     leaked=np.array([True, True, False, False, True]),
    ...     t=np.arange(5.0),
    ...     offsets=np.array([0, 5]),
    ... )
    >>> leaks.plr, leaks.segments
    (array([0.6]), array([2]))
    >>> leaks.ael_s, leaks.mel_s
    (array([1.5]), array([2.]))
    """
    if leaked.shape != t.shape or leaked.ndim != 1:
        raise ValueError(
            f"leaked and t must have one shape (M,), got {leaked.shape}, {t.shape}"
        )
    if offsets[0] != 0 or offsets[-1] != t.size or (np.diff(offsets) < 1).any():
        raise ValueError("offsets must run from 0 to M without an empty trajectory")
    # Positions that lie at the truth where they leak, and beyond epsilon elsewhere.
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
    """Return the descriptors of every trajectory, (`N_DESCRIBED`, N).

    PLR, AEL, MEL, number of segments, mean squared error in m^2, PLR at `WIDE_TIMES`
    epsilon, and the median distance to the truth in m. They are those of `exposure` and
    `leakage_indicator`, in one pass over arrays that are not checked: `xy` and `truth`
    are (M, 2) m, `t` (M,) s, `offsets` (N + 1,).

    `moved` holds the positions to which and from which an attack moved the samples. Its
    frame is turned by the angle of the unit number `turn`; the steps are turned back
    and added to `xy`. A sample that was not moved stays exactly where it is.
    """
    to, since = moved or (xy, xy)
    places = tuple(np.ascontiguousarray(points) for points in (xy, truth, to, since))
    rule = (
        turn.real,
        turn.imag,
        settings.epsilon_m,
        WIDE_TIMES * settings.epsilon_m,
        float(settings.intervals == "segment"),
    )
    out = np.empty((N_DESCRIBED, offsets.size - 1))
    import_module("isac_track._privacy_loop").described(
        places, np.ascontiguousarray(t), offsets, rule, out
    )
    return out


def alignment_error(*, xy: Floats, truth: Floats, offsets: Ints) -> Floats:
    """Return the RMS distance of each trajectory to its aligned true walk, (N,) m.

    The walk is aligned by the rotation and translation that bring it closest (Umeyama,
    IEEE TPAMI 13(4), 1991, without scale). This error remains for an adversary who
    knows neither the place nor the direction of a walk. NaN for a single sample. `xy`
    and `truth` are (M, 2) m, `offsets` (N + 1,).

    Examples
    --------
    A walk that is turned and moved, but keeps its shape, has no error:

    >>> import numpy as np
    >>> from isac_track.privacy import alignment_error
    >>> truth = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    >>> shared = np.array([[5.0, 5.0], [5.0, 6.0], [3.0, 6.0]])
    >>> error_m = alignment_error(xy=shared, truth=truth, offsets=np.array([0, 3]))
    >>> bool(error_m[0] < 1e-6)
    True
    """
    starts, sizes = offsets[:-1], np.diff(offsets)
    shared, true = _centred(xy, offsets), _centred(truth, offsets)
    squares = np.add.reduceat(np.abs(shared) ** 2 + np.abs(true) ** 2, starts)
    # The best rotation makes the sum of products real: its modulus.
    squares -= 2.0 * np.abs(np.add.reduceat(shared.conj() * true, starts))
    return np.where(sizes == 1, np.nan, np.sqrt(np.maximum(squares, 0.0) / sizes))


def _centred(xy: Floats, offsets: Ints) -> Complexes:
    """Return positions as complex numbers about the mean of their track, (M,) m."""
    starts, sizes = offsets[:-1], np.diff(offsets)
    points = xy[:, 0] + 1j * xy[:, 1]
    return points - np.repeat(np.add.reduceat(points, starts) / sizes, sizes)


def mean_interval_s(*, t: Floats, offsets: Ints) -> Floats:
    """Return the mean sampling interval of each trajectory, (N,) s.

    NaN for a single sample. `t` is (M,) s, `offsets` (N + 1,).
    """
    intervals = np.diff(offsets) - 1
    span_s = t[offsets[1:] - 1] - t[offsets[:-1]]
    unknown = np.full(span_s.shape, np.nan)
    return np.asarray(np.divide(span_s, intervals, out=unknown, where=intervals > 0))
