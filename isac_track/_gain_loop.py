"""Compiled loop of the large-scale gain: see `isac_track.sensing.gain_along`."""

from math import sqrt

from isac_track.compiling import compiled, read, written
from isac_track.types import Floats


@compiled(read(1), read(1), written(1))
def correlated(innovations: Floats, kept: Floats, out: Floats) -> None:
    """Fill `out` (M,) with a process that keeps so much of its last value at every sample."""
    last = 0.0
    for k in range(out.size):
        last = kept[k] * last + sqrt(1.0 - kept[k] * kept[k]) * innovations[k]
        out[k] = last
