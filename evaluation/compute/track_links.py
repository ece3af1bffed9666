"""Linkers of tracks across a rotation of pseudonyms, as they come from a tracker.

An adversary is trained on the tracks of other people, at other rotations. Rows are per seed
of sensing and walking group, which intervals draw.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from attacks.tasks.task_list import TASKS
from attacks.tasks.track_handover import track_handover
from evaluation.compute.current_cell import note_cell
from evaluation.compute.link_setup import SensedTask, prepare_fold, whole_searches
from evaluation.compute.link_views import level_of_releases
from evaluation.compute.linkage import search_scores
from evaluation.compute.tables import ROWS
from isac_track.linkability.ranks import rank1
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from attacks.tasks.track_handover import TrackHandover
    from attacks.tasks.windows import TaskWindows
    from evaluation.compute.tables import Rows
    from evaluation.compute.tracking_setup import SeedRelease, TrackingSetup
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin
    from isac_track.types import Floats

LINK_COLUMNS: Final = ("seed", "block", "hits", "chance", "linkable", "trials")
"""Columns of the cells of linkers of tracks; a `block` is a walking group here."""


def link_rows(
    consumers: Iterable[Consumer],
    releases: list[SeedRelease],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the linkers and controls of tracks, each with the rows of its table.

    The windows of a task are cut once for all of them, and held as long as this runs.
    """
    handovers: dict[str, list[TrackHandover]] = {}
    for consumer in consumers:
        note_cell(mechanism.spec, consumer.label)
        if consumer.task not in handovers:
            handovers[consumer.task] = [
                track_handover(
                    TASKS[consumer.task],
                    setup.patrol,
                    release.shared,
                    settings=setup.stages.linkage,
                    seed=seed,
                )
                for seed, release in zip(setup.seeds, releases, strict=True)
            ]
        rows = _rows(consumer, handovers[consumer.task], setup, mechanism=mechanism)
        yield consumer, {ROWS: rows}


def _rows(
    consumer: Consumer,
    handovers: list[TrackHandover],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Rows:
    """Return the counts of trials by seed and walking group: `LINK_COLUMNS`."""
    _, cluster = np.unique(setup.patrol.people.group, return_inverse=True)
    n_groups = int(cluster.max()) + 1
    counts = []
    for seed, handover in zip(setup.seeds, handovers, strict=True):
        hits, chance = _linked(
            consumer, handover, setup, mechanism=mechanism, seed=seed
        )
        linkable, trials = handover.trials.is_linkable, np.ones(hits.size)
        group = cluster[handover.trials.person]
        counts.append(
            [
                np.bincount(group, weights=values, minlength=n_groups)
                for values in (hits, chance, linkable, trials)
            ]
        )
    columns = np.concatenate(counts, axis=1)
    seeds = np.arange(len(handovers), dtype=np.int32)
    return {
        "seed": np.repeat(seeds, n_groups),
        "block": np.tile(np.arange(n_groups, dtype=np.int32), seeds.size),
        **dict(zip(LINK_COLUMNS[2:], columns, strict=True)),
    }


def _linked(
    consumer: Consumer,
    handover: TrackHandover,
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
    seed: int,
) -> tuple[Floats, Floats]:
    """Return the expected hit of each trial, and that of guessing, (D,) each."""
    trials, task_windows = handover.trials, handover.task_windows
    hits, chance = np.zeros((2, trials.person.size))
    if task_windows is None:
        return hits, chance
    sensed = _sensed(task_windows, setup, seed=seed)
    if not _can_learn(sensed):
        # A tracker may lose so many people that no track of others has a mate.
        if consumer.plugin is not None and Knowledge.TRAIN in consumer.requires:
            return hits, chance
        consumer = replace(consumer, granted=consumer.granted - {Knowledge.TRAIN})
    level = level_of_releases(mechanism, sensed, handover.releases)
    scores = search_scores(consumer, level)
    hit = np.zeros(len(task_windows.probe))
    for number, pairing in sensed.searches.items():
        expected = rank1(scores=scores[number], mate=pairing.mate)
        hit[pairing.probe] = np.nan_to_num(expected)
    n_candidates = np.bincount(task_windows.gallery.search)
    linkable = np.flatnonzero(trials.is_linkable)
    probe = trials.probe[linkable]
    hits[linkable] = hit[probe]
    chance[linkable] = 1.0 / n_candidates[task_windows.probe.search[probe]]
    return hits, chance


def _can_learn(setup: SensedTask) -> bool:
    """Whether the adversary of each fold has other people's tracks with mates."""
    return all(fold.training.has_mates for fold in setup.folds)


def _sensed(
    task_windows: TaskWindows, setup: TrackingSetup, *, seed: int
) -> SensedTask:
    """Return windows that are sensed and shared already, ready to be linked."""
    folds = tuple(
        prepare_fold(task_windows, fold) for fold in np.unique(task_windows.fold)
    )
    _, cluster = np.unique(task_windows.group, return_inverse=True)
    return SensedTask(
        task_windows=task_windows,
        sensed=(),
        frames=(),
        folds=folds,
        searches=whole_searches(fold.searches for fold in folds),
        drawn_as=np.zeros(0, dtype=np.int64),
        n_groups=0,
        weights=np.zeros((0, int(cluster.max()) + 1)),
        cluster=cluster.astype(np.int64),
        privacy=setup.stages.privacy,
        seed=seed,
        n_candidates=0,
    )
