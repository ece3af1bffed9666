"""Smoothing with both moods of a walk: interacting models, then Rauch-Tung-Striebel per pair."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.parameters import positive
from attacks.reconstruction.kalman_rts import PRIOR_STD
from attacks.reconstruction.learning import around, smoother
from isac_track.kalman import Batch, Moods, imm_smoother
from isac_track.types import Floats, Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from isac_track.protocols import AttackContext, Reconstructor


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
    uses: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.MECHANISM, Knowledge.TRAIN, Knowledge.SIGMA}
    )
    DEFAULT_Q: ClassVar[tuple[float, float]] = (0.03, 0.12)

    def __post_init__(self) -> None:
        if (self.q is None) != (self.q_turn is None):
            raise ValueError("give both q and q_turn, or neither to have them learnt")
        positive(q=self.q, q_turn=self.q_turn, walk_s=self.walk_s, turn_s=self.turn_s)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        return smoother(
            context,
            partial(smooth, stay_s=(self.walk_s, self.turn_s)),
            given=None if self.q is None or self.q_turn is None else (self.q, self.q_turn),
            candidates=list(
                zip(*(around(density, factor=4.0) for density in self.DEFAULT_Q), strict=True)
            ),
        )


def smooth(
    release: Release, variance: Floats, density: tuple[float, float], *, stay_s: tuple[float, float]
) -> Reconstruction:
    """Return smoothed positions of a release with error variance per axis `variance`, (M,) m^2.

    `density`, m^2/s^3, is that of the acceleration while walking on and while turning, `stay_s`
    how long either lasts.
    """
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    # The spread between the modes couples the axes; what is claimed is their mean variance.
    position, spread = imm_smoother(batch, Moods(density, stay_s))
    return Reconstruction(position, np.sqrt(spread))
