"""The smoother as an attack is filterpy's."""

import numpy as np
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import one_by_one
from helpers.walks import context, cv_walks, flat_release

from attacks.reconstruction.kalman_rts import PRIOR_STD, KalmanRTS
from isac_track.kalman import Batch
from isac_track.rng import stream
from isac_track.types import Knowledge


def test_with_the_true_noise_it_is_filterpys_smoother():
    t, truth, offsets = cv_walks(80, 1, 2, 30)
    rng = stream(0, "test", "rts")
    std = rng.uniform(0.2, 0.8, t.size)
    xy = truth + std[:, None] * rng.standard_normal(truth.shape)
    # Declared is the length, as under the radial law.
    release = flat_release(t, xy, offsets, sigma=std * np.sqrt(2.0))
    found = KalmanRTS(q=0.04).fit(context(granted={Knowledge.SIGMA}))(release)
    for rows, track in one_by_one(Batch(t, xy, std**2, offsets, PRIOR_STD), q=0.04):
        mean, cov = oracle.filterpy_smooth(**track)
        np.testing.assert_allclose(found.xy[rows], mean[:, :, 0], rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.std[rows], np.sqrt(cov[:, 0, 0]), rtol=1e-6)
