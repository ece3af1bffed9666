"""What one cell computes: a block of scenes, one mechanism level, one consumer.

A level is shared once; every consumer of the block reads the same release.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from evaluation.cells.left_out import kept, reduced
from evaluation.cells.link_file import to_parquet
from evaluation.cells.link_scores import Linked
from evaluation.cells.link_setup import ground as link_ground
from evaluation.cells.linkage import link_level
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.cells.progress import Failed, note, noted
from evaluation.cells.reconstruction import (
    attack_rows,
    descriptors,
    ground,
    ground_without,
    level,
    track_columns,
)
from evaluation.cells.windows import to_parquet as windows_to_parquet
from isac_track.conflict import is_conflict
from isac_track.encounter import conflict_probability
from isac_track.errors import IsacTrackError, PluginError, SettingsError, told
from isac_track.rng import stream
from isac_track.scenes import make_scenes, predicted_separation, robot_positions
from isac_track.sensing import sense_scenes
from isac_track.types import SHARED_LIMIT_M, Knowledge, Prediction, Release, within

if TYPE_CHECKING:
    from collections.abc import Iterator

    from attacks.tasks.sessions import Sessions
    from evaluation.cells.reconstruction import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Ints, Scenes, Sensed


_OURS = ("isac_track", "predictors", "attacks", "evaluation")

Item: TypeAlias = "tuple[int, Plugin, Consumer, Rows | bytes]"
"""A finished cell: its block, mechanism, consumer, and rows or file."""


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Work of one block of scenes: which levels, and which of their consumers are missing."""

    number: int
    first_scene: int
    order: Ints
    """(S, A) rows of the tracks."""
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...]
    """Mechanism and its consumers."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkWork:
    """Work of one linkage task: which levels, and which of their consumers are missing."""

    sessions: Sessions
    groups: tuple[str, ...]
    """Clusters of the run's scenes."""
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...]
    """Mechanism and its consumers."""


def cells(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    """Yield every cell of a piece of work: its block, mechanism, consumer, and rows or file.

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    if isinstance(work, LinkWork):
        for mechanism, consumer, content in compute_links(work, stages=stages, seed=seed):
            yield 0, mechanism, consumer, content
        return
    for mechanism, consumer, rows in compute_block(work, tracks=tracks, stages=stages, seed=seed):
        yield work.number, mechanism, consumer, rows


def attempt(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item | Failed]:
    """Yield `cells` until something fails, and then that (for workers, too).

    A fault of our own fails by name as a plug-in's does: what an odd plug-in brings to light in one
    cell takes no others along.

    Raises
    ------
    IsacTrackError
        For what fails all cells alike: data or settings that do not fit.
    """
    try:
        yield from cells(work, tracks=tracks, stages=stages, seed=seed)
    except PluginError as error:
        yield Failed(noted(), str(error))
    except IsacTrackError:
        raise
    except Exception as error:  # noqa: BLE001 - nobody knows what else goes wrong
        yield Failed(noted(), f"{told(error)} ({_place(error)})")


def _place(error: Exception) -> str:
    """Return which line of ours an error comes from, and what to do about it."""
    ours = [
        (module, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if (module := frame.f_globals.get("__name__", "")).partition(".")[0] in _OURS
    ]
    module, line = ours[-1]  # the innermost; there is one: `attempt` itself
    return f"in isac-track's own code, {module}, line {line}: please report this"


