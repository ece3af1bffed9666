"""The simplest predictor, the baseline of all others: nobody moves."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.types import Floats, Knowledge, Prediction, Release


@dataclass(frozen=True, slots=True)
class ConstantPosition:
    """Everybody stays where they were last shared."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return the last positions at all of `t_future`, (N, H) s; no covariance."""
        last = release.xy[release.offsets[1:] - 1]
        return Prediction(np.repeat(last[:, None, :], t_future.shape[1], axis=1))
