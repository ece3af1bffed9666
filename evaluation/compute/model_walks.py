"""Scenes as sensed; in a model world, with agents that walk by the fitted model."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from isac_track.model_world import (
    Motion,
    OwnMotions,
    fit_motion,
    fit_own_motions,
    simulate_walks,
)
from isac_track.rng import stream
from isac_track.sensing import sense_scenes
from isac_track.types import Scenes, Sensed, derived

if TYPE_CHECKING:
    from isac_track.config import StageSettings
    from isac_track.scenes import Cut


# The motions of the newest recordings, for the life of the process.
@lru_cache(maxsize=2)
def recording_motion(tracks: Cut) -> Motion:
    """Return the motion of a recording's people, fitted once."""
    return fit_motion(tracks)


# As above.
@lru_cache(maxsize=2)
def recording_own_motions(tracks: Cut) -> OwnMotions:
    """Return the motion of each person of a recording, fitted once."""
    return fit_own_motions(tracks)


def sensed_scenes(
    scenes: Scenes,
    *names: str | int,
    tracks: Cut,
    is_model: bool,
    stages: StageSettings,
    seed: int,
) -> tuple[Scenes, Sensed]:
    """Return scenes as they are walked, and what is sensed of them.

    They are walked as recorded, or by the model if the world `is_model`. `names` name
    the streams of the sensing errors. A model's walk has the motion that was fitted to
    the recorded walk; it has the same start, the same instants and the very same
    errors. The errors depend on the recorded place, which no adversary can use.
    """
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed, names=names)
    if not is_model:
        return scenes, sensed
    walks, motions = [], recording_own_motions(tracks).take(scenes.track)
    for row, index in enumerate(scenes.index.tolist()):
        first, end = row * scenes.n_agents, (row + 1) * scenes.n_agents
        offsets = scenes.offsets[first : end + 1]
        walk = simulate_walks(
            t=scenes.t[offsets[0] : offsets[-1]],
            offsets=offsets - offsets[0],
            start=scenes.xy[offsets[:-1]],
            motion=motions.take(np.arange(first, end)),
            rng=stream(seed, "model walks", index),
        )
        walks.append(walk)
    xy = np.concatenate(walks)
    errors = sensed.sigma_raw[:, None] * sensed.unit_error
    return derived(scenes, xy=xy), derived(sensed, xy=xy + errors)
