"""The work of a run in pieces: what is missing, how it is cut, and the files that come of it.

When a plug-in or a worker fails, its cell is left out by name, and the rest goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from evaluation.compute.linkage import who_sees_alike
from evaluation.compute.where import Failed
from evaluation.compute.work import Block, Item, Levels, LinkWork, attempt
from evaluation.plan.constants import BLOCK_SCENES, WORLDS, horizon_world
from evaluation.plan.fingerprint import sources
from evaluation.store.cell_files import index_of, packed, places_of
from evaluation.store.files import FOLDER, written_down
from isac_track.scenes import track_order

if TYPE_CHECKING:
    from collections import deque

    import pandas as pd

    from evaluation.plan.axes import Consumer
    from evaluation.plan.plan import Plan, Unit
    from isac_track.plugins import Plugin

Work: TypeAlias = "Block | LinkWork"
# Block (0: what is linked), mechanism, consumer.
Cell: TypeAlias = "tuple[int, Plugin, Consumer]"
# Block, SPEC of the mechanism, label of the consumer.
Place: TypeAlias = "tuple[int, str, str]"
Found: TypeAlias = "WholeFile | Item | Failed"  # What comes of work.
_TASKS_PER_WORKER = 2
_LEVELS_PER_TASK = 12  # Of what is linked.
# The share of the work with which the last block begins, for it takes long.
_BLOCKS_WITHIN = 0.75
_CLUSTER_TASKS = 64  # At least so many, where there are as many levels and blocks.
_MOST_NAMED = 3


def missing_of(ready: Plan, places: Mapping[tuple[str, str], str]) -> list[Unit]:
    """Return the units of a run that lack consumers, with these; `places` are as of `places_of`."""
    units = []
    for unit in ready.units:
        who = {
            key: one
            for key, one in unit.consumers.items()
            if (unit.key, key) not in places
        }
        if who:
            units.append(replace(unit, consumers=who))
    return units


def n_finished(ready: Plan) -> int:
    """Return how many cells of a run are finished, as `unfinished` looks at its folder."""
    return ready.n_cells - sum(len(one.consumers) for one in unfinished(ready))


def unfinished(ready: Plan) -> list[Unit]:
    """Return what a run lacks by the checksums of its folder; raises as `written_down`."""
    indices = (
        (name, index_of(ready.out / FOLDER / name)) for name in written_down(ready.out)
    )
    return missing_of(
        ready, places_of({name: one for name, one in indices if one is not None})
    )


def pieces_of(missing: Sequence[Unit], ready: Plan) -> list[Work]:
    """Return what is to be computed: scenes, block by block, and what is linked."""
    settings = ready.settings
    order = partial(
        track_order,
        n_scenes=settings.n_utility_scenes,
        agents=settings.stages.scenes.agents,
        seed=settings.seed,
    )
    orders = dict.fromkeys(("", *WORLDS), order(n_tracks=len(ready.tracks)))
    for horizon_s, tracks in ready.tracks.further.items():
        orders[horizon_world(horizon_s)] = order(n_tracks=len(tracks))
    tasks = {sessions.task.name for sessions in ready.sessions}
    groups = tuple(sorted(set(ready.tracks.group)))
    starts = range(0, settings.n_utility_scenes, BLOCK_SCENES)
    # Split where few blocks are attacked by the workers; each piece senses the block
    # again, so that there are no more than an even load takes.
    n_attacked = -(-settings.n_scenes // BLOCK_SCENES)
    n_pieces = (
        1 if ready.jobs == 1 else -(-_TASKS_PER_WORKER * ready.jobs // n_attacked)
    )
    blocks = [
        Block(number, first, rows[first : first + BLOCK_SCENES], piece, world)
        for number, first in enumerate(starts)
        for world, rows in orders.items()
        for piece in _shared_out(
            _levels(
                one
                for one in missing
                if one.block == number and one.stage not in tasks and one.world == world
            ),
            n_pieces if number < n_attacked and not world else 1,
        )
    ]
    links: list[LinkWork] = []
    walked = [(one, "") for one in ready.sessions]
    walked += [
        (one, world) for world in ready.axes.linked_in for one in ready.model_sessions
    ]
    for sessions, world in walked:
        name = sessions.task.name
        levels = _levels(
            one for one in missing if one.stage == name and one.world == world
        )
        # Each piece senses the sessions again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_TASK):
            piece = levels[first : first + _LEVELS_PER_TASK]
            links.append(LinkWork(sessions, groups, piece, settings.keep_scores, world))
    # The longest first: at the end no worker waits for long.
    links.sort(key=_n_pairs, reverse=True)
    # A block takes the most memory, and the longer the more consumers it has: with
    # workers, most of the time one alone is under way.
    share = _BLOCKS_WITHIN if ready.jobs > 1 else 0.0
    n_cells = [sum(len(consumers) for _, consumers in one.levels) for one in blocks]
    due = [share * sum(n_cells[:n]) / sum(n_cells) for n in range(len(blocks))]
    due += [(n + 1) / len(links) for n in range(len(links))]
    works: list[Work] = [*blocks, *links]
    return [works[n] for n in sorted(range(len(works)), key=due.__getitem__)]


def _levels(units: Iterable[Unit]) -> Levels:
    """Return the levels of some units of one block, or of one task: all stages together."""
    levels: dict[str, tuple[Plugin, list[Consumer]]] = {}
    for one in units:
        found = levels.setdefault(one.mechanism.spec, (one.mechanism, []))
        found[1].extend(one.consumers.values())
    return tuple(
        (mechanism, tuple(consumers)) for mechanism, consumers in levels.values()
    )


def _n_pairs(work: LinkWork) -> int:
    """Return how many pairs are compared: what a linker takes goes by it."""
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (
        np.bincount(side, minlength=len(work.sessions.searches)) for side in sides
    )
    return len(work.levels) * int((probes * gallery).sum())


def _shared_out(levels: Levels, n_pieces: int) -> list[Levels]:
    """Split levels; neighbours take alike long, so every n-th level is in a piece."""
    return [levels[piece::n_pieces] for piece in range(min(n_pieces, len(levels)))]


def cut_for_cluster(works: deque[Work]) -> None:
    """Cut work into pieces for some dozen threads, in place: workers come and go.

    Who links behind one reconstruction is in a piece: what others make of theirs is not
    beside it.
    """
    n_pieces = -(-_CLUSTER_TASKS // len(works))
    for _ in range(len(works)):
        work = works.popleft()
        for part in (
            replace(work, levels=one) for one in _shared_out(work.levels, n_pieces)
        ):
            cells = list(cells_of(part))
            for sees in sorted({who_sees_alike(one) for *_, one in cells}):
                alike = [cell for cell in cells if who_sees_alike(cell[2]) == sees]
                works.append(_only(part, alike.__contains__))


def cells_of(work: Work) -> Iterator[Cell]:
    """Yield the cells of a piece of work."""
    number = work.number if isinstance(work, Block) else 0
    for mechanism, consumers in work.levels:
        for consumer in consumers:
            yield number, mechanism, consumer


def place_of(cell: Cell) -> Place:
    """Return which cell it is, by names: those that are noted while it is computed."""
    return cell[0], cell[1].spec, cell[2].label


class Failures:
    """The failed cells of a run with the reasons, and those that a worker died at once."""

    def __init__(self) -> None:
        self.cells: list[tuple[Cell, str]] = []
        self._died_at: set[tuple[Place, ...]] = set()

    def rest(
        self, work: Work, failure: Failed, *, finished: Container[Place]
    ) -> list[Work]:
        """Return what is left of a work in which something failed; a death is tried once more."""
        spec, label = failure.at or ("", "")

        def is_at(cell: Cell) -> bool:  # in a mechanism, all of its consumers are
            return not spec or (cell[1].spec == spec and label in ("", cell[2].label))

        left = _only(work, lambda cell: place_of(cell) not in finished)
        if not left.levels:
            return []
        culprits, innocent = (
            _only(left, is_at),
            _only(left, lambda cell: not is_at(cell)),
        )
        if (
            not culprits.levels
        ):  # none is there: it cannot be told, and must not go on for ever
            culprits, innocent = innocent, culprits
        again = (
            self._once_more(culprits, place_is_known=bool(failure.at))
            if failure.died
            else []
        )
        if not again:
            self.cells += [(cell, failure.why) for cell in cells_of(culprits)]
        return [*again, *([innocent] if innocent.levels else ())]

    def _once_more(self, culprits: Work, *, place_is_known: bool) -> list[Work]:
        """Return the work at which a worker died, to be tried again; none if it was its second."""
        key = tuple(map(place_of, cells_of(culprits)))
        if (
            not place_is_known and len(key) > 1
        ):  # nobody knows which it was: each by itself, once
            self._died_at.update((one,) for one in key)
            return [
                replace(culprits, levels=((mechanism, (one,)),))
                for mechanism, consumers in culprits.levels
                for one in consumers
            ]
        if key in self._died_at:
            return []
        self._died_at.add(key)
        return [culprits]


def _only(work: Work, wanted: Callable[[Cell], bool]) -> Work:
    """Return the work with no other cells."""
    chosen = [cell for cell in cells_of(work) if wanted(cell)]
    levels = (
        (mechanism, tuple(one for _, of, one in chosen if of is mechanism))
        for mechanism, _ in work.levels
    )
    return replace(work, levels=tuple(level for level in levels if level[1]))


class ToCome(NamedTuple):
    """A file to come, and what it holds when it is whole: plug-ins are named, none is here."""

    name: str
    unit: str  # Key of the unit of work.
    code: Mapping[str, str]
    consumers: Mapping[
        str, tuple[str, Mapping[str, str]]
    ]  # Key and code of each, by its label.


class WholeFile(NamedTuple):
    """A file of cells that is ready to be written."""

    name: str
    content: bytes
    places: tuple[Place, ...]


def files_to_come(
    units: Iterable[Unit], code_of: Mapping[str, str]
) -> dict[Place, ToCome]:
    """Return the file of every cell of some units; `code_of` has the digest of every module."""
    found: dict[Place, ToCome] = {}
    for unit in units:
        consumers = {
            one.label: (
                key,
                {name: code_of[name] for name in sources("", *one.plugins)},
            )
            for key, one in unit.consumers.items()
        }
        file = ToCome(unit.file, unit.key, unit.code, consumers)
        found |= {(unit.block, unit.mechanism.spec, label): file for label in consumers}
    return found


class Gathered:
    """What is computed of files to come, and of each until it is whole."""

    def __init__(self, files: Mapping[Place, ToCome], names: Mapping[str, str]) -> None:
        self._files, self._names = files, names
        self._found: dict[str, dict[Place, Item | None]] = {}

    def add(self, place: Place, item: Item | None) -> WholeFile | None:
        """Take what a consumer makes, None if it fails; return a file that is whole."""
        file = self._files[place]
        found = self._found.setdefault(file.name, {})
        found[place] = item
        if len(found) < len(file.consumers):
            return None
        del self._found[file.name]
        whole = [
            (label, *about, item[3])
            for label, about in file.consumers.items()
            if (item := found[*place[:2], label]) is not None
        ]
        if not whole:
            return None
        content = packed(whole, unit=file.unit, code=file.code, names=self._names)
        return WholeFile(file.name, content, tuple(found))

    def rest(self) -> Iterator[Item]:
        """Yield what there is of files that are not whole."""
        for found in self._found.values():
            yield from filter(None, found.values())


def in_files(
    work: Work,
    *,
    files: Mapping[Place, ToCome],
    names: Mapping[str, str],
    **options: Any,  # noqa: ANN401 - handed on
) -> Iterator[Found]:
    """Yield what `attempt` does, packed where files are whole: there is less to send."""
    gathered, failed = Gathered(files, names), list[Failed]()
    for found in attempt(work, **options):
        if isinstance(found, Failed):
            failed.append(found)
        elif whole := gathered.add(place_of(found[:3]), found):
            yield whole
    yield from gathered.rest()
    yield from failed


def failed_lines(rows: pd.DataFrame) -> list[str]:
    """Return what failed, by `failed.csv`: for each consumer and reason the levels left out."""
    lines = []
    for (consumer, knows, why), part in rows.groupby(
        ["consumer", "knowledge", "why"], sort=False
    ):
        who = f"{consumer} ({knows})" if str(knows) else consumer
        specs = list(part["spec"].unique())
        more = (
            f" and {len(specs) - _MOST_NAMED} more" if len(specs) > _MOST_NAMED else ""
        )
        lines.append(
            f"{who} at {', '.join(specs[:_MOST_NAMED])}{more}: {why}; left out"
            " everywhere"
        )
    return lines
