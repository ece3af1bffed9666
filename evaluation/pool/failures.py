"""Failed cells: a cell that fails costs itself alone, and the rest goes on."""

from __future__ import annotations

from collections.abc import Container
from typing import TYPE_CHECKING, NamedTuple

from evaluation.pool.pieces import (
    cell_name,
    planned_cells,
    select_cells,
    split_by_cell,
)

if TYPE_CHECKING:
    from evaluation.compute.current_cell import Failure
    from evaluation.compute.work import Work
    from evaluation.pool.pieces import CellName, PlannedCell


class FailedCell(NamedTuple):
    """A cell that failed, and why."""

    cell: PlannedCell
    message: str


class Failures:
    """The failed cells of a run with reasons, and those where a worker died before."""

    def __init__(self) -> None:
        self.cells: list[FailedCell] = []
        self._died_at: set[CellName] = set()

    def work_after(
        self, work: Work, failure: Failure, *, finished: Container[CellName]
    ) -> list[Work]:
        """Return the work that is left after a failure; a death is tried once more.

        Every call either marks new cells as died-at or records them as failed, so this
        ends. Cells in `finished` are left out.
        """
        left = select_cells(work, lambda cell: cell_name(cell) not in finished)
        blamed = [cell for cell in planned_cells(left) if _is_at(cell, failure.cell)]
        # Where no cell fits, blame all that is left, or this goes on for ever.
        blamed = blamed or list(planned_cells(left))
        names = {cell_name(cell) for cell in blamed}
        culprits = select_cells(left, lambda cell: cell_name(cell) in names)
        innocent = select_cells(left, lambda cell: cell_name(cell) not in names)
        again: list[Work] = []
        if failure.worker_died and not names <= self._died_at:
            self._died_at |= names
            # Where the cell is unknown, each is tried by itself.
            again = [culprits] if failure.cell else list(split_by_cell(culprits))
        else:
            self.cells += [FailedCell(cell, failure.message) for cell in blamed]
        return [*again, innocent] if innocent.levels else again


def _is_at(cell: PlannedCell, names: tuple[str, ...]) -> bool:
    """Whether a failure may be at a cell, by the names that `note_cell` got.

    These are the SPEC of the mechanism and the label of the consumer. Without names
    the failure may be at any cell.
    """
    if not names:
        return True
    spec, label = names
    # Without a label the mechanism failed, and with it all of its consumers.
    return cell.mechanism.spec == spec and label in ("", cell.consumer.label)
