"""Pack finished cells into files: a worker sends whole files where it can."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from evaluation.compute.current_cell import Failure
from evaluation.compute.work import FinishedCell, attempt_cells
from evaluation.plan.fingerprint import sources
from evaluation.pool.pieces import cell_name
from evaluation.store.cell_files import pack_cells

if TYPE_CHECKING:
    from evaluation.plan.plan import Unit
    from evaluation.pool.pieces import CellName, Work

WorkResult: TypeAlias = "WholeFile | FinishedCell | Failure"


class ConsumerCode(NamedTuple):
    """The key of a consumer in a file of cells, and the code that computes it."""

    key: str
    code: Mapping[str, str]  # Digest by module.


class ExpectedFile(NamedTuple):
    """A file of cells that is still to be computed.

    It holds no plug-ins, only their digests, so that it is small to send to a worker.
    """

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
            modules = sources("", *consumer.plugins)
            code = {module: digests[module] for module in modules}
            consumers[consumer.label] = ConsumerCode(key, code)
        file = ExpectedFile(unit.file, unit.key, unit.code, consumers)
        files |= {(unit.block, unit.mechanism.spec, label): file for label in consumers}
    return files


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
        if len(cells) < len(file.consumers):
            return None
        del self._cells[file.name]
        block, spec, _ = name
        packed = []
        for label, (key, code) in file.consumers.items():
            finished = cells[block, spec, label]
            if finished is not None:
                packed.append((label, key, code, finished.tables))
        if not packed:  # all of its cells failed
            return None
        content = pack_cells(packed, unit=file.unit, code=file.code, names=self.names)
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
