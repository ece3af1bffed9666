"""Pieces of work for one process: levels of a block of scenes, or of a linkage task.

What all levels have in common is made once: walks, unit errors, frames, folds, and what sees no
more of a level than its times. A level is shared once; all of its consumers read the same release,
and what sees nothing else is computed once for levels that are shared alike.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from evaluation.cells.forecasts import sharing_rows
from evaluation.cells.link_scores import Linked
from evaluation.cells.link_setup import sensed_sessions
from evaluation.cells.link_tables import linkage_tables
from evaluation.cells.linkage import link, linked_level
from evaluation.cells.progress import Failed, note, noted
from evaluation.cells.reconstruction import attack_rows, attacked_block, attacked_level
from evaluation.cells.samples import restricted, samples_shared
from evaluation.cells.sharing import release_digest, sees_release_alone, share_block
from evaluation.cells.tables import ROWS, rows_table
from evaluation.cells.windows import window_tables
from isac_track.errors import IsacTrackError, PluginError, told
from isac_track.scenes import make_scenes
from isac_track.sensing import sense_scenes
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from attacks.tasks.sessions import Sessions
    from evaluation.cells.linkage import LinkedLevel
    from evaluation.cells.tables import Tables
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Ints, Release, Scenes

_OURS = ("isac_track", "predictors", "attacks", "evaluation")

Levels: TypeAlias = "tuple[tuple[Plugin, tuple[Consumer, ...]], ...]"
"""Mechanisms, and the consumers that are missing of each."""
Item: TypeAlias = "tuple[int, Plugin, Consumer, Tables]"
"""A finished cell: its block, mechanism, consumer, and tables."""


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Work of one block of scenes."""

    number: int
    first_scene: int
    order: Ints
    """(S, A) rows of the tracks."""
    levels: Levels


@dataclass(frozen=True, eq=False, slots=True)
class LinkWork:
    """Work of one linkage task."""

    sessions: Sessions
    groups: tuple[str, ...]
    """Clusters of the run's scenes."""
    levels: Levels
    keep_scores: bool = False


def cells(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    """Yield every cell of a piece of work: its block, mechanism, consumer, and tables.

    Rows of `shared` and of a reconstruction are per track (scene, agent), those of a predictor per
    scene, those of a linkage task per window or probe.

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    if isinstance(work, LinkWork):
        for mechanism, consumer, tables in _linked(work, stages=stages, seed=seed):
            yield 0, mechanism, consumer, tables
        return
    for mechanism, consumer, table in _of_scenes(work, tracks=tracks, stages=stages, seed=seed):
        yield work.number, mechanism, consumer, table


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


class _Alike:
    """What was computed for levels that are shared alike."""

    def __init__(self) -> None:
        self._found: dict[tuple[bytes, str], Tables] = {}

    def once(
        self, consumer: Consumer, releases: tuple[Release, ...], compute: Callable[[], Tables]
    ) -> Tables:
        """Return what a consumer makes of releases, computed or of a level that shared the same."""
        if not sees_release_alone(consumer):
            return compute()
        key = (release_digest(*releases), consumer.label)
        if key not in self._found:
            self._found[key] = compute()
        return self._found[key]


def _linked(
    work: LinkWork, *, stages: StageSettings, seed: int
) -> Iterator[tuple[Plugin, Consumer, Tables]]:
    whole = sensed_sessions(work.sessions, groups=work.groups, stages=stages, seed=seed)
    controls: dict[str, Linked] = {}
    alike = _Alike()

    def compute(consumer: Consumer, level: LinkedLevel) -> Tables:
        found = link(consumer, level, whole=whole, controls=controls)
        if isinstance(found, Linked):
            return linkage_tables(found, whole, seed=seed, keep_scores=work.keep_scores)
        return window_tables(found, work.sessions)

    for mechanism, consumers in work.levels:
        note(mechanism.spec, "")
        level = linked_level(mechanism, known=whole, epsilon_m=stages.privacy.epsilon_m, seed=seed)
        for consumer in consumers:
            note(mechanism.spec, consumer.label)
            tables = alike.once(consumer, level.shared, partial(compute, consumer, level))
            yield mechanism, consumer, tables


def _of_scenes(
    block: Block, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[tuple[Plugin, Consumer, Tables]]:
    scenes = make_scenes(
        tracks, order=block.order, first=block.first_scene, settings=stages, seed=seed
    )
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    attacked = None
    alike = _Alike()
    for mechanism, consumers in block.levels:
        note(mechanism.spec, "")
        release = share_block(mechanism, sensed, block.number, seed=seed)
        samples = samples_shared(release, sensed)
        known = scenes if samples is None else restricted(scenes, samples)

        def compute(
            consumer: Consumer, release: Release = release, known: Scenes = known
        ) -> Tables:
            rows = sharing_rows(consumer, release, known, stages=stages)
            return {ROWS: rows_table(rows, tracks=tracks)}

        for consumer in consumers:
            if consumer.kind != "attack":
                note(mechanism.spec, consumer.label)
                yield (
                    mechanism,
                    consumer,
                    alike.once(consumer, (release,), partial(compute, consumer)),
                )
        attacks = [one for one in consumers if one.kind == "attack"]
        if not attacks:
            continue
        note(mechanism.spec, attacks[0].label)
        attacked = attacked or attacked_block(
            scenes=scenes,
            sensed=sensed,
            tracks=tracks,
            repeats=_again(block),
            stages=stages,
            seed=seed,
        )
        level = attacked_level(
            mechanism=mechanism,
            release=release,
            block=attacked,
            consumers=attacks,
            stages=stages,
            seed=seed,
        )
        for consumer in attacks:
            note(mechanism.spec, consumer.label)
            rows = attack_rows(consumer, level=level, epsilon_m=stages.privacy.epsilon_m, seed=seed)
            yield mechanism, consumer, {ROWS: rows_table(rows, tracks=tracks)}


def _again(block: Block) -> bool:
    """Whether an attack on a block gets further releases of the same walks."""
    return any(
        Knowledge.REPEATS in one.granted
        for _, consumers in block.levels
        for one in consumers
        if one.kind == "attack"
    )
