"""An attack of your own: the point that is nearest to all positions about a sample."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from isac_track.types import Knowledge, Reconstruction


@dataclass(frozen=True)
class GeometricMedian:
    """Geometric median of the positions about a sample; stray ones hardly move it."""

    window_s: float = 1.0
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def __post_init__(self):
        if not self.window_s > 0:
            raise ValueError(f"window_s must be positive, got {self.window_s}")

    def fit(self, context):  # noqa: ARG002 - it learns nothing
        return lambda release: Reconstruction(
            np.concatenate([self.smooth(track) for track in release])
        )

    def smooth(self, track):
        """Return the (n, 2) positions of a track by Weiszfeld's iteration."""
        if len(track.t) < 2:
            return track.xy
        interval_s = (track.t[-1] - track.t[0]) / (len(track.t) - 1)
        half = min(round(self.window_s / interval_s / 2), len(track.t) - 1)
        padded = np.pad(track.xy, ((half, half), (0, 0)), mode="edge")
        near = sliding_window_view(padded, 2 * half + 1, axis=0)  # (n, 2, window)
        median = near.mean(axis=2)
        for _ in range(5):
            gap = near - median[:, :, None]
            weight = 1.0 / np.maximum(np.hypot(gap[:, 0], gap[:, 1]), 0.01)
            total = np.einsum("nkw,nw->nk", near, weight)
            median = total / weight.sum(axis=1)[:, None]
        return median
