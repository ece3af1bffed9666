"""An attack that learns how slowly errors change, whatever noise a mechanism adds.

    python -m evaluation.board --attack matched_smoother:MatchedSmoother cards --out board

A smoother removes the quick errors. What is left is slow, and its covariance over time
is measured on other people. The walk is then the best linear estimate under that
covariance, with people who accelerate at random. `ou_rts` knows a single form of slow
errors; this attack knows none, and takes the form from the data.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from attacks.building_blocks import make_attack
from isac_track.protocols import AttackContext
from isac_track.types import Knowledge, Reconstruction

LAG_S, LONGEST_S = 0.5, 40.0  # Step and end of the measured covariance.
START_M = 30.0  # Standard deviation of a walk's start.
MOTIONS = ((1e-6, 1e-3), (1e-4, 0.05), (0.01, 1.5), (0.04, 1.5), (0.16, 1.5))
"""Density of the acceleration, m^2/s^3, and standard deviation of the first speed, m/s.

The first stands still. Each person has the motion that makes the positions likeliest.
"""


@dataclass(frozen=True)
class MatchedSmoother:
    """Best linear estimates under the error covariance of other people."""

    every_s: float = 0.5  # Step of the estimates; between them errors hardly change.

    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context):
        train = context.train
        blind = AttackContext(rng=context.rng, epsilon_m=context.epsilon_m)
        smooth = make_attack("radial_rts").fit(blind)
        smoothed = smooth(train.release).xy
        covariance = error_covariance(train.release, smoothed - train.truth)

        def rebuild(release, smoothed):
            xy = smoothed.copy()
            for first, end in pairwise(release.offsets):
                t, own = release.t[first:end], smoothed[first:end]
                rows = thinned(t, self.every_s)
                if rows.size > 2:
                    moved = matched(t[rows], own[rows], covariance) - own[rows]
                    xy[first:end] += np.column_stack(
                        [np.interp(t, t[rows], moved[:, axis]) for axis in (0, 1)]
                    )
            return xy

        def known(xy):
            return (np.hypot(*(xy - train.truth).T) < context.epsilon_m).mean()

        if known(rebuild(train.release, smoothed)) <= known(smoothed):
            return smooth

        def reconstruct(release):
            return Reconstruction(rebuild(release, smooth(release).xy), None)

        return reconstruct


def thinned(t, every_s):
    """Samples at least a step apart."""
    number = np.floor((t - t[0]) / every_s).astype(int)
    return np.flatnonzero(np.diff(number, prepend=-1) > 0)


def error_covariance(release, error):
    """The mean product of errors by lag, on the grid of lags, m^2 per axis."""
    total, count = (
        np.zeros(int(LONGEST_S / LAG_S) + 1),
        np.zeros(int(LONGEST_S / LAG_S) + 1),
    )
    for first, end in pairwise(release.offsets):
        rows = first + thinned(release.t[first:end], LAG_S)
        lag = np.rint(
            np.abs(np.subtract.outer(release.t[rows], release.t[rows])) / LAG_S
        )
        product = error[rows] @ error[rows].T / 2.0
        is_near = lag < total.size
        np.add.at(total, lag[is_near].astype(int), product[is_near])
        np.add.at(count, lag[is_near].astype(int), 1.0)
    taper = np.linspace(1.0, 0.0, total.size)
    return taper * total / np.maximum(count, 1.0)


def matched(t, xy, covariance):
    """The best linear estimate of a walk, (n, 2) m, from positions with slow errors."""
    since = t - t[0]
    early, late = np.minimum.outer(since, since), np.maximum.outer(since, since)
    lag = np.abs(np.subtract.outer(t, t))
    noise = np.interp(lag, LAG_S * np.arange(covariance.size), covariance, right=0.0)
    # What was measured need not be a covariance: negative parts are left out.
    value, vector = np.linalg.eigh(noise)
    noise = (vector * np.maximum(value, 1e-4)) @ vector.T
    middle = xy.mean(axis=0)
    estimates = []
    for q, speed_mps in MOTIONS:
        walk = q * (early**2 * late / 2.0 - early**3 / 6.0)
        walk += START_M**2 + speed_mps**2 * np.multiply.outer(since, since)
        solved = np.linalg.solve(walk + noise, xy - middle)
        likelihood = -(solved * (xy - middle)).sum() / 2.0
        likelihood -= np.linalg.slogdet(walk + noise)[1]
        estimates.append((likelihood, middle + walk @ solved))
    return max(estimates, key=lambda pair: pair[0])[1]
