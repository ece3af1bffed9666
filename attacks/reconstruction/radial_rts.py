"""The smoother for errors that are heavy at zero: iteratively re-weighted for the radial law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from attacks.parameters import positive
from attacks.reconstruction.kalman_rts import smooth
from attacks.reconstruction.learning import around, smoother
from isac_track.types import Floats, Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from isac_track.protocols import AttackContext, Reconstructor


@dataclass(frozen=True, slots=True)
class RadialRTS:
    """Constant velocity; samples that lie close to the walk count for more, again and again."""

    q: float | None = None
    """m^2/s^3; None: learnt from the training set, or `DEFAULT_Q` without one."""
    passes: int = 5
    """Smoothers; more gain little under linear adding and lose a little under independent."""
    anneal: float = 0.15

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.MECHANISM, Knowledge.TRAIN, Knowledge.SIGMA}
    )
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
