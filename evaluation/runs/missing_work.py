"""The work of a run that is not done yet, in parts for its workers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from evaluation.cells.scenes import Block, LinkWork
from evaluation.experiment.constants import BLOCK_SCENES
from evaluation.experiment.axes import n_blocks
from isac_track.scenes import track_order

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Iterator
    from collections.abc import Set as AbstractSet

    from evaluation.runs.failures import Work
    from evaluation.experiment.axes import Consumer
    from evaluation.experiment.plan import Plan
    from isac_track.plugins import Plugin

_TASKS_PER_WORKER = 2
_LEVELS_PER_TASK = 12
"""Of what is linked."""
_CLUSTER_TASKS = 64
"""At least so many, where there are as many levels and blocks."""


def missing_work(ready: Plan, *, sound: AbstractSet[str]) -> list[Work]:
    """Return what is to be computed: first scenes, block by block, then what is linked.

    Parameters
    ----------
    ready : Plan
    sound : set of str
        Names of the cells that are finished.
    """
    # The longest first: at the end no worker waits for long.
    links = sorted(_missing_links(ready, sound), key=_pairs, reverse=True)
    return [*_missing_blocks(ready, sound), *links]


def cut_for_cluster(works: deque[Work]) -> None:
    """Cut work into parts for some dozen threads, in place: workers come and go."""
    n_parts = -(-_CLUSTER_TASKS // len(works))
    for _ in range(len(works)):
        work = works.popleft()
        works.extend(
            replace(work, levels=work.levels[part::n_parts])
            for part in range(min(n_parts, len(work.levels)))
        )


def _missing_blocks(ready: Plan, present: AbstractSet[str]) -> Iterator[Block]:
    settings = ready.settings
    order = track_order(
        n_tracks=len(ready.tracks),
        n_scenes=settings.n_scenes,
        agents=settings.stages.scenes.agents,
        seed=settings.seed,
    )
    for number in range(n_blocks(settings.n_scenes)):
        missing: dict[str, tuple[Plugin, list[Consumer]]] = {}
        for mechanism, consumer, names in ready.cells:
            if not consumer.task and names[number] not in present:
                missing.setdefault(mechanism.spec, (mechanism, []))[1].append(consumer)
        levels = tuple((mechanism, tuple(consumers)) for mechanism, consumers in missing.values())
        first = number * BLOCK_SCENES
        for part in _parts(levels, ready=ready):
            yield Block(
                number=number,
                first_scene=first,
                order=order[first : first + BLOCK_SCENES],
                levels=part,
            )


def _missing_links(ready: Plan, present: AbstractSet[str]) -> Iterator[LinkWork]:
    for sessions in ready.sessions:
        missing: dict[str, tuple[Plugin, list[Consumer]]] = {}
        for mechanism, consumer, names in ready.cells:
            if consumer.task == sessions.task.name and names[0] not in present:
                missing.setdefault(mechanism.spec, (mechanism, []))[1].append(consumer)
        levels = [(mechanism, tuple(consumers)) for mechanism, consumers in missing.values()]
        # Each part senses the sessions again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_TASK):
            yield LinkWork(
                sessions=sessions,
                groups=tuple(sorted(set(ready.tracks.group))),
                levels=tuple(levels[first : first + _LEVELS_PER_TASK]),
            )


def _pairs(work: LinkWork) -> int:
    """Return how many pairs are compared: what a linker takes goes by it."""
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (np.bincount(side, minlength=len(work.sessions.searches)) for side in sides)
    return len(work.levels) * int((probes * gallery).sum())


def _parts(
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...], *, ready: Plan
) -> list[tuple[tuple[Plugin, tuple[Consumer, ...]], ...]]:
    """Split the levels of a block where there are few blocks for the workers.

    Each part senses the block again, so that there are no more parts than an even load takes.
    """
    if not levels:
        return []
    if ready.jobs == 1:
        return [levels]
    n_tasks = _TASKS_PER_WORKER * ready.jobs
    n_parts = min(len(levels), -(-n_tasks // n_blocks(ready.settings.n_scenes)))
    # Every n-th level: neighbours take alike long, and so do the parts.
    return [levels[part::n_parts] for part in range(n_parts)]
