"""Adversaries with no model of a walk: what was shared, at its word, or the mean of its repeats."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Knowledge, Reconstruction, Release


@dataclass(frozen=True, slots=True)
class Identity:
    """Return the shared positions; its descriptors are those as shared, to the last bit."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return what hands a release back."""
        del context
        return lambda release: Reconstruction(release.xy)


@dataclass(frozen=True, slots=True)
class Averaging:
    """Mean of all releases of a walk, each sample weighed by its declared variance if known."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.REPEATS, Knowledge.SCENE}
    )
    """SCENE, too: releases in frames of their own cannot be laid upon each other."""
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return what averages a release with the repeats of its walks."""
        repeats = context.repeats

        def reconstruct(release: Release) -> Reconstruction:
            total, weight = np.zeros_like(release.xy), np.zeros_like(release.t)
            for one in (release, *repeats):
                trust = np.ones_like(one.t)
                if one.sigma is not None:
                    trust /= np.maximum(one.sigma**2, 1e-12)
                weight += trust
                for axis in range(2):  # both at once would take longer
                    total[:, axis] += trust * one.xy[:, axis]
            for axis in range(2):
                total[:, axis] /= weight
            return Reconstruction(total)

        return reconstruct
