"""The work of a run in pieces: find the missing cells, and cut their work."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evaluation.compute.link_views import view_key
from evaluation.compute.work import (
    FinishedCell,
    Levels,
    LinkWork,
    PatrolWork,
    ReturnWork,
    SceneWork,
    TrackingWork,
    Work,
)
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.fingerprint import (
    PATROL,
    RECONSTRUCTION,
    RETURNS,
    SHARING,
    TRACKING,
)
from evaluation.plan.world import OWN_WORLD, WORLDS, World
from evaluation.store.cell_index import CellKey, file_by_cell, read_index
from evaluation.store.checksums import checksummed_files
from evaluation.store.files import CELLS_FOLDER
from isac_track.scenes import track_order

if TYPE_CHECKING:
    from collections import deque

    from evaluation.plan.consumer import Consumer
    from evaluation.plan.plan import Plan
    from evaluation.plan.units import Unit
    from isac_track.plugins import Plugin
    from isac_track.types import Ints

_PIECES_PER_WORKER = 2
_LEVELS_PER_PIECE = 12  # Of a linkage task.
# All blocks of scenes begin within this share of the run: the last takes long.
_BLOCKS_WITHIN = 0.75
_LEAST_CLUSTER_PIECES = 64  # Where there are as many levels and blocks.


class CellName(NamedTuple):
    """The name of a cell: it tells the cells of a run apart, and is small to send."""

    block: int  # 0 for a linkage task.
    spec: str  # SPEC of the mechanism.
    label: str  # Of the consumer.


class PlannedCell(NamedTuple):
    """A cell that is to be computed."""

    block: int  # 0 for a linkage task.
    mechanism: Plugin
    consumer: Consumer


def missing_units(plan: Plan, finished: Mapping[CellKey, str]) -> list[Unit]:
    """Return the units of a run that lack consumers, each with the consumers it lacks.

    `finished` has the files of finished cells, as `file_by_cell` returns them.
    """
    units = []
    for unit in plan.units:
        consumers = {
            key: consumer
            for key, consumer in unit.consumers.items()
            if CellKey(unit.key, key) not in finished
        }
        if consumers:
            units.append(replace(unit, consumers=consumers))
    return units


def n_finished(plan: Plan) -> int:
    """Return the number of finished cells of a run, by its folder's checksums."""
    return plan.n_cells - sum(len(unit.consumers) for unit in missing_in_folder(plan))


def missing_in_folder(plan: Plan) -> list[Unit]:
    """Return the units with consumers that a run lacks by its folder's checksums.

    Raises as `checksummed_files` does.
    """
    indices = {}
    for name in checksummed_files(plan.out):
        index = read_index(plan.out / CELLS_FOLDER / name)
        if index is not None:
            indices[name] = index
    return missing_units(plan, file_by_cell(indices))


class _DueWork(NamedTuple):
    """A piece of work, and when it is handed out."""

    due: float  # Share of the run before it, 0..1.
    work: Work


def cut_work(missing: Sequence[Unit], plan: Plan) -> list[Work]:
    """Return the work of missing units in pieces, in the order of their handing out.

    Each piece is due at a share of the run. With several workers, blocks of scenes are
    spread over the first `_BLOCKS_WITHIN` of it, by the cells before each; with a single
    worker they come first. The pieces of linkage tasks, the longest first, are
    spread evenly over the run. So are those of patrols and tracking, and those of
    people who come back. Among pieces due at a time, those named first here come first.
    """
    links = _cut_linkage(missing, plan)
    # The longest first: at the end no worker waits for long.
    links.sort(key=lambda work: len(work.levels) * n_pairs(work), reverse=True)
    patrols: list[Work] = [*_cut_patrols(missing, plan), *_cut_tracking(missing, plan)]
    returns = _cut_returns(missing, plan)
    pieces = _spread_blocks(_cut_scenes(missing, plan), jobs=plan.jobs)
    pieces += _spread_evenly(links, n_parts=len(links))
    # A patrol takes as long as several blocks: it begins early.
    pieces += _spread_evenly(patrols, n_parts=len(patrols) + 1)
    pieces += _spread_evenly(returns, n_parts=len(returns) + 1)
    return [piece.work for piece in sorted(pieces, key=lambda piece: piece.due)]


