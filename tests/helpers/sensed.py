"""What a network holds about a few made-up walks, for mechanisms to share."""

from __future__ import annotations

import numpy as np

from isac_track.rng import stream
from isac_track.sensing import unit_errors
from isac_track.types import Sensed

LAWS = ["radial", "isotropic"]
ADDING = ["linear", "independent"]


def rng(*names):
    return stream(0, "test", *(names or ("share",)))


def truth(n_samples):
    return stream(0, "test", "truth").uniform(-20.0, 20.0, (n_samples, 2))


def sensed(*, sizes=(5, 1, 7), law="radial", sigma_raw=None):
    n_samples = int(np.sum(sizes))
    draw = stream(0, "test", "sensed")
    sigma = (
        draw.uniform(0.05, 2.0, n_samples)
        if sigma_raw is None
        else np.full(n_samples, sigma_raw)
    )
    unit = unit_errors(n_samples=n_samples, law=law, rng=draw)
    return Sensed(
        t=np.arange(n_samples) / 12.0,
        xy=truth(n_samples) + sigma[:, None] * unit,
        unit_error=unit,
        sigma_raw=sigma,
        information=24.0 / sigma**2,
        fid=288.0 / sigma**2,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        law=law,
    )
