"""Who walks like this, moment for moment? Speed and turning over all alignments in time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.linkage.learning import EVERYBODY, Few, learn, linker, tried
from attacks.linkage.signals import FACTORS, aligned_costs, motions
from attacks.parameters import positive
from isac_track.types import Floats, Knowledge, Release

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker

_RANK = 8
_TAUGHT_BY = 80
"""Mated pairs to learn from: three widths of smoothing on all would cost more than the attack."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Least mean squared distance of two profiles of speed and turning over all lags.

    The profile is the speed in m/s and the signed turning rate in rad/s times `turn_m`, four
    times a second, both from parabolas over a stretch that grows with the noise of the track
    (`attacks.linkage.signals.widths_s`): both are then about as wrong as each other. For every
    lag, d is the mean squared difference over the overlap of m cells, of its first eight
    polynomials; the score is -log of the least ``(d + floor) (L / m)^3``, L the cells of 12 s.
    `attacks.linkage.shape.Shape` says why a logarithm and why a floor.
    """

    factor: float | None = None
    """Of the widths; None: learnt from the training set, or 1 without one."""
    turn_m: float = 1.0
    floor: float | None = None
    """None: learnt, or `DEFAULT_FLOOR`."""
    reach_s: float = 6.0
    """s, greatest lag."""

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_FLOOR: ClassVar[float] = 0.002

    def __post_init__(self) -> None:
        positive(factor=self.factor, turn_m=self.turn_m, floor=self.floor, reach_s=self.reach_s)

    def fit(self, context: AttackContext) -> Linker:
        """Return what scores walks like those in the training set."""
        factors = tried(self.factor, FACTORS)
        floors = tried(self.floor, (self.DEFAULT_FLOOR, 1e-4, 5e-4, 1e-2, 3e-2))
        pairs = list(product(factors, floors))

        def scores(train: LinkageTrainingSet, few: Few) -> Callable[[tuple[float, float]], Floats]:
            sides = train.probe, train.gallery
            each = [_score(*sides, self, factor, floors, few) for factor in factors]
            return dict(zip(pairs, np.concatenate(each), strict=True)).__getitem__

        (best,) = learn(context, (pairs,), most=_TAUGHT_BY, scores=scores)
        return linker(_score, self, *best)


def _score(
    probe: Release,
    gallery: Release,
    attack: Profile,
    factor: float,
    floors: float | Sequence[float],
    few: Few = EVERYBODY,
) -> Floats:
    """Return the score of every pair, (P, G), or (E, P, G) of several floors."""
    p, g = motions(probe, gallery, factor, attack.turn_m, few)
    score: Floats = -np.log(aligned_costs(p, g, floors=floors, rank=_RANK, reach_s=attack.reach_s))
    return score
