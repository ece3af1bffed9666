"""Learn hyper-parameters from other people, and estimate the noise of each sample.

A blind adversary estimates one level of noise for each track from its innovations. With
the declared standard deviations (the oracle) only the error law is unknown. Under
FID-controlled sharing, an adversary who knows the rule is in between: a sample gets
error if its information per second, ``(gap / sigma_raw)^2 / interval``, exceeds the
public threshold. The raw standard deviation of each track is that under which the
rule explains best how errors differ between short and long intervals. The gap of the
network's estimator is a constant, learnt from other people.
"""

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import TypeVar

import numpy as np

from attacks.remembered import memoised, noise_m2
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.protocols import AttackContext, Reconstructor, TrainingSet
from isac_track.sensing import intervals_before
from isac_track.sharing import Fid, fid_d_sigma
from isac_track.types import (
    Floats,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
    squared_lengths,
)

_Choice = TypeVar("_Choice")
COMMON_KNOWLEDGE = frozenset({Knowledge.MECHANISM, Knowledge.TRAIN, Knowledge.SIGMA})
"""The knowledge that `learn_variance` and `choose` use."""
_POWERS = (-1.0, 0.0, 1.0)
N_CANDIDATES = len(_POWERS)  # A built-in attack tries so many before it attacks.
# Variance per axis of a radial error of std 1: the paper's law, the default.
RADIAL_PER_AXIS = 0.5
_SIGMAS_M = np.geomspace(0.01, 8.0, 80)
# Steps finer than whole tracks can resolve.
_FINE_SIGMAS_M = np.geomspace(0.01, 8.0, 240)
_GAPS = np.geomspace(1.0, 32.0, 16)
_N_BINS = 6
_LONE_S = 1.0  # s, in place of the interval that a lone sample does not have.


def candidates_around(default: float, *, factor: float) -> tuple[float, ...]:
    """Return ``default / factor``, the default and ``default * factor``.

    Defaults of motion come from the bundled crowd. Its constants were set by hand to
    agree with Students03: that much of this recording is in the defaults.
    """
    return tuple(default * factor**power for power in _POWERS)


def choose(
    context: AttackContext,
    *,
    default: _Choice,
    candidates: Sequence[_Choice],
    reconstruct: Callable[[_Choice, Release], Floats],
) -> _Choice:
    """Return the candidate that reconstructs the training set best.

    Without a training set it is the default; of equal candidates it is the first.
    `reconstruct` is from a candidate and a release to positions, (M, 2) m. Attacks of
    users call this function as well, by `attacks.building_blocks`.
    """
    if Knowledge.TRAIN not in context.granted:
        return default
    if len(candidates) == 1:
        return candidates[0]
    release, truth = context.train.release, context.train.truth
    loss = partial(
        exposure_loss, truth=truth, offsets=release.offsets, epsilon_m=context.epsilon_m
    )
    losses = [loss(xy=reconstruct(candidate, release)) for candidate in candidates]
    return candidates[int(np.argmin(losses))]


