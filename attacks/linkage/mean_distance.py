"""Who was where, when? The mean distance of two walks at equal instants, in the true frame."""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import linker
from attacks.parameters import positive
from isac_track.protocols import AttackContext, Linker
from isac_track.types import Floats, Ints, Knowledge, Release

_FARTHEST_M = 1e6  # As far as two walks count that were not there at the same time.


@dataclass(frozen=True, slots=True)
class MeanDistance:
    """Minus the mean distance of two walks, m, over the instants at which both were there.

    Positions lie on the lines through the samples, at multiples of `step_s`. A pair
    that shares fewer than `least_s` is as far apart as can be. Two logs of the same
    steps need no more.

    References
    ----------
    Nanni, Pedreschi, "Time-focused clustering of trajectories of moving objects",
    Journal of Intelligent Information Systems 27(3), 2006.
    """

    step_s: float = 0.25
    least_s: float = 2.0

    kind: ClassVar[str] = "linkage"
    one_stretch: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SCENE})
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def __post_init__(self) -> None:
        positive(step_s=self.step_s, least_s=self.least_s)

    def fit(self, context: AttackContext) -> Linker:
        """Return what scores walks; it learns nothing."""
        del context
        return linker(_closeness, self.step_s, self.least_s)


def _closeness(
    probe: Release, gallery: Release, step_s: float, least_s: float
) -> Floats:
    """Return minus the mean distance of every pair, (P, G) m."""
    (tick, xy, offsets), other = _on_grid(probe, step_s), _on_grid(gallery, step_s)
    theirs, their_xy, their_offsets = other
    row = np.repeat(np.arange(len(gallery)), np.diff(their_offsets))
    in_time = np.argsort(theirs, kind="stable")
    theirs, their_xy, row = theirs[in_time], their_xy[in_time], row[in_time]
    score = np.full((len(probe), len(gallery)), -_FARTHEST_M)
    for place, (first, last) in enumerate(pairwise(offsets.tolist())):
        if first == last:
            continue
        among = slice(*np.searchsorted(theirs, (tick[first], tick[last - 1] + 1)))
        apart_m = np.hypot(
            *(their_xy[among] - xy[first + theirs[among] - tick[first]]).T
        )
        shared = np.bincount(row[among], minlength=len(gallery))
        total_m = np.bincount(row[among], weights=apart_m, minlength=len(gallery))
        enough = shared * step_s >= least_s
        score[place, enough] = -total_m[enough] / shared[enough]
    return score


def _on_grid(release: Release, step_s: float) -> tuple[Ints, Floats, Ints]:
    """Return the steps of a common grid at which walks were there, places, and offsets."""
    ticks, places = [], []
    for first, last in pairwise(release.offsets.tolist()):
        t, xy = release.t[first:last], release.xy[first:last]
        tick = np.arange(np.ceil(t[0] / step_s), np.floor(t[-1] / step_s) + 1.0)
        ticks.append(tick.astype(np.int64))
        places.append(
            np.column_stack([np.interp(tick * step_s, t, axis) for axis in xy.T])
        )
    offsets = np.cumsum([0, *map(len, ticks)])
    return np.concatenate(ticks), np.concatenate(places), offsets
