"""Smoothers of constant-velocity walks, by Rauch, Tung and Striebel: which everybody tries first.

For Gaussian errors, for radial ones, which are heavy at zero, and with two moods of a walk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.parameters import positive
from attacks.reconstruction.learning import TOLD, around, smoother
from isac_track.kalman import Batch, Moods, imm_smoother, smooth_positions
from isac_track.types import Floats, Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from isac_track.protocols import AttackContext, Reconstructor

PRIOR_STD = (100.0, 10.0)
"""m around the first sample and m/s around rest: far more than any walk."""


@dataclass(frozen=True, slots=True)
class KalmanRTS:
    """Constant velocity, white-noise acceleration; exact for Gaussian errors of known variance."""

    q: float | None = None
    """m^2/s^3; None: learnt from the training set, or `DEFAULT_Q` without one."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD
    DEFAULT_Q: ClassVar[float] = 0.04

    def __post_init__(self) -> None:
        positive(q=self.q)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        candidates = around(self.DEFAULT_Q, factor=4.0)
        return smoother(context, smooth, given=self.q, candidates=candidates)


@dataclass(frozen=True, slots=True)
class RadialRTS:
    """Constant velocity; samples that lie close to the walk count for more, again and again."""

    q: float | None = None
    """m^2/s^3; None: learnt from the training set, or `DEFAULT_Q` without one."""
    passes: int = 5
    """Smoothers; more gain little under linear adding and lose a little under independent."""
    anneal: float = 0.15

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD
    DEFAULT_Q: ClassVar[float] = 0.04

    def __post_init__(self) -> None:
        positive(q=self.q)
        if self.passes < 1:
            raise ValueError(f"passes must be at least 1, got {self.passes}")
        if not 0 <= self.anneal < 1:
            raise ValueError(f"anneal must lie in [0, 1), got {self.anneal}")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        candidates = around(self.DEFAULT_Q, factor=4.0)
        return smoother(context, self._smooth, given=self.q, candidates=candidates)

    def _smooth(self, release: Release, variance: Floats, q: float) -> Reconstruction:
        return smooth(release, variance, q, passes=self.passes, anneal=self.anneal)


@dataclass(frozen=True, slots=True)
class ImmRTS:
    """Two constant-velocity models, walking on and stopping or turning, with a Markov chain.

    The default densities reconstruct the bundled crowd best; the robot's tracker `kalman_imm`
    foresees a second and has a calmer first mode. The smoother is Barber's expectation
    correction; see `isac_track.kalman`.

    References
    ----------
    Blom, Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian
    switching coefficients", IEEE Trans. Automatic Control 33(8), 1988, 780-783. Barber,
    "Expectation correction for smoothed inference in switching linear dynamical systems",
    J. Machine Learning Research 7, 2006, 2515-2540.
    """

    q: float | None = None
    """m^2/s^3 while walking on; None, together with `q_turn`: learnt from the training set, or
    `DEFAULT_Q` without one."""
    q_turn: float | None = None
    """m^2/s^3 while stopping or turning."""
    walk_s: float = 4.0
    """Mean time of walking on."""
    turn_s: float = 1.5
    """Mean time of stopping or turning."""

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
        candidates = list(zip(walking, turning, strict=True))
        return smoother(context, self._smooth, given=given, candidates=candidates)

    def _smooth(
        self, release: Release, variance: Floats, density: tuple[float, float]
    ) -> Reconstruction:
        batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
        # The spread between the modes couples the axes; what is claimed is their mean variance.
        position, spread = imm_smoother(batch, Moods(density, (self.walk_s, self.turn_s)))
        return Reconstruction(position, np.sqrt(spread))


def smooth(
    release: Release, variance: Floats, q: float, *, passes: int = 1, anneal: float = 0.0
) -> Reconstruction:
    """Return smoothed positions of a release with error variance per axis `variance`, (M,) m^2.

    `passes` and `anneal` are those of `isac_track.kalman.smooth_positions`.
    """
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    position, spread = smooth_positions(batch, q=q, passes=passes, anneal=anneal)
    return Reconstruction(position, np.sqrt(spread))
