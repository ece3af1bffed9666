"""Model worlds: walks of a known motion, and a bound for every attack on them.

A walk has constant velocity but for white acceleration of spectral density q, the same
in either axis. Its errors are Gaussian given the scale of each error. The *genie* is an
adversary who is given every scale, and how each person moves. Its exact posterior is
that of a smoother. In expectation no attack knows more samples within epsilon than the
genie's posterior mean. Real walks are not drawn from this motion: for them this is no
bound. Derivations: docs/explanation/optimum.md.

References
----------
Scale mixtures: Andrews, Mallows, J. R. Statist. Soc. B 36(1), 1974, 99-102; the mean of
a Gaussian posterior holds most within epsilon: Anderson, Proc. Amer. Math. Soc. 6,
1955, 170-176.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Final

import numpy as np
from numpy.random import Generator
from scipy.special import i0e, logsumexp

from isac_track.kalman import Batch, kalman_last
from isac_track.kalman.slow_errors import SlowError, smooth_each
from isac_track.mechanisms.controls import Thin
from isac_track.mechanisms.paper import Clean, Fid, Fixed, Raw
from isac_track.mechanisms.protections import Laplace, Ou, OuFid
from isac_track.types import Floats, Ints, Release, Sensed, Tracks, squared_lengths

# Time over which acceleration is measured, about that over which a smoother averages.
_LAG_S: Final = 1.0
_STEPS_PER_LAG = 4
_MOST_FITTED = 300  # Tracks to which a motion is fitted.
START_STD_M = 100.0  # Prior around the first sample: a walk may start anywhere.
_LEAST_VARIANCE_M2 = 1e-12
_LEAST_Q = 1e-4
_LEAST_SPEED_MPS = 0.01


@dataclass(frozen=True, slots=True)
class Motion:
    """How people walk, as fitted to tracks."""

    # m^2/s^3, spectral density of the acceleration, per axis: the mean over people.
    q: float
    speed_mps: float  # Standard deviation of the velocity, per axis.


@dataclass(frozen=True, eq=False, slots=True)
class OwnMotions:
    """How each of N people walks, as fitted to their tracks; units as in `Motion`."""

    q: Floats  # (N,)
    speed_mps: Floats  # (N,)

    def take(self, rows: Ints) -> "OwnMotions":
        """Return the motions of some rows, which may repeat."""
        return OwnMotions(self.q[rows], self.speed_mps[rows])


@dataclass(frozen=True, eq=False, slots=True)
class Errors:
    """Errors of M samples, Gaussian given their scales."""

    variance: Floats  # (M,) m^2 per axis, of the white part.
    slow: SlowError | None = None  # The slowly changing part, if any.
    # Whether the errors are Gaussian without a genie: every adversary knows the scales.
    is_gaussian: bool = False


def fit_motion(tracks: Tracks) -> Motion:
    """Fit one motion to tracks of two samples or more, at most 300 of them.

    If white acceleration drives a walk, x(t + h) - 2 x(t) + x(t - h) has the variance
    2 q h^3 / 3 per axis; h is 1 s, or a third of a shorter track.
    """
    n_fitted = min(_MOST_FITTED, len(tracks))
    rows = np.unique(np.linspace(0, len(tracks) - 1, n_fitted).astype(int)).tolist()
    density, square = np.transpose([_fit_track(tracks[row]) for row in rows])
    # Nobody walks perfectly straight or stands perfectly still: such a track comes from
    # a target that stood there.
    speed_mps = max(float(np.sqrt(np.mean(square))), _LEAST_SPEED_MPS)
    return Motion(max(float(np.mean(density)), _LEAST_Q), speed_mps)


def fit_own_motions(tracks: Tracks) -> OwnMotions:
    """Fit a motion to each of N tracks of two samples or more, as `fit_motion`."""
    density, square = np.transpose(
        [_fit_track(tracks[row]) for row in range(len(tracks))]
    )
    speed_mps = np.maximum(np.sqrt(square), _LEAST_SPEED_MPS)
    return OwnMotions(np.maximum(density, _LEAST_Q), speed_mps)


def _fit_track(track: Tracks) -> tuple[float, float]:
    """Return a track's spectral density of acceleration and mean squared velocity."""
    lag_s = min(_LAG_S, (track.t[-1] - track.t[0]) / 3.0)
    middle = np.arange(track.t[0] + lag_s, track.t[-1] - lag_s, lag_s / _STEPS_PER_LAG)
    before = _interpolate(track, middle - lag_s)
    now = _interpolate(track, middle)
    after = _interpolate(track, middle + lag_s)
    density = np.square(after - 2.0 * now + before).mean() / (2.0 / 3.0 * lag_s**3)
    return float(density), float(np.square((after - before) / (2.0 * lag_s)).mean())


