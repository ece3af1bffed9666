"""Link walks by their mean distance at equal instants, in the true frame."""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import make_linker
from attacks.parameters import require_positive
from isac_track.protocols import AttackContext, Linker
from isac_track.types import Floats, Ints, Knowledge, Release, lengths

_FARTHEST_M = 1e6  # The distance of two walks that do not overlap in time.


@dataclass(frozen=True, slots=True)
class MeanDistance:
    """Minus the mean distance of two walks, m, over the instants that they share.

    Positions lie on the lines through the samples, at multiples of `step_s`. A pair
    that shares less than `least_s` has the greatest distance. For two logs of the same
    steps this attack suffices.

    References
    ----------
    Nanni, Pedreschi, "Time-focused clustering of trajectories of moving objects",
    Journal of Intelligent Information Systems 27(3), 2006.
    """

    step_s: float = 0.25
    least_s: float = 2.0

    kind: ClassVar[str] = "linkage"
    same_stretch: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SCENE})
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def __post_init__(self) -> None:
        require_positive(step_s=self.step_s, least_s=self.least_s)

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, which learns nothing."""
        del context
        return make_linker(_closeness, self.step_s, self.least_s)


def _closeness(
    probe: Release, gallery: Release, step_s: float, least_s: float
) -> Floats:
    """Return minus the mean distance of every pair, (P, G) m."""
    own, other = _on_grid(probe, step_s), _on_grid(gallery, step_s)
    in_time = np.argsort(other.tick, kind="stable")
    tick, xy = other.tick[in_time], other.xy[in_time]
    row = np.repeat(np.arange(len(gallery)), np.diff(other.offsets))[in_time]
    score = np.full((len(probe), len(gallery)), -_FARTHEST_M)
    for number, (first, last) in enumerate(pairwise(own.offsets.tolist())):
        if first == last:
            continue
        start, end = own.tick[first], own.tick[last - 1]
        overlap = slice(*np.searchsorted(tick, (start, end + 1)))
        own_xy = own.xy[first + tick[overlap] - start]
        apart_m = lengths(xy[overlap] - own_xy)
        shared = np.bincount(row[overlap], minlength=len(gallery))
        total_m = np.bincount(row[overlap], weights=apart_m, minlength=len(gallery))
        enough = shared * step_s >= least_s
        score[number, enough] = -total_m[enough] / shared[enough]
    return score


@dataclass(frozen=True, eq=False, slots=True)
class _GridWalks:
    """N walks at the instants of a common grid that lie within them."""

    tick: Ints  # (M,) number of the instant
    xy: Floats  # (M, 2) m
    offsets: Ints  # (N + 1,) of the walks


def _on_grid(release: Release, step_s: float) -> _GridWalks:
    """Interpolate walks at the multiples of `step_s`."""
    ticks, places = [], []
    for first, last in pairwise(release.offsets.tolist()):
        t, xy = release.t[first:last], release.xy[first:last]
        tick = np.arange(np.ceil(t[0] / step_s), np.floor(t[-1] / step_s) + 1.0)
        ticks.append(tick.astype(np.int64))
        places.append(
            np.column_stack([np.interp(tick * step_s, t, axis) for axis in xy.T])
        )
    offsets = np.cumsum([0, *map(len, ticks)])
    return _GridWalks(np.concatenate(ticks), np.concatenate(places), offsets)
