"""The cells of a run folder: parquet files of one or more units.

A unit is a row group. It holds the tables of several consumers, one below the
other; a column that a table does not have is null there. The metadata of the file say
where each consumer's tables begin, and which code computed them (`cell_index`). A
consumer that is added later has a further file: no file is rewritten.

A unit has a record for each stage of its life:

| record | a unit that | holds |
|---|---|---|
| `plan.units.Unit` | a run plans | mechanism and consumers |
| `pool.packing.ExpectedUnit` | is still to be computed | keys and digests |
| `ComputedUnit` | is to be written | tables by consumer |
| `cell_index.UnitIndex` | a file has | where its tables lie |
| `ReadUnit` | was read from a file | one table, and the above |

Every page has a checksum, which is verified when it is read: a bit that flips later, in
memory or on the disk, is an error and no other number. Files of earlier versions, whose
pages have none, are read as they are.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.compute.link_tables import ABOUT
from evaluation.compute.tables import DESCRIPTORS, ON_TRIAL, ROWS, Tables
from evaluation.compute.tables import column as make_column
from evaluation.store.cell_index import (
    INDEX_KEY,
    ConsumerTables,
    FileIndex,
    UnitIndex,
    decode_index,
    encode_index,
)
from evaluation.store.files import CELLS_FOLDER, open_regular
from evaluation.store.people import read_labels
from isac_track.errors import DataError, check_limits

if TYPE_CHECKING:
    from evaluation.store.entries import Entry

_SCORES: Final = "scores"
_TEXT_COLUMNS: Final = (
    "source",
    "group",
    "search",
    "side",
    "assigned",
    "metric",
    "about",
)
_PERSON_COLUMNS: Final = ("source", "group")
_NO_NAMES: Final[Mapping[str, str]] = MappingProxyType({})
_RECURRING_COLUMNS: Final = {
    "plr",
    "plr_wide",
    "plr_gap",
    "plr_attacked",
    "separation_m",
    "speed_mps",
    "tpr_at_fpr_1pct",
    "chance",
}
"""Numbers that recur in other rows or for other consumers: unsplit they compress."""
_FLOAT32_COLUMNS: Final = {
    *DESCRIPTORS,
    *ON_TRIAL,
    "mse_m2",
    "benchmark_mse_m2",
    "benchmark_plr",
    "plr_ceiling",
    "plr_optimum",
    "plr_gap",
    "plr_wide",
    "median_error_m",
    "duration_s",
    "speed_mps",
    "sigma_m",
}
"""Columns of a track or window in single precision: saves a sixth of a run's disk."""


class ComputedCell(NamedTuple):
    """The tables of a consumer that are to be written."""

    label: str
    key: str
    code: Mapping[str, str]  # Digest by module, of its plug-ins.
    tables: Tables


class ComputedUnit(NamedTuple):
    """A unit of work that is to be written: the cells of one level."""

    spec: str  # SPEC of the mechanism.
    key: str
    code: Mapping[str, str]  # Digest by module.
    cells: Sequence[ComputedCell]


@dataclass(frozen=True, eq=False, slots=True)
class ReadUnit:
    """A unit of work that was read from a file of cells."""

    path: Path
    table: pa.Table
    index: UnitIndex


def pack_units(
    units: Sequence[ComputedUnit], *, names: Mapping[str, str] = _NO_NAMES
) -> bytes:
    """Return the file of some units of work; `names` are people's, by their ids."""
    index, tables, sizes = [], [], []
    for place, unit in enumerate(units):
        consumers, n_rows = {}, 0
        for cell in unit.cells:
            rows = {}
            for name, table in cell.tables.items():
                rows[name] = (n_rows, table.num_rows)
                n_rows += table.num_rows
                tables.append(rename_people(table, names))
            consumers[cell.label] = ConsumerTables(cell.key, dict(cell.code), rows)
        index.append((unit.spec, UnitIndex(unit.key, unit.code, consumers, place)))
        sizes.append(n_rows)
    whole = pa.concat_tables(tables, promote_options="default").combine_chunks()
    whole = _with_precision(whole, pa.float32())
    return _write_groups(whole, sizes, index=encode_index(index))


