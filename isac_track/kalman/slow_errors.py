"""A walk of constant velocity behind an error that changes slowly: filter and smoother.

Per axis the state is (p, v, e): position and velocity as in `isac_track.kalman`, and an
error that is an Ornstein-Uhlenbeck process of standard deviation s, correlated as
exp(-dt / tau). What is measured is p + e plus white noise of the batch's variance.
Whoever knows s and tau, and how people accelerate, tells p from e as well as Gaussian
errors allow.

References
----------
Colored measurement noise by augmenting the state: Bar-Shalom, Li, Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, section 8.2. Smoother:
Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18(1),
1973, 65-75 (modified Bryson-Frazier).
"""

from dataclasses import dataclass
from importlib import import_module

import numpy as np

from isac_track.kalman import MAX_REJECTIONS, Batch, LastState
from isac_track.noise import running_means
from isac_track.types import Floats, Ints, positive


@dataclass(frozen=True, eq=False, slots=True)
class SlowError:
    """Of an error that changes slowly along a track. ValueError for what cannot be."""

    std_m: Floats | float
    """Per axis; one number, or (M,): the process of variance 1 that is scaled by it is one."""
    # Time over which its correlation falls to 1/e; 0: white, infinite: constant.
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
        """Return how much of its variance each track's innovations take for noise, (N,).

        Those are the innovations of `isac_track.noise`: their mean square, divided by
        s^2. Next to nothing of a slow error, all of a white one. 1 for tracks of fewer
        than three samples. If `running` it is that of the samples up to each one, (M,).
        """
        if self.tau_s == 0.0:
            return np.ones(t.size if running else offsets.size - 1)
        step, ratio = np.diff(t), np.ones(max(t.size - 2, 0))
        first, second = step[:-1], step[1:]
        np.divide(second, first, out=ratio, where=first > 0.0)
        gaps = second, first, first + second
        near, far, both = (np.exp(-np.abs(gap) / self.tau_s) for gap in gaps)
        a, b = 1.0 + ratio, ratio  # e_k - a e_(k-1) + b e_(k-2)
        scale = 1.0 + a * a + b * b
        share = (scale - 2.0 * (a * near + a * b * far - b * both)) / scale
        found = running_means(share, offsets, start=1.0)
        return found if running else found[offsets[1:] - 1]

    def arrays(self, batch: Batch) -> tuple[Floats | Ints, ...]:
        """Return what a compiled loop takes."""
        return (*batch.arrays(2), np.full(batch.t.size, self.std_m, dtype=np.float64))


def added_error(mechanism: object) -> tuple[float, float]:
    """Return what a mechanism says of the error that it adds: std per axis, m, and tau, s.

    tau is 0 for white errors, infinite for one that is constant along a track. Read are
    `std_m` (per axis), `distance`, `alpha` and `beta` (where the rule adds most) or
    `d_sigma`, of radial errors unless `law` says isotropic, and `tau_s`. (0, 0) for a
    mechanism that has none of them.
    """
    said = {
        name: float(getattr(mechanism, name, 0.0) or 0.0)
        for name in ("std_m", "distance", "alpha", "beta", "d_sigma", "tau_s")
    }
    if said["std_m"]:
        return said["std_m"], said["tau_s"]
    if said["distance"]:
        return said["distance"] / np.sqrt(2.0), np.inf
    slow_rule = said["alpha"] > 0.0 and said["tau_s"] > 0.0
    isotropic = slow_rule or getattr(mechanism, "law", None) == "isotropic"
    std_m = said["alpha"] * said["beta"] or said["d_sigma"]
    return std_m * (1.0 if isotropic else np.sqrt(0.5)), said["tau_s"]


def filter_tracks(
    batch: Batch, error: SlowError, *, q: float, gate: float = np.inf
) -> tuple[LastState, Floats]:
    """Return the state (p, v, e) of every track after its last sample, and p after each, (M, 2) m.

    Parameters and errors are those of `isac_track.kalman.kalman_last`; `batch` has a
    prior of two states, the error's own is its stationary law. A position is estimated
    from its own sample and those before.
    """
    n, causal = len(batch), np.empty((batch.t.size, 2))
    out = LastState(np.empty((n, 2, 3)), np.empty((n, 3, 3)), np.empty(n))
    import_module("isac_track.kalman._error_loops").filter_tracks(
        error.arrays(batch),
        error.tau_s,
        positive("q", q),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        (out.mean, out.cov, out.log_likelihood, causal),
    )
    return out, causal


