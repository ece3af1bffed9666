"""Interacting multiple models (IMM) over many tracks at once: the front of the compiled loops.

Every mode is a constant-velocity model with a spectral density of its own; the modes are a
Markov chain in continuous time. One cycle is Blom and Bar-Shalom's: mix, predict, update, weigh.
It equals filterpy's `IMMEstimator` except where that departs from the textbook:

- filterpy works out the mixing weights at the end of ``update``, from the M of that moment: with
  irregular steps M lags one step behind, unless the caller sets M and calls
  ``_compute_mixing_probabilities`` before ``predict``. Here M belongs to the step it is used in.
- Before its first measurement filterpy has already moved the mode probabilities by one M.
- ``x_prior`` and ``P_prior`` are mixed by the probabilities before the step, not by those
  predicted to its end.
- Likelihoods below 1e-308 are raised to it, so that far outliers count the same under every mode;
  here they are compared as logarithms.
- ``update(None)`` still weighs the modes, by the likelihood of an innovation of zero. A sample that
  the gate rejects here leaves the predicted probabilities alone.

References
----------
Blom, Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Automatic Control 33(8), 1988, 780-783. Bar-Shalom, Li, Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, section 11.6.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.kalman.arguments import covariances, floats, positive, ragged_times, variances
from isac_track.kalman.linear import MAX_REJECTIONS

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class ImmStates:
    """States of N tracks under each of J modes, a row for each of M samples, or a row a track.

    To forecast, predict each mode with its own q and mix by `probability`.
    """

    mean: Floats
    """(M, J, 2, 2) m, m/s: per mode and axis position and velocity."""
    cov: Floats
    """(M, J, 4, 4) of (x, vx, y, vy) under each mode."""
    probability: Floats
    """(M, J) of the modes."""
    mixed_mean: Floats
    """(M, 2, 2) m, m/s: over the modes."""
    mixed_cov: Floats
    """(M, 4, 4) over the modes, with the spread between them."""
    log_likelihood: Floats
    """(N,) log density of a track's accepted samples, 1/m^2 each."""


def imm_filter(
    *,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: Floats,
    rates: Floats,
    initial_mean: Floats,
    initial_cov: Floats,
    initial_probability: Floats,
    gate: float = np.inf,
) -> ImmStates:
    """Return the states of every track after each of its samples, under each mode.

    Parameters
    ----------
    t : (M,) s
        Strictly increasing within a track.
    xy : (M, 2) m
    variance : (M,) m^2
        Measurement variance per axis, positive.
    offsets : (N + 1,) int
        Track i owns the samples ``offsets[i]:offsets[i + 1]``; none is empty.
    q : (J,) m^2/s^3
        Spectral density of the acceleration in each of J >= 2 constant-velocity modes.
    rates : (J, J) 1/s
        ``rates[i, j]``, i != j, of leaving mode i for mode j; not negative. The diagonal is not
        read: it is minus the sum of its row. The modes are a Markov chain in continuous time,
        so that its transitions compose over irregular steps.
    initial_mean : (N, 2, 2)
    initial_cov : (N, 2, 2)
        Prior state per axis at the time of a track's first sample, under every mode.
    initial_probability : (J,)
        Of the modes before the first sample; adds up to 1.
    gate : float, optional
        A sample is not used if its normalised innovation squared exceeds this under every mode,
        unless `MAX_REJECTIONS` samples before it were not. Default: all are used.

    Raises
    ------
    ValueError
        If shapes disagree, a number is not finite, a track is empty, times do not increase, a
        variance is not positive, a rate is negative or probabilities do not add up to 1.
    """
    arrays = _arguments(
        *(t, xy, variance, offsets, q, rates),
        *(initial_mean, initial_cov, initial_probability, gate),
    )
    return _filter(arrays, every=True)


def imm_last(
    *,
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: Floats,
    rates: Floats,
    initial_mean: Floats,
    initial_cov: Floats,
    initial_probability: Floats,
    gate: float = np.inf,
) -> ImmStates:
    """Return the states of every track after its last sample, equal to those of `imm_filter`.

    Nothing of length M is made. Parameters and errors are those of `imm_filter`.
    """
    arrays = _arguments(
        *(t, xy, variance, offsets, q, rates),
        *(initial_mean, initial_cov, initial_probability, gate),
    )
    return _filter(arrays, every=False)


def imm_smoother(
    *, t: Floats, offsets: Ints, q: Floats, rates: Floats, filtered: ImmStates
) -> ImmStates:
    """Return the states of every track at each sample, given all samples, under each mode.

    Expectation correction (Barber 2006) with one Gaussian per mode: backwards in time, every
    mode now is smoothed from every mode next by Rauch-Tung-Striebel; the pair's weight is that of
    the filter times the density of the next smoothed mean under the pair's prediction; the
    pairs of each mode are then collapsed into one Gaussian. Like the filter it is an
    approximation: exact with one mode, or with modes of equal q.

    Parameters
    ----------
    t, offsets, q, rates
        What `imm_filter` was called with.
    filtered : ImmStates
        What it returned.

    Raises
    ------
    ValueError
        If shapes disagree.

    References
    ----------
    Barber, "Expectation correction for smoothed inference in switching linear dynamical
    systems", J. Machine Learning Research 7, 2006, 2515-2540.
    """
    t, offsets = ragged_times(t, offsets)
    density, chances = _modes(q, rates, t)
    out = _empty(t.size, modes=density.size, log_likelihood=filtered.log_likelihood)
    _loops().imm_smoother(
        *(t, offsets, density, chances),
        _planar(floats("filtered.mean", filtered.mean, out.mean.shape)),
        floats("filtered.cov", filtered.cov, out.cov.shape),
        floats("filtered.probability", filtered.probability, out.probability.shape),
        *(_planar(out.mean), out.cov, out.probability, _planar(out.mixed_mean), out.mixed_cov),
    )
    return out


