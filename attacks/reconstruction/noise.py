"""How noisy each sample is, for what an adversary knows.

Blind, an adversary reads one level of noise for each track off its innovations. With the declared
standard deviations (the oracle) nothing is left to guess but the error law. In between, under
FID-controlled sharing, the rule itself tells: a sample gets error if the information that it
carries per second, ``(gap / sigma_raw)^2 / interval``, exceeds the public threshold. The
intervals are in the release; what an informed adversary finds is one raw standard deviation for
each track, the one under which the rule explains best how the track's errors differ between short
and long intervals (one is a simplification: the beam fluctuates from sample to sample). The gap of
the network's estimator is a constant, learnt from other people.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.noise import MIN_VARIANCE_M2, innovation_variance_m2
from isac_track.sensing import intervals_before
from isac_track.sharing import Fid, fid_d_sigma
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Ints, Release

RADIAL_PER_AXIS = 0.5
"""Variance per axis of a radial error of standard deviation 1: the paper's law, if nobody tells."""
_SIGMAS_M = np.geomspace(0.01, 8.0, 80)
_FINE_SIGMAS_M = np.geomspace(0.01, 8.0, 240)
"""For a fit over whole tracks: steps well below what hundreds of samples can tell apart."""
_GAPS = np.geomspace(1.0, 32.0, 16)
_N_BINS = 6
_LONE_S = 1.0
"""s, in place of the interval that a lone sample does not have."""


@dataclass(frozen=True, eq=False, slots=True)
class Binned:
    """Squared errors of tracks, summed over samples of like sampling interval."""

    count: Floats
    """(N, B)"""
    total_m2: Floats
    """(N, B) sum of squared lengths."""


def learn_variance(context: AttackContext) -> Callable[[Release], Floats]:
    """Return what tells the error variance per axis of every sample of a release, (M,) m^2."""
    if Knowledge.SIGMA in context.granted:
        share = _share_per_axis(context)
        return lambda release: _declared(release, share=share)
    knows = {Knowledge.MECHANISM, Knowledge.TRAIN} <= context.granted
    if knows and isinstance(context.mechanism, Fid):
        return _learn_fid(context, mechanism=context.mechanism)
    return _estimated


def _estimated(release: Release) -> Floats:
    level = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    return np.repeat(level, np.diff(release.offsets))


def _declared(release: Release, *, share: float) -> Floats:
    assert release.sigma is not None  # granted
    return np.maximum(share * release.sigma**2, MIN_VARIANCE_M2)


def _share_per_axis(context: AttackContext) -> float:
    """Return which share of a squared standard deviation falls on either axis."""
    if Knowledge.TRAIN not in context.granted:
        return RADIAL_PER_AXIS
    train = context.train
    assert train.release.sigma is not None  # granted
    declared_m2 = float((train.release.sigma**2).sum())
    if declared_m2 == 0.0:
        return RADIAL_PER_AXIS
    return float(((train.release.xy - train.truth) ** 2).sum()) / 2.0 / declared_m2


def _learn_fid(context: AttackContext, *, mechanism: Fid) -> Callable[[Release], Floats]:
    train = context.train
    release = train.release
    interval_s = _intervals(release)
    edges = np.unique(np.quantile(interval_s, np.linspace(0.0, 1.0, _N_BINS + 1)[1:-1]))
    square_m2 = ((release.xy - train.truth) ** 2).sum(axis=1)
    seen = _binned(square_m2, release=release, interval_s=interval_s, edges=edges)
    middle_s = _middles(interval_s, edges=edges)
    fits = [
        _log_likelihood(
            seen, square_m2=_total_m2(_FINE_SIGMAS_M[:, None], middle_s, gap=gap, rule=mechanism)
        )
        .max(axis=1)
        .sum()
        for gap in _GAPS
    ]
    gap = float(_GAPS[int(np.argmax(fits))])

    def inferred(release: Release) -> Floats:
        interval_s = _intervals(release)
        square_m2, counts = _innovation_squares(release)
        seen = _binned(
            square_m2, release=release, interval_s=interval_s, edges=edges, counts=counts
        )
        model_m2 = _total_m2(_SIGMAS_M[:, None], middle_s, gap=gap, rule=mechanism)
        best = _SIGMAS_M[_log_likelihood(seen, square_m2=model_m2).argmax(axis=1)]
        sigma_raw_m = np.repeat(best, np.diff(release.offsets))
        total_m2 = _total_m2(sigma_raw_m, interval_s, gap=gap, rule=mechanism)
        # The rule says how the samples of a track differ, the track itself how large they are.
        owner = np.repeat(np.arange(len(release)), np.diff(release.offsets))
        scale = _estimated(release) / _mean_of_track(total_m2, owner=owner, n=len(release))
        return np.maximum(scale * total_m2, MIN_VARIANCE_M2)

    return inferred


