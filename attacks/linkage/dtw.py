"""Link walks by dynamic time warping of speed and turning."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import learn_parameters, make_linker
from attacks.linkage.signals import (
    EXPONENT,
    FULL_CELLS,
    Signals,
    blocks,
    load_loops,
    release_motion,
    width_factors,
)
from attacks.parameters import candidate_values, require_positive
from isac_track.protocols import AttackContext, Linker
from isac_track.types import Floats, Knowledge, Release

# Cells between those compared: 2 Hz of signals that are smoothed over more than that.
_STRIDE = 2
# Mated pairs to learn from: five candidates on all would cost too much.
_TAUGHT_BY = 48


@dataclass(frozen=True, slots=True)
class DTW:
    """Least squared distance of two profiles of speed and turning under time warping.

    A profile is (speed in m/s, turning rate in rad/s times `turn_m`) twice a second. It
    may be warped within a Sakoe-Chiba band: the share `band` of the longer profile. As
    much may be left out at either end, since two releases do not start together. A step
    of warping costs `penalty` squared. The score is ``-log((d^2 / m + floor) * (L /
    m)^3)`` of the distance d, m cells of the shorter and L of 12 s.

    References
    ----------
    Sakoe, Chiba, "Dynamic programming algorithm optimization for spoken word
    recognition", IEEE Trans. ASSP 26(1), 1978, 43-49; for several signals at once:
    Shokoohi-Yekta et al., "Generalizing DTW to the multi-dimensional case requires an
    adaptive approach", Data Mining and Knowledge Discovery 31, 2017, 1-31.
    """

    # Of `signals.widths_s`; None: learnt from the training set, or 1.
    factor: float | None = None
    turn_m: float = 1.0
    band: float = 0.15
    penalty: float | None = None  # None: learnt, or `DEFAULT_PENALTY`.
    floor: float = 0.003

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_PENALTY: ClassVar[float] = 0.1

    def __post_init__(self) -> None:
        require_positive(
            factor=self.factor,
            turn_m=self.turn_m,
            penalty=self.penalty,
            floor=self.floor,
        )
        if not 0 <= self.band <= 1:
            raise ValueError(f"band must lie in [0, 1], got {self.band}")

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        penalties = candidate_values(self.penalty, (self.DEFAULT_PENALTY, 0.02, 0.5))
        best = learn_parameters(
            context,
            (width_factors(context, self.factor), penalties),
            most=_TAUGHT_BY,
            scores=lambda train: partial(_score, train.probe, train.gallery, self),
        )
        return make_linker(_score, self, *best)


def _score(
    probe: Release, gallery: Release, attack: DTW, factor: float, penalty: float
) -> Floats:
    p = release_motion(probe, factor, attack.turn_m)
    g = release_motion(gallery, factor, attack.turn_m)
    costs = warped_costs(p, g, band=attack.band, penalty=penalty, floor=attack.floor)
    return np.asarray(-np.log(costs))


def warped_costs(
    probe: Signals, gallery: Signals, *, band: float, penalty: float, floor: float
) -> Floats:
    """Return the cost of warping P profiles onto each of G, (P, G); see `DTW`."""
    costs = np.empty((probe.sizes.size, gallery.sizes.size))
    thinned = [
        Signals(side.values[:, :, ::_STRIDE], -(-side.sizes // _STRIDE))
        for side in (probe, gallery)
    ]
    for block in blocks(*thinned):
        shorter, longer = sorted((block.probe.shape[1], block.gallery.shape[1]))
        reach = round(band * longer)
        # Cells left out at the ends must leave some cells, and lie within the band.
        loose = min(reach, (shorter - 1) // 2)
        square = np.empty((block.rows.size, block.columns.size))
        load_loops().warp(block.probe, block.gallery, reach, loose, penalty**2, square)
        overlap = (FULL_CELLS / _STRIDE / shorter) ** EXPONENT
        costs[block.rows[:, None], block.columns[None, :]] = (
            square / shorter + floor
        ) * overlap
    return costs
