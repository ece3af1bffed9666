"""Pieces of work for one process: levels of a block of scenes, or of a linkage task.

What all levels have in common is made once: walks, unit errors, frames, folds, and what
sees no more of a level than its times. A level is shared once; all of its consumers
read the same release.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from evaluation.compute import linkage, reconstruction, sharing
from evaluation.compute.forecasts import sharing_rows
from evaluation.compute.link_scores import linkage_tables
from evaluation.compute.link_setup import sensed_sessions
from evaluation.compute.tables import ROWS, Tables, rows_table
from evaluation.compute.where import Failed, here, note
from evaluation.plan.constants import (
    MODEL,
    OTHER_LAW,
    OTHER_LAW_WORLD,
    horizon_of,
)
from evaluation.plan.fingerprint import OURS
from isac_track.errors import IsacTrackError, PluginError, told
from isac_track.scenes import Cut, make_scenes
from isac_track.types import Ints, Knowledge

if TYPE_CHECKING:
    from attacks.tasks.sessions import Sessions
    from evaluation.plan.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

Levels: TypeAlias = "tuple[tuple[Plugin, tuple[Consumer, ...]], ...]"
"""Mechanisms, and the consumers that are missing of each."""
Item: TypeAlias = "tuple[int, Plugin, Consumer, Tables]"
"""A finished cell: its block, mechanism, consumer, and tables."""


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Work of one block of scenes."""

    number: int
    first_scene: int
    order: Ints  # (S, A) rows of the tracks.
    levels: Levels
    world: str = ""  # Of `WORLDS`, or of a further horizon; empty: that of the run.


@dataclass(frozen=True, eq=False, slots=True)
class LinkWork:
    """Work of one linkage task."""

    sessions: Sessions
    groups: tuple[str, ...]  # Clusters of the run's scenes.
    levels: Levels
    keep_scores: bool = False
    world: str = ""


def attempt(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item | Failed]:
    """Yield `cells` until something fails, and then that (for workers, too).

    A fault of our own fails by name as a plug-in's does: what an odd plug-in brings to
    light in one cell takes no others along. Raises IsacTrackError for what fails all
    cells alike: data or settings that do not fit.
    """
    try:
        yield from cells(work, tracks=tracks, stages=stages, seed=seed)
    except PluginError as error:
        yield Failed(here.at, str(error))
    except IsacTrackError:
        raise
    except Exception as error:  # noqa: BLE001 - nobody knows what else goes wrong
        frames = traceback.walk_tb(error.__traceback__)
        places = ((frame.f_globals.get("__name__", ""), line) for frame, line in frames)
        # The innermost of ours; there is one: this very function.
        module, line = [one for one in places if one[0].partition(".")[0] in OURS][-1]
        where = f"in isac-track's own code, {module}, line {line}: please report this"
        yield Failed(here.at, f"{told(error)} ({where})")


def cells(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    """Yield every cell of a piece of work: its block, mechanism, consumer, and tables.

    Rows of `shared` and of a reconstruction are per track (scene, agent), those of a
    predictor per scene, those of a linkage task per window or probe. Raises PluginError
    if a plug-in raises or breaks its contract, which names it, and DataError if an
    attack has nobody to learn from.
    """
    if OTHER_LAW_WORLD in work.world:
        stages = stages.changed({"sensing.law": OTHER_LAW})
    if isinstance(work, LinkWork):
        yield from _linked(work, tracks=tracks, stages=stages, seed=seed)
    else:
        yield from _of_scenes(work, tracks=tracks, stages=stages, seed=seed)


def _linked(
    work: LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    motion = reconstruction.motion_of(tracks) if MODEL in work.world else None
    whole = sensed_sessions(
        work.sessions, groups=work.groups, motion=motion, stages=stages, seed=seed
    )
    alike: dict[str, Tables] = {}
    for mechanism, consumers in work.levels:
        note(mechanism.spec, "")
        level, before = linkage.linked_level(mechanism, whole), ("", "")
        for consumer in sorted(consumers, key=linkage.who_sees_alike):
            note(mechanism.spec, consumer.label)
            if linkage.who_sees_alike(consumer) != before:
                before = linkage.who_sees_alike(consumer)
                for held in (level.sides, level.blind.found, level.seen.found):
                    held.clear()  # and what was made of it goes with it
                if (
                    whole.candidates
                ):  # of thousands of people all that was made of it is gone, too
                    level = linkage.linked_level(mechanism, whole)
            is_same = linkage.sees_times_alone(consumer, level)
            tables = alike.get(consumer.label) if is_same else None
            if tables is None and consumer.kind == "windows":
                tables = linkage.window_tables(consumer, level)
            elif tables is None:
                is_bound = consumer.kind == "linkage" and not consumer.plugins
                found = (
                    linkage.bound(level, motion)
                    if is_bound
                    else linkage.link(consumer, level)
                )
                tables = linkage_tables(found, whole, keep_scores=work.keep_scores)
                # Of thousands of people its scores must not stay beside the next ones.
                del found
            if is_same:
                alike[consumer.label] = tables
            yield 0, mechanism, consumer, tables


def _of_scenes(
    block: Block, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    horizon_s, order, first = horizon_of(block.world), block.order, block.first_scene
    if horizon_s is not None:
        tracks = tracks.further[horizon_s]
    scenes = make_scenes(tracks, order=order, first=first, settings=stages, seed=seed)
    of: dict[str, Any] = {"tracks": tracks, "stages": stages, "seed": seed}
    of["is_model"] = MODEL in block.world
    scenes, sensed = reconstruction.sensed_scenes(scenes, **of)
    granted = {what for _, some in block.levels for one in some for what in one.granted}
    attacked: reconstruction.AttackedBlock | None = None
    for mechanism, consumers in block.levels:
        note(mechanism.spec, "")
        # All that was made of the one before is gone.
        level: reconstruction.AttackedLevel | None = None
        release = sharing.share(mechanism, sensed, "block", block.number, seed=seed)
        left = sharing.restricted(scenes, sharing.samples_shared(release, sensed))
        for consumer in consumers:
            note(mechanism.spec, consumer.label)
            if consumer.kind not in {"attack", "bound"}:
                rows = sharing_rows(
                    consumer,
                    release,
                    left,
                    mechanism=mechanism,
                    stages=stages,
                    is_logged=horizon_s
                    is None,  # what a robot knows of the past is one for all
                )
            else:
                attacked = attacked or reconstruction.attacked_block(
                    scenes=scenes,
                    sensed=sensed,
                    repeats=Knowledge.REPEATS in granted,
                    **of,
                )
                attacks = [one for one in consumers if one.kind == "attack"]
                level = level or reconstruction.attacked_level(
                    mechanism, release, attacked, attacks
                )
                rows = reconstruction.attack_rows(consumer, level)
            yield (
                block.number,
                mechanism,
                consumer,
                {ROWS: rows_table(rows, tracks=tracks)},
            )
