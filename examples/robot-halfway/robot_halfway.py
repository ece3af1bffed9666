"""Predict half of the last second's speed, since people slow down near a robot."""

from dataclasses import dataclass

import numpy as np

from isac_track.types import Prediction


@dataclass(frozen=True)
class Halfway:
    share: float = 0.5
    requires = frozenset()

    def predict(self, release, t_future):
        mean = np.empty((*t_future.shape, 2))
        for row, track in enumerate(release):
            lately = track.t > track.t[-1] - 1.0
            t, xy = track.t[lately], track.xy[lately]
            pace = (xy[-1] - xy[0]) / max(t[-1] - t[0], 0.1)
            mean[row] = (
                xy.mean(axis=0)
                + self.share * pace * (t_future[row] - t.mean())[:, None]
            )
        return Prediction(mean)