def _spread_blocks(blocks: Sequence[SceneWork], *, jobs: int) -> list[_DueWork]:
    """Return blocks of scenes with the time at which each is due.

    A block takes the most memory, and longer the more consumers it has: with several
    workers, most of the time only one block is under way.
    """
    share = _BLOCKS_WITHIN if jobs > 1 else 0.0
    n_cells = [sum(len(consumers) for _, consumers in block.levels) for block in blocks]
    return [
        _DueWork(share * sum(n_cells[:place]) / sum(n_cells), block)
        for place, block in enumerate(blocks)
    ]


def _spread_evenly(works: Sequence[Work], *, n_parts: int) -> list[_DueWork]:
    """Return works that are due at the ends of the first of `n_parts` parts of a run."""
    return [_DueWork((place + 1) / n_parts, work) for place, work in enumerate(works)]


def _cut_scenes(missing: Sequence[Unit], plan: Plan) -> list[SceneWork]:
    """Return the missing levels of every block of scenes, in every world."""
    # Split where few blocks are attacked by the workers. Each piece senses the block
    # again, so that there are no more pieces than an even load takes.
    n_attacked = _divide_up(plan.settings.n_attacked_scenes, BLOCK_SCENES)
    n_pieces = 1
    if plan.jobs > 1:
        n_pieces = _divide_up(_PIECES_PER_WORKER * plan.jobs, n_attacked)
    orders = _scene_orders(plan)
    blocks = []
    for number, first in enumerate(range(0, plan.settings.n_all_scenes, BLOCK_SCENES)):
        for world, order in orders.items():
            levels = _merge_levels(
                unit
                for unit in missing
                if unit.block == number
                and unit.section in {SHARING, RECONSTRUCTION}
                and unit.world == world
            )
            is_attacked = number < n_attacked and not world
            blocks += [
                SceneWork(
                    number, first, order[first : first + BLOCK_SCENES], piece, world
                )
                for piece in _share_out(levels, n_pieces if is_attacked else 1)
            ]
    return blocks


