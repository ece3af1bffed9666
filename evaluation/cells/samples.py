"""Which tracks and samples are looked at: of a release that left some out, or of some tracks.

A mechanism may share fewer samples than were sensed. Whoever compares its release with the truth
does so on those alone; scenes, what was sensed and windows are cut down to them, so that nothing
else has to know.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from attacks.tasks.sessions import Windows
from isac_track.types import Release, Scenes, Sensed

if TYPE_CHECKING:
    from isac_track.types import Ints

_Batch = TypeVar("_Batch", Scenes, Sensed, Windows)
_PER_SAMPLE = ("t", "xy", "unit_error", "sigma_raw", "information", "fid")


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Some of the samples of a batch of tracks."""

    rows: Ints
    """(m,) which of the M samples."""
    offsets: Ints
    """(n + 1,) of the tracks among them."""


def samples_shared(release: Release, sensed: Sensed) -> Samples | None:
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
    return Samples(rows=found, offsets=release.offsets)


def restricted(batch: _Batch, shared: Samples) -> _Batch:
    """Return a batch without the samples that a release of it left out."""
    samples = {
        name: getattr(batch, name)[shared.rows] for name in _PER_SAMPLE if hasattr(batch, name)
    }
    return replace(batch, offsets=shared.offsets, **samples)


def samples_of(offsets: Ints, tracks: Ints) -> Samples:
    """Return the samples of some tracks, one after the other.

    Parameters
    ----------
    offsets : (N + 1,) int
        Of all tracks.
    tracks : (n,) int
        Rows of those that are wanted.
    """
    sizes = np.diff(offsets)[tracks]
    among = np.concatenate([[0], np.cumsum(sizes)])
    return Samples(np.repeat(offsets[tracks] - among[:-1], sizes) + np.arange(among[-1]), among)


def tracks_of(release: Release, tracks: Ints) -> Release:
    """Return some tracks of a release."""
    samples = samples_of(release.offsets, tracks)
    return Release(
        t=release.t[samples.rows],
        xy=release.xy.take(samples.rows, axis=0),
        sigma=None if release.sigma is None else release.sigma[samples.rows],
        offsets=samples.offsets,
        pseudonym=tuple(release.pseudonym[row] for row in tracks),
    )
