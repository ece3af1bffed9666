"""Mechanisms that share fewer samples than were sensed: which ones are left.

Whoever compares a release with the truth does so on those alone; scenes, what was sensed and
windows are cut down to them, so that nothing else has to know.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from attacks.tasks.sessions import Windows
from isac_track.types import Scenes, Sensed

if TYPE_CHECKING:
    from isac_track.types import Ints, Release

_Batch = TypeVar("_Batch", Scenes, Sensed, Windows)
_PER_SAMPLE = ("t", "xy", "unit_error", "sigma_raw", "information", "fid")


@dataclass(frozen=True, eq=False, slots=True)
class Kept:
    """The samples of a batch that a release holds."""

    samples: Ints
    """(m,) which of the M samples."""
    offsets: Ints
    """(N + 1,) of the tracks among them."""


def kept(release: Release, sensed: Sensed) -> Kept | None:
    """Return which samples a release holds; None if it is all of them.

    Raises
    ------
    ValueError
        If it holds other tracks, or a sample at an instant at which nothing was sensed.
    """
    if np.array_equal(release.offsets, sensed.offsets) and np.array_equal(release.t, sensed.t):
        return None
    if len(release) != len(sensed):
        raise ValueError(f"of {len(sensed)} tracks it returned {len(release)}")
    found = np.empty(release.t.size, dtype=np.int64)
    for row in range(len(sensed)):
        mine = slice(release.offsets[row], release.offsets[row + 1])
        start, end = sensed.offsets[row], sensed.offsets[row + 1]
        known_s, asked_s = sensed.t[start:end], release.t[mine]
        place = np.minimum(np.searchsorted(known_s, asked_s), known_s.size - 1)
        strange = known_s[place] != asked_s
        if strange.any():
            raise ValueError(
                f"in track {row} nothing was sensed at {asked_s[strange][0]:.12g} s; samples may "
                "be left out, not moved or added"
            )
        found[mine] = start + place
    return Kept(samples=found, offsets=release.offsets)


def reduced(batch: _Batch, left: Kept) -> _Batch:
    """Return a batch without the samples that a release of it left out."""
    samples = {
        name: getattr(batch, name)[left.samples] for name in _PER_SAMPLE if hasattr(batch, name)
    }
    return replace(batch, offsets=left.offsets, **samples)