def _divide_up(total: int, size: int) -> int:
    """Return how many parts of a size, the last perhaps smaller, make a total."""
    return -(-total // size)


def _scene_orders(plan: Plan) -> dict[World, Ints]:
    """Return the tracks of every scene, (S, A) rows, by world."""
    settings = plan.settings
    if plan.axes.scenes.why_left_out:
        return {}

    def order(n_tracks: int) -> Ints:
        return track_order(
            n_tracks=n_tracks,
            n_scenes=settings.n_all_scenes,
            agents=settings.stages.scenes.agents,
            seed=settings.seed,
        )

    orders = dict.fromkeys((OWN_WORLD, *WORLDS), order(len(plan.scene_tracks)))
    for horizon_s, tracks in plan.scene_tracks.further.items():
        orders[World(horizon_s=horizon_s)] = order(len(tracks))
    return orders


def _cut_linkage(missing: Sequence[Unit], plan: Plan) -> list[LinkWork]:
    """Return the missing levels of every linkage task, in every world."""
    groups = tuple(sorted(set(plan.scene_tracks.group)))
    walked = [(windows, OWN_WORLD) for windows in plan.task_windows]
    walked += [
        (windows, world)
        for world in plan.axes.linkage.mechanisms_by_world
        for windows in plan.model_task_windows
    ]
    links = []
    for windows, world in walked:
        levels = _merge_levels(
            unit
            for unit in missing
            if unit.section == windows.task.name and unit.world == world
        )
        # Each piece senses the windows again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_PIECE):
            piece = levels[first : first + _LEVELS_PER_PIECE]
            keep_scores = plan.settings.keep_scores
            links.append(LinkWork(windows, groups, piece, keep_scores, world))
    return links


def _cut_patrols(missing: Sequence[Unit], plan: Plan) -> list[PatrolWork]:
    """Return the missing levels of patrols, a piece for each worker.

    Each piece makes the patrol and senses everybody again.
    """
    levels = _merge_levels(unit for unit in missing if unit.section == PATROL)
    return [PatrolWork(plan.recorded, piece) for piece in _share_out(levels, plan.jobs)]


def _cut_returns(missing: Sequence[Unit], plan: Plan) -> list[ReturnWork]:
    """Return the missing levels of people who come back, a piece for each worker.

    Each piece senses all passages again, which takes less than one level.
    """
    levels = _merge_levels(unit for unit in missing if unit.section == RETURNS)
    if plan.passages is None:
        return []
    confirming = plan.settings.confirming
    return [
        ReturnWork(plan.passages, piece, confirming)
        for piece in _share_out(levels, plan.jobs)
    ]


def _cut_tracking(missing: Sequence[Unit], plan: Plan) -> list[TrackingWork]:
    """Return the missing levels of tracks, a piece for each worker.

    Each piece detects everybody and tracks the detections without noise again.
    """
    levels = _merge_levels(unit for unit in missing if unit.section == TRACKING)
    return [
        TrackingWork(plan.recorded, piece) for piece in _share_out(levels, plan.jobs)
    ]


def _merge_levels(units: Iterable[Unit]) -> Levels:
    """Return the levels of units of one block, or of one task: all sections together."""
    levels: dict[str, tuple[Plugin, list[Consumer]]] = {}
    for unit in units:
        spec = unit.mechanism.spec
        _, consumers = levels.setdefault(spec, (unit.mechanism, []))
        consumers.extend(unit.consumers.values())
    return tuple(
        (mechanism, tuple(consumers)) for mechanism, consumers in levels.values()
    )


def n_pairs(work: LinkWork) -> int:
    """Return the number of pairs that a linker compares at a level of a work.

    Its time is proportional to it.
    """
    sides = (work.task_windows.probe.search, work.task_windows.gallery.search)
    probes, gallery = (
        np.bincount(side, minlength=len(work.task_windows.search_names))
        for side in sides
    )
    return int(probes @ gallery)


def _share_out(levels: Levels, n_pieces: int) -> list[Levels]:
    """Split levels; neighbours take equally long, so a piece has every n-th level."""
    return [levels[piece::n_pieces] for piece in range(min(n_pieces, len(levels)))]


def cut_for_cluster(works: deque[Work]) -> None:
    """Cut work into pieces for some dozen threads, in place: workers come and go.

    The linkers behind one reconstruction are in one piece: its memory does not hold the
    releases of another.
    """
    n_pieces = _divide_up(_LEAST_CLUSTER_PIECES, len(works))
    for _ in range(len(works)):
        work = works.popleft()
        for levels in _share_out(work.levels, n_pieces):
            works.extend(_cut_by_view(replace(work, levels=levels)))


def _cut_by_view(work: Work) -> Iterator[Work]:
    """Yield a part of a work for every reconstruction that its consumers are behind."""
    keys = {view_key(cell.consumer) for cell in planned_cells(work)}
    for key in sorted(keys):

        def is_behind(cell: PlannedCell, key: tuple[str, str] = key) -> bool:
            return view_key(cell.consumer) == key

        yield select_cells(work, is_behind)


def planned_cells(work: Work) -> Iterator[PlannedCell]:
    """Yield the cells of a piece of work."""
    number = work.number if isinstance(work, SceneWork) else 0
    for mechanism, consumers in work.levels:
        for consumer in consumers:
            yield PlannedCell(number, mechanism, consumer)


def cell_name(cell: PlannedCell | FinishedCell) -> CellName:
    """Return the name of a cell, with the names that `note_cell` gets."""
    return CellName(cell.block, cell.mechanism.spec, cell.consumer.label)


def select_cells(work: Work, is_wanted: Callable[[PlannedCell], bool]) -> Work:
    """Return a work with the wanted cells only."""
    levels = []
    for level in work.levels:
        cells = planned_cells(replace(work, levels=(level,)))
        wanted = tuple(cell.consumer for cell in cells if is_wanted(cell))
        if wanted:
            levels.append((level[0], wanted))
    return replace(work, levels=tuple(levels))


def split_by_cell(work: Work) -> Iterator[Work]:
    """Yield a work of its own for every cell."""
    for cell in planned_cells(work):
        yield replace(work, levels=((cell.mechanism, (cell.consumer,)),))
