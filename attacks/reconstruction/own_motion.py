"""How each person moves, read off the release: a bank of motions, weighed track by track.

A smoother of one motion takes who stands for as restless as who turns. Here every track
is smoothed under several motions, and the results are mixed by how probable each is:
its likelihood, times how common it is among people. Slow velocities that forget soon
are of people who stand; fast ones that last are of people who walk on. As a kernel over
time the mixture is one of integrated Ornstein-Uhlenbeck processes.

References
----------
Multiple-model adaptive estimation: Magill, IEEE Trans. Automatic Control 10(4), 1965,
434-439; Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and
Navigation*, 2001, section 11.6.2 (static multiple models).
"""

import numpy as np
from scipy.special import softmax

from attacks.remembered import by_track, noise_m2
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import (
    Motions,
    SlowError,
    motion_log_likelihoods,
    smooth_mixture,
)
from isac_track.types import Floats, Release

PRIOR_STD = (
    100.0,
    10.0,
)  # m around the first sample and m/s around rest: far more than any walk.
MOTIONS = Motions.with_speeds(
    (0.01, 1.0),
    (0.05, 1.0),
    (0.2, 2.0),
    (0.2, 12.0),
    (1.0, 4.0),
    (1.0, 16.0),
    (1.0, 64.0),
)
"""Speed, m/s per axis, and time, s: standing still, standing, shuffling, strolling, walking.

Behind a slow error whoever stands still is at the mean of the track: hence two ways to
stand. Twice as many gain at most another half point of PLR. A motion that is both fast
and smoother than the last one is left out: where a walk sways, the likelihood takes its
errors for the sway.
"""
SHARES = (0.05, 0.05, 0.1, 0.15, 0.05, 0.15, 0.45)
"""How common each is: rounded means of Students03 and the bundled crowd; half of those who stand
are still. Shares found in the release itself (EM) gain less than 0.2 points, and a
track would depend on the others."""
_LEAST_WEIGHT = 0.02  # Of a motion for a track: below, it is not smoothed.


def smooth_own_motion(
    batch: Batch, error: SlowError, weight: Floats, *, passes: int, anneal: float
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    `weight`, (N, K), says how probable each of `MOTIONS` is for each track; other
    parameters are those of `isac_track.kalman.slow_errors.smooth_tracks`.
    """
    some = np.where(weight < _LEAST_WEIGHT, 0.0, weight)
    return smooth_mixture(batch, error, MOTIONS, some, passes=passes, anneal=anneal)


@by_track()
def white_probabilities(release: Release) -> Floats:
    """Return how probable each motion is for each track, (N, K), behind white errors.

    Their level is what innovations show: what else an adversary knows of them hardly
    matters here.
    """
    variance = np.repeat(noise_m2(release), np.diff(release.offsets))
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    return probabilities(batch, SlowError(0.0, 0.0))


def probabilities(batch: Batch, error: SlowError) -> Floats:
    """Return how probable each motion is for each track, (N, K), by likelihood and `SHARES`."""
    log_likelihood = motion_log_likelihoods(batch, error, MOTIONS)
    return np.asarray(softmax(log_likelihood + np.log(SHARES), axis=1))
