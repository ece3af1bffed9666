"""Pieces of work for one process: levels of a block of scenes, or of a linkage task.

All levels of a piece share their walks, unit errors, frames and folds. They also share
the tables of controls that see only the times of a level. A level is shared once; all
of its consumers read the same release.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from evaluation.compute import (
    link_views,
    linkage,
    model_walks,
    patrols,
    recipients,
    reconstruction,
    sharing,
    track_links,
    track_policies,
    tracking,
    tracking_setup,
)
from evaluation.compute.current_cell import Failure, current_cell, note_cell
from evaluation.compute.forecasts import sharing_rows
from evaluation.compute.link_setup import SensedTask, sense_task
from evaluation.compute.link_tables import linkage_tables
from evaluation.compute.tables import ROWS, Rows, Tables, rows_table, table
from evaluation.compute.window_tables import window_tables
from evaluation.plan.origins import OURS
from evaluation.plan.world import OWN_WORLD, World
from isac_track.errors import IsacTrackError, PluginError, error_text
from isac_track.scenes import Cut, make_scenes
from isac_track.types import Ints, Knowledge, Scenes, Sensed, Tracks

if TYPE_CHECKING:
    from attacks.tasks.passages import Passages
    from attacks.tasks.windows import TaskWindows
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.model_world import Motion
    from isac_track.plugins import Plugin

Levels: TypeAlias = "tuple[tuple[Plugin, tuple[Consumer, ...]], ...]"
"""Mechanisms, each with its consumers whose cells are missing."""


class FinishedCell(NamedTuple):
    """The tables of one consumer at one level, in one block of scenes or one task."""

    block: int  # Number of the block; 0 for a linkage task.
    mechanism: Plugin
    consumer: Consumer
    tables: Tables


@dataclass(frozen=True, eq=False, slots=True)
class SceneWork:
    """Work of one block of scenes."""

    number: int
    first_scene: int
    order: Ints  # (S, A) rows of the tracks.
    levels: Levels
    world: World = OWN_WORLD


@dataclass(frozen=True, eq=False, slots=True)
class LinkWork:
    """Work of one linkage task."""

    task_windows: TaskWindows
    groups: tuple[str, ...]  # Clusters of the run's scenes.
    levels: Levels
    keep_scores: bool = False
    world: World = OWN_WORLD


@dataclass(frozen=True, eq=False, slots=True)
class PatrolWork:
    """Work of patrols through the whole recording."""

    recorded: Tracks  # Placed where they are sensed.
    levels: Levels
    # That of the run: consumers of further horizons name theirs.
    world: World = OWN_WORLD


@dataclass(frozen=True, eq=False, slots=True)
class ReturnWork:
    """Work of linking people who come back."""

    passages: Passages
    levels: Levels
    confirming: str | None = None  # Session that is left aside.
    world: World = OWN_WORLD


@dataclass(frozen=True, eq=False, slots=True)
class TrackingWork:
    """Work of tracks of a network's detections, over the whole recording."""

    recorded: Tracks  # Placed where they are sensed.
    levels: Levels
    # That of the run: consumers of further horizons name theirs.
    world: World = OWN_WORLD


Work: TypeAlias = "SceneWork | LinkWork | PatrolWork | ReturnWork | TrackingWork"


def attempt_cells(
    work: Work,
    *,
    tracks: Cut,
    stages: StageSettings,
    seed: int,
) -> Iterator[FinishedCell | Failure]:
    """Yield finished cells until one fails, and then its failure.

    An error in the project's own code fails one cell, as a plug-in's error does: an
    unusual plug-in may cause it, and other cells must go on. Raises IsacTrackError for
    an error that all cells share: data or settings that do not fit.
    """
    try:
        yield from compute_cells(work, tracks=tracks, stages=stages, seed=seed)
    except PluginError as error:
        yield Failure(current_cell.names, str(error))
    except IsacTrackError:
        raise
    except Exception as error:  # noqa: BLE001 - a plug-in may cause any error
        frames = traceback.walk_tb(error.__traceback__)
        places = ((frame.f_globals.get("__name__", ""), line) for frame, line in frames)
        own_places = [place for place in places if place[0].partition(".")[0] in OURS]
        # The innermost frame; at least this function is among them.
        module, line = own_places[-1]
        report = f"in isac-track's own code, {module}, line {line}: please report this"
        yield Failure(current_cell.names, f"{error_text(error)} ({report})")