def make_smoother(
    context: AttackContext,
    smooth: Callable[[Release, Floats, _Choice], Reconstruction],
    *,
    candidates: Sequence[_Choice],
    refine: Callable[[_Choice], Sequence[_Choice]] = lambda best: (best,),
) -> Reconstructor:
    """Return the smoother with the best choice, given the noise of each sample.

    `smooth` takes a release, the error variance per axis, (M,) m^2, and a choice. The
    choice is the candidate that reconstructs the training set best, of equals the
    first. Without a training set it is the middle candidate, as of `candidates_around`.
    `refine` makes further candidates from the best.
    """
    variance = learn_variance(context)

    def reconstruct(candidate: _Choice, release: Release) -> Floats:
        return smooth(release, variance(release), candidate).xy

    choice = candidates[len(candidates) // 2]
    choice = choose(
        context, default=choice, candidates=candidates, reconstruct=reconstruct
    )
    choice = choose(
        context, default=choice, candidates=refine(choice), reconstruct=reconstruct
    )
    # Two adversaries who make the same choice share the result.
    if variance is _estimate_variance:
        return lambda release: smooth_memoised(release, smooth, choice)
    return lambda release: smooth(release, variance(release), choice)


@memoised
def smooth_memoised(
    release: Release,
    smooth: Callable[[Release, Floats, _Choice], Reconstruction],
    choice: _Choice,
) -> Reconstruction:
    """Return a release smoothed by the noise that its innovations show (memoised)."""
    return smooth(release, _estimate_variance(release), choice)


def exposure_loss(
    *, xy: Floats, truth: Floats, offsets: Ints, epsilon_m: float
) -> float:
    """Return a smooth stand-in for 1 - PLR: the mean of d^2 / (d^2 + epsilon^2).

    The mean is over the samples of a track, then over tracks, as for PLR. Positions are
    (M, 2) m.
    """
    square = squared_lengths(xy - truth)
    share = np.add.reduceat(square / (square + epsilon_m**2), offsets[:-1]) / np.diff(
        offsets
    )
    return float(share.mean())


def learn_variance(context: AttackContext) -> Callable[[Release], Floats]:
    """Return the function from a release to its error variances per axis, (M,) m^2."""
    if Knowledge.SIGMA in context.granted:
        share = RADIAL_PER_AXIS
        if Knowledge.TRAIN in context.granted:
            release, truth = context.train.release, context.train.truth
            declared_m2 = float(_declared_m2(release).sum())
            if declared_m2 > 0.0:
                share = float(((release.xy - truth) ** 2).sum()) / 2.0 / declared_m2
        return lambda release: np.maximum(
            share * _declared_m2(release), MIN_VARIANCE_M2
        )
    knows = {Knowledge.MECHANISM, Knowledge.TRAIN} <= context.granted
    if knows and isinstance(context.mechanism, Fid):
        return _learn_fid(context.train, context.mechanism)
    return _estimate_variance


def _estimate_variance(release: Release) -> Floats:
    return np.repeat(noise_m2(release), np.diff(release.offsets))


def _declared_m2(release: Release) -> Floats:
    assert release.sigma is not None  # granted
    return release.sigma**2


@memoised
def _learn_fid(train: TrainingSet, rule: Fid) -> Callable[[Release], Floats]:
    """Learn the estimator's gap; return the function from a release to variances."""
    interval_s = _intervals_s(train.release)
    edges = np.unique(np.quantile(interval_s, np.linspace(0.0, 1.0, _N_BINS + 1)[1:-1]))
    bin_number = np.searchsorted(edges, interval_s, side="right")
    count = np.bincount(bin_number, minlength=edges.size + 1)
    total_s = np.bincount(bin_number, interval_s, edges.size + 1)
    # An empty bin (equal quantiles) has no samples; any positive time will do.
    middle_s = np.where(count > 0, total_s / np.maximum(count, 1), interval_s.mean())

    def fits(errors: Floats, sigmas_m: Floats, gap: float) -> Floats:
        """Return log likelihoods of tracks under raw errors, (N, S), times a factor.

        `errors`, (2, N, B), are counts and sums of squares by sampling interval. The
        length of a radial error is |N(0, sigma)|; an isotropic error has twice its log
        likelihood.
        """
        square_m2 = _total_m2(sigmas_m[:, None], middle_s, gap=gap, rule=rule)
        return -np.asarray(
            errors[0] @ np.log(square_m2).T + errors[1] @ (1.0 / square_m2).T
        )

    square_m2 = ((train.release.xy - train.truth) ** 2).sum(axis=1)
    shape = len(train.release), count.size
    cell = (
        np.repeat(np.arange(shape[0]) * shape[1], np.diff(train.release.offsets))
        + bin_number
    )
    ones = np.ones_like(square_m2)
    errors = np.array(
        [np.bincount(cell, x, shape[0] * shape[1]) for x in (ones, square_m2)]
    )
    errors = errors.reshape(2, *shape)
    gap = max(
        _GAPS.tolist(),
        key=lambda candidate: fits(errors, _FINE_SIGMAS_M, candidate).max(axis=1).sum(),
    )

    @memoised
    def infer_variance(release: Release) -> Floats:
        # Counts and sums of squares by sampling interval, as in `isac_track.noise`.
        arrays = map(
            np.ascontiguousarray, (release.t, release.xy, release.offsets, edges)
        )
        errors = np.zeros((2, len(release), edges.size + 1))
        import_module("isac_track.kalman._linear_loops").innovations_by_interval(
            *arrays, *errors
        )
        best_m = _SIGMAS_M[fits(errors, _SIGMAS_M, gap).argmax(axis=1)]
        sizes = np.diff(release.offsets)
        total_m2 = _total_m2(
            np.repeat(best_m, sizes), _intervals_s(release), gap=gap, rule=rule
        )
        # The rule sets the ratios of the variances within a track, the innovations of
        # the track their level.
        mean_m2 = np.add.reduceat(total_m2, release.offsets[:-1]) / sizes
        level = np.repeat(noise_m2(release) / mean_m2, sizes)
        return np.maximum(level * total_m2, MIN_VARIANCE_M2)

    return infer_variance


def _total_m2(
    sigma_raw_m: Floats, interval_s: Floats, *, gap: float, rule: Fid
) -> Floats:
    """Return the squared standard deviation as shared.

    Equations swarm_fid and fid_error_control of the paper.
    """
    fid = (gap / sigma_raw_m) ** 2 / interval_s
    added_m = fid_d_sigma(fid=fid, eta=rule.eta, alpha_m=rule.alpha, beta=rule.beta)
    if rule.adding == "linear":
        return np.square(sigma_raw_m + added_m)
    return np.asarray(sigma_raw_m**2 + added_m**2)


def _intervals_s(release: Release) -> Floats:
    interval_s = intervals_before(t=release.t, offsets=release.offsets)
    return np.where(interval_s > 0.0, interval_s, _LONE_S)
