"""Cells on their way into files: what computes them packs each file as soon as it is whole.

So a worker sends a few kilobytes where its tables would be megabytes, and who writes them does not
compress them, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from evaluation.cells.where import Failed
from evaluation.cells.work import Item, attempt
from evaluation.experiment.fingerprint import sources
from evaluation.runs.cell_files import packed

if TYPE_CHECKING:
    from evaluation.experiment.plan import Unit
    from evaluation.runs.pieces import Place, Work


class ToCome(NamedTuple):
    """A file to come, and what it holds when it is whole: plug-ins are named, none is here."""

    name: str
    unit: str  # Key of the unit of work.
    code: Mapping[str, str]
    consumers: Mapping[str, tuple[str, Mapping[str, str]]]  # Key and code of each, by its label.


class WholeFile(NamedTuple):
    """A file of cells that is ready to be written."""

    name: str
    content: bytes
    places: tuple[Place, ...]


def files_to_come(units: Iterable[Unit], code_of: Mapping[str, str]) -> dict[Place, ToCome]:
    """Return the file of every cell of some units; `code_of` has the digest of every module."""
    found: dict[Place, ToCome] = {}
    for unit in units:
        consumers = {
            one.label: (key, {name: code_of[name] for name in sources("", *one.plugins)})
            for key, one in unit.consumers.items()
        }
        file = ToCome(unit.file, unit.key, unit.code, consumers)
        found |= {(unit.block, unit.mechanism.spec, label): file for label in consumers}
    return found


class Gathered:
    """What is computed of files to come, and of each until it is whole."""

    def __init__(self, files: Mapping[Place, ToCome]) -> None:
        self._files = files
        self._found: dict[str, dict[Place, Item | None]] = {}

    def add(self, place: Place, item: Item | None) -> WholeFile | None:
        """Take what a consumer makes of a unit, None if it fails; return the file if it is whole.

        One of which everything failed is none.
        """
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
        content = packed(whole, unit=file.unit, code=file.code)
        return WholeFile(file.name, content, tuple(found))

    def rest(self) -> Iterator[Item]:
        """Yield what there is of files that are not whole, and forget it."""
        for found in self._found.values():
            yield from filter(None, found.values())
        self._found = {}


def in_files(
    work: Work,
    *,
    files: Mapping[Place, ToCome],
    **options: Any,  # noqa: ANN401 - handed on
) -> Iterator[WholeFile | Item | Failed]:
    """Yield what `attempt` does, packed as far as files are whole: the rest one by one."""
    gathered = Gathered(files)
    for found in attempt(work, **options):
        if isinstance(found, Failed):
            yield from gathered.rest()
            yield found
        elif whole := gathered.add((found[0], found[1].spec, found[2].label), found):
            yield whole
    yield from gathered.rest()
