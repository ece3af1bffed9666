"""The smoother that everybody would try first: constant velocity, Rauch-Tung-Striebel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.parameters import positive
from attacks.reconstruction.learning import around, smoother
from isac_track.kalman import Batch, smooth_positions
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
    uses: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.MECHANISM, Knowledge.TRAIN, Knowledge.SIGMA}
    )
    DEFAULT_Q: ClassVar[float] = 0.04

    def __post_init__(self) -> None:
        positive(q=self.q)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        candidates = around(self.DEFAULT_Q, factor=4.0)
        return smoother(context, smooth, given=self.q, candidates=candidates)


def smooth(
    release: Release, variance: Floats, q: float, *, passes: int = 1, anneal: float = 0.0
) -> Reconstruction:
    """Return smoothed positions of a release with error variance per axis `variance`, (M,) m^2.

    `passes` and `anneal` are those of `isac_track.kalman.smooth_positions`.
    """
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    position, spread = smooth_positions(batch, q=q, passes=passes, anneal=anneal)
    return Reconstruction(position, np.sqrt(spread))
