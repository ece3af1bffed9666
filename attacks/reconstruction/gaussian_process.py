"""Gaussian-process regression of each axis on time, in linear time."""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from attacks.parameters import candidate_values, require_positive
from attacks.reconstruction.learning import (
    COMMON_KNOWLEDGE,
    candidates_around,
    make_smoother,
)
from isac_track.measurement import error_ellipses, mean_variance
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Ints, Knowledge, Reconstruction, Release

TREND_STD = (100.0, 10.0)  # m and m/s, of the line: far more than any walk needs.


@dataclass(frozen=True, slots=True)
class GaussianProcess:
    """A Matern-3/2 process about a straight line, for each axis and track.

    The line's offset from the first shared position and its slope have vague Gaussian
    priors (`TREND_STD`): no mean attracts place or speed of a walk.
    The noise is as estimated. A Kalman filter and a Rauch-Tung-Striebel smoother of
    line and process run over all tracks at once.

    References
    ----------
    Hartikainen, Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian
    process regression models", IEEE MLSP, 2010. Rasmussen, Williams, *Gaussian
    Processes for Machine Learning*, 2006: sections 2.2, 4.2.1.
    """

    length_s: float | None = None
    """s; None, with `scale_m`: learnt from a training set, or else `DEFAULT`."""
    scale_m: float | None = None  # m, standard deviation of the process about the line.

    slow: ClassVar[bool] = True
    seconds_per_sample: ClassVar[float] = 3.2e-6
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE
    DEFAULT: ClassVar[tuple[float, float]] = (12.0, 2.5)

    def __post_init__(self) -> None:
        if (self.length_s is None) != (self.scale_m is None):
            raise ValueError(
                "give both length_s and scale_m, or neither to have them learnt"
            )
        require_positive(length_s=self.length_s, scale_m=self.scale_m)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the regression of releases like those in the training set."""
        given = None
        if self.length_s and self.scale_m:
            given = (self.length_s, self.scale_m)
        length_s, middle_m = self.DEFAULT
        others = [
            (length_s, scale_m) for scale_m in candidates_around(middle_m, factor=2.0)
        ]
        return make_smoother(
            context, smooth, candidates=candidate_values(given, others)
        )


def smooth(
    release: Release, variance: Floats, kernel: tuple[float, float]
) -> Reconstruction:
    """Return the posterior of every track at its samples, by filter and smoother.

    Step k of all tracks that have it is taken at once. `variance`, (M,) m^2, is that of
    the errors per axis, `kernel` length, s, and scale, m. Errors with a shape have the
    declared one, and `variance` is the mean of both axes.
    """
    if release.cov is not None:
        return _smooth_ellipses(release, variance, error_ellipses(release.cov), kernel)
    first, sizes = release.offsets[:-1], np.diff(release.offsets)
    rows, starts = _by_step(release)
    origin = np.repeat(release.xy[first], sizes, axis=0)
    xy, noise = (release.xy - origin)[rows], variance[rows]
    elapsed_s = np.diff(release.t, prepend=release.t[0])
    elapsed_s[first] = 0.0  # not since the end of another track
    prior, move = _model(elapsed_s[rows], kernel=kernel)
    measured = np.array([1.0, 0.0, 1.0, 0.0])  # position on the line plus the process
    mean, cov = np.zeros((rows.size, 2, 4)), np.empty((rows.size, 4, 4))
    ahead_mean, ahead_cov = np.zeros_like(mean), np.empty_like(cov)
    ahead_cov[: starts[1]] = prior
    process = prior.copy()
    process[:2] = 0.0  # the line does not move
    grown = process - move @ process @ move.swapaxes(1, 2)
    previous = slice(0, 0)
    for lo, hi in pairwise(starts.tolist()):
        now = slice(lo, hi)
        if lo > 0:
            before = slice(previous.start, previous.start + hi - lo)
            transition = move[now].swapaxes(1, 2)
            ahead_mean[now] = mean[before] @ transition
            ahead_cov[now] = move[now] @ cov[before] @ transition + grown[now]
        towards = ahead_cov[now] @ measured  # (n, d) covariance with what is measured
        spread = towards @ measured + noise[now]
        innovation = xy[now] - ahead_mean[now] @ measured
        gain = towards / spread[:, None]
        mean[now] = ahead_mean[now] + innovation[:, :, None] * gain[:, None, :]
        cov[now] = ahead_cov[now] - gain[:, :, None] * towards[:, None, :]
        previous = now
    for lo, hi, top in zip(starts[-3::-1], starts[-2:0:-1], starts[:1:-1], strict=True):
        later, earlier = slice(hi, top), slice(lo, lo + top - hi)
        # The smoother's gain, transposed.
        back = np.linalg.solve(ahead_cov[later], move[later] @ cov[earlier])
        mean[earlier] += (mean[later] - ahead_mean[later]) @ back
        cov[earlier] += back.swapaxes(1, 2) @ (cov[later] - ahead_cov[later]) @ back
    place, std = origin.copy(), np.empty(rows.size)
    place[rows] += mean @ measured
    std[rows] = np.sqrt(np.maximum((cov @ measured) @ measured, 0.0))
    return Reconstruction(place, std)


def _by_step(release: Release) -> tuple[Ints, Ints]:
    """Return the samples by their number in a track, and where numbers begin.

    Of each number the longest tracks are first, of equals in their order.
    """
    sizes = np.diff(release.offsets)
    step = np.arange(release.t.size) - np.repeat(release.offsets[:-1], sizes)
    rows = np.lexsort((np.repeat(-sizes, sizes), step))
    return rows, np.concatenate([[0], np.cumsum(np.bincount(step))])


def _smooth_ellipses(
    release: Release, variance: Floats, ellipse: Floats, kernel: tuple[float, float]
) -> Reconstruction:
    """Return what `smooth` does where the errors couple both axes.

    The state has the four numbers of either axis, and a measurement is a position.
    `ellipse`, (M, 2, 2), is in units of `variance`.
    """
    first, sizes = release.offsets[:-1], np.diff(release.offsets)
    rows, starts = _by_step(release)
    origin = np.repeat(release.xy[first], sizes, axis=0)
    xy = (release.xy - origin)[rows]
    noise = (variance[:, None, None] * ellipse)[rows]
    elapsed_s = np.diff(release.t, prepend=release.t[0])
    elapsed_s[first] = 0.0  # not since the end of another track
    prior, move = (
        np.kron(np.eye(2), part) for part in _model(elapsed_s[rows], kernel=kernel)
    )
    measured = np.kron(np.eye(2), np.array([[1.0, 0.0, 1.0, 0.0]]))
    mean, cov = np.zeros((rows.size, 8)), np.empty((rows.size, 8, 8))
    ahead_mean, ahead_cov = np.zeros_like(mean), np.empty_like(cov)
    ahead_cov[: starts[1]] = prior
    process = prior * np.tile([0.0, 0.0, 1.0, 1.0], 2)  # the line does not move
    grown = process - move @ process @ move.swapaxes(1, 2)
    previous = slice(0, 0)
    for lo, hi in pairwise(starts.tolist()):
        now = slice(lo, hi)
        if lo > 0:
            before = slice(previous.start, previous.start + hi - lo)
            turned = move[now].swapaxes(1, 2)
            ahead_mean[now] = np.einsum("nab,nb->na", move[now], mean[before])
            ahead_cov[now] = move[now] @ cov[before] @ turned + grown[now]
        towards = ahead_cov[now] @ measured.T
        gain = np.linalg.solve(
            measured @ towards + noise[now], towards.swapaxes(1, 2)
        ).swapaxes(1, 2)
        innovation = xy[now] - ahead_mean[now] @ measured.T
        mean[now] = ahead_mean[now] + np.einsum("nab,nb->na", gain, innovation)
        cov[now] = ahead_cov[now] - gain @ towards.swapaxes(1, 2)
        previous = now
    for lo, hi, top in zip(starts[-3::-1], starts[-2:0:-1], starts[:1:-1], strict=True):
        later, earlier = slice(hi, top), slice(lo, lo + top - hi)
        # The smoother's gain, transposed.
        back = np.linalg.solve(ahead_cov[later], move[later] @ cov[earlier])
        surprise = mean[later] - ahead_mean[later]
        mean[earlier] += np.einsum("nba,nb->na", back, surprise)
        cov[earlier] += back.swapaxes(1, 2) @ (cov[later] - ahead_cov[later]) @ back
    place, std = origin.copy(), np.empty(rows.size)
    place[rows] += mean @ measured.T
    spread = mean_variance(measured @ cov @ measured.T)
    std[rows] = np.sqrt(np.maximum(spread, 0.0))
    return Reconstruction(place, std)


def _model(step_s: Floats, *, kernel: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the prior covariance (4, 4) and exp(F step), (M, 4, 4).

    The state is offset and slope of the line, then the process and its derivative.
    """
    length_s, scale_m = kernel
    rate = np.sqrt(3.0) / length_s
    prior = np.diag([*np.square(TREND_STD), scale_m**2, scale_m**2 * rate**2])
    # The characteristic polynomial is (s + rate)^2, so F + rate 1 is nilpotent and its
    # exponential series finite.
    rest = np.array([[rate, 1.0], [-(rate**2), -rate]])
    tau = step_s[:, None, None]
    move = np.zeros((step_s.size, 4, 4))
    move[:, :2, :2] = np.eye(2)
    move[:, 0, 1] = step_s
    move[:, 2:, 2:] = np.exp(-rate * tau) * (np.eye(2) + tau * rest)
    return prior, move