def _interpolate(track: Tracks, t: Floats) -> Floats:
    """Return linearly interpolated positions of a track at times `t`, (K, 2) m."""
    return np.column_stack([np.interp(t, track.t, axis) for axis in track.xy.T])


def simulate_walks(
    *,
    t: Floats,
    offsets: Ints,
    start: Floats,
    motion: Motion | OwnMotions,
    rng: Generator,
) -> Floats:
    """Simulate walks at the instants `t`, (M,) s, from `start`, (N, 2) m; (M, 2) m.

    All walks have the same motion, or each has its own.
    """
    first = offsets[:-1]
    sizes = np.diff(offsets)
    q = motion.q if isinstance(motion, Motion) else np.repeat(motion.q, sizes)
    speed_mps = np.reshape(motion.speed_mps, (-1, 1))
    draws = rng.standard_normal((t.size, 2, 2))
    step = np.diff(t, prepend=t[:1])
    step[first] = 0.0
    scale = np.sqrt(q * step)[:, None]
    # Exact for any step: the second draw is the part of the position that does not
    # follow from the velocity.
    kick = scale * draws[:, 0]
    velocity = _cumulate(kick, offsets, speed_mps * draws[first, 0])
    before = velocity - kick
    move = step[:, None] * (before + 0.5 * kick + scale * draws[:, 1] / np.sqrt(12.0))
    return _cumulate(move, offsets, start)


def _cumulate(steps: Floats, offsets: Ints, start: Floats) -> Floats:
    """Return `start`, (N, 2), plus the sums of the steps of each track, (M, 2)."""
    total, first = np.cumsum(steps, axis=0), offsets[:-1]
    before = start - total[first] + steps[first]
    return np.asarray(total + np.repeat(before, np.diff(offsets), axis=0))


def release_errors(
    *, release: Release, sensed: Sensed, mechanism: object, rng: Generator
) -> Errors | None:
    """Return the errors of a release as the genie sees them, or None if not covered.

    `sensed` has exactly the samples of the release. The genie knows the scales of
    radial errors and of Laplace noise; they are drawn given the errors. Not covered are
    errors with a shape or along one line, `offset`, `correlated`, `forecast`, and third-party
    mechanisms.
    """
    raw, shared = sensed.sigma_raw, release.sigma
    if sensed.law == "fixed_direction" or shared is None or sensed.cov is not None:
        return None
    if isinstance(mechanism, Clean):
        return Errors(np.full(raw.shape, _LEAST_VARIANCE_M2), is_gaussian=True)
    if not isinstance(mechanism, (Raw, Fixed, Fid, Thin, Laplace, Ou, OuFid)):
        return None
    if isinstance(mechanism, Laplace):
        added_law = "laplace"
    else:
        added_law = getattr(mechanism, "law", None) or sensed.law
    slow = None
    scale = scale_m2(raw, squared_lengths(sensed.unit_error), law=sensed.law, rng=rng)
    std_m = np.sqrt(np.maximum(np.square(shared) - np.square(raw), 0.0))
    if getattr(mechanism, "adding", "linear") == "linear":
        scale *= np.square(
            np.divide(shared, raw, out=np.ones_like(raw), where=raw > 0.0)
        )
    elif isinstance(mechanism, Ou | OuFid):
        slow = SlowError(std_m, mechanism.tau_s)
    else:
        unit = np.ones_like(std_m)
        np.divide(
            squared_lengths(release.xy - sensed.xy),
            std_m**2,
            out=unit,
            where=std_m > 0.0,
        )
        scale += scale_m2(std_m, unit, law=added_law, rng=rng)
    is_gaussian = sensed.law == added_law == "isotropic"
    variance = np.maximum(scale, _LEAST_VARIANCE_M2)
    return Errors(variance, slow, is_gaussian=is_gaussian)


