"""Reconstruct without a model of walks: shared positions, or the mean of repeats."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Knowledge, Reconstruction, Release


@dataclass(frozen=True, slots=True)
class Identity:
    """Return the shared positions; the descriptors are those as shared, bit for bit."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the function that returns the shared positions."""
        del context
        return lambda release: Reconstruction(release.xy)


@dataclass(frozen=True, slots=True)
class Averaging:
    """Mean of all releases of a walk, weighed by the declared variances if known."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.REPEATS, Knowledge.SCENE}
    )
    """SCENE, too: releases in frames of their own cannot be averaged."""
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the function that averages a release with the repeats of its walks."""
        repeats = context.repeats

        def reconstruct(release: Release) -> Reconstruction:
            total, weight = np.zeros_like(release.xy), np.zeros_like(release.t)
            for item in (release, *repeats):
                trust = np.ones_like(item.t)
                if item.sigma is not None:
                    trust /= np.maximum(item.sigma**2, 1e-12)
                weight += trust
                for axis in range(2):  # both at once would take longer
                    total[:, axis] += trust * item.xy[:, axis]
            for axis in range(2):
                total[:, axis] /= weight
            return Reconstruction(total)

        return reconstruct
