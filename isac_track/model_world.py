"""Model worlds: walks of a motion that is known, and what nobody can know better of them.

A walk has constant velocity but for white acceleration of spectral density q, the same
in either axis; its errors are Gaussian once the scale of each is told. Then the exact
posterior is a smoother's, and no attack, in expectation, knows more samples to epsilon
than its mean does in the hands of a genie who is told every scale, and how each person
moves. Real walks are not drawn from this motion: of them that is no bound. Derivations:
docs/optimum.md.

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

# Over which acceleration is measured: what a smoother averages over.
_LAG_S: Final = 1.0
_EVERY = 4  # Of them within one lag.
_MOST_FITTED = 300
START_STD_M = 100.0  # Around the first sample: nothing is known of where a walk starts.
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
    """How each of N people walks, as fitted to their tracks: units are those of `Motion`."""

    q: Floats  # (N,)
    speed_mps: Floats  # (N,)

    def take(self, rows: Ints) -> "OwnMotions":
        """Return those of some tracks, or of a track several times."""
        return OwnMotions(self.q[rows], self.speed_mps[rows])


@dataclass(frozen=True, eq=False, slots=True)
class Errors:
    """Errors of M samples, Gaussian once their scales are told."""

    variance: Floats  # (M,) m^2 per axis, of what is white.
    slow: SlowError | None = None  # What else there is.
    # Whether there was nothing to tell: everybody knows the scales.
    is_gaussian: bool = False


def fitted_motion(tracks: Tracks) -> Motion:
    """Return the motion of tracks of two samples or more, from at most 300 of them.

    Of a walk that white acceleration drives x(t + h) - 2 x(t) + x(t - h) has the
    variance 2 q h^3 / 3 per axis; h is 1 s, or a third of a shorter track.
    """
    n_fitted = min(_MOST_FITTED, len(tracks))
    rows = np.unique(np.linspace(0, len(tracks) - 1, n_fitted).astype(int)).tolist()
    density, square = np.transpose([_moves(tracks[row]) for row in rows])
    # Nobody walks dead straight, or stands dead still: a track that does was left
    # standing.
    speed_mps = max(float(np.sqrt(np.mean(square))), _LEAST_SPEED_MPS)
    return Motion(max(float(np.mean(density)), _LEAST_Q), speed_mps)


def own_motions(tracks: Tracks) -> OwnMotions:
    """Return the motion of each of N tracks of two samples or more, as `fitted_motion` of it."""
    density, square = np.transpose([_moves(tracks[row]) for row in range(len(tracks))])
    speed_mps = np.maximum(np.sqrt(square), _LEAST_SPEED_MPS)
    return OwnMotions(np.maximum(density, _LEAST_Q), speed_mps)


def _moves(track: Tracks) -> tuple[float, float]:
    """Return the spectral density of a track's acceleration and its mean squared velocity."""
    lag_s = min(_LAG_S, (track.t[-1] - track.t[0]) / 3.0)
    middle = np.arange(track.t[0] + lag_s, track.t[-1] - lag_s, lag_s / _EVERY)
    before, at, after = (
        np.column_stack(
            [np.interp(middle + shift_s, track.t, axis) for axis in track.xy.T]
        )
        for shift_s in (-lag_s, 0.0, lag_s)
    )
    density = np.square(after - 2.0 * at + before).mean() / (2.0 / 3.0 * lag_s**3)
    return float(density), float(np.square((after - before) / (2.0 * lag_s)).mean())


def simulated(
    *,
    t: Floats,
    offsets: Ints,
    start: Floats,
    motion: Motion | OwnMotions,
    rng: Generator,
) -> Floats:
    """Return walks at the instants `t`, (M, 2) m, that start at `start`, (N, 2) m.

    All are of one motion, or each of its own.
    """
    first = offsets[:-1]
    q = (
        motion.q
        if isinstance(motion, Motion)
        else np.repeat(motion.q, np.diff(offsets))
    )
    speed_mps = np.reshape(motion.speed_mps, (-1, 1))
    draws = rng.standard_normal((t.size, 2, 2))
    step = np.diff(t, prepend=t[:1])
    step[first] = 0.0
    scale = np.sqrt(q * step)[:, None]
    # Exact at any steps: the second draw is what of the position the velocity does not
    # tell.
    kick = scale * draws[:, 0]
    velocity = _along(kick, offsets, speed_mps * draws[first, 0])
    before = velocity - kick
    move = step[:, None] * (before + 0.5 * kick + scale * draws[:, 1] / np.sqrt(12.0))
    return _along(move, offsets, start)


