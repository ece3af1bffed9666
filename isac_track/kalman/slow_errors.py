"""Filter and smoother of a constant-velocity walk behind a slowly changing error.

Per axis the state is (p, v, e): position and velocity as in `isac_track.kalman`, and an
error that is an Ornstein-Uhlenbeck process of standard deviation s, correlated as
exp(-dt / tau). The measurement is p + e plus white noise of the batch's variance. An
adversary who knows s, tau and how people accelerate separates p from e as well as
Gaussian errors allow.

References
----------
Colored measurement noise by augmenting the state: Bar-Shalom, Li, Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, section 8.2. Smoother:
Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18(1),
1973, 65-75 (modified Bryson-Frazier).
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Final, NamedTuple

import numpy as np

from isac_track.kalman import (
    MAX_REJECTIONS,
    Batch,
    LastState,
    PlanarState,
    smooth_planar,
)
from isac_track.measurement import mean_variance
from isac_track.noise import running_means
from isac_track.types import Floats, Ints, positive

LEAST_REST: Final = 0.05
"""Least share of the innovations' variance that is not attributed to a slow error."""


@dataclass(frozen=True, eq=False, slots=True)
class SlowError:
    """An error that changes slowly along a track. ValueError if out of range."""

    std_m: Floats | float
    """m per axis: a number, or (M,); it scales a process of variance 1."""
    # Time over which the correlation falls to 1/e; 0: white, infinite: constant.
    tau_s: float

    def __post_init__(self) -> None:
        if not (
            np.isfinite(self.std_m).all() and np.min(self.std_m, initial=0.0) >= 0.0
        ):
            raise ValueError(f"std_m must be finite and not negative, got {self.std_m}")
        if not self.tau_s >= 0.0:
            raise ValueError(f"tau_s must not be negative, got {self.tau_s}")

    def innovation_share(
        self, *, t: Floats, offsets: Ints, running: bool = False
    ) -> Floats:
        """Return the share of the error's variance that innovations show, (N,).

        Innovations are those of `isac_track.noise`: the share is their mean square,
        divided by s^2. It is nearly 0 for a slow error, 1 for a white error, and 1 for
        tracks of fewer than three samples. With `running` it is the share of the
        samples up to each, (M,).
        """
        if self.tau_s == 0.0:
            return np.ones(t.size if running else offsets.size - 1)
        steps, ratio = np.diff(t), np.ones(max(t.size - 2, 0))
        first, second = steps[:-1], steps[1:]
        np.divide(second, first, out=ratio, where=first > 0.0)
        gaps = second, first, first + second
        near, far, whole = (np.exp(-np.abs(gap) / self.tau_s) for gap in gaps)
        a, b = 1.0 + ratio, ratio  # e_k - a e_(k-1) + b e_(k-2)
        scale = 1.0 + a * a + b * b
        share = (scale - 2.0 * (a * near + a * b * far - b * whole)) / scale
        shares = running_means(share, offsets, start=1.0)
        return shares if running else shares[offsets[1:] - 1]

    def arrays(self, batch: Batch) -> tuple[Floats | Ints, ...]:
        """Return batch and error as a compiled loop takes them: a plain tuple.

        Behind what `Batch.arrays` returns stands the error's standard deviation at each
        sample.
        """
        return (*batch.arrays(2), np.full(batch.t.size, self.std_m, dtype=np.float64))

    def planar_arrays(self, batch: Batch) -> tuple[Floats | Ints, ...]:
        """Return the arguments of a compiled loop for white errors with a shape."""
        _, xy, variance, offsets, prior, axes, shares = batch.planar_arrays(2)
        amplitude = np.full(batch.t.size, self.std_m, dtype=np.float64)
        return xy, variance, offsets, prior, amplitude, axes, shares

    def steps(self, batch: Batch, motion: Floats) -> Floats:
        """Return the step to each sample under a motion, (M, 6), for planar loops."""
        steps = np.empty((batch.t.size, 5))
        loops = import_module("isac_track.kalman._error_loops")
        loops.fill_steps(batch.t, batch.offsets, motion, steps)
        memory = np.zeros(batch.t.size)
        if self.tau_s > 0.0:
            elapsed_s = np.diff(batch.t, prepend=batch.t[:1])
            elapsed_s[batch.offsets[:-1]] = 0.0
            memory = np.exp(-elapsed_s / self.tau_s)
        return np.column_stack([steps, memory])


def added_error(mechanism: object) -> tuple[float, float]:
    """Return the error that a mechanism adds: standard deviation, m per axis; tau, s.

    tau is 0 for white errors, infinite for an error that is constant along a track. The
    parameters `std_m` (per axis), `distance`, `alpha` and `beta` (where the rule adds
    most) or `d_sigma`, and `tau_s` are read. `distance` and `d_sigma` are those of
    radial errors, unless `law` says isotropic. (0, 0) for a mechanism without any of
    them.
    """
    parameters = {
        name: float(getattr(mechanism, name, 0.0) or 0.0)
        for name in ("std_m", "distance", "alpha", "beta", "d_sigma", "tau_s")
    }
    if parameters["std_m"]:
        return parameters["std_m"], parameters["tau_s"]
    if parameters["distance"]:
        return parameters["distance"] / np.sqrt(2.0), np.inf
    slow_rule = parameters["alpha"] > 0.0 and parameters["tau_s"] > 0.0
    isotropic = slow_rule or getattr(mechanism, "law", None) == "isotropic"
    std_m = parameters["alpha"] * parameters["beta"] or parameters["d_sigma"]
    return std_m * (1.0 if isotropic else np.sqrt(0.5)), parameters["tau_s"]