def _loops() -> Any:  # noqa: ANN401 - a module of compiled functions, which have no types
    return import_module("isac_track.kalman._imm_loops")


def _filter(arrays: tuple[Any, ...], *, every: bool) -> ImmStates:
    n_tracks = arrays[3].size - 1
    rows = arrays[0].size if every else n_tracks
    out = _empty(rows, modes=arrays[4].size, log_likelihood=np.zeros(n_tracks))
    _loops().imm_filter(
        *(*arrays, MAX_REJECTIONS, every, _planar(out.mean), out.cov, out.probability),
        *(_planar(out.mixed_mean), out.mixed_cov, out.log_likelihood),
    )
    return out


def _empty(rows: int, *, modes: int, log_likelihood: Floats) -> ImmStates:
    return ImmStates(
        mean=np.empty((rows, modes, 2, 2)),
        cov=np.empty((rows, modes, 4, 4)),
        probability=np.empty((rows, modes)),
        mixed_mean=np.empty((rows, 2, 2)),
        mixed_cov=np.empty((rows, 4, 4)),
        log_likelihood=log_likelihood,
    )


def _planar(mean: Floats) -> Floats:
    """Return a view (..., 4), (x, vx, y, vy), of states (..., 2, 2)."""
    return mean.reshape(*mean.shape[:-2], 4)


def _arguments(
    t: Floats,
    xy: Floats,
    variance: Floats,
    offsets: Ints,
    q: Floats,
    rates: Floats,
    initial_mean: Floats,
    initial_cov: Floats,
    initial_probability: Floats,
    gate: float,
) -> tuple[Any, ...]:
    t, offsets = ragged_times(t, offsets)
    n_tracks = offsets.size - 1
    density, chances = _modes(q, rates, t)
    per_axis = covariances("initial_cov", initial_cov, (n_tracks, 2, 2))
    cov = np.zeros((n_tracks, 4, 4))
    cov[:, :2, :2] = cov[:, 2:, 2:] = per_axis
    mean = _planar(floats("initial_mean", initial_mean, (n_tracks, 2, 2)))
    prior = floats("initial_probability", initial_probability, density.shape)
    if not (prior >= 0).all() or not np.isclose(prior.sum(), 1.0, rtol=0, atol=1e-9):
        raise ValueError("initial_probability must not be negative and must add up to 1")
    return (
        t,
        floats("xy", xy, (t.size, 2)),
        variances(variance, t.size),
        offsets,
        density,
        chances,
        mean,
        cov,
        prior / prior.sum(),
        positive("gate", gate, finite=False),
    )


def _modes(q: Floats, rates: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return spectral densities (J,), and the chances (M, J, J) of modes after the step to each t.

    The step to the first sample of a track counts for nothing.
    """
    density = np.ascontiguousarray(q, dtype=np.float64)
    if density.ndim != 1 or density.size < 2:  # noqa: PLR2004 - one mode is a Kalman filter
        raise ValueError(f"q must have shape (J,) with J >= 2, got {density.shape}")
    density = floats("q", density, density.shape)
    if not (density > 0).all():
        raise ValueError("q must be positive")
    generator = np.array(rates, dtype=np.float64)
    if generator.shape != (density.size, density.size):
        raise ValueError(f"rates must have shape {(density.size,) * 2}, got {generator.shape}")
    np.fill_diagonal(generator, 0.0)
    if not np.isfinite(generator).all() or not (generator >= 0).all():
        raise ValueError("rates must be finite and not negative")
    np.fill_diagonal(generator, -generator.sum(axis=1))
    return density, chances(generator, np.abs(np.diff(t, prepend=t[:1])))


def chances(generator: Floats, step_s: Floats) -> Floats:
    """Return exp(generator * step), (M, J, J), of steps (M,): row by row of the mode before.

    Two modes: in closed form.
    """
    if len(generator) > 2:  # noqa: PLR2004
        from scipy.linalg import expm  # noqa: PLC0415 - two modes do without

        found: Floats = expm(generator * step_s[:, None, None])
        return found
    leave = generator[0, 1] + generator[1, 0]
    changed = -np.expm1(-leave * step_s) / leave if leave > 0 else np.zeros_like(step_s)
    found = np.empty((step_s.size, 2, 2))
    found[:, 0, 1] = generator[0, 1] * changed
    found[:, 1, 0] = generator[1, 0] * changed
    found[:, 0, 0] = 1 - found[:, 0, 1]
    found[:, 1, 1] = 1 - found[:, 1, 0]
    return found
