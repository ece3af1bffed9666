"""The last samples of every track, as flat arrays of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints, Release


@dataclass(frozen=True, eq=False, slots=True)
class Recent:
    """N tracks, K samples in all; the clock of each track begins at its last sample."""

    t: Floats
    """(K,) s, 0 at the last sample of a track: late clocks lose no precision"""
    xy: Floats
    """(K, 2) m"""
    sigma: Floats | None
    """(K,) m, None if it was not declared"""
    offsets: Ints
    """(N + 1,)"""


def recent(release: Release, *, window: int) -> Recent:
    """Return the last `window` samples of every track, or all that it has."""
    last = release.offsets[1:]
    sizes = np.minimum(np.diff(release.offsets), window)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    sample = np.repeat(last - sizes - offsets[:-1], sizes) + np.arange(offsets[-1])
    return Recent(
        t=release.t[sample] - np.repeat(release.t[last - 1], sizes),
        xy=release.xy[sample],
        sigma=None if release.sigma is None else release.sigma[sample],
        offsets=offsets,
    )
