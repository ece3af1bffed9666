"""The work of a run that is not done yet: what each unit lacks, and in which pieces it is done."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from evaluation.cells.work import Block, LinkWork
from evaluation.experiment.axes import n_blocks
from evaluation.experiment.constants import BLOCK_SCENES
from evaluation.runs.cell_files import index_of, places_of
from evaluation.runs.checksums import FOLDER, written_down
from isac_track.scenes import track_order

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.cells.work import Levels
    from evaluation.experiment.axes import Consumer
    from evaluation.experiment.plan import Plan, Unit
    from evaluation.runs.failures import Work
    from isac_track.plugins import Plugin

_TASKS_PER_WORKER = 2
_LEVELS_PER_TASK = 12
"""Of what is linked."""
_CLUSTER_TASKS = 64
"""At least so many, where there are as many levels and blocks."""


@dataclass(frozen=True, eq=False, slots=True)
class Missing:
    """What a unit of work lacks, and the file that it will be in."""

    unit: Unit
    keys: tuple[str, ...]
    """Of the consumers."""
    file: str

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """Who is missing."""
        return tuple(self.unit.consumers[key] for key in self.keys)


def missing_of(ready: Plan, places: Mapping[tuple[str, str], str]) -> list[Missing]:
    """Return what the units of a run lack.

    Parameters
    ----------
    ready : Plan
    places : mapping
        File of every finished cell, by the keys of unit and consumer.
    """
    lacking = (
        (unit, tuple(key for key in unit.consumers if (unit.key, key) not in places))
        for unit in ready.units
    )
    return [Missing(unit, keys, unit.file_of(keys)) for unit, keys in lacking if keys]


def n_finished(ready: Plan) -> int:
    """Return how many cells of a run are finished by the checksums of its folder.

    Raises
    ------
    DataError
        If the checksums cannot be read.
    OSError
        If the folder of the cells cannot be read.
    """
    indices = {name: index_of(ready.out / FOLDER / name) for name in written_down(ready.out)}
    places = places_of({name: one for name, one in indices.items() if one is not None})
    return ready.n_cells - sum(len(one.keys) for one in missing_of(ready, places))


def files_of(
    ready: Plan, places: Mapping[tuple[str, str], str], missing: Sequence[Missing]
) -> dict[tuple[str, str], list[str]]:
    """Return the files of every mechanism and consumer, block by block, finished or to come."""
    to_come = {(one.unit.key, key): one.file for one in missing for key in one.keys}
    files: dict[tuple[str, str], list[str]] = {}
    for unit in ready.units:
        for key, consumer in unit.consumers.items():
            place = unit.key, key
            name = places.get(place) or to_come[place]
            files.setdefault((unit.mechanism.spec, consumer.label), []).append(name)
    return files


def pieces_of(missing: Sequence[Missing], ready: Plan) -> list[Work]:
    """Return what is to be computed: first scenes, block by block, then what is linked."""
    # The longest first: at the end no worker waits for long.
    links = sorted(_links(missing, ready), key=_pairs, reverse=True)
    return [*_blocks(missing, ready), *links]


def cut_for_cluster(works: deque[Work]) -> None:
    """Cut work into pieces for some dozen threads, in place: workers come and go."""
    n_pieces = -(-_CLUSTER_TASKS // len(works))
    for _ in range(len(works)):
        work = works.popleft()
        works.extend(
            replace(work, levels=work.levels[piece::n_pieces])
            for piece in range(min(n_pieces, len(work.levels)))
        )


def _blocks(missing: Sequence[Missing], ready: Plan) -> Iterator[Block]:
    settings = ready.settings
    order = track_order(
        n_tracks=len(ready.tracks),
        n_scenes=settings.n_scenes,
        agents=settings.stages.scenes.agents,
        seed=settings.seed,
    )
    of_scenes = [one for one in missing if not one.consumers[0].task]
    for number in range(n_blocks(settings.n_scenes)):
        first = number * BLOCK_SCENES
        for levels in _shared_out(
            _levels([one for one in of_scenes if one.unit.block == number]), ready=ready
        ):
            yield Block(
                number=number,
                first_scene=first,
                order=order[first : first + BLOCK_SCENES],
                levels=levels,
            )


def _links(missing: Sequence[Missing], ready: Plan) -> Iterator[LinkWork]:
    for sessions in ready.sessions:
        levels = _levels([one for one in missing if one.unit.stage == sessions.task.name])
        # Each piece senses the sessions again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_TASK):
            yield LinkWork(
                sessions=sessions,
                groups=tuple(sorted(set(ready.tracks.group))),
                levels=levels[first : first + _LEVELS_PER_TASK],
                keep_scores=ready.settings.keep_scores,
            )


def _levels(missing: Sequence[Missing]) -> Levels:
    """Return the levels of some units of one block, or of one task: all stages together."""
    levels: dict[str, tuple[Plugin, list[Consumer]]] = {}
    for one in missing:
        mechanism = one.unit.mechanism
        levels.setdefault(mechanism.spec, (mechanism, []))[1].extend(one.consumers)
    return tuple((mechanism, tuple(consumers)) for mechanism, consumers in levels.values())


def _pairs(work: LinkWork) -> int:
    """Return how many pairs are compared: what a linker takes goes by it."""
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (np.bincount(side, minlength=len(work.sessions.searches)) for side in sides)
    return len(work.levels) * int((probes * gallery).sum())


def _shared_out(levels: Levels, *, ready: Plan) -> list[Levels]:
    """Split the levels of a block where there are few blocks for the workers.

    Each piece senses the block again, so that there are no more than an even load takes.
    """
    if not levels:
        return []
    if ready.jobs == 1:
        return [levels]
    n_tasks = _TASKS_PER_WORKER * ready.jobs
    n_pieces = min(len(levels), -(-n_tasks // n_blocks(ready.settings.n_scenes)))
    # Every n-th level: neighbours take alike long, and so do the pieces.
    return [levels[piece::n_pieces] for piece in range(n_pieces)]
