"""Link walks by shape or profile: the least distance over all alignments in time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import learn_parameters, make_linker
from attacks.linkage.signals import (
    aligned_costs,
    on_grid,
    release_motion,
    width_factors,
)
from attacks.parameters import candidate_values, require_positive
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Knowledge, Release

_RANK = 8  # Polynomials of a profile.
# Mated pairs to learn from: three widths on all would cost more than the attack.
_TAUGHT_BY = 80


@dataclass(frozen=True, slots=True)
class Shape:
    """Least mean squared distance of two paths over shift, rotation and lag.

    Let a and b be the overlapping stretches at one lag: complex, less their means,
    projected on polynomials of degree up to `rank` (beyond is little but noise). After
    the best rotation, without reflection, their distance is d = (|a|^2 + |b|^2 - 2
    |a b*|) / m with m the cells of the overlap. The score is -log of the least ``(d +
    floor) (L / m)^3`` over the lags, L the cells of 12 s.

    The logarithm is that of a Gaussian likelihood maximised over the unknown noise,
    which differs between tracks a hundredfold. The floor keeps short pairs that fit by
    chance from winning.

    References
    ----------
    Dryden, Mardia, *Statistical Shape Analysis*, 2016, ch. 4 and 8 (complex arithmetic
    for rotation without reflection).
    """

    # None: learnt from the training set, or `DEFAULT_FLOOR_M2`.
    floor_m2: float | None = None
    rank: int = 5
    """A higher rank shows more detail of a walk, and holds more of the noise."""
    reach_s: float = 6.0  # s, greatest lag.

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_FLOOR_M2: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        require_positive(floor_m2=self.floor_m2, reach_s=self.reach_s)
        if self.rank < 1:
            raise ValueError(f"rank must be at least 1, got {self.rank}")

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        floors = candidate_values(
            self.floor_m2, (self.DEFAULT_FLOOR_M2, 1e-4, 1e-3, 3e-3, 3e-2, 1e-1)
        )

        def scores(train: LinkageTrainingSet) -> Callable[[float], Floats]:
            by_floor = _shapes(train.probe, train.gallery, self, floors)
            return lambda floor: by_floor[floors.index(floor)]

        return make_linker(
            _shapes, self, *learn_parameters(context, (floors,), scores=scores)
        )


def _shapes(
    probe: Release, gallery: Release, attack: Shape, floors: float | Sequence[float]
) -> Floats:
    """Return the score of every pair, (P, G), or (E, P, G) of several floors."""
    p, g, reach_s = on_grid(probe), on_grid(gallery), attack.reach_s
    costs = aligned_costs(
        p, g, floors=floors, rank=attack.rank, reach_s=reach_s, rotated=True
    )
    return np.negative(np.log(costs, out=costs), out=costs)  # (E, P, G) may be large


@dataclass(frozen=True, slots=True)
class Profile:
    """Least mean squared distance of two profiles of speed and turning over all lags.

    The profile is the speed in m/s and the signed turning rate in rad/s times `turn_m`,
    four times a second. A noisier track is smoothed more
    (`attacks.linkage.signals.widths_s`). For every lag, d is the mean squared
    difference over the overlap of m cells, of its first eight polynomials; the score is
    that of `Shape`.
    """

    # Of the widths; None: learnt from the training set, or 1.
    factor: float | None = None
    turn_m: float = 1.0
    floor: float | None = None  # None: learnt, or `DEFAULT_FLOOR`.
    reach_s: float = 6.0  # s, greatest lag.

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_FLOOR: ClassVar[float] = 0.002

    def __post_init__(self) -> None:
        require_positive(
            factor=self.factor,
            turn_m=self.turn_m,
            floor=self.floor,
            reach_s=self.reach_s,
        )

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        widths = width_factors(context, self.factor)
        floors = candidate_values(
            self.floor, (self.DEFAULT_FLOOR, 1e-4, 5e-4, 1e-2, 3e-2)
        )
        pairs = list(product(widths, floors))

        def scores(
            train: LinkageTrainingSet,
        ) -> Callable[[tuple[float, float]], Floats]:
            by_width = [
                _profiles(train.probe, train.gallery, self, width, floors)
                for width in widths
            ]
            by_pair = np.concatenate(by_width)
            return lambda pair: by_pair[pairs.index(pair)]

        (best,) = learn_parameters(context, (pairs,), most=_TAUGHT_BY, scores=scores)
        return make_linker(_profiles, self, *best)


def _profiles(
    probe: Release,
    gallery: Release,
    attack: Profile,
    factor: float,
    floor: float | Sequence[float],
) -> Floats:
    """Return the score of every pair, (P, G), or (E, P, G) of several floors."""
    p = release_motion(probe, factor, attack.turn_m)
    g = release_motion(gallery, factor, attack.turn_m)
    costs = aligned_costs(p, g, floors=floor, rank=_RANK, reach_s=attack.reach_s)
    return np.negative(np.log(costs, out=costs), out=costs)
