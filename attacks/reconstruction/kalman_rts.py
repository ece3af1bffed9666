"""Smoothers of constant-velocity walks, by Rauch, Tung and Striebel: what everybody tries."""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from attacks.parameters import positive, tried
from attacks.reconstruction.learning import TOLD, around, smoothed, smoother
from attacks.reconstruction.own_motion import (
    PRIOR_STD,
    smooth_own_motion,
    white_probabilities,
)
from attacks.remembered import noise_m2, remembered
from isac_track.kalman import Batch, Moods, imm_smoother, smooth_positions
from isac_track.kalman.slow_errors import SlowError
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release

_RADIAL_BELOW = -1 / 3
"""Third cumulant of log distances to a smoothed walk; Gaussian errors have -zeta(3) / 4 = -0.30,
radial ones -2.10 about the walk itself, -0.40 to -0.59 about what a smoother makes of
it."""
_LEAST_M = 1e-9


class _Choice(NamedTuple):
    """What a smoother reckons with; the last two are those of `smooth_positions`."""

    q: float | None  # m^2/s^3; None: each track has a motion of its own.
    passes: int
    anneal: float


@dataclass(frozen=True, slots=True)
class KalmanRTS:
    """Constant velocity, white-noise acceleration; exact for Gaussian errors of known variance."""

    # m^2/s^3; None: learnt from the training set, or `DEFAULT_Q`.
    q: float | None = None

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD
    DEFAULT_Q: ClassVar[float] = 0.04

    def __post_init__(self) -> None:
        positive(q=self.q)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        return RadialRTS(self.q, passes=1, anneal=0.0, own_motion=False).fit(context)


@dataclass(frozen=True, slots=True)
class RadialRTS:
    """Constant velocity; samples that lie close to the walk count for more, again and again.

    That is right for errors of the radial law alone, and which law holds nobody tells:
    the release shows it (`looks_radial`). If it is another, one pass is left. Every
    track has a motion of its own (`smooth_own_motion`); with one for all, a single pass
    is `KalmanRTS`.
    """

    # As of `KalmanRTS`; if given, no track has a motion of its own.
    q: float | None = None
    passes: int | None = None
    """Smoothers; None: learnt from the training set, 1, `USUAL_PASSES` or twice as many; without
    one `USUAL_PASSES` if the errors look radial, else 1. Twice as many gain 1.3 to 2.3
    points of PLR where much error is added linearly, and lose about as much where it is
    independent."""
    anneal: float = 0.15
    own_motion: bool = True  # Else q is learnt from the training set, or `DEFAULT_Q`.

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD
    DEFAULT_Q: ClassVar[float] = 0.04
    USUAL_PASSES: ClassVar[int] = 5

    def __post_init__(self) -> None:
        positive(q=self.q)
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
            return lambda release: (radial if looks_radial(release) else linear)(
                release
            )
        q = self.DEFAULT_Q if self.q is None else self.q
        numbers = tried(self.passes, (1, usual, 2 * usual))
        densities = tried(self.q, around(q, factor=4.0))

        def motions(best: _Choice) -> list[_Choice]:
            if self.own_motion and self.q is None:
                return [best._replace(q=None)]
            return [best._replace(q=density) for density in densities]

        choices = [_Choice(q, number, self.anneal) for number in numbers]
        if Knowledge.TRAIN not in context.granted:
            choices = motions(choices[0])
            choices = [choices[len(choices) // 2]]
        return smoother(context, _smooth, candidates=choices, then=motions)


@dataclass(frozen=True, slots=True)
class ImmRTS:
    """Two constant-velocity models, walking on and stopping or turning, with a Markov chain.

    Filter, smoother and their sources are those of `isac_track.kalman`.
    """

    # m^2/s^3 while walking on; None, with `q_turn`: learnt or `DEFAULT_Q`.
    q: float | None = None
    q_turn: float | None = None  # m^2/s^3 while stopping or turning.
    walk_s: float = 4.0  # Mean time of walking on.
    turn_s: float = 1.5  # Mean time of stopping or turning.

    slow: ClassVar[bool] = True
    seconds_per_sample: ClassVar[float] = 2e-6
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD
    DEFAULT_Q: ClassVar[tuple[float, float]] = (0.03, 0.12)

    def __post_init__(self) -> None:
        if (self.q is None) != (self.q_turn is None):
            raise ValueError("give both q and q_turn, or neither to have them learnt")
        positive(q=self.q, q_turn=self.q_turn, walk_s=self.walk_s, turn_s=self.turn_s)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        given = None if self.q is None or self.q_turn is None else (self.q, self.q_turn)
        walking, turning = (around(density, factor=4.0) for density in self.DEFAULT_Q)
        candidates = tried(given, list(zip(walking, turning, strict=True)))
        return smoother(context, self._smooth, candidates=candidates)

    def _smooth(
        self, release: Release, variance: Floats, density: tuple[float, float]
    ) -> Reconstruction:
        batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
        # The spread between the modes couples the axes; what is claimed is their mean
        # variance.
        position, spread = imm_smoother(
            batch, Moods(density, (self.walk_s, self.turn_s))
        )
        return Reconstruction(position, np.sqrt(spread))


def _smooth(release: Release, variance: Floats, choice: _Choice) -> Reconstruction:
    """Return smoothed positions."""
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
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


@remembered
def information(release: Release, passes: int) -> Floats:
    """Return what each sample tells of where the walk was, per axis, (M,) 1/m^2.

    The inverse of the error variance; under radial errors the weights in the last of a
    smoother's `passes`: a sample close to the walk is very likely almost exact.
    """
    variance = np.repeat(noise_m2(release), np.diff(release.offsets))
    if not looks_radial(release):
        return 1.0 / variance
    found = smoothed(
        release, _smooth, _Choice(RadialRTS.DEFAULT_Q, passes, RadialRTS().anneal)
    )
    assert found.std is not None
    square_m2 = ((release.xy - found.xy) ** 2).sum(axis=1)
    return np.asarray(1.0 / (square_m2 + 2.0 * found.std**2) + 0.5 / variance)


@remembered
def looks_radial(release: Release) -> bool:
    """Return whether the errors of a release are radial, by their distances to smoothed walks.

    Of the logarithm of a distance the third cumulant is taken, about each track's own
    mean: what scales the errors does not move it. A radial error is often far smaller
    than sigma, which skews the logarithm to the left; the smoother's own error blurs
    that. Tracks of fewer than three samples do not count.
    """
    off_m = (
        release.xy - smoothed(release, _smooth, _Choice(KalmanRTS.DEFAULT_Q, 1, 0.0)).xy
    )
    square_m2 = off_m[:, 0] * off_m[:, 0] + off_m[:, 1] * off_m[:, 1]
    log_m = 0.5 * np.log(
        np.maximum(square_m2, _LEAST_M**2, out=square_m2), out=square_m2
    )
    sizes, first = np.diff(release.offsets), release.offsets[:-1]
    log_m -= np.repeat(np.add.reduceat(log_m, first) / sizes, sizes)
    unbiased = ((sizes - 1) * (sizes - 2) / sizes).sum()
    return bool((log_m * log_m * log_m).sum() < _RADIAL_BELOW * unbiased)