class FilteredTracks(NamedTuple):
    """N filtered tracks of M samples."""

    # (p, v, e) after the last sample of each track; planar behind an ellipse.
    last: LastState | PlanarState
    causal_xy: Floats  # (M, 2) m, position p after each sample, from those up to it.


def filter_tracks(
    batch: Batch, error: SlowError, *, q: float, gate: float = np.inf
) -> FilteredTracks:
    """Filter tracks behind a slow error: their last states, and all positions.

    Parameters and errors are those of `isac_track.kalman.kalman_last`. `batch` has a
    prior of two states; the prior of the error is its stationary law.
    """
    if batch.ellipse is not None:
        return _filter_planar(batch, error, q=q, gate=gate)
    n, causal_xy = len(batch), np.empty((batch.t.size, 2))
    out = LastState(np.empty((n, 2, 3)), np.empty((n, 3, 3)), np.empty(n))
    import_module("isac_track.kalman._error_loops").filter_tracks(
        error.arrays(batch),
        error.tau_s,
        positive("q", q),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        (out.mean, out.cov, out.log_likelihood, causal_xy),
    )
    return FilteredTracks(out, causal_xy)


def _filter_planar(
    batch: Batch, error: SlowError, *, q: float, gate: float
) -> FilteredTracks:
    n, causal_xy = len(batch), np.empty((batch.t.size, 2))
    mean, cov, log_likelihood = np.empty((n, 6)), np.empty((n, 6, 6)), np.empty(n)
    motion = np.array([batch.prior_std[1] ** 2, np.inf, positive("q", q)])
    import_module("isac_track.kalman._planar_error_loops").filter_tracks(
        error.planar_arrays(batch),
        error.steps(batch, motion),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        (mean, cov, log_likelihood, causal_xy),
    )
    last = PlanarState(
        mean.reshape(n, 2, 3), cov.reshape(n, 2, 3, 2, 3), log_likelihood
    )
    return FilteredTracks(last, causal_xy)