def smooth_tracks(
    batch: Batch, error: SlowError, *, q: float, passes: int = 1, anneal: float = 0.0
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    Parameters and errors are those of `isac_track.kalman.smooth_positions`: further
    passes take what is neither walk nor slow error for a radial error and weigh it
    anew.
    """
    alone = Motions(np.array([positive("q", q)]), np.array([np.inf]))
    return smooth_mixture(
        batch, error, alone, np.ones((len(batch), 1)), passes=passes, anneal=anneal
    )


@dataclass(frozen=True, eq=False, slots=True)
class Motions:
    """K motions of a walk: the velocity, per axis, is an Ornstein-Uhlenbeck process.

    A bank of them is a mixture of Gaussian-process kernels: the covariance of the
    velocity falls as exp(-dt / tau). ValueError for what cannot be.

    References
    ----------
    Uhlenbeck, Ornstein, Physical Review 36, 1930 (integrated: eq. 23); Hartikainen,
    Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process
    regression models", IEEE MLSP, 2010.
    """

    q: Floats  # (K,) m^2/s^3, spectral density of the acceleration.
    tau_s: Floats
    """(K,) time over which the correlation of velocity falls to 1/e; infinite: constant velocity,
    but for the acceleration, from the prior of the batch."""

    def __post_init__(self) -> None:
        if np.shape(self.q) != np.shape(self.tau_s) or np.ndim(self.q) != 1:
            raise ValueError("q and tau_s must be as many")
        for value in self.q:
            positive("q", value)
        for value in self.tau_s:
            positive("tau_s", value, finite=False)

    @classmethod
    def with_speeds(cls, *speeds_and_times: tuple[float, float]) -> "Motions":
        """Return motions of a speed, m/s per axis (standard deviation), and a time, s, each."""
        speed_mps, tau_s = np.array(speeds_and_times, dtype=np.float64).T
        return cls(2.0 * speed_mps**2 / tau_s, tau_s)

    def __len__(self) -> int:
        """Return their number."""
        return self.q.size

    def arrays(self, prior_std: tuple[float, ...]) -> Floats:
        """Return what the compiled loops take: variance of the first velocity, time and q, (K, 3).

        Of a process the first velocity is drawn from its stationary law.
        """
        lasting = np.isfinite(self.tau_s)
        first = np.full(len(self), prior_std[1] ** 2)
        np.multiply(self.q, self.tau_s / 2.0, out=first, where=lasting)
        return np.column_stack([first, self.tau_s, self.q])


def motion_log_likelihoods(batch: Batch, error: SlowError, motions: Motions) -> Floats:
    """Return the log density of each track under each motion, (N, K), 1/m^2 each sample."""
    found = np.empty((len(batch), len(motions)))
    import_module("isac_track.kalman._error_loops").log_likelihoods(
        error.arrays(batch), error.tau_s, motions.arrays(batch.prior_std), found
    )
    return found


def smooth_mixture(
    batch: Batch,
    error: SlowError,
    motions: Motions,
    weight: Floats,
    *,
    passes: int = 1,
    anneal: float = 0.0,
) -> tuple[Floats, Floats]:
    """Return the mean of smoothed positions under several motions, (M, 2) m, and the variance.

    `weight`, (N, K), is that of each motion for each track, none negative and not all
    0: those of 0 cost nothing. With the posterior probabilities of the motions, mean
    and variance are those of the posterior mixture. Other parameters and errors are
    those of `smooth_tracks`.
    """
    if passes < 1 or not 0 <= anneal < 1:
        raise ValueError(
            f"need passes >= 1 and 0 <= anneal < 1, got {passes} and {anneal}"
        )
    if weight.shape != (len(batch), len(motions)) or not (weight >= 0.0).all():
        raise ValueError("need a weight, not negative, of each motion for each track")
    if not (weight.sum(axis=1) > 0.0).all():
        raise ValueError("need a motion of positive weight for each track")
    track, which = np.nonzero(weight)
    motion = motions.arrays(batch.prior_std)[which]
    return _smooth_runs(
        batch, error, track, motion, weight[track, which], passes, anneal
    )


def smooth_each(
    batch: Batch, error: SlowError, *, q: Floats, speed_mps: Floats
) -> tuple[Floats, Floats]:
    """Return smoothed positions and variance where each track has a motion of its own, once.

    `q`, m^2/s^3, and `speed_mps`, the standard deviation of the first velocity per
    axis, are (N,) and positive; what else the batch says of velocity does not count.
    """
    track, forever = np.arange(len(batch)), np.full(len(batch), np.inf)
    motion = np.column_stack([np.square(speed_mps), forever, q])
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
    """Return what the compiled loops make of runs, each of a track, a motion and a weight."""
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
