"""Smooth each track under several motions, weighed by how probable each motion is.

A smoother with a single motion assumes that people who stand are as restless as people
who turn. Here every track is smoothed under several motions, and the results are mixed
by the probability of each: its likelihood, times its share among people. People who
stand have slow velocities that change soon; those of people who walk on are fast and
last. As a kernel over time the mixture is one of integrated Ornstein-Uhlenbeck
processes.

References
----------
Multiple-model adaptive estimation: Magill, IEEE Trans. Automatic Control 10(4), 1965,
434-439; Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and
Navigation*, 2001, section 11.6.2 (static multiple models).
"""

import numpy as np
from scipy.special import softmax

from attacks.remembered import memoised_by_track, noise_m2
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import (
    Motions,
    SlowError,
    motion_log_likelihoods,
    smooth_mixture,
)
from isac_track.types import Floats, Release

# m around the first sample and m/s around rest: far more than any walk.
PRIOR_STD = (100.0, 10.0)
MOTIONS = Motions.with_speeds(
    (0.01, 1.0),
    (0.05, 1.0),
    (0.2, 2.0),
    (0.2, 12.0),
    (1.0, 4.0),
    (1.0, 16.0),
    (1.0, 64.0),
)
"""Speed, m/s per axis, and time, s, of each motion: from standing still to walking.

Behind a slow error, a person who stands still is at the mean of the track: hence two
motions for standing. Twice as many motions gain at most another half point of PLR. The
bank has no motion that is both fast and smoother than the last: for a walk that
sways, its likelihood would attribute errors to the sway.
"""
SHARES = (0.05, 0.05, 0.1, 0.15, 0.05, 0.15, 0.45)
"""Share of each motion: rounded means of Students03 and the bundled crowd.

Half of the people who stand are still. Shares estimated from the release itself (EM)
gain less than 0.2 points, and a track would depend on the others.
"""
_LEAST_WEIGHT = 0.02  # Below this weight, a track is not smoothed under a motion.


def smooth_own_motion(
    batch: Batch, error: SlowError, weight: Floats, *, passes: int, anneal: float
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    `weight`, (N, K), is the probability of each of `MOTIONS` for each track; other
    parameters are those of `isac_track.kalman.slow_errors.smooth_tracks`.
    """
    used = np.where(weight < _LEAST_WEIGHT, 0.0, weight)
    return smooth_mixture(batch, error, MOTIONS, used, passes=passes, anneal=anneal)


@memoised_by_track()
def white_probabilities(release: Release) -> Floats:
    """Return the probability of each motion per track, (N, K), behind white errors.

    The level of the errors comes from innovations: further knowledge of them hardly
    changes the result.
    """
    variance = np.repeat(noise_m2(release), np.diff(release.offsets))
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    return probabilities(batch, SlowError(0.0, 0.0))


def probabilities(batch: Batch, error: SlowError) -> Floats:
    """Return the probability of each motion for each track, (N, K), given `SHARES`."""
    log_likelihood = motion_log_likelihoods(batch, error, MOTIONS)
    return np.asarray(softmax(log_likelihood + np.log(SHARES), axis=1))
