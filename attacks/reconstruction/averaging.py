"""Reconstruct without a model of walks: shared positions, or the mean of repeats."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from isac_track.measurement import covariance_without
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release

_LEAST_M2: Final = 1e-12  # Of a declared variance.


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
    """Mean of all releases of a walk, weighed by the declared variances if known.

    Of errors with a shape the inverse covariances are the weights.
    """

    requires: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.REPEATS, Knowledge.SCENE}
    )
    """SCENE, too: releases in frames of their own cannot be averaged."""
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the function that averages a release with the repeats of its walks."""
        repeats = context.repeats

        def reconstruct(release: Release) -> Reconstruction:
            releases = release, *repeats
            if all(item.cov is not None for item in releases):
                return Reconstruction(_informed_mean(releases))
            total, weight = np.zeros_like(release.xy), np.zeros_like(release.t)
            for item in releases:
                trust = np.ones_like(item.t)
                if item.sigma is not None:
                    trust /= np.maximum(item.sigma**2, _LEAST_M2)
                weight += trust
                for axis in range(2):  # both at once would take longer
                    total[:, axis] += trust * item.xy[:, axis]
            for axis in range(2):
                total[:, axis] /= weight
            return Reconstruction(total)

        return reconstruct


def _informed_mean(releases: Sequence[Release]) -> Floats:
    """Return the mean of positions weighed by their information, (M, 2) m."""
    total, information = np.zeros_like(releases[0].xy), np.zeros((1, 2, 2))
    for item in releases:
        assert item.cov is not None
        trust = np.linalg.inv(
            covariance_without(item.cov, std_m=0.0, least_m2=_LEAST_M2)
        )
        total += np.einsum("mab,mb->ma", trust, item.xy)
        information = information + trust
    return np.asarray(np.linalg.solve(information, total[:, :, None])[:, :, 0])
