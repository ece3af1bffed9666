"""Noise levels on both sides of a silence, as evidence that one person made both walks.

The channel of a person who walks on changes slowly: shadowing is correlated over some
metres (Gudmundson, "Correlation model for shadow fading in mobile radio systems",
Electron. Lett. 27, 1991). Innovations of the shared positions show its level to every
adversary.
"""

from dataclasses import dataclass
from math import exp, log
from typing import Final, NamedTuple

import numpy as np

from attacks.remembered import as_shared, memoised_by_track
from isac_track.noise import scaled_innovations_m2
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Floats, Ints, Release

# The weight of a sample falls by 1/e for so many seconds between it and the silence.
_RECENT_S: Final = 2.0
_LONGEST_S: Final = 60.0  # A sample that is farther away counts as this far.
_RELATIVE_VARIANCE: Final = 3.0
"""Variance of the log of a mean of n squared innovations, times n.

It exceeds that without overlap, since neighbours share samples. It is 3 for radial
errors and 1.9 for Gaussian errors (tested).
"""
# Variance of the log level of a track that is too short for a level.
_UNKNOWN: Final = 1e6
# (1 cm)^2: below it innovations show how people accelerate, not noise.
_LEAST_M2: Final = 1e-4
_LEAST_VARIANCE: Final = 1e-2  # Of log levels over people.
_CORRELATIONS: Final = tuple(step / 20.0 for step in range(20))


class NoiseLevels(NamedTuple):
    """Noise levels of N tracks where a silence begins or ends."""

    log_m2: Floats  # (N,) log of the error variance per axis, in m^2.
    variance: Floats  # (N,) variance of this estimate, without unit.

    def tracks(self, rows: Ints) -> "NoiseLevels":
        """Return the levels of some of the tracks."""
        return NoiseLevels(self.log_m2[rows], self.variance[rows])


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Log noise levels of a person before and after a silence, jointly normal."""

    correlation: float
    """Between both levels, in [0, 1); 0: levels are no evidence."""
    variance: float
    """Of log levels over people, without the variance of their estimates."""


_SHADOWING_DB: Final = 4.0
_DECORRELATION_M: Final = 10.0
_ASSUMED_WAY_M: Final = 7.0  # 3 s of silence and 1 s on either side, at 1.4 m/s
ASSUMED: Final = NoiseModel(
    correlation=round(exp(-_ASSUMED_WAY_M / _DECORRELATION_M), 1),
    variance=(_SHADOWING_DB * log(10.0) / 10.0) ** 2,
)
"""The model of an adversary without a training set.

It has the spread and decorrelation distance of shadowing in a street with line of sight
(3GPP TR 38.901, tables 7.4.1-1 and 7.5-6).
"""


def log_ratios(probe: Release, gallery: Release, model: NoiseModel) -> Floats:
    """Return the log likelihood ratio of each pair's noise levels, (P, G).

    Behind a reconstruction, levels are those of the positions as shared.
    """
    ends, starts = end_levels(probe, 1), end_levels(gallery, -1)
    square = np.square(ends.log_m2[:, None] - starts.log_m2)
    return _log_ratios(square, ends.variance[:, None] + starts.variance, model)


def _log_ratios(square: Floats, measured: Floats, model: NoiseModel) -> Floats:
    """Return the log likelihood ratios of squared differences of two log levels.

    A difference is normal. Its variance is 2 s^2 (1 - c) for one person and 2 s^2 for
    two, with s^2 and c of the model. Both grow by `measured`, the sum of the variances
    of the estimates.
    """
    strangers = measured + 2.0 * model.variance
    person = strangers - 2.0 * model.variance * model.correlation
    ratios = np.log(strangers / person) + square / strangers - square / person
    return np.asarray(0.5 * ratios)


def fitted_model(train: LinkageTrainingSet) -> NoiseModel:
    """Return the model of noise levels that fits a training set.

    The variance is that of all levels less that of their estimates. The correlation
    makes the differences of mates most probable. The model is `ASSUMED` if no track has
    a level.
    """
    ends, starts = end_levels(train.probe, 1), end_levels(train.gallery, -1)
    log_m2 = np.concatenate([ends.log_m2, starts.log_m2])
    measured = np.concatenate([ends.variance, starts.variance])
    has_level = measured < _UNKNOWN
    if not has_level.any():
        return ASSUMED
    variance = max(
        float(log_m2[has_level].var() - measured[has_level].mean()), _LEAST_VARIANCE
    )
    rows = np.flatnonzero(train.mate >= 0)
    mate = train.mate[rows]
    square = np.square(ends.log_m2[rows] - starts.log_m2[mate])
    added = ends.variance[rows] + starts.variance[mate]
    models = [NoiseModel(correlation, variance) for correlation in _CORRELATIONS]
    return max(models, key=lambda model: float(_log_ratios(square, added, model).sum()))


def end_levels(release: Release, direction: int) -> NoiseLevels:
    """Return the noise levels at the ends of walks (`direction` 1) or starts (-1).

    A level is the mean of squared innovations of the positions as shared, weighted by
    how near they are to the silence. A track of fewer than three samples has the
    variance `_UNKNOWN`.
    """
    return _levels(as_shared(release), direction)


@memoised_by_track(NoiseLevels.tracks)
def _levels(shared: Release, direction: int) -> NoiseLevels:
    t, offsets, n_tracks = shared.t, shared.offsets, len(shared)
    log_m2, variance = np.zeros(n_tracks), np.full(n_tracks, _UNKNOWN)
    silence_s = t[offsets[1:] - 1] if direction > 0 else t[offsets[:-1]]
    owner: Ints = np.repeat(np.arange(n_tracks), np.diff(offsets))
    within = owner[2:] == owner[:-2]
    track = owner[2:][within]
    if not track.size:
        return NoiseLevels(log_m2, variance)
    square_m2 = scaled_innovations_m2(t=t, xy=shared.xy, offsets=offsets)[within]
    age_s = np.minimum(np.abs(t[1:-1][within] - silence_s[track]), _LONGEST_S)
    weight = np.exp(-age_s / _RECENT_S)
    total = np.bincount(track, weight, n_tracks)
    square_weights = np.bincount(track, weight**2, n_tracks)
    weighted_m2 = np.bincount(track, weight * square_m2, n_tracks)
    rows = total > 0.0
    log_m2[rows] = np.log(np.maximum(weighted_m2[rows] / total[rows], _LEAST_M2))
    variance[rows] = _RELATIVE_VARIANCE * square_weights[rows] / total[rows] ** 2
    return NoiseLevels(log_m2, variance)
