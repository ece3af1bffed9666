"""The smoother as an attack: filterpy's RTS, what is learnt, and what is claimed."""

from itertools import pairwise

import numpy as np
from helpers import kernel_oracles as oracle
from helpers.walks import context, cv_walks, flat_release

from attacks.reconstruction.kalman_rts import PRIOR_STD, KalmanRTS
from isac_track.rng import stream
from isac_track.types import Knowledge


def walks(*sizes, noise_m=(0.2, 0.8)):
    """A release of exact constant-velocity walks, noise drawn per sample, and the truth."""
    t, truth, offsets = cv_walks(*sizes)
    rng = stream(0, "test", "rts", *sizes)
    std = rng.uniform(*noise_m, len(truth))
    xy = truth + std[:, None] * rng.standard_normal(truth.shape)
    # Declared is the length, as under the radial law.
    return flat_release(t, xy, offsets, sigma=std * np.sqrt(2.0)), truth


def test_with_the_true_noise_it_is_filterpys_smoother():
    release, _ = walks(80, 1, 2, 30)
    found = KalmanRTS(q=0.04).fit(context(granted={Knowledge.SIGMA}))(release)
    for lo, hi in pairwise(release.offsets):
        theirs = oracle.filterpy_track(
            t=release.t[lo:hi],
            xy=release.xy[lo:hi],
            variance=release.sigma[lo:hi] ** 2 / 2,
            q=0.04,
            mean=np.stack([release.xy[lo], np.zeros(2)], axis=1),
            cov=np.diag(PRIOR_STD) ** 2,
        )
        mean, cov, _, _ = theirs["kf"].rts_smoother(
            theirs["mean"], theirs["cov"], theirs["fs"], theirs["qs"]
        )
        np.testing.assert_allclose(found.xy[lo:hi], mean[:, [0, 2]], rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.std[lo:hi], np.sqrt(cov[:, 0, 0]), rtol=1e-6)