def _total_m2(sigma_raw_m: Floats, interval_s: Floats, *, gap: float, rule: Fid) -> Floats:
    """Return the squared standard deviation as shared, by eqs. swarm_fid and fid_error_control."""
    fid = (gap / sigma_raw_m) ** 2 / interval_s
    added_m = fid_d_sigma(fid=fid, eta=rule.eta, alpha_m=rule.alpha, beta=rule.beta)
    if rule.adding == "linear":
        linear: Floats = (sigma_raw_m + added_m) ** 2
        return linear
    independent: Floats = sigma_raw_m**2 + added_m**2
    return independent


def _log_likelihood(seen: Binned, *, square_m2: Floats) -> Floats:
    """Return the log likelihood of each track under each hypothesis, (N, S), up to a factor.

    The length of a radial error is |N(0, sigma)|: -log sigma - r^2 / (2 sigma^2) a sample. An
    isotropic error has twice that, which moves no maximum.

    Parameters
    ----------
    seen : Binned
    square_m2 : (S, B) m^2
        Mean squared length in each bin under each hypothesis.
    """
    likelihood: Floats = -(seen.count @ np.log(square_m2).T + seen.total_m2 @ (1.0 / square_m2).T)
    return likelihood


def _intervals(release: Release) -> Floats:
    interval_s = intervals_before(t=release.t, offsets=release.offsets)
    return np.where(interval_s > 0.0, interval_s, _LONE_S)


def _innovation_squares(release: Release) -> tuple[Floats, Floats]:
    """Return squared innovations scaled to the squared length of one error, (M,), and which count.

    As in `isac_track.noise`. An innovation spans three samples and counts for the middle one, which
    weighs most in it; the first and the last of a track have none.
    """
    counts = np.ones_like(release.t)
    counts[release.offsets[:-1]] = 0.0
    counts[release.offsets[1:] - 1] = 0.0
    square_m2 = np.zeros_like(release.t)
    step_s = np.diff(release.t)
    if step_s.size > 1:
        ratio = np.where(
            counts[1:-1] > 0, step_s[1:] / np.where(step_s[:-1] > 0, step_s[:-1], 1), 0
        )
        x, y = release.xy[:, 0], release.xy[:, 1]
        gap_x = x[2:] - x[1:-1] - ratio * (x[1:-1] - x[:-2])
        gap_y = y[2:] - y[1:-1] - ratio * (y[1:-1] - y[:-2])
        square_m2[1:-1] = (gap_x**2 + gap_y**2) / (1.0 + (1.0 + ratio) ** 2 + ratio**2)
    return square_m2 * counts, counts


def _binned(
    square_m2: Floats,
    *,
    release: Release,
    interval_s: Floats,
    edges: Floats,
    counts: Floats | None = None,
) -> Binned:
    n_tracks, n_bins = len(release), edges.size + 1
    owner = np.repeat(np.arange(n_tracks), np.diff(release.offsets))
    cell: Ints = owner * n_bins + np.searchsorted(edges, interval_s, side="right")
    weight = np.ones_like(square_m2) if counts is None else counts
    sums = [
        np.bincount(cell, values, n_tracks * n_bins).astype(np.float64).reshape(n_tracks, n_bins)
        for values in (weight, square_m2)
    ]
    return Binned(count=sums[0], total_m2=sums[1])


def _middles(interval_s: Floats, *, edges: Floats) -> Floats:
    """Return the mean interval of each bin, (B,) s."""
    which = np.searchsorted(edges, interval_s, side="right")
    count = np.bincount(which, minlength=edges.size + 1)
    total = np.bincount(which, interval_s, edges.size + 1)
    # An empty bin (equal quantiles) is nobody's; any positive time will do.
    middle_s: Floats = np.where(count > 0, total / np.maximum(count, 1), interval_s.mean())
    return middle_s


def _mean_of_track(values: Floats, *, owner: Ints, n: int) -> Floats:
    """Return for every sample the mean over its track, (M,)."""
    mean: Floats = (np.bincount(owner, values, n) / np.bincount(owner, minlength=n))[owner]
    return mean