def scale_m2(std_m: Floats, square: Floats, *, law: str, rng: Generator) -> Floats:
    """Draw the variance per axis of errors given their lengths, (M,) m^2.

    `square` is their squared length in units of ``std_m**2``. A radial error is
    Gaussian of variance s std^2 per axis, where s has the arcsine law; given the error,
    1 / s - 1 is z^2 / square with z standard Gaussian. For a Laplace error s has a
    Gamma law of shape 3/2; given the error, 1 / s is inverse Gaussian.
    """
    if law == "radial":
        noise = np.square(rng.standard_normal(std_m.size))
        return np.asarray(
            np.square(std_m) * square / np.maximum(square + noise, 1e-300)
        )
    if law == "laplace":
        length = np.sqrt(np.maximum(square, 1e-18))
        return np.asarray(np.square(std_m) / rng.wald(np.sqrt(3.0) / length, 3.0))
    return np.square(std_m)


def known_share(
    *,
    t: Floats,
    offsets: Ints,
    errors: Errors,
    motion: Motion | OwnMotions,
    epsilon_m: float,
) -> Floats:
    """Return the share of samples that each track's exact posterior knows, (N,).

    That is the expected share within `epsilon_m` of the posterior mean: 1 - exp(-eps^2
    / 2 P) averaged over the track, with P the variance per axis of a smoothed position.
    The motion is that of all walks, or each walk's own; the adversary knows it.
    """
    n_tracks = offsets.size - 1
    q = np.broadcast_to(motion.q, n_tracks)
    speed_mps = np.broadcast_to(motion.speed_mps, n_tracks)
    batch = Batch(
        t, np.zeros((t.size, 2)), errors.variance, offsets, (START_STD_M, 1.0)
    )
    slow = errors.slow or SlowError(0.0, 0.0)
    _, spread = smooth_each(batch, slow, q=q, speed_mps=speed_mps)
    known = -np.expm1(-(epsilon_m**2) / (2.0 * np.maximum(spread, _LEAST_VARIANCE_M2)))
    return np.asarray(np.add.reduceat(known, offsets[:-1]) / np.diff(offsets))


def log_ratios(
    probe: Batch, gallery: Batch, *, motion: Motion, lags_s: Floats, weight: Floats
) -> Floats:
    """Return the log likelihood ratio of each pair: one walk against two, (P, G).

    It is ln p(y1, y2) - ln p(y1) - ln p(y2), exactly, for walks of `motion` with
    Gaussian errors of known variance, where each release is turned and shifted by
    itself. The likelihood is averaged over the lag of the gallery's start after the
    probe's: one of `lags_s`, (L,), with probability `weight`. Among equally likely
    candidates that with the highest ratio is the best guess (Bayes). The prior of
    the batches is `START_STD_M` and the motion's speed.
    """
    loops = import_module("isac_track.kalman._pair_loops")
    probe_arrays, gallery_arrays = _relative_arrays(probe), _relative_arrays(gallery)
    probe_alone = kalman_last(probe, q=motion.q).log_likelihood
    gallery_alone = kalman_last(gallery, q=motion.q).log_likelihood
    prior = np.square([START_STD_M, motion.speed_mps, START_STD_M])
    lags_s = np.ascontiguousarray(lags_s, dtype=np.float64)
    joint, log_weight = np.empty((len(probe), len(gallery))), np.log(weight)
    terms = np.empty((len(gallery), lags_s.size, 2))
    for row in range(len(probe)):
        loops.fill_walk_densities(
            probe_arrays, row, gallery_arrays, lags_s, prior, motion.q, terms
        )
        turned = terms[:, :, 1]
        log_likelihood = terms[:, :, 0] + np.log(i0e(turned)) + turned
        joint[row] = logsumexp(log_likelihood + log_weight, axis=1)
    return np.asarray(joint - probe_alone[:, None] - gallery_alone)


def _relative_arrays(batch: Batch) -> tuple[Floats, Floats, Floats, Ints]:
    """Return times and positions relative to each track's first, variance, offsets."""
    first = np.repeat(batch.offsets[:-1], np.diff(batch.offsets))
    t, xy = batch.t - batch.t[first], batch.xy - batch.xy[first]
    return t, xy, batch.variance, batch.offsets
