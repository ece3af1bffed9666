"""What repeating a release gives away: the mean over several releases of one walk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Release

_LEAST_VARIANCE_M2 = 1e-12


@dataclass(frozen=True, slots=True)
class Averaging:
    """Mean of all releases of a walk, each sample weighed by its declared variance if known."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.REPEATS, Knowledge.SCENE})
    """SCENE, too: releases in frames of their own cannot be laid upon each other."""
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context: AttackContext) -> Callable[[Release], Reconstruction]:
        """Return what averages a release with the repeats of its walks."""
        repeats = context.repeats

        def reconstruct(release: Release) -> Reconstruction:
            total = np.zeros_like(release.xy)
            weight = np.zeros_like(release.t)
            for one in (release, *repeats):
                trust = _trust(one)
                total += trust[:, None] * one.xy
                weight += trust
            return Reconstruction(total / weight[:, None])

        return reconstruct


def _trust(release: Release) -> Floats:
    """Return the weight of every sample, (M,): one over its variance, or 1 where it is unknown."""
    if release.sigma is None:
        return np.ones_like(release.t)
    trust: Floats = 1.0 / np.maximum(release.sigma**2, _LEAST_VARIANCE_M2)
    return trust
