"""The index of a file of cells: its units of work, and where their tables lie.

The metadata of a file have the index. For each unit of work it names the level, the
code that computed it, and the rows of every consumer. Each unit is a row group of its
own, so that a reader of one level reads no other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.store.checksums import checked_files, checksummed_files
from evaluation.store.files import open_regular

INDEX_KEY: Final = b"isac_track.cells"
_ANY_LEVEL: Final = ""
"""In place of a SPEC in files of earlier versions, which hold a single unit each."""


class ConsumerTables(NamedTuple):
    """The tables of a consumer in a file: its key, its plug-ins' code, their rows."""

    key: str
    code: Mapping[str, str]  # Digest by module.
    tables: Mapping[str, tuple[int, int]]
    """First row within the unit and number of rows, by table."""


class UnitIndex(NamedTuple):
    """A unit of work in a file: its key and code, consumers by label."""

    key: str
    code: Mapping[str, str]  # Digest by module.
    consumers: Mapping[str, ConsumerTables]
    row_group: int | None = None  # None: the whole file.


class FileIndex(NamedTuple):
    """The content of a file: units of work by the SPEC of their mechanism."""

    units: Mapping[str, UnitIndex]

    def unit_at(self, spec: str) -> UnitIndex | None:
        """Return the unit of a level; None if the file has none."""
        return self.units.get(spec) or self.units.get(_ANY_LEVEL)

    def holds(self, spec: str, label: str) -> bool:
        """Whether the file has the rows of a consumer at a level."""
        unit = self.unit_at(spec)
        return unit is not None and label in unit.consumers


def encode_index(units: Sequence[tuple[str, UnitIndex]]) -> bytes:
    """Return an index as the metadata of a file; each unit comes with its SPEC.

    The order is that of the row groups.
    """
    content = [
        {
            "spec": spec,
            "unit": unit.key,
            "code": dict(unit.code),
            "consumers": {
                label: consumer._asdict() for label, consumer in unit.consumers.items()
            },
        }
        for spec, unit in units
    ]
    return json.dumps({"units": content}).encode()


def decode_index(metadata: Mapping[bytes, bytes]) -> FileIndex:
    """Return the index in the metadata of a file; KeyError or ValueError without."""
    content = json.loads(metadata[INDEX_KEY])
    if "units" not in content:
        return FileIndex({_ANY_LEVEL: _decode_unit(content, row_group=None)})
    units = enumerate(content["units"])
    return FileIndex(
        {unit["spec"]: _decode_unit(unit, row_group=place) for place, unit in units}
    )


def _decode_unit(content: Mapping[str, Any], *, row_group: int | None) -> UnitIndex:
    consumers = {
        label: ConsumerTables(**tables)
        for label, tables in content["consumers"].items()
    }
    return UnitIndex(content["unit"], content["code"], consumers, row_group)


def read_index(content: bytes | Path) -> FileIndex | None:
    """Return the index of a file of cells, from its bytes or path, if it has any."""
    try:
        if isinstance(content, bytes):
            return decode_index(pq.read_metadata(pa.BufferReader(content)).metadata)
        with open_regular(content) as file:
            return decode_index(pq.read_metadata(file).metadata)
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        return None


class SoundFiles(NamedTuple):
    """The files of cells in a run folder that are as they were written."""

    index_by_file: dict[str, FileIndex]  # By name.
    damaged: list[str]  # Names of the others.


def sound_files(out: Path, names: Sequence[str] = ()) -> SoundFiles:
    """Return the sound files of a run folder, among `names` and those with a checksum."""
    index_by_file, damaged = dict[str, FileIndex](), list[str]()
    candidates = sorted({*names, *checksummed_files(out)})
    for name, content in checked_files(out, candidates):
        if content is None:
            damaged.append(name)
        elif (index := read_index(content)) is not None:
            index_by_file[name] = index
    return SoundFiles(index_by_file, damaged)


class CellKey(NamedTuple):
    """The keys of a cell: equal keys mean equal cells, in any run folder."""

    unit: str
    consumer: str


def file_by_cell(index_by_file: Mapping[str, FileIndex]) -> dict[CellKey, str]:
    """Return the name of the file of every cell, by its keys."""
    return {
        CellKey(unit.key, consumer.key): name
        for name, index in index_by_file.items()
        for unit in index.units.values()
        for consumer in unit.consumers.values()
    }