def _along(steps: Floats, offsets: Ints, start: Floats) -> Floats:
    total, first = np.cumsum(steps, axis=0), offsets[:-1]
    before = start - total[first] + steps[first]
    return np.asarray(total + np.repeat(before, np.diff(offsets), axis=0))


def errors_of(
    *, release: Release, sensed: Sensed, mechanism: object, rng: Generator
) -> Errors | None:
    """Return the errors of a release as a genie sees them; None of a mechanism that it is blind to.

    `sensed` has the samples of the release and no others. Told are the scales of radial
    errors and of Laplace noise, drawn given the errors. Not covered: errors along one
    line, `offset`, `correlated`, `forecast`, and mechanisms that are not the project's
    own.
    """
    raw, shared = sensed.sigma_raw, release.sigma
    if sensed.law == "fixed_direction" or shared is None:
        return None
    if isinstance(mechanism, Clean):
        return Errors(np.full(raw.shape, _LEAST_VARIANCE_M2), is_gaussian=True)
    if not isinstance(mechanism, (Raw, Fixed, Fid, Thin, Laplace, Ou, OuFid)):
        return None
    law = (
        "laplace" if isinstance(mechanism, Laplace) else getattr(mechanism, "law", None)
    )
    added, slow = law or sensed.law, None
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
        scale += scale_m2(std_m, unit, law=added, rng=rng)
    gaussian = sensed.law == added == "isotropic"
    return Errors(np.maximum(scale, _LEAST_VARIANCE_M2), slow, is_gaussian=gaussian)


def scale_m2(std_m: Floats, square: Floats, *, law: str, rng: Generator) -> Floats:
    """Return the variance per axis, (M,) m^2, that errors were drawn with, given how long they are.

    `square` is their squared length in units of ``std_m**2``. A radial error is
    Gaussian of variance s std^2 per axis, s of the arcsine law: 1 / s - 1 is then z^2 /
    square, z standard Gaussian. A Laplace one has s of a Gamma law of shape 3/2, and 1
    / s is inverse Gaussian.
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
    """Return of which share of its samples the exact posterior of each track tells, (N,).

    That is the expected share within `epsilon_m` of the posterior mean: 1 - exp(-eps^2
    / 2 P), P the variance per axis of a smoothed position, averaged over the track. The
    motion is that of all walks, or each walk's own, which is known.
    """
    n_tracks = offsets.size - 1
    q, speed_mps = (
        np.broadcast_to(one, n_tracks) for one in (motion.q, motion.speed_mps)
    )
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
    """Return how much likelier each pair is of one walk than of two, (P, G), as a logarithm.

    ln p(y1, y2) - ln p(y1) - ln p(y2), exactly, for walks of `motion` behind Gaussian
    errors of known variance, each release turned and shifted by itself; averaged over
    the lag of the gallery's start after the probe's, which is one of `lags_s`, (L,),
    with probability `weight`. Of equally likely candidates none is a better guess than
    the one of the highest ratio (Bayes). The prior of the batches is `START_STD_M` and
    the motion's speed.
    """
    loops, sides, alone = import_module("isac_track.kalman._pair_loops"), [], []
    for one in (probe, gallery):
        first = np.repeat(one.offsets[:-1], np.diff(one.offsets))
        sides.append(
            (one.t - one.t[first], one.xy - one.xy[first], one.variance, one.offsets)
        )
        alone.append(kalman_last(one, q=motion.q).log_likelihood)
    prior = np.square([START_STD_M, motion.speed_mps, START_STD_M])
    lags_s = np.ascontiguousarray(lags_s, dtype=np.float64)
    found, log_weight = np.empty((len(probe), len(gallery))), np.log(weight)
    one_probe = np.empty((len(gallery), lags_s.size, 2))
    for row in range(len(probe)):
        loops.one_walk(sides[0], row, sides[1], lags_s, prior, motion.q, one_probe)
        turned = one_probe[:, :, 1]
        both = one_probe[:, :, 0] + np.log(i0e(turned)) + turned
        found[row] = logsumexp(both + log_weight, axis=1)
    return np.asarray(found - alone[0][:, None] - alone[1])
