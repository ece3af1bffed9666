"""What an adversary finds out first: hyper-parameters from other people, and how noisy samples are.

Blind, an adversary reads one level of noise for each track off its innovations. With
the declared standard deviations (the oracle) only the error law is left to guess. In
between, under FID-controlled sharing, the rule tells: a sample gets error if its
information per second, ``(gap / sigma_raw)^2 / interval``, exceeds the public
threshold. Found is the raw standard deviation of each track under which the rule
explains best how errors differ between short and long intervals; the gap of the
network's estimator is a constant, learnt from other people.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from typing import TypeVar

import numpy as np

from attacks.remembered import noise_m2, remembered
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
TOLD = frozenset({Knowledge.MECHANISM, Knowledge.TRAIN, Knowledge.SIGMA})
"""What `learn_variance` and `choose` make use of."""
_POWERS = (-1.0, 0.0, 1.0)
N_CANDIDATES = len(_POWERS)  # What a built-in attack tries before it attacks.
# Variance of a radial error of std 1: the paper's law, if nobody tells.
RADIAL_PER_AXIS = 0.5
_SIGMAS_M = np.geomspace(0.01, 8.0, 80)
_FINE_SIGMAS_M = np.geomspace(
    0.01, 8.0, 240
)  # Steps below what whole tracks can tell apart.
_GAPS = np.geomspace(1.0, 32.0, 16)
_N_BINS = 6
_LONE_S = 1.0  # s, in place of the interval that a lone sample does not have.


def around(default: float, *, factor: float) -> tuple[float, ...]:
    """Return ``default / factor``, the default and ``default * factor``.

    Defaults of motion come from the bundled crowd, whose constants were set by hand to
    agree with Students03: of that recording they know as much.
    """
    return tuple(default * factor**power for power in _POWERS)


def choose(
    context: AttackContext,
    *,
    default: _Choice,
    candidates: Sequence[_Choice],
    reconstruct: Callable[[_Choice, Release], Floats],
) -> _Choice:
    """Return the candidate that reconstructs the training set best; without one the default.

    Of equals the first is taken. `reconstruct` is from a candidate and a release to
    positions, (M, 2) m. Own attacks call it as well: docs/attacks.md.
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


def smoother(
    context: AttackContext,
    smooth: Callable[[Release, Floats, _Choice], Reconstruction],
    *,
    candidates: Sequence[_Choice],
    then: Callable[[_Choice], Sequence[_Choice]] = lambda best: (best,),
) -> Reconstructor:
    """Return what smooths releases like those in the training set, by the noise of each sample.

    `smooth` takes a release, the error variance per axis, (M,) m^2, and a choice: the
    candidate that reconstructs the training set best (of equals the first), or without
    one the middle one, as from `around`. `then` makes further candidates of that one.
    """
    variance = learn_variance(context)

    @cache
    def reconstruct(one: _Choice, release: Release) -> Floats:
        return smooth(release, variance(release), one).xy

    choice = candidates[len(candidates) // 2]
    choice = choose(
        context, default=choice, candidates=candidates, reconstruct=reconstruct
    )
    choice = choose(
        context, default=choice, candidates=then(choice), reconstruct=reconstruct
    )
    if variance is _estimated:  # two adversaries may well choose alike
        return lambda release: smoothed(release, smooth, choice)
    return lambda release: smooth(release, variance(release), choice)


@remembered
def smoothed(
    release: Release,
    smooth: Callable[[Release, Floats, _Choice], Reconstruction],
    choice: _Choice,
) -> Reconstruction:
    """Return what a smoother makes of a release by the noise that its innovations show."""
    return smooth(release, _estimated(release), choice)


def exposure_loss(
    *, xy: Floats, truth: Floats, offsets: Ints, epsilon_m: float
) -> float:
    """Return a smooth stand-in for 1 - PLR: the mean of d^2 / (d^2 + epsilon^2).

    Of (M, 2) positions, over the samples of a track, then over tracks, as for PLR.
    """
    square = squared_lengths(xy - truth)
    share = np.add.reduceat(square / (square + epsilon_m**2), offsets[:-1]) / np.diff(
        offsets
    )
    return float(share.mean())


def learn_variance(context: AttackContext) -> Callable[[Release], Floats]:
    """Return what tells the error variance per axis of every sample of a release, (M,) m^2."""
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
    return _estimated


def _estimated(release: Release) -> Floats:
    return np.repeat(noise_m2(release), np.diff(release.offsets))


def _declared_m2(release: Release) -> Floats:
    assert release.sigma is not None  # granted
    return release.sigma**2


@remembered
def _learn_fid(train: TrainingSet, rule: Fid) -> Callable[[Release], Floats]:
    """Learn the gap of the estimator, and return what finds the raw error of every track."""
    interval_s = _intervals(train.release)
    edges = np.unique(np.quantile(interval_s, np.linspace(0.0, 1.0, _N_BINS + 1)[1:-1]))
    which = np.searchsorted(edges, interval_s, side="right")
    count = np.bincount(which, minlength=edges.size + 1)
    total_s = np.bincount(which, interval_s, edges.size + 1)
    # An empty bin (equal quantiles) is nobody's; any positive time will do.
    middle_s = np.where(count > 0, total_s / np.maximum(count, 1), interval_s.mean())

    def fits(errors: Floats, sigmas_m: Floats, gap: float) -> Floats:
        """Return the log likelihood of each track under each raw error, (N, S), up to a factor.

        `errors`, (2, N, B), are counts and sums of squares by sampling interval. The
        length of a radial error is |N(0, sigma)|; an isotropic one has twice its log
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
        + which
    )
    ones = np.ones_like(square_m2)
    errors = np.array(
        [np.bincount(cell, x, shape[0] * shape[1]) for x in (ones, square_m2)]
    )
    errors = errors.reshape(2, *shape)
    gap = max(
        _GAPS.tolist(),
        key=lambda one: fits(errors, _FINE_SIGMAS_M, one).max(axis=1).sum(),
    )

    @remembered
    def inferred(release: Release) -> Floats:
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
            np.repeat(best_m, sizes), _intervals(release), gap=gap, rule=rule
        )
        # The rule says how the samples of a track differ, the track itself how large
        # they are.
        mean_m2 = np.add.reduceat(total_m2, release.offsets[:-1]) / sizes
        level = np.repeat(noise_m2(release) / mean_m2, sizes)
        return np.maximum(level * total_m2, MIN_VARIANCE_M2)

    return inferred


def _total_m2(
    sigma_raw_m: Floats, interval_s: Floats, *, gap: float, rule: Fid
) -> Floats:
    """Return the squared standard deviation as shared, by eqs. swarm_fid and fid_error_control."""
    fid = (gap / sigma_raw_m) ** 2 / interval_s
    added_m = fid_d_sigma(fid=fid, eta=rule.eta, alpha_m=rule.alpha, beta=rule.beta)
    if rule.adding == "linear":
        return np.square(sigma_raw_m + added_m)
    return np.asarray(sigma_raw_m**2 + added_m**2)


def _intervals(release: Release) -> Floats:
    interval_s = intervals_before(t=release.t, offsets=release.offsets)
    return np.where(interval_s > 0.0, interval_s, _LONE_S)
