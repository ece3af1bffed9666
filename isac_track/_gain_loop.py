"""Compiled loop of the large-scale gain: see `isac_track.sensing.gain_along`."""

from math import sqrt

from isac_track.compiling import compiled, read, written
from isac_track.types import Floats


@compiled(read(1), read(1), written(1))
def correlated(innovations: Floats, correlation: Floats, out: Floats) -> None:
    """Fill `out` (M,) with a first-order autoregressive process of unit variance.

    `correlation`, (M,), is that of each sample with the sample before.
    """
    last = 0.0
    for k in range(out.size):
        last = (
            correlation[k] * last
            + sqrt(1.0 - correlation[k] * correlation[k]) * innovations[k]
        )
        out[k] = last