def smooth_tracks(
    batch: Batch, error: SlowError, *, q: float, passes: int = 1, anneal: float = 0.0
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    Parameters and errors are those of `isac_track.kalman.smooth_positions`. Further
    passes treat the residual, neither walk nor slow error, as a radial error and weigh
    it anew.
    """
    motion = Motions(np.array([positive("q", q)]), np.array([np.inf]))
    return smooth_mixture(
        batch, error, motion, np.ones((len(batch), 1)), passes=passes, anneal=anneal
    )


@dataclass(frozen=True, eq=False, slots=True)
class Motions:
    """K motions of a walk: each velocity is an Ornstein-Uhlenbeck process per axis.

    Together they are a mixture of Gaussian-process kernels: the covariance of the
    velocity falls as exp(-dt / tau). ValueError if a number is out of range.

    References
    ----------
    Uhlenbeck, Ornstein, Physical Review 36, 1930 (integrated: eq. 23); Hartikainen,
    Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process
    regression models", IEEE MLSP, 2010.
    """

    q: Floats  # (K,) m^2/s^3, spectral density of the acceleration.
    tau_s: Floats
    """(K,) time over which the correlation of the velocity falls to 1/e.

    Infinite: constant velocity, but for the acceleration, from the batch's prior.
    """

    def __post_init__(self) -> None:
        if np.shape(self.q) != np.shape(self.tau_s) or np.ndim(self.q) != 1:
            raise ValueError("q and tau_s must be as many")
        for value in self.q:
            positive("q", value)
        for value in self.tau_s:
            positive("tau_s", value, finite=False)

    @classmethod
    def with_speeds(cls, *speeds_and_times: tuple[float, float]) -> "Motions":
        """Return motions of these standard speeds (m/s per axis) and times (s)."""
        speed_mps, tau_s = np.array(speeds_and_times, dtype=np.float64).T
        return cls(2.0 * speed_mps**2 / tau_s, tau_s)

    def __len__(self) -> int:
        """Return the number of motions."""
        return self.q.size

    def arrays(self, prior_std: tuple[float, ...]) -> Floats:
        """Return variance of the first velocity, time and q of each motion, (K, 3).

        The first velocity is drawn from the stationary law of its process, if any.
        """
        lasting = np.isfinite(self.tau_s)
        first = np.full(len(self), prior_std[1] ** 2)
        np.multiply(self.q, self.tau_s / 2.0, out=first, where=lasting)
        return np.column_stack([first, self.tau_s, self.q])


def motion_log_likelihoods(batch: Batch, error: SlowError, motions: Motions) -> Floats:
    """Return the log density of each track under each motion, (N, K).

    Its unit is the logarithm of 1/m^2 for each sample.
    """
    log_density = np.empty((len(batch), len(motions)))
    if batch.ellipse is not None:
        loops = import_module("isac_track.kalman._planar_error_loops")
        for number, motion in enumerate(motions.arrays(batch.prior_std)):
            column = np.empty(len(batch))
            steps = error.steps(batch, motion)
            loops.log_likelihoods(error.planar_arrays(batch), steps, motion[0], column)
            log_density[:, number] = column
        return log_density
    import_module("isac_track.kalman._error_loops").log_likelihoods(
        error.arrays(batch), error.tau_s, motions.arrays(batch.prior_std), log_density
    )
    return log_density


def smooth_mixture(
    batch: Batch,
    error: SlowError,
    motions: Motions,
    weight: Floats,
    *,
    passes: int = 1,
    anneal: float = 0.0,
) -> tuple[Floats, Floats]:
    """Return the mean, (M, 2) m, and variance of positions smoothed under motions.

    `weight`, (N, K), is the prior weight of each motion for each track, none negative
    and not all 0: weights of 0 cost no time. With the posterior probabilities of the
    motions, mean and variance are those of the posterior mixture. Other parameters and
    errors are those of `smooth_tracks`.
    """
    if passes < 1 or not 0 <= anneal < 1:
        raise ValueError(
            f"need passes >= 1 and 0 <= anneal < 1, got {passes} and {anneal}"
        )
    if weight.shape != (len(batch), len(motions)) or not (weight >= 0.0).all():
        raise ValueError("need a weight, not negative, of each motion for each track")
    if not (weight.sum(axis=1) > 0.0).all():
        raise ValueError("need a motion of positive weight for each track")
    if batch.ellipse is not None:
        smooth = _smooth_planar if np.any(error.std_m) else _smooth_white
        xy, cov = smooth(batch, error, motions, weight, passes, anneal)
        return xy, mean_variance(cov)
    track, index = np.nonzero(weight)
    motion = motions.arrays(batch.prior_std)[index]
    return _smooth_runs(
        batch, error, track, motion, weight[track, index], passes, anneal
    )


def _smooth_white(
    batch: Batch,
    error: SlowError,
    motions: Motions,
    weight: Floats,
    passes: int,
    anneal: float,
) -> tuple[Floats, Floats]:
    """Return mean and covariance, (M, 2, 2) m^2, without a slow error."""
    del error
    return smooth_planar(
        batch,
        motions=motions.arrays(batch.prior_std),
        weight=np.asarray(weight, dtype=np.float64),
        passes=passes,
        anneal=anneal,
    )


def _smooth_planar(
    batch: Batch,
    error: SlowError,
    motions: Motions,
    weight: Floats,
    passes: int,
    anneal: float,
) -> tuple[Floats, Floats]:
    """Return mean and covariance, (M, 2, 2) m^2, behind a slow error."""
    loops = import_module("isac_track.kalman._planar_error_loops")
    arrays, n = error.planar_arrays(batch), batch.t.size
    out = np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros(len(batch))
    numbers = motions.arrays(batch.prior_std)
    for motion, own in zip(numbers, weight.T, strict=True):
        track = np.flatnonzero(own)
        if track.size:
            runs = track, np.asarray(own[track], dtype=np.float64)
            steps = error.steps(batch, motion)
            loops.smooth_tracks(
                arrays, steps, motion[0], runs, passes, float(anneal), out
            )
    return out[0], out[1]


def smooth_each(
    batch: Batch, error: SlowError, *, q: Floats, speed_mps: Floats
) -> tuple[Floats, Floats]:
    """Return smoothed positions and variances, each track with a motion of its own.

    `q`, m^2/s^3, and `speed_mps`, the standard deviation of the first velocity per
    axis, are (N,) and positive; the batch's prior of velocity is not used. There is one
    pass.
    """
    track, no_decay = np.arange(len(batch)), np.full(len(batch), np.inf)
    motion = np.column_stack([np.square(speed_mps), no_decay, q])
    return _smooth_runs(batch, error, track, motion, np.ones(len(batch)), 1, 0.0)


def _smooth_runs(
    batch: Batch,
    error: SlowError,
    track: Ints,
    motion: Floats,
    weight: Floats,
    passes: int,
    anneal: float,
) -> tuple[Floats, Floats]:
    """Smooth runs, each of a track, a motion and a weight; return mean and variance."""
    order = np.argsort(np.diff(batch.offsets)[track], kind="stable")
    runs = track[order], motion[order], weight[order]
    out = np.zeros((batch.t.size, 2)), np.zeros(batch.t.size), np.zeros(len(batch))
    loops = import_module("isac_track.kalman._error_loops")
    if not np.any(error.std_m):
        loops.smooth_lanes(error.arrays(batch), runs, passes, float(anneal), out)
    else:
        loops.smooth_tracks(
            error.arrays(batch), error.tau_s, runs, passes, float(anneal), out
        )
    return out[:2]
