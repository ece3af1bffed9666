"""The work of a run in pieces: find missing cells, cut the work, pack files of cells.

When a plug-in or a worker fails, its cell is left out by name, and the rest goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from evaluation.compute.current_cell import Failure
from evaluation.compute.linkage import view_key
from evaluation.compute.work import (
    Block,
    FinishedCell,
    Levels,
    LinkWork,
    attempt_cells,
)
from evaluation.plan.constants import BLOCK_SCENES, WORLDS, horizon_world
from evaluation.plan.fingerprint import sources
from evaluation.store.cell_files import cell_places, pack_cells, read_index
from evaluation.store.files import FOLDER, checksummed_files
from isac_track.scenes import track_order

if TYPE_CHECKING:
    from collections import deque

    import pandas as pd

    from evaluation.plan.axes import Consumer
    from evaluation.plan.plan import Plan, Unit
    from isac_track.plugins import Plugin
    from isac_track.types import Ints

Work: TypeAlias = "Block | LinkWork"
CellName: TypeAlias = "tuple[int, str, str]"
"""Block (0 for linkage), SPEC of the mechanism, label of the consumer."""
WorkResult: TypeAlias = "WholeFile | FinishedCell | Failure"
_TASKS_PER_WORKER = 2
_LEVELS_PER_TASK = 12  # Of a linkage task.
# The share of the work with which the last block begins, for it takes long.
_BLOCKS_WITHIN = 0.75
_CLUSTER_TASKS = 64  # At least so many, where there are as many levels and blocks.
_MOST_NAMED = 3


class PlannedCell(NamedTuple):
    """A cell that is to be computed."""

    block: int  # 0 for a linkage task.
    mechanism: Plugin
    consumer: Consumer


def missing_units(ready: Plan, places: Mapping[tuple[str, str], str]) -> list[Unit]:
    """Return the units of a run that lack consumers, each with the consumers it lacks.

    `places` has the files of finished cells, as `cell_places` returns them.
    """
    units = []
    for unit in ready.units:
        consumers = {
            key: consumer
            for key, consumer in unit.consumers.items()
            if (unit.key, key) not in places
        }
        if consumers:
            units.append(replace(unit, consumers=consumers))
    return units


def n_finished(ready: Plan) -> int:
    """Return the number of finished cells of a run, as `unfinished` finds them."""
    return ready.n_cells - sum(len(unit.consumers) for unit in unfinished(ready))


def unfinished(ready: Plan) -> list[Unit]:
    """Return the units that a run lacks by the checksums of its folder.

    Raises as `checksummed_files` does.
    """
    indices = {}
    for name in checksummed_files(ready.out):
        index = read_index(ready.out / FOLDER / name)
        if index is not None:
            indices[name] = index
    return missing_units(ready, cell_places(indices))


def cut_work(missing: Sequence[Unit], ready: Plan) -> list[Work]:
    """Return the work of missing units in pieces: blocks of scenes, linkage tasks."""
    blocks = _cut_scenes(missing, ready)
    links = _cut_linkage(missing, ready)
    # The longest first: at the end no worker waits for long.
    links.sort(key=_n_pairs, reverse=True)
    # A block takes the most memory, and longer the more consumers it has: with several
    # workers, most of the time only one block is under way.
    share = _BLOCKS_WITHIN if ready.jobs > 1 else 0.0
    n_cells = [sum(len(consumers) for _, consumers in block.levels) for block in blocks]
    due = [share * sum(n_cells[:n]) / sum(n_cells) for n in range(len(blocks))]
    due += [(n + 1) / len(links) for n in range(len(links))]
    works: list[Work] = [*blocks, *links]
    return [works[n] for n in sorted(range(len(works)), key=due.__getitem__)]


def _cut_scenes(missing: Sequence[Unit], ready: Plan) -> list[Block]:
    """Return the missing levels of every block of scenes, in every world."""
    n_scenes = ready.settings.n_utility_scenes
    tasks = {sessions.task.name for sessions in ready.sessions}
    # Split where few blocks are attacked by the workers. Each piece senses the block
    # again, so that there are no more pieces than an even load takes.
    n_attacked = -(-ready.settings.n_scenes // BLOCK_SCENES)
    n_pieces = 1
    if ready.jobs > 1:
        n_pieces = -(-_TASKS_PER_WORKER * ready.jobs // n_attacked)
    orders = _scene_orders(ready)
    blocks = []
    for number, first in enumerate(range(0, n_scenes, BLOCK_SCENES)):
        for world, order in orders.items():
            levels = _levels(
                unit
                for unit in missing
                if unit.block == number
                and unit.stage not in tasks
                and unit.world == world
            )
            is_attacked = number < n_attacked and not world
            blocks += [
                Block(number, first, order[first : first + BLOCK_SCENES], piece, world)
                for piece in _share_out(levels, n_pieces if is_attacked else 1)
            ]
    return blocks


def _scene_orders(ready: Plan) -> dict[str, Ints]:
    """Return the tracks of every scene, (S, A) rows, by world."""
    settings = ready.settings

    def order(n_tracks: int) -> Ints:
        return track_order(
            n_tracks=n_tracks,
            n_scenes=settings.n_utility_scenes,
            agents=settings.stages.scenes.agents,
            seed=settings.seed,
        )

    orders = dict.fromkeys(("", *WORLDS), order(len(ready.tracks)))
    for horizon_s, tracks in ready.tracks.further.items():
        orders[horizon_world(horizon_s)] = order(len(tracks))
    return orders


def _cut_linkage(missing: Sequence[Unit], ready: Plan) -> list[LinkWork]:
    """Return the missing levels of every linkage task, in every world."""
    groups = tuple(sorted(set(ready.tracks.group)))
    walked = [(sessions, "") for sessions in ready.sessions]
    walked += [
        (sessions, world)
        for world in ready.axes.linked_in
        for sessions in ready.model_sessions
    ]
    links = []
    for sessions, world in walked:
        levels = _levels(
            unit
            for unit in missing
            if unit.stage == sessions.task.name and unit.world == world
        )
        # Each piece senses the sessions again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_TASK):
            piece = levels[first : first + _LEVELS_PER_TASK]
            keep_scores = ready.settings.keep_scores
            links.append(LinkWork(sessions, groups, piece, keep_scores, world))
    return links


def _levels(units: Iterable[Unit]) -> Levels:
    """Return the levels of units of one block, or of one task: all stages together."""
    levels: dict[str, tuple[Plugin, list[Consumer]]] = {}
    for unit in units:
        spec = unit.mechanism.spec
        _, consumers = levels.setdefault(spec, (unit.mechanism, []))
        consumers.extend(unit.consumers.values())
    return tuple(
        (mechanism, tuple(consumers)) for mechanism, consumers in levels.values()
    )


def _n_pairs(work: LinkWork) -> int:
    """Return the number of compared pairs, to which a linker's time is proportional."""
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (
        np.bincount(side, minlength=len(work.sessions.searches)) for side in sides
    )
    return len(work.levels) * int((probes * gallery).sum())