def compute_cells(
    work: Work,
    *,
    tracks: Cut,
    stages: StageSettings,
    seed: int,
) -> Iterator[FinishedCell]:
    """Yield every cell of a piece of work.

    Rows of `shared` and of a reconstruction are per track (scene, agent), those of a
    predictor per scene, those of a linkage task per window or probe, those of a patrol
    per person and route, those of tracks per seed and block, those of people who come
    back per linker and metric. Raises PluginError if a plug-in raises or breaks its
    contract, which names it, and DataError if an attack has nobody to learn from.
    """
    if work.world.law:
        stages = stages.changed({"sensing.law": work.world.law})
    if isinstance(work, ReturnWork):
        yield from _return_cells(work, stages=stages, seed=seed)
    elif isinstance(work, PatrolWork):
        yield from _patrol_cells(work, stages=stages, seed=seed)
    elif isinstance(work, TrackingWork):
        yield from _tracking_cells(work, stages=stages, seed=seed)
    elif isinstance(work, LinkWork):
        yield from _linkage_cells(work, tracks=tracks, stages=stages, seed=seed)
    else:
        yield from _scene_cells(work, tracks=tracks, stages=stages, seed=seed)


def _patrol_cells(
    work: PatrolWork, *, stages: StageSettings, seed: int
) -> Iterator[FinishedCell]:
    setup = patrols.patrol_setup(work.recorded, stages=stages, seed=seed)
    people = setup.patrol.people
    for mechanism, consumers in work.levels:
        note_cell(mechanism.spec, "")
        by_policy = _group_by_policy(consumers)
        policies = [own[0].policy for own in by_policy if own[0].policy is not None]
        shared = patrols.share_level(mechanism, setup, policies)
        for own in by_policy:
            made = patrols.policy_rows(own, shared, mechanism=mechanism)
            for consumer, rows_by_table in made:
                tables = {
                    name: rows_table(rows, tracks=people)
                    for name, rows in rows_by_table.items()
                }
                yield FinishedCell(0, mechanism, consumer, tables)


def _return_cells(
    work: ReturnWork, *, stages: StageSettings, seed: int
) -> Iterator[FinishedCell]:
    # Few runs have people who come back, and scikit-learn takes a second.
    from evaluation.compute import returns  # noqa: PLC0415 - as said

    setup = returns.ReturnSetup(work.passages, stages, seed, work.confirming)
    for mechanism, consumers in work.levels:
        for consumer in consumers:
            note_cell(mechanism.spec, consumer.label)
            tables = returns.return_tables(mechanism, setup)
            yield FinishedCell(0, mechanism, consumer, tables)


def _group_by_policy(consumers: Iterable[Consumer]) -> list[list[Consumer]]:
    """Return the consumers of each release of tracks and each policy."""
    by_policy: dict[str, list[Consumer]] = {}
    for consumer in consumers:
        by_policy.setdefault(consumer.address.policy, []).append(consumer)
    return [*by_policy.values()]


def _tracking_cells(
    work: TrackingWork, *, stages: StageSettings, seed: int
) -> Iterator[FinishedCell]:
    setup = tracking_setup.make_tracking_setup(work.recorded, stages=stages, seed=seed)
    for mechanism, consumers in work.levels:
        # By the tracker: policies answer from the same tracks.
        shared: dict[str, list[tracking_setup.SeedRelease]] = {}
        for own in _group_by_policy(consumers):
            tracker = own[0].track_release
            assert tracker is not None
            note_cell(mechanism.spec, own[0].label)
            if tracker.name not in shared:
                shared[tracker.name] = tracking_setup.share_tracked(
                    mechanism, tracker, setup
                )
            releases = shared[tracker.name]
            for consumer, rows_by_table in _read_tracks(
                own, releases, setup, mechanism=mechanism
            ):
                tables = {name: table(rows) for name, rows in rows_by_table.items()}
                yield FinishedCell(0, mechanism, consumer, tables)


