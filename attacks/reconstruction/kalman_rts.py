"""Smoothers of constant-velocity walks, by Rauch, Tung and Striebel."""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from attacks.parameters import candidate_values, require_positive
from attacks.reconstruction.learning import (
    COMMON_KNOWLEDGE,
    candidates_around,
    make_smoother,
    smooth_memoised,
)
from attacks.reconstruction.own_motion import (
    PRIOR_STD,
    smooth_own_motion,
    white_probabilities,
)
from attacks.remembered import memoised, noise_m2
from isac_track.kalman import Batch, smooth_positions
from isac_track.kalman.slow_errors import SlowError
from isac_track.measurement import error_ellipses, mean_variance, round_errors
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Ints, Knowledge, Reconstruction, Release

_RADIAL_BELOW = -1 / 3
"""Third cumulant of log distances to a smoothed walk, below which errors are radial.

Gaussian errors have -zeta(3) / 4 = -0.30. Radial errors: -2.10 about the walk itself,
and -0.36 to -0.59 about the smoothed walk.
"""
_BLOCK = 16  # Samples over which the scale of errors hardly changes: 1 to 2 s.
_LEAST_M = 1e-9


class _Choice(NamedTuple):
    """Parameters of a smoother; the last two are those of `smooth_positions`."""

    q: float | None  # m^2/s^3; None: each track has a motion of its own.
    passes: int
    anneal: float


@dataclass(frozen=True, slots=True)
class KalmanRTS:
    """A constant-velocity smoother with white-noise acceleration.

    It is exact for Gaussian errors of known variance, and of a declared shape.
    """

    # m^2/s^3; None: learnt from the training set, or `DEFAULT_Q`.
    q: float | None = None

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE
    DEFAULT_Q: ClassVar[float] = 0.04

    def __post_init__(self) -> None:
        require_positive(q=self.q)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        return RadialRTS(self.q, passes=1, anneal=0.0, own_motion=False).fit(context)


