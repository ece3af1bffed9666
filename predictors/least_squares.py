"""The paper's predictor: a straight line through the most recent shared samples."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.types import Floats, Knowledge, Prediction, Release


@dataclass(frozen=True, slots=True)
class LeastSquares:
    """First-order polynomials in x and y over the last `window` samples.

    Eqs. linear_fit, velocity_estimate and agent_prediction. A shorter track uses
    all its samples; a track of a single sample is predicted to stand still.
    """

    window: int = 16  # Samples; q in the equations of the paper.

    requires: ClassVar[frozenset[Knowledge]] = frozenset()

    def __post_init__(self) -> None:
        if self.window < 2:  # noqa: PLR2004 - a line needs two points
            raise ValueError(f"window must be at least 2 samples, got {self.window}")

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return the extrapolated lines at `t_future`, (N, H) s; no covariance."""
        first, last = release.offsets[:-1, None], release.offsets[1:, None] - 1
        sample = last - np.arange(self.window)[::-1]  # (N, window), newest last
        weight = (sample >= first).astype(np.float64)
        count = weight.sum(axis=1, keepdims=True)
        sample = np.maximum(sample, first)
        t, xy = release.t[sample], release.xy[sample]  # (N, window) s, (N, window, 2) m
        t_mean = (weight * t).sum(axis=1, keepdims=True) / count
        xy_mean = (weight[..., None] * xy).sum(axis=1, keepdims=True) / count[..., None]
        # Centred times: absolute times would cancel badly late in a recording.
        centred = weight * (t - t_mean)
        spread = (centred * (t - t_mean)).sum(axis=1)
        moment = (centred[..., None] * (xy - xy_mean)).sum(axis=1)
        velocity = np.zeros_like(moment)
        np.divide(moment, spread[:, None], out=velocity, where=spread[:, None] > 0)
        return Prediction(
            xy_mean + (t_future - t_mean)[..., None] * velocity[:, None, :]
        )
