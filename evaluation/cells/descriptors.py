"""The descriptors of tracks, shared or reconstructed, and what names the tracks of a block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from isac_track import privacy

if TYPE_CHECKING:
    from evaluation.cells.tables import Rows
    from isac_track.types import Floats, Ints, Scenes


DESCRIPTORS: Final = ("plr", "ael_s", "mel_s")
"""Columns of the descriptors of a track, or of a window."""


def descriptors(*, xy: Floats, truth: Floats, t: Floats, offsets: Ints, epsilon_m: float) -> Rows:
    """Return PLR, AEL, MEL and mean squared error of every track, shared or reconstructed.

    Parameters
    ----------
    xy, truth : (M, 2) m
    t : (M,) s
    offsets : (N + 1,) int
    epsilon_m : float
    """
    away_m = privacy.distance_m(shared_xy=xy, true_xy=truth)
    # `privacy.leakage_indicator`, on a distance that the squared error needs as well
    exposure = privacy.exposure(leaked=away_m < epsilon_m, t=t, offsets=offsets)
    starts = offsets[:-1]
    return {
        **{name: getattr(exposure, name) for name in DESCRIPTORS},
        "segments": exposure.segments,
        "mse_m2": np.add.reduceat(away_m**2, starts) / np.diff(offsets)
        if starts.size
        else np.zeros(0),
    }


def track_columns(scenes: Scenes, rows: Ints) -> Rows:
    """Return what names the tracks of a block: scene, agent and source track."""
    return {
        "scene": np.repeat(scenes.index, scenes.n_agents)[rows],
        "agent": np.tile(np.arange(scenes.n_agents), len(scenes))[rows],
        "track": scenes.track[rows],
        "n_samples": np.diff(scenes.offsets)[rows],
    }
