"""What an adversary that is granted COMPANIONS gets: shared walks of companions.

A companion is the person of the same group who is present longest at the same time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evaluation.compute import sharing
from isac_track.sensing import draw_channel, sense, walk_numbers, walked_within
from isac_track.types import Floats, Ints, Release, Scenes

if TYPE_CHECKING:
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut


class _Walk(NamedTuple):
    """A true walk of m samples."""

    t: Floats  # (m,) s
    xy: Floats  # (m, 2) m


def companion_release(
    mechanism: Plugin, scenes: Scenes, *, tracks: Cut, stages: StageSettings, seed: int
) -> Release:
    """Return the shared walks of the companions of the N tracks of a block of scenes.

    Each is sensed and shared with errors of its own. A track without a companion has a
    single sample, of the track itself. `tracks` are those of the recording.
    """
    group = np.unique(tracks.group, return_inverse=True)[1]
    walks = [
        _companion_walk(scenes, row, tracks=tracks, group=group)
        for row in range(scenes.track.size)
    ]
    n_samples = np.array([walk.t.size for walk in walks])
    t = np.concatenate([walk.t for walk in walks])
    xy = np.concatenate([walk.xy for walk in walks])
    first_scene = int(scenes.index[0])
    offsets = np.concatenate([[0], np.cumsum(n_samples)])
    keys = [("beside", first_scene, row) for row in range(n_samples.size)]
    channel = draw_channel(
        walked_m=walked_within(xy, offsets),
        n_samples=n_samples[:, None],
        keys=keys,
        settings=stages.sensing,
        seed=seed,
    )
    walk = walk_numbers("beside", first_scene, n_walks=n_samples.size, seed=seed)
    sensed = sense(
        t=t, xy=xy, offsets=offsets, channel=channel, settings=stages.sensing, walk=walk
    )
    return sharing.share(mechanism, sensed, "scenes", first_scene, "beside", seed=seed)


def _companion_walk(scenes: Scenes, row: int, *, tracks: Cut, group: Ints) -> _Walk:
    """Return the walk of the companion of the track in a `row` of scenes.

    It is moved into the scene as the track is. `group` has the number of the group of
    every track of the recording.
    """
    track = scenes.track[row]
    lo, hi = scenes.offsets[row : row + 2]
    moved_m = scenes.xy[lo] - tracks.xy[tracks.offsets[track]]
    walk = _Walk(scenes.t[lo : lo + 1], scenes.xy[lo : lo + 1])
    longest_s = 0.0
    for other in np.flatnonzero(group == group[track]):
        first, end = tracks.offsets[other], tracks.offsets[other + 1]
        t = tracks.t[first:end]
        together_s = min(t[-1], scenes.t[hi - 1]) - max(t[0], scenes.t[lo])
        if other != track and together_s > longest_s:
            walk = _Walk(t, tracks.xy[first:end] + moved_m)
            longest_s = together_s
    return walk