def _write_groups(table: pa.Table, sizes: Sequence[int], *, index: bytes) -> bytes:
    """Return a parquet file whose row groups have these numbers of rows."""
    # The leading bytes of similar numbers are equal: split off, they compress.
    floats = {field.name for field in table.schema if pa.types.is_floating(field.type)}
    elements = ["scores.list.element"] if _SCORES in table.column_names else []
    split = list(floats - _RECURRING_COLUMNS) + elements
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink,
        table.schema,
        write_statistics=False,
        compression="zstd",
        compression_level=9,
        store_schema=False,
        write_page_checksum=True,
        use_dictionary=[
            name for name in table.column_names if name not in floats | {_SCORES}
        ],
        column_encoding=dict.fromkeys(split, "BYTE_STREAM_SPLIT"),
    ) as writer:
        first = 0
        for n_rows in sizes:
            unit_rows = table.slice(first, n_rows)
            writer.write_table(unit_rows, row_group_size=max(n_rows, 1))
            first += n_rows
        writer.add_key_value_metadata({INDEX_KEY: index})
    return bytes(sink.getvalue())


def rename_people(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a table to be written: ids of people become `names`, if there are any."""
    if not names:
        return table
    for place, column in enumerate(table.column_names):
        if column in _PERSON_COLUMNS:
            coded = table[column].combine_chunks().dictionary_encode()
            new_names = make_column(
                [names[person] for person in coded.dictionary.to_pylist()]
            )
            table = table.set_column(place, column, new_names.take(coded.indices))
        elif column == ABOUT:
            texts = [_rename_about(text, names) for text in table[column].to_pylist()]
            table = table.set_column(place, column, make_column(texts))
    return table


def _rename_about(text: str, names: Mapping[str, str]) -> str:
    about = json.loads(text)
    about["clusters"] = [names[cluster] for cluster in about["clusters"]]
    if "gallery" in about:
        about["gallery"] = [
            [names[person] for person in gallery] for gallery in about["gallery"]
        ]
    return json.dumps(about)


def _with_labels(table: pa.Table, labels: Mapping[str, str]) -> pa.Table:
    """Return a table that was read: names of people become `labels`, if there are any."""
    for place, column in enumerate(table.column_names):
        if labels and column in _PERSON_COLUMNS:
            coded = table[column].combine_chunks()
            # None stands for tables of the file that are not about people.
            names = coded.dictionary.to_pylist()
            new_names = make_column([labels.get(name, name) for name in names])
            relabelled = pa.DictionaryArray.from_arrays(coded.indices, new_names)
            table = table.set_column(place, column, relabelled)
    return table


def _with_precision(table: pa.Table, kind: pa.DataType) -> pa.Table:
    """Return a table with the columns of `_FLOAT32_COLUMNS` as numbers of another kind."""
    fields = (
        field.with_type(kind) if field.name in _FLOAT32_COLUMNS else field
        for field in table.schema
    )
    return table.cast(pa.schema(fields))


def read_rows(
    out: Path,
    entry: Entry,
    *,
    columns: Sequence[str],
    beside: Collection[str] = (),
    table: str = ROWS,
) -> pa.Table:
    """Return the rows of one consumer at one level, an entry of a manifest, by block.

    `table` is that of the cell. Columns `beside` are read, too, for the next call that
    asks for the same files: one read for all. Raises DataError if a cell is missing or
    broken, or has no such table or column; the message names it.
    """
    parts = []
    for file in read_units(out, entry, {*columns, *beside}):
        places = consumer_tables(file, entry).tables
        if table not in places:
            raise DataError(
                f"{file.path} has no table {table}: another version wrote it; run the"
                " matrix again"
            )
        rows = file.table.slice(*places[table])
        check_columns(rows, columns, path=file.path)
        parts.append(rows.select(list(columns)))
    return pa.concat_tables(parts).unify_dictionaries()


def check_columns(rows: pa.Table, columns: Iterable[str], *, path: Path) -> None:
    """Raise DataError if rows lack a column, or have no value in it.

    A table without rows may have any columns without values.
    """
    for column in columns:
        is_present = column in rows.column_names
        if not is_present or rows[column].null_count == max(rows.num_rows, 1):
            raise DataError(
                f"{path} has no column {column}: it is no cell of the kind"
                " that the manifest says; run the matrix again with --fresh"
            )


def consumer_tables(file: ReadUnit, entry: Entry) -> ConsumerTables:
    """Return the tables of an entry's consumer; DataError if the file has none."""
    label = entry.label
    if label not in file.index.consumers:
        raise DataError(
            f"{file.path} has no rows of {label}; delete it and run the matrix again"
        )
    return file.index.consumers[label]


def read_units(
    out: Path, entry: Entry, columns: Collection[str] | None
) -> list[ReadUnit]:
    """Return the units that hold a cell, block by block.

    Read `columns` of their tables; None: all but the raw scores of linkers.
    """
    stamped = []
    for name in entry.files:
        path = out / CELLS_FOLDER / name
        with readable(path):
            stat = path.stat()
        stamped.append(_Stamped(path, stat.st_mtime_ns, stat.st_size))
    names = None if columns is None else frozenset(columns)
    return _read_level(tuple(stamped), entry.spec, names)


class _Stamped(NamedTuple):
    """A file, with its age and size: another of its name is read again."""

    path: Path
    changed_ns: int
    n_bytes: int


# Some columns of the newest cell's units, whose consumers are read one after another;
# until another is read, or a file changes.
@lru_cache(maxsize=1)
def _read_level(
    stamped: tuple[_Stamped, ...], spec: str, columns: frozenset[str] | None
) -> list[ReadUnit]:
    """Return the units of a level in some files."""
    units = []
    for file in stamped:
        with readable(file.path):
            metadata = _read_metadata(file)
            unit = metadata.units.unit_at(spec)
            if unit is None:
                raise DataError(
                    f"{file.path} has no rows at {spec}; delete it and run the matrix"
                    " again"
                )
            table = _read_columns(file.path, metadata.parquet, unit, columns)
            table = _with_precision(table, pa.float64())
            labels = read_labels(file.path.parent.parent)
            units.append(ReadUnit(file.path, _with_labels(table, labels), unit))
    return units


class _Metadata(NamedTuple):
    parquet: pq.FileMetaData
    units: FileIndex


# The metadata of the newest files, some kB each, which every level is looked up in;
# until so many others were read.
@lru_cache(maxsize=64)
def _read_metadata(file: _Stamped) -> _Metadata:
    with open_regular(file.path) as opened:
        metadata = pq.read_metadata(opened)
    return _Metadata(metadata, decode_index(metadata.metadata))


def _read_columns(
    path: Path,
    metadata: pq.FileMetaData,
    unit: UnitIndex,
    columns: frozenset[str] | None,
) -> pa.Table:
    """Return some columns of a unit in a file, or all but raw scores."""
    present = metadata.schema.to_arrow_schema().names
    if columns is None:
        columns = frozenset(present) - {_SCORES}
    names = [name for name in present if name in columns]
    # Not pq.read_table: its data set machinery takes longer than the read.
    with (
        open_regular(path) as opened,
        pq.ParquetFile(
            opened,
            metadata=metadata,
            read_dictionary=[name for name in names if name in _TEXT_COLUMNS],
            page_checksum_verification=True,
        ) as file,
    ):
        if unit.row_group is None:
            return file.read(columns=names, use_threads=False)
        return file.read_row_group(unit.row_group, columns=names, use_threads=False)


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn an error of a cell's content into a DataError that names the file."""
    try:
        yield
    except FileNotFoundError:
        raise DataError(
            f"{path} is missing; run the matrix again to compute it"
        ) from None
    except (OSError, pa.ArrowException, LookupError, TypeError, ValueError) as error:
        check_limits(error)
        raise DataError(
            f"{path} cannot be read ({error}); delete it and run the matrix again"
        ) from None
