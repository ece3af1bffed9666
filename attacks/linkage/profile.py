"""Who walks like this, moment for moment? Speed and turning over all alignments in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from attacks.linkage.alignment import aligned_costs
from attacks.linkage.learning import chosen, few_mates, log_rank, teaches, tried
from attacks.linkage.signals import FACTORS, motions
from attacks.parameters import positive
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Release

_EXPONENT = 3.0
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

    def fit(self, context: AttackContext) -> Callable[[Release, Release], Floats]:
        """Return what scores walks like those in the training set."""
        floors, factors = tried(self.floor, FLOORS), tried(self.factor, FACTORS)
        best = 0
        if teaches(context) and len(floors) * len(factors) > 1:
            train = few_mates(context.train, most=_TAUGHT_BY)
            best = chosen(
                [
                    log_rank(-cost, mate=train.mate)
                    for costs in self._costs(
                        train.probe, train.gallery, factors=factors, floors=floors
                    )
                    for cost in costs
                ]
            )
        factor, floor = factors[best // len(floors)], floors[best % len(floors)]
        return partial(self._score, factor=factor, floor=floor)

    def _score(self, probe: Release, gallery: Release, *, factor: float, floor: float) -> Floats:
        costs = next(self._costs(probe, gallery, factors=(factor,), floors=(floor,)))
        score: Floats = -np.log(costs[0])
        return score

    def _costs(
        self,
        probe: Release,
        gallery: Release,
        *,
        factors: Sequence[float],
        floors: Sequence[float],
    ) -> Iterator[Floats]:
        """Yield ``(d + floor) (L / m)^3`` at the best lag of every pair, (E, P, G), per factor."""
        for p, g in zip(
            motions(probe, factors=factors), motions(gallery, factors=factors), strict=True
        ):
            yield aligned_costs(
                probe=p.profile(self.turn_m),
                probe_count=p.count,
                gallery=g.profile(self.turn_m),
                gallery_count=g.count,
                floors=floors,
                rank=_RANK,
                exponent=_EXPONENT,
                reach_s=self.reach_s,
                rotated=False,
            )


FLOORS: tuple[float, ...] = (Profile.DEFAULT_FLOOR, 1e-4, 5e-4, 1e-2, 3e-2)
"""The default first."""