@dataclass(frozen=True, slots=True)
class RadialRTS:
    """A constant-velocity smoother that gives samples close to the walk more weight.

    That is right under the radial error law alone. No adversary is granted the law, but
    the release shows it (`looks_radial`). Under another law there is one pass. Every
    track has a motion of its own (`smooth_own_motion`); with one motion for all, a
    single pass is `KalmanRTS`.
    """

    # As of `KalmanRTS`; if given, no track has a motion of its own.
    q: float | None = None
    passes: int | None = None
    """Number of smoothers; None: learnt, 1, `USUAL_PASSES` or twice as many.

    Without a training set it is `USUAL_PASSES` if the errors look radial, else 1. Twice
    as many gain 1.3 to 2.3 points of PLR where much error is added linearly, and lose
    about as much where it is independent.
    """
    anneal: float = 0.15
    own_motion: bool = True  # Else q is learnt from the training set, or `DEFAULT_Q`.

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE
    DEFAULT_Q: ClassVar[float] = 0.04
    USUAL_PASSES: ClassVar[int] = 5

    def __post_init__(self) -> None:
        require_positive(q=self.q)
        if self.passes is not None and self.passes < 1:
            raise ValueError(f"passes must be at least 1, got {self.passes}")
        if not 0 <= self.anneal < 1:
            raise ValueError(f"anneal must lie in [0, 1), got {self.anneal}")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        usual = self.USUAL_PASSES
        if self.passes is None and Knowledge.TRAIN not in context.granted:
            radial = replace(self, passes=usual).fit(context)
            linear = replace(self, passes=1, anneal=0.0).fit(context)

            def smooth_by_law(release: Release) -> Reconstruction:
                if looks_radial(release):
                    return radial(release)
                return linear(release)

            return smooth_by_law
        q = self.DEFAULT_Q if self.q is None else self.q
        numbers = candidate_values(self.passes, (1, usual, 2 * usual))
        densities = candidate_values(self.q, candidates_around(q, factor=4.0))

        def motions(best: _Choice) -> list[_Choice]:
            if self.own_motion and self.q is None:
                return [best._replace(q=None)]
            return [best._replace(q=density) for density in densities]

        choices = [_Choice(q, number, self.anneal) for number in numbers]
        if Knowledge.TRAIN not in context.granted:
            choices = motions(choices[0])
            choices = [choices[len(choices) // 2]]
        return make_smoother(context, _smooth, candidates=choices, refine=motions)


def _smooth(release: Release, variance: Floats, choice: _Choice) -> Reconstruction:
    """Return smoothed positions; the shape of the errors is as declared, if any."""
    ellipse = None if release.cov is None else error_ellipses(release.cov)
    t, xy, offsets = release.t, release.xy, release.offsets
    batch = Batch(t, xy, variance, offsets, PRIOR_STD, ellipse)
    q, passes, anneal = choice
    if q is None:
        nothing = SlowError(0.0, 0.0)
        weight = white_probabilities(release)
        position, spread = smooth_own_motion(
            batch, nothing, weight, passes=passes, anneal=anneal
        )
    else:
        position, spread = smooth_positions(batch, q=q, passes=passes, anneal=anneal)
    return Reconstruction(position, np.sqrt(spread))


@memoised
def information(release: Release, passes: int) -> Floats:
    """Return the information of each sample on its position, (M,) 1/m^2 per axis.

    It is the inverse of the error variance. Under radial errors it is the weight in the
    last of a smoother's `passes`: a sample close to the walk is very likely almost
    exact. Of errors with a declared shape it is that of a sample's mean variance.
    """
    variance = np.repeat(noise_m2(release), np.diff(release.offsets))
    if release.cov is not None:
        variance = np.maximum(mean_variance(release.cov), MIN_VARIANCE_M2)
    if not looks_radial(release):
        return 1.0 / variance
    smoothed = smooth_memoised(
        release, _smooth, _Choice(RadialRTS.DEFAULT_Q, passes, RadialRTS().anneal)
    )
    assert smoothed.std is not None
    square_m2 = (_gaps(release, smoothed) ** 2).sum(axis=1)
    return np.asarray(1.0 / (square_m2 + 2.0 * smoothed.std**2) + 0.5 / variance)


def _gaps(release: Release, smoothed: Reconstruction) -> Floats:
    """Return samples less smoothed positions, (M, 2) m, in units of declared shapes."""
    gap_m = release.xy - smoothed.xy
    if release.cov is None:
        return gap_m
    return round_errors(cov=error_ellipses(release.cov), error=gap_m)


@memoised
def looks_radial(release: Release) -> bool:
    """Return whether errors are radial, by the distances to smoothed walks.

    The decision rests on the third cumulant of the log distance, about the mean of each
    block of neighbouring samples. The scale of the errors does not change it, nor does
    a scale that drifts along a track. Where a shape is declared, a distance counts in
    units of the ellipse. A radial error is often far smaller than sigma, which skews
    the logarithm to the left; the smoother's own error blurs that. Blocks of fewer than
    three samples do not count.
    """
    single_pass = _Choice(KalmanRTS.DEFAULT_Q, 1, 0.0)
    gap_m = _gaps(release, smooth_memoised(release, _smooth, single_pass))
    square_m2 = gap_m[:, 0] * gap_m[:, 0] + gap_m[:, 1] * gap_m[:, 1]
    log_m = 0.5 * np.log(
        np.maximum(square_m2, _LEAST_M**2, out=square_m2), out=square_m2
    )
    first = _block_starts(release.offsets)
    sizes = np.diff(first, append=log_m.size)
    log_m -= np.repeat(np.add.reduceat(log_m, first) / sizes, sizes)
    unbiased = ((sizes - 1) * (sizes - 2) / sizes).sum()
    return bool((log_m * log_m * log_m).sum() < _RADIAL_BELOW * unbiased)


def _block_starts(offsets: Ints) -> Ints:
    """Return the first sample of each block of `_BLOCK` samples; tracks begin a block."""
    n_blocks = -(-np.diff(offsets) // _BLOCK)
    number = np.arange(n_blocks.sum()) - np.repeat(
        np.cumsum(n_blocks) - n_blocks, n_blocks
    )
    return np.asarray(np.repeat(offsets[:-1], n_blocks) + _BLOCK * number)
