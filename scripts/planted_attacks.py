"""Planted attackers: 20 that are weak by construction, 20 that are strong.

Each weak attacker spoils a smoother in a known way. Each strong attacker is a smoother
for radial errors with other parameters, or averages two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS, RadialRTS
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.rng import stream
from isac_track.types import Floats, Knowledge, Reconstruction, Release


@dataclass(frozen=True)
class _Smoother:
    """Knows nothing, so that the adversary is blind."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()


def _blind(context: AttackContext) -> AttackContext:
    return AttackContext(rng=context.rng, epsilon_m=context.epsilon_m)


@dataclass(frozen=True)
class Stale(_Smoother):
    """A smoother that is some samples late."""

    lag: int = 1

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother, late."""
        smooth = KalmanRTS().fit(_blind(context))

        def reconstruct(release: Release) -> Reconstruction:
            rows = np.arange(release.t.size)
            first = np.repeat(release.offsets[:-1], np.diff(release.offsets))
            xy = smooth(release).xy[np.maximum(rows - self.lag, first)]
            return Reconstruction(xy, None)

        return reconstruct


@dataclass(frozen=True)
class Blurred(_Smoother):
    """A moving average over far too many samples."""

    width: int = 61

    def fit(self, _: AttackContext) -> Reconstructor:
        """Return the average."""

        def reconstruct(release: Release) -> Reconstruction:
            parts = [_averaged(track.xy, self.width) for track in release]
            return Reconstruction(np.concatenate(parts), None)

        return reconstruct


def _averaged(xy: Floats, width: int) -> Floats:
    """Return centred means of up to `width` samples, narrower towards both ends."""
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(xy, axis=0)])
    rows = np.arange(len(xy))
    half = np.minimum(np.minimum(rows, len(xy) - 1 - rows), width // 2)
    sums = total[rows + half + 1] - total[rows - half]
    return np.asarray(sums / (2 * half + 1)[:, None])


@dataclass(frozen=True)
class Jittered(_Smoother):
    """A smoother with an error of its own on top."""

    std_m: float = 0.1

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother with noise."""
        smooth = KalmanRTS().fit(_blind(context))
        rng = stream(int(1000 * self.std_m), "planted", "jitter")

        def reconstruct(release: Release) -> Reconstruction:
            noise = self.std_m * rng.standard_normal(release.xy.shape)
            return Reconstruction(smooth(release).xy + noise, None)

        return reconstruct


@dataclass(frozen=True)
class Partial(_Smoother):
    """A smoother of the first share of each walk; the rest stays as it is shared."""

    share: float = 0.5

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother."""
        smooth = KalmanRTS().fit(_blind(context))

        def reconstruct(release: Release) -> Reconstruction:
            sizes = np.diff(release.offsets)
            place = np.arange(release.t.size) - np.repeat(release.offsets[:-1], sizes)
            is_smoothed = place < self.share * np.repeat(sizes, sizes)
            xy = np.where(is_smoothed[:, None], smooth(release).xy, release.xy)
            return Reconstruction(xy, None)

        return reconstruct


@dataclass(frozen=True)
class Stiff(_Smoother):
    """A smoother that takes people for billiard balls, or for flies."""

    q: float = 1e-4

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother."""
        return KalmanRTS(self.q).fit(_blind(context))


@dataclass(frozen=True)
class Radial(_Smoother):
    """A smoother for radial errors."""

    passes: int = 5
    anneal: float = 0.15

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother."""
        return RadialRTS(passes=self.passes, anneal=self.anneal).fit(_blind(context))


@dataclass(frozen=True)
class Pair(_Smoother):
    """The mean of two smoothers for radial errors."""

    passes: int = 4
    others: int = 6

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the mean."""
        first, second = (
            RadialRTS(passes=number).fit(_blind(context))
            for number in (self.passes, self.others)
        )

        def reconstruct(release: Release) -> Reconstruction:
            return Reconstruction((first(release).xy + second(release).xy) / 2.0, None)

        return reconstruct


WEAK: Final = (
    *(Stale(lag) for lag in (1, 2, 4, 8)),
    *(Blurred(width) for width in (61, 101, 151, 201)),
    *(Jittered(std_m) for std_m in (0.05, 0.1, 0.2, 0.3)),
    *(Partial(share) for share in (0.25, 0.5, 0.75, 0.9)),
    *(Stiff(q) for q in (1e-6, 1e-5, 1e-4, 10.0)),
)
STRONG: Final = (
    *(Radial(passes) for passes in (3, 4, 5, 6, 7, 8, 9, 10)),
    *(Radial(5, anneal) for anneal in (0.05, 0.1, 0.2, 0.25)),
    *(Radial(10, anneal) for anneal in (0.1, 0.2)),
    *(Pair(*both) for both in ((3, 5), (3, 8), (4, 6), (5, 7), (5, 10), (6, 8))),
)

NEAR: Final = tuple(Stiff(q) for q in (0.03, 0.035, 0.045, 0.05))
"""Nearly as good as `kalman_rts`, whose density is 0.04 without knowledge."""
