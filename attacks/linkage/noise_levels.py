"""How noisy positions are on both sides of a silence, as evidence that they are one person's.

The channel of a person who walks on changes slowly: shadowing is correlated over some
metres (Gudmundson, "Correlation model for shadow fading in mobile radio systems",
Electron. Lett. 27, 1991). Innovations of the shared positions tell its level to
everybody.
"""

from dataclasses import dataclass
from math import exp, log
from typing import Final, NamedTuple

import numpy as np

from attacks.remembered import as_shared, by_track
from isac_track.noise import scaled_innovations_m2
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Floats, Ints, Release

# A sample counts by 1/e less for every so many seconds from the silence.
_RECENT_S: Final = 2.0
_LONGEST_S: Final = 60.0  # An earlier sample counts as one of this age.
_RELATIVE_VARIANCE: Final = 3.0
"""Variance of the log of a mean of n squared innovations, times n: neighbours share samples. It
is 3 for radial errors and 1.9 for Gaussian ones (tested)."""
# Variance of the log level of a track that is too short to have one.
_UNKNOWN: Final = 1e6
# (1 cm)^2: below it innovations show how people accelerate, not noise.
_LEAST_M2: Final = 1e-4
_LEAST_VARIANCE: Final = 1e-2  # Of log levels over people.
_CORRELATIONS: Final = tuple(step / 20.0 for step in range(20))


class NoiseLevels(NamedTuple):
    """Noise levels of N tracks where a silence begins or ends."""

    log_m2: Floats  # (N,) log of the error variance per axis, in m^2.
    variance: Floats  # (N,) variance of this estimate, without unit.


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Log noise levels of a person before and after a silence, jointly normal."""

    correlation: float
    """Between both levels, in [0, 1); 0: levels tell nothing."""
    variance: float
    """Of log levels over people, without what estimating them adds."""


_SHADOWING_DB: Final = 4.0
_DECORRELATION_M: Final = 10.0
_ASSUMED_WAY_M: Final = 7.0  # 3 s of silence and 1 s on either side, at 1.4 m/s
ASSUMED: Final = NoiseModel(
    correlation=round(exp(-_ASSUMED_WAY_M / _DECORRELATION_M), 1),
    variance=(_SHADOWING_DB * log(10.0) / 10.0) ** 2,
)
"""For an adversary without a training set: spread and decorrelation distance of shadowing in a
street with line of sight (3GPP TR 38.901, tables 7.4.1-1 and 7.5-6)."""


def log_ratios(probe: Release, gallery: Release, model: NoiseModel) -> Floats:
    """Return the log likelihood ratio of each pair's noise levels, (P, G).

    Behind a reconstruction levels are those of the positions as shared.
    """
    ends, starts = end_levels(probe, 1), end_levels(gallery, -1)
    square = np.square(ends.log_m2[:, None] - starts.log_m2)
    return _log_ratios(square, ends.variance[:, None] + starts.variance, model)


def _log_ratios(square: Floats, measured: Floats, model: NoiseModel) -> Floats:
    """Return the log likelihood ratios of squared differences of two estimated log levels.

    A difference is normal. Its variance is 2 s^2 (1 - c) for one person and 2 s^2 for
    two, with s^2 and c of the model; to both is added `measured`, the sum of the
    variances of the estimates.
    """
    strangers = measured + 2.0 * model.variance
    person = strangers - 2.0 * model.variance * model.correlation
    ratios = np.log(strangers / person) + square / strangers - square / person
    return np.asarray(0.5 * ratios)


def fitted_model(train: LinkageTrainingSet) -> NoiseModel:
    """Return how levels vary over the people of a training set, and how far they persist.

    The variance is that of all levels less what estimating them adds; the correlation
    makes the differences of mates most probable. Without anybody whose level is known
    it is `ASSUMED`.
    """
    ends, starts = end_levels(train.probe, 1), end_levels(train.gallery, -1)
    log_m2, measured = (np.concatenate(each) for each in zip(ends, starts, strict=True))
    known = measured < _UNKNOWN
    if not known.any():
        return ASSUMED
    variance = max(float(log_m2[known].var() - measured[known].mean()), _LEAST_VARIANCE)
    rows = np.flatnonzero(train.mate >= 0)
    mate = train.mate[rows]
    square = np.square(ends.log_m2[rows] - starts.log_m2[mate])
    both = ends.variance[rows] + starts.variance[mate]
    models = [NoiseModel(correlation, variance) for correlation in _CORRELATIONS]
    return max(models, key=lambda model: float(_log_ratios(square, both, model).sum()))


def end_levels(release: Release, at: int) -> NoiseLevels:
    """Return the noise levels at the ends of walks, or (-1) at their starts.

    The mean of squared innovations of the positions as shared, the nearer to the
    silence the more weight. A track of fewer than three samples has the variance
    `_UNKNOWN`.
    """
    return _levels(as_shared(release), at)


@by_track(lambda levels, rows: NoiseLevels(*(values[rows] for values in levels)))
def _levels(shared: Release, at: int) -> NoiseLevels:
    t, offsets, n_tracks = shared.t, shared.offsets, len(shared)
    log_m2, variance = np.zeros(n_tracks), np.full(n_tracks, _UNKNOWN)
    silence_s = t[offsets[1:] - 1] if at > 0 else t[offsets[:-1]]
    owner: Ints = np.repeat(np.arange(n_tracks), np.diff(offsets))
    within = owner[2:] == owner[:-2]
    track = owner[2:][within]
    if not track.size:
        return NoiseLevels(log_m2, variance)
    square_m2 = scaled_innovations_m2(t=t, xy=shared.xy, offsets=offsets)[within]
    age_s = np.minimum(np.abs(t[1:-1][within] - silence_s[track]), _LONGEST_S)
    weight = np.exp(-age_s / _RECENT_S)
    total, squares, both = (
        np.bincount(track, each, n_tracks)
        for each in (weight, weight**2, weight * square_m2)
    )
    has = total > 0.0
    log_m2[has] = np.log(np.maximum(both[has] / total[has], _LEAST_M2))
    variance[has] = _RELATIVE_VARIANCE * squares[has] / total[has] ** 2
    return NoiseLevels(log_m2, variance)