def _read_tracks(
    consumers: list[Consumer],
    releases: list[tracking_setup.SeedRelease],
    setup: tracking_setup.TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the consumers of a tracker's release, each with the rows of its tables.

    They get all tracks, or a policy's answers from them, or link them.
    """
    linkers = [consumer for consumer in consumers if consumer.kind == "track_link"]
    others = [consumer for consumer in consumers if consumer.kind != "track_link"]
    if consumers[0].policy is not None:
        read = track_policies.answer_rows
    elif setup.stages.tracking.release == "detections":
        read = recipients.recipient_rows
    else:
        read = tracking.release_rows
    yield from read(others, releases, setup, mechanism=mechanism)
    yield from track_links.link_rows(linkers, releases, setup, mechanism=mechanism)


def _linkage_cells(
    work: LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[FinishedCell]:
    motion = model_walks.recording_motion(tracks) if work.world.is_model else None
    setup = sense_task(
        work.task_windows, groups=work.groups, motion=motion, stages=stages, seed=seed
    )
    # Tables of controls that are the same at every level, by the control's label.
    shared_tables: dict[str, Tables] = {}
    for mechanism, consumers in work.levels:
        note_cell(mechanism.spec, "")
        level, last_view = link_views.linked_level(mechanism, setup), ("", "")
        for consumer in sorted(consumers, key=link_views.view_key):
            note_cell(mechanism.spec, consumer.label)
            if link_views.view_key(consumer) != last_view:
                last_view = link_views.view_key(consumer)
                # Releases of the last view, and all that linkers remember of them, go.
                level.forget_views()
                if setup.n_candidates:
                    # Thousands of people: forget all that was made of the level.
                    level = link_views.linked_level(mechanism, setup)
            is_shared = linkage.is_same_at_all_levels(consumer, level)
            tables = shared_tables.get(consumer.label) if is_shared else None
            if tables is None:
                tables = _linkage_tables(
                    consumer, level, setup, motion=motion, keep_scores=work.keep_scores
                )
            if is_shared:
                shared_tables[consumer.label] = tables
            yield FinishedCell(0, mechanism, consumer, tables)


def _linkage_tables(
    consumer: Consumer,
    level: link_views.LinkedLevel,
    setup: SensedTask,
    *,
    motion: Motion | None,
    keep_scores: bool,
) -> Tables:
    """Return the tables of a consumer of a linkage task; its scores are freed."""
    if consumer.kind == "windows":
        return window_tables(consumer, level)
    if consumer.kind == "link_bound":
        linked = linkage.link_optimum(level, motion)
    else:
        linked = linkage.link(consumer, level)
    return linkage_tables(linked, setup, keep_scores=keep_scores)


def _scene_cells(
    block: SceneWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[FinishedCell]:
    horizon_s, is_model = block.world.horizon_s, block.world.is_model
    if horizon_s is not None:
        tracks = tracks.further[horizon_s]
    scenes = make_scenes(
        tracks, order=block.order, first=block.first_scene, settings=stages, seed=seed
    )
    scenes, sensed = model_walks.sensed_scenes(
        scenes, tracks=tracks, is_model=is_model, stages=stages, seed=seed
    )
    attacked: reconstruction.AttackedBlock | None = None
    for mechanism, consumers in block.levels:
        note_cell(mechanism.spec, "")
        # Nothing of the level before stays in memory.
        level: reconstruction.AttackedLevel | None = None
        release = sharing.share(mechanism, sensed, "block", block.number, seed=seed)
        shared_scenes = sharing.take_samples(
            scenes, sharing.samples_shared(release, sensed)
        )
        for consumer in consumers:
            note_cell(mechanism.spec, consumer.label)
            if consumer.kind not in {"attack", "bound"}:
                rows = sharing_rows(
                    consumer,
                    release,
                    shared_scenes,
                    mechanism=mechanism,
                    stages=stages,
                    # A robot's estimates of the past depend on no horizon.
                    is_logged=horizon_s is None,
                )
            else:
                attacked = attacked or _attacked_block(
                    block, scenes, sensed, tracks=tracks, stages=stages, seed=seed
                )
                attacks = [
                    consumer for consumer in consumers if consumer.kind == "attack"
                ]
                level = level or reconstruction.attacked_level(
                    mechanism, release, attacked, attacks
                )
                rows = reconstruction.attack_rows(consumer, level)
            tables = {ROWS: rows_table(rows, tracks=tracks)}
            yield FinishedCell(block.number, mechanism, consumer, tables)


def _attacked_block(
    block: SceneWork,
    scenes: Scenes,
    sensed: Sensed,
    *,
    tracks: Cut,
    stages: StageSettings,
    seed: int,
) -> reconstruction.AttackedBlock:
    """Prepare the scenes of a block for all attacks on its levels."""
    needs_repeats = any(
        Knowledge.REPEATS in consumer.granted
        for _, consumers in block.levels
        for consumer in consumers
    )
    return reconstruction.attacked_block(
        scenes=scenes,
        sensed=sensed,
        tracks=tracks,
        repeats=needs_repeats,
        is_model=block.world.is_model,
        stages=stages,
        seed=seed,
    )
