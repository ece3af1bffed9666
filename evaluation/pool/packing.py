"""Pack finished cells into files: a worker sends whole files where it can."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from evaluation.compute.current_cell import Failure
from evaluation.compute.work import FinishedCell, attempt_cells
from evaluation.plan.fingerprint import plugin_modules
from evaluation.pool.pieces import CellName, cell_name
from evaluation.store.cell_files import ComputedCell, ComputedUnit, pack_units
from evaluation.store.new_files import group_units

if TYPE_CHECKING:
    from evaluation.compute.work import Work
    from evaluation.plan.units import Unit

WorkResult: TypeAlias = "WholeFile | HeldCell | FinishedCell | Failure"


class ConsumerCode(NamedTuple):
    """The key of a consumer in a file of cells, and the code that computes it."""

    key: str
    code: Mapping[str, str]  # Digest by module.


class ExpectedUnit(NamedTuple):
    """A unit of work in a file that is still to be computed."""

    block: int  # Of scenes; 0 for a linkage task.
    spec: str  # SPEC of the mechanism.
    key: str
    code: Mapping[str, str]  # Digest by module.
    consumers: Mapping[str, ConsumerCode]  # By label.


class ExpectedFile(NamedTuple):
    """A file of cells that is still to be computed.

    It holds no plug-ins, only their digests, so that it is small to send to a worker.
    """

    name: str
    units: tuple[ExpectedUnit, ...]
    cells: tuple[CellName, ...]


class WholeFile(NamedTuple):
    """A file of cells that is ready to be written."""

    name: str
    content: bytes
    cells: tuple[CellName, ...]


class HeldCell(NamedTuple):
    """A note that a cell is computed, and waits for others of its file."""

    cell: CellName


def expected_files(
    units: Iterable[Unit], digests: Mapping[str, str]
) -> dict[CellName, ExpectedFile]:
    """Return the file of every cell of some units; `digests` are by module."""
    files: dict[CellName, ExpectedFile] = {}
    for name, file_units in group_units(units):
        expected = tuple(_expected_unit(unit, digests) for unit in file_units)
        cells = tuple(
            CellName(unit.block, unit.spec, label)
            for unit in expected
            for label in unit.consumers
        )
        files |= dict.fromkeys(cells, ExpectedFile(name, expected, cells))
    return files


def _expected_unit(unit: Unit, digests: Mapping[str, str]) -> ExpectedUnit:
    consumers = {}
    for key, consumer in unit.consumers.items():
        modules = plugin_modules(consumer.plugins)
        code = {module: digests[module] for module in modules}
        consumers[consumer.label] = ConsumerCode(key, code)
    return ExpectedUnit(
        unit.block, unit.mechanism.spec, unit.key, unit.code_digests, consumers
    )


class FileCollector:
    """Finished cells of expected files, held until their file is whole.

    `files` are by cell; `names` are those of people in the files, by their ids.
    """

    def __init__(
        self, files: Mapping[CellName, ExpectedFile], names: Mapping[str, str]
    ) -> None:
        self.files, self.names = files, names
        self._cells: dict[str, dict[CellName, FinishedCell | None]] = {}

    def add(self, name: CellName, cell: FinishedCell | None) -> WholeFile | None:
        """Add a cell, None if it failed; return its file as soon as that is whole."""
        file = self.files[name]
        cells = self._cells.setdefault(file.name, {})
        cells[name] = cell
        if len(cells) < len(file.cells):
            return None
        del self._cells[file.name]
        units = [_computed_unit(unit, cells) for unit in file.units]
        units = [unit for unit in units if unit.cells]
        if not units:  # all of its cells failed
            return None
        return WholeFile(file.name, pack_units(units, names=self.names), file.cells)

    def unfinished_cells(self) -> Iterator[FinishedCell]:
        """Yield the cells of files that are not whole."""
        for cells in self._cells.values():
            yield from filter(None, cells.values())


def _computed_unit(
    unit: ExpectedUnit, cells: Mapping[CellName, FinishedCell | None]
) -> ComputedUnit:
    """Return a unit with those of its cells that did not fail."""
    computed = []
    for label, consumer in unit.consumers.items():
        cell = cells[CellName(unit.block, unit.spec, label)]
        if cell is not None:
            computed.append(
                ComputedCell(label, consumer.key, consumer.code, cell.tables)
            )
    return ComputedUnit(unit.spec, unit.key, unit.code, computed)


def compute_files(
    work: Work,
    *,
    files: Mapping[CellName, ExpectedFile],
    names: Mapping[str, str],
    **options: Any,  # noqa: ANN401 - handed on
) -> Iterator[WorkResult]:
    """Yield the results of `attempt_cells`, in packed files where these are whole.

    Cells of other files follow at the end; until then each is announced.
    """
    collector, failures = FileCollector(files, names), list[Failure]()
    for result in attempt_cells(work, **options):
        if isinstance(result, Failure):
            failures.append(result)
        elif whole := collector.add(cell_name(result), result):
            yield whole
        else:
            yield HeldCell(cell_name(result))
    yield from collector.unfinished_cells()
    yield from failures