def _share_out(levels: Levels, n_pieces: int) -> list[Levels]:
    """Split levels; neighbours take equally long, so a piece has every n-th level."""
    return [levels[piece::n_pieces] for piece in range(min(n_pieces, len(levels)))]


def cut_for_cluster(works: deque[Work]) -> None:
    """Cut work into pieces for some dozen threads, in place: workers come and go.

    The linkers behind one reconstruction are in one piece: its memory does not hold the
    releases of another.
    """
    n_pieces = -(-_CLUSTER_TASKS // len(works))
    for _ in range(len(works)):
        work = works.popleft()
        for levels in _share_out(work.levels, n_pieces):
            part = replace(work, levels=levels)
            cells = list(planned_cells(part))
            for key in sorted({view_key(cell.consumer) for cell in cells}):
                chosen = [cell for cell in cells if view_key(cell.consumer) == key]
                works.append(_only(part, chosen.__contains__))


def planned_cells(work: Work) -> Iterator[PlannedCell]:
    """Yield the cells of a piece of work."""
    number = work.number if isinstance(work, Block) else 0
    for mechanism, consumers in work.levels:
        for consumer in consumers:
            yield PlannedCell(number, mechanism, consumer)


def cell_name(cell: PlannedCell | FinishedCell) -> CellName:
    """Return the name of a cell, with the names that `note_cell` gets."""
    return cell.block, cell.mechanism.spec, cell.consumer.label


class Failures:
    """The failed cells of a run with reasons, and those where a worker died once."""

    def __init__(self) -> None:
        self.cells: list[tuple[PlannedCell, str]] = []
        self._died_at: set[tuple[CellName, ...]] = set()

    def rest(
        self, work: Work, failure: Failure, *, finished: Container[CellName]
    ) -> list[Work]:
        """Return the work that is left after a failure; a death is tried once more."""
        spec, label = failure.cell or ("", "")

        def is_culprit(cell: PlannedCell) -> bool:
            if not spec:
                return True
            # Without a label the mechanism failed, and with it all of its consumers.
            return cell.mechanism.spec == spec and label in ("", cell.consumer.label)

        left = _only(work, lambda cell: cell_name(cell) not in finished)
        if not left.levels:
            return []
        culprits = _only(left, is_culprit)
        innocent = _only(left, lambda cell: not is_culprit(cell))
        if not culprits.levels:
            # The culprit is unknown: blame all that is left, or this goes on for ever.
            culprits, innocent = innocent, culprits
        again: list[Work] = []
        if failure.worker_died:
            again = self._once_more(culprits, is_cell_known=bool(failure.cell))
        if not again:
            self.cells += [(cell, failure.message) for cell in planned_cells(culprits)]
        return [*again, innocent] if innocent.levels else again

    def _once_more(self, culprits: Work, *, is_cell_known: bool) -> list[Work]:
        """Return a work at which a worker died, for a second try; none for a third."""
        key = tuple(map(cell_name, planned_cells(culprits)))
        if not is_cell_known and len(key) > 1:
            # The culprit is unknown: try each cell by itself, once.
            self._died_at.update((name,) for name in key)
            return [
                replace(culprits, levels=((mechanism, (consumer,)),))
                for mechanism, consumers in culprits.levels
                for consumer in consumers
            ]
        if key in self._died_at:
            return []
        self._died_at.add(key)
        return [culprits]


def _only(work: Work, is_wanted: Callable[[PlannedCell], bool]) -> Work:
    """Return a work with the wanted cells only."""
    chosen = [cell for cell in planned_cells(work) if is_wanted(cell)]
    levels = []
    for mechanism, _ in work.levels:
        consumers = tuple(
            cell.consumer for cell in chosen if cell.mechanism is mechanism
        )
        if consumers:
            levels.append((mechanism, consumers))
    return replace(work, levels=tuple(levels))


class ConsumerCode(NamedTuple):
    """The key of a consumer in a file of cells, and the code that computes it."""

    key: str
    code: Mapping[str, str]  # Digest by module.


class ExpectedFile(NamedTuple):
    """A file of cells that is still to be computed; it names its plug-ins only."""

    name: str
    unit: str  # Key of the unit of work.
    code: Mapping[str, str]
    consumers: Mapping[str, ConsumerCode]  # By label.


class WholeFile(NamedTuple):
    """A file of cells that is ready to be written."""

    name: str
    content: bytes
    cells: tuple[CellName, ...]


def expected_files(
    units: Iterable[Unit], digests: Mapping[str, str]
) -> dict[CellName, ExpectedFile]:
    """Return the file of every cell of some units; `digests` are by module."""
    files: dict[CellName, ExpectedFile] = {}
    for unit in units:
        consumers = {}
        for key, consumer in unit.consumers.items():
            code = {name: digests[name] for name in sources("", *consumer.plugins)}
            consumers[consumer.label] = ConsumerCode(key, code)
        file = ExpectedFile(unit.file, unit.key, unit.code, consumers)
        files |= {(unit.block, unit.mechanism.spec, label): file for label in consumers}
    return files


class FileCollector:
    """Finished cells of expected files, held until their file is whole."""

    def __init__(
        self, files: Mapping[CellName, ExpectedFile], names: Mapping[str, str]
    ) -> None:
        self._files, self._names = files, names
        self._cells: dict[str, dict[CellName, FinishedCell | None]] = {}

    def add(self, name: CellName, cell: FinishedCell | None) -> WholeFile | None:
        """Add a cell, None if it failed; return its file as soon as that is whole."""
        file = self._files[name]
        cells = self._cells.setdefault(file.name, {})
        cells[name] = cell
        if len(cells) < len(file.consumers):
            return None
        del self._cells[file.name]
        block, spec, _ = name
        whole = []
        for label, (key, code) in file.consumers.items():
            finished = cells[block, spec, label]
            if finished is not None:
                whole.append((label, key, code, finished.tables))
        if not whole:
            return None
        content = pack_cells(whole, unit=file.unit, code=file.code, names=self._names)
        return WholeFile(file.name, content, tuple(cells))

    def rest(self) -> Iterator[FinishedCell]:
        """Yield the cells of files that are not whole."""
        for cells in self._cells.values():
            yield from filter(None, cells.values())


def compute_files(
    work: Work,
    *,
    files: Mapping[CellName, ExpectedFile],
    names: Mapping[str, str],
    **options: Any,  # noqa: ANN401 - handed on
) -> Iterator[WorkResult]:
    """Yield the results of `attempt_cells`, in packed files where these are whole."""
    collector, failures = FileCollector(files, names), list[Failure]()
    for result in attempt_cells(work, **options):
        if isinstance(result, Failure):
            failures.append(result)
        elif whole := collector.add(cell_name(result), result):
            yield whole
    yield from collector.rest()
    yield from failures


def failed_lines(rows: pd.DataFrame) -> list[str]:
    """Return a line for each consumer and reason in `failed.csv`, with the levels."""
    lines = []
    for (consumer, knows, why), part in rows.groupby(
        ["consumer", "knowledge", "why"], sort=False
    ):
        name = f"{consumer} ({knows})" if str(knows) else consumer
        specs = list(part["spec"].unique())
        levels = ", ".join(specs[:_MOST_NAMED])
        if len(specs) > _MOST_NAMED:
            levels += f" and {len(specs) - _MOST_NAMED} more"
        lines.append(f"{name} at {levels}: {why}; left out everywhere")
    return lines
