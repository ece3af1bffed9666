"""When a plug-in or a worker fails: its cell is left out by name, and the rest goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from evaluation.cells.work import Block

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    import pandas as pd

    from evaluation.cells.progress import Failed
    from evaluation.cells.work import LinkWork
    from evaluation.experiment.axes import Consumer
    from isac_track.plugins import Plugin

Work: TypeAlias = "Block | LinkWork"
Cell: TypeAlias = "tuple[int, Plugin, Consumer]"
"""Block (0 for what is linked), mechanism and consumer."""


@dataclass(frozen=True, slots=True)
class FailedCell:
    """A cell that could not be computed, and why."""

    block: int
    mechanism: Plugin
    consumer: Consumer
    why: str


COLUMNS = ("spec", "kind", "consumer", "knowledge", "block", "why")
"""Of `failed.csv`."""
_MOST_NAMED = 3


class Failures:
    """The failed cells of a run, and those that a worker died at once."""

    def __init__(self) -> None:
        self.cells: list[FailedCell] = []
        self._died_at: set[tuple[tuple[int, str, str], ...]] = set()

    def rest(
        self, work: Work, failure: Failed, *, finished: AbstractSet[tuple[str, str]]
    ) -> list[Work]:
        """Return the work that is still to be done; a worker's death is tried once more.

        Parameters
        ----------
        work : Block or LinkWork
            In which something failed.
        failure : Failed
        finished : set of (mechanism, consumer)
            Cells of the work that are finished.
        """
        left = only(work, lambda cell: specs_of(cell) not in finished)
        culprits = only(left, lambda cell: _is_at(cell, failure.at))
        innocent = only(left, lambda cell: not _is_at(cell, failure.at))
        if not culprits.levels:  # none is there: it cannot be told, and must not go on for ever
            culprits, innocent = innocent, culprits
        again = self._once_more(culprits, place_is_known=bool(failure.at)) if failure.died else []
        if not again:
            self.cells += [FailedCell(*cell, failure.why) for cell in cells_of(culprits)]
        return [*again, *([innocent] if innocent.levels else ())]

    def _once_more(self, culprits: Work, *, place_is_known: bool) -> list[Work]:
        """Return the work at which a worker died, in smaller parts; none if it was its second."""
        key = tuple((cell[0], *specs_of(cell)) for cell in cells_of(culprits))
        is_vague = not place_is_known and len(key) > 1
        if key in self._died_at and not is_vague:
            return []
        self._died_at.add(key)
        # One level at a time: the next death, if there is one, takes no others along.
        again: list[Work] = [replace(culprits, levels=(level,)) for level in culprits.levels]
        if is_vague and len(again) == 1:  # where it was is not known: cell by cell
            self._died_at.update((one,) for one in key)
            again = [only(culprits, partial(_is_at, at=one[1:])) for one in key]
        return again


def cells_of(work: Work) -> Iterator[Cell]:
    """Yield the cells of a piece of work."""
    number = work.number if isinstance(work, Block) else 0
    for mechanism, consumers in work.levels:
        for consumer in consumers:
            yield number, mechanism, consumer


def specs_of(cell: Cell) -> tuple[str, str]:
    """Return how a cell is noted while it is computed."""
    return cell[1].spec, cell[2].label


def only(work: Work, wanted: Callable[[Cell], bool]) -> Work:
    """Return the work with no other cells."""
    chosen = [cell for cell in cells_of(work) if wanted(cell)]
    levels = (
        (mechanism, tuple(one for _, of, one in chosen if of is mechanism))
        for mechanism, _ in work.levels
    )
    return replace(work, levels=tuple(level for level in levels if level[1]))


def _is_at(cell: Cell, at: tuple[str, ...]) -> bool:
    """Whether a cell is where the work was; in a mechanism, all of its consumers are."""
    if not at:
        return True
    mechanism, consumer = at
    return cell[1].spec == mechanism and consumer in ("", cell[2].label)


def failed_lines(rows: pd.DataFrame) -> list[str]:
    """Return what failed: a line for each consumer and reason, with the levels left out."""
    lines = []
    for (consumer, knowledge, why), part in rows.groupby(
        ["consumer", "knowledge", "why"], sort=False
    ):
        who = f"{consumer} ({knowledge})" if str(knowledge) else consumer
        lines.append(f"{who} at {_listed(list(part['spec'].unique()))}: {why}; left out everywhere")
    return lines


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMED])
    return shown + (f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else "")
