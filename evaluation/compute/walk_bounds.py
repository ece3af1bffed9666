"""How well the walks of a release can be estimated: linear benchmark, and genie.

The genie is an imagined adversary that knows the scale of every error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS
from attacks.reconstruction.own_motion import PRIOR_STD
from evaluation.compute.model_walks import recording_own_motions
from evaluation.compute.tables import Rows, track_means
from isac_track.kalman import Batch, smooth_ellipses, smooth_positions
from isac_track.measurement import (
    axis_share,
    error_ellipses,
    mean_variance,
    share_within,
)
from isac_track.model_world import known_share, release_errors
from isac_track.rng import stream

if TYPE_CHECKING:
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Release, Scenes, Sensed

BENCHMARK_Q = KalmanRTS.DEFAULT_Q  # m^2/s^3, motion of the benchmark.
_BENCHMARK = ("benchmark_mse_m2", "benchmark_plr")
_LEAST_VARIANCE_M2 = 1e-12


def genie_plr(
    mechanism: Plugin,
    release: Release,
    *,
    scenes: Scenes,
    sensed: Sensed,
    tracks: Cut,
    is_model: bool,
    epsilon_m: float,
    seed: int,
) -> Rows:
    """Return the PLR of the genie, and of the exact posterior where it is known.

    It is known in a model world with Gaussian errors. Both know how each person moves,
    by the motions that were fitted to the `tracks` of the recording. For recorded walks
    neither is a bound: these follow no model.
    """
    rng = stream(seed, "genie", mechanism.spec, int(scenes.index[0]))
    errors = release_errors(
        release=release, sensed=sensed, mechanism=mechanism.instance, rng=rng
    )
    unknown = np.full(len(release), np.nan)
    if errors is None:  # a mechanism whose errors even the genie does not know
        return {"plr_ceiling": unknown, "plr_optimum": unknown}
    known = known_share(
        t=release.t,
        offsets=release.offsets,
        errors=errors,
        motion=recording_own_motions(tracks).take(scenes.track),
        epsilon_m=epsilon_m,
    )
    is_exact = is_model and errors.is_gaussian
    return {"plr_ceiling": known, "plr_optimum": known if is_exact else unknown}


def benchmark(
    release: Release, *, sensed: Sensed, mechanism: Plugin, epsilon_m: float
) -> Rows:
    """Return the linear benchmark's expected squared error and PLR of each track, (N,).

    The benchmark is the exact smoother of a constant-velocity walk that knows the
    variance of every sample: no linear estimator has a smaller expected squared error,
    and none at all if the errors are Gaussian. Its posterior covariance P per axis
    depends on no position: the expected squared error is 2 P, and a Gaussian error of
    that size leaks with probability 1 - exp(-epsilon^2 / 2P). NaN for a mechanism that
    denies `errors_are_independent`: its errors depend on each other. Errors with a shape
    leave a P of both axes together; the PLR then is `share_within`.
    """
    if not getattr(mechanism.instance, "errors_are_independent", True):
        return dict.fromkeys(_BENCHMARK, np.full(len(release), np.nan))
    if release.cov is not None:
        return _shaped_benchmark(release, release.cov, epsilon_m=epsilon_m)
    law = getattr(mechanism.instance, "law", None) or sensed.law
    assert release.sigma is not None  # `share` refuses a release without
    shared_m2, raw_m2 = release.sigma**2, sensed.sigma_raw**2
    # A mechanism that reduces the raw error scales it; an added error has the law
    # of the mechanism. An error of standard deviation 1 has this variance per axis.
    variance = axis_share(sensed.law) * np.minimum(shared_m2, raw_m2)
    variance += axis_share(law) * np.maximum(shared_m2 - raw_m2, 0.0)
    variance = np.maximum(variance, _LEAST_VARIANCE_M2, out=variance)
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    square_m2 = 2.0 * smooth_positions(batch, q=BENCHMARK_Q)[1]
    leaked = -np.expm1(-(epsilon_m**2) / square_m2)
    return _benchmark_rows(square_m2, leaked, release)


def _shaped_benchmark(release: Release, cov: Floats, *, epsilon_m: float) -> Rows:
    """Return the benchmark of errors with declared covariances, (M, 2, 2) m^2."""
    batch = Batch(
        t=release.t,
        xy=release.xy,
        variance=np.maximum(mean_variance(cov), _LEAST_VARIANCE_M2),
        offsets=release.offsets,
        prior_std=PRIOR_STD,
        ellipse=error_ellipses(cov),
    )
    _, posterior = smooth_ellipses(batch, q=BENCHMARK_Q)
    leaked = share_within(posterior, epsilon_m=epsilon_m)
    return _benchmark_rows(2.0 * mean_variance(posterior), leaked, release)


def _benchmark_rows(square_m2: Floats, leaked: Floats, release: Release) -> Rows:
    return {
        "benchmark_mse_m2": track_means(square_m2, release.offsets),
        "benchmark_plr": track_means(leaked, release.offsets),
    }
