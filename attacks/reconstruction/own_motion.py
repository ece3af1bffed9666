"""How each person moves, read off the release: a bank of motions, weighed track by track.

A smoother of one motion takes who stands for as restless as who turns. Here every track is smoothed
under several motions, and the results are mixed by how probable each is: its likelihood, times how
common it is among the tracks of the release (empirical Bayes). Slow velocities that forget soon are
of people who stand; fast ones that last are of people who walk on. Nothing of that is told by
anybody. As a kernel over time the mixture is one of integrated Ornstein-Uhlenbeck processes.

References
----------
Empirical Bayes with finitely many components: Efron, *Large-Scale Inference*, 2010, ch. 1 and 5;
EM for their shares: Dempster, Laird, Rubin, J. R. Statist. Soc. B 39(1), 1977, 1-38.
"""

import numpy as np
from scipy.special import softmax

from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import Motions, SlowError, motion_log_likelihoods, smooth_mixture
from isac_track.types import Floats

MOTIONS = Motions.with_speeds(
    *((0.05, 1.0), (0.2, 2.0), (0.2, 12.0), (1.0, 4.0), (1.0, 16.0), (1.0, 64.0))
)
"""Speed, m/s per axis, and time, s: standing, shuffling, strolling, and walking, ever straighter.

Twice as many gain at most another half point of PLR. A motion that is both fast and smoother than
the last one is left out: where a walk sways, the likelihood takes the errors for the sway.
"""
_TURNS = 60  # Of the EM: the shares then stand to a percent.
_LEAST_WEIGHT = 0.02  # Of a motion for a track: below, it is not smoothed.


def smooth_own_motion(
    batch: Batch, error: SlowError, *, passes: int, anneal: float
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    Parameters are those of `isac_track.kalman.slow_errors.smooth_tracks`.
    """
    weight = probabilities(motion_log_likelihoods(batch, error, MOTIONS))
    weight[weight < _LEAST_WEIGHT] = 0.0
    return smooth_mixture(batch, error, MOTIONS, weight, passes=passes, anneal=anneal)


def probabilities(log_likelihood: Floats) -> Floats:
    """Return how probable each motion is for each track, (N, K), by its log likelihood, (N, K).

    The prior is the share of each motion among all tracks, found by EM; an even share counts for
    one more track, so that few tracks decide nothing for sure.
    """
    n_tracks, n_motions = log_likelihood.shape
    share = np.full(n_motions, 1.0 / n_motions)
    for _ in range(_TURNS):
        posterior = softmax(log_likelihood + np.log(share), axis=1)
        share = (posterior.sum(axis=0) + 1.0 / n_motions) / (n_tracks + 1.0)
    return np.asarray(softmax(log_likelihood + np.log(share), axis=1))
