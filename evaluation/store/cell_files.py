"""The cells of a run folder: a parquet file for each unit of work.

A file holds the tables of several consumers, one below the other; a column that a table
does not have is null there. Its metadata say where each consumer's tables begin, and
which code computed them. A consumer that is added later has a further file: no file is
rewritten.

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

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.compute.link_scores import (
    ABOUT,
    COMPANIONS,
)
from evaluation.compute.sample_tracks import COLUMNS as SAMPLE_COLUMNS
from evaluation.compute.tables import DESCRIPTORS, ON_TRIAL, ROWS, Tables
from evaluation.compute.tables import column as make_column
from evaluation.store.files import (
    FOLDER,
    GALLERY,
    checked_files,
    checksummed_files,
    open_regular,
    write_whole,
)
from evaluation.store.people import read_labels
from isac_track.errors import DataError, check_limits
from isac_track.types import Floats

if TYPE_CHECKING:
    import pandas as pd

    from evaluation.store.entries import Entry

_INDEX: Final = b"isac_track.cells"
_SCORES: Final = "scores"
_NAMES: Final = ("source", "group", "search", "side", "assigned", "metric", "about")
_NAMED = ("metric", "group", "assigned")
_COUNTED = ("above", "tied", "chance", *COMPANIONS)
_OUTCOME: Final = (*_NAMED, *_COUNTED, "about", "value", "ci_low", "ci_high", "n")
"""Columns of a linkage cell beside its replicates."""
_PEOPLE: Final = ("source", "group")
_AS_THEY_ARE: Final[Mapping[str, str]] = MappingProxyType({})
_NONE: Final[Floats] = np.zeros(0, dtype=np.float32)
_REPEATED: Final = {
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
_SINGLE: Final = {
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


class ConsumerTables(NamedTuple):
    """The tables of a consumer in a file: its key, its plug-ins' code, their rows."""

    key: str
    code: Mapping[str, str]  # Digest by module.
    tables: Mapping[str, tuple[int, int]]  # First row and number of rows, by table.


class FileIndex(NamedTuple):
    """The content of a file: key and code of the unit of work, consumers by label."""

    unit: str
    code: Mapping[str, str]
    consumers: Mapping[str, ConsumerTables]


@dataclass(frozen=True, eq=False, slots=True)
class CellFile:
    """A file of cells that was read."""

    path: Path
    table: pa.Table
    index: FileIndex


def pack_cells(
    cells: Sequence[tuple[str, str, Mapping[str, str], Tables]],
    *,
    unit: str,
    code: Mapping[str, str],
    names: Mapping[str, str] = _AS_THEY_ARE,
) -> bytes:
    """Return the file of a unit of work, of key `unit`.

    Each of `cells` has a consumer's label, key, code and tables. `names` are the names
    of people in the file, by their ids.
    """
    consumers, start = {}, 0
    for label, key, own_code, tables in cells:
        places = {}
        for name, table in tables.items():
            places[name] = (start, table.num_rows)
            start += table.num_rows
        consumers[label] = {"key": key, "code": dict(own_code), "tables": places}
    parts = [
        rename_people(table, names) for *_, tables in cells for table in tables.values()
    ]
    whole = pa.concat_tables(parts, promote_options="default").combine_chunks()
    whole = _with_precision(whole, pa.float32())
    index = {"unit": unit, "code": dict(code), "consumers": consumers}
    # The leading bytes of similar numbers are equal: split off, they compress.
    floats = {field.name for field in whole.schema if pa.types.is_floating(field.type)}
    elements = ["scores.list.element"] if _SCORES in whole.column_names else []
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink,
        whole.schema,
        write_statistics=False,
        compression="zstd",
        compression_level=9,
        store_schema=False,
        write_page_checksum=True,
        use_dictionary=[
            name for name in whole.column_names if name not in floats | {_SCORES}
        ],
        column_encoding=dict.fromkeys(
            [*(floats - _REPEATED), *elements], "BYTE_STREAM_SPLIT"
        ),
    ) as writer:
        writer.write_table(whole)
        writer.add_key_value_metadata({_INDEX: json.dumps(index).encode()})
    return bytes(sink.getvalue())


def rename_people(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a table with other names of people, by their ids; without names, as is."""
    if not names:
        return table
    for place, column in enumerate(table.column_names):
        if column in _PEOPLE:
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
    """Return a table that was read, with people called by the labels of their names."""
    for place, column in enumerate(table.column_names):
        if labels and column in _PEOPLE:
            coded = table[column].combine_chunks()
            # None stands for tables of the file that are not about people.
            names = coded.dictionary.to_pylist()
            new_names = make_column([labels.get(name, name) for name in names])
            relabelled = pa.DictionaryArray.from_arrays(coded.indices, new_names)
            table = table.set_column(place, column, relabelled)
    return table


def _with_precision(table: pa.Table, kind: pa.DataType) -> pa.Table:
    """Return a table with the columns of `_SINGLE` as numbers of another kind."""
    fields = (
        field.with_type(kind) if field.name in _SINGLE else field
        for field in table.schema
    )
    return table.cast(pa.schema(fields))


def read_index(content: bytes | Path) -> FileIndex | None:
    """Return the index of a file of cells, from its bytes or path; None without one."""
    try:
        if isinstance(content, bytes):
            return _index(pq.read_metadata(pa.BufferReader(content)).metadata)
        with open_regular(content) as file:
            return _index(pq.read_metadata(file).metadata)
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        return None


def _index(metadata: Mapping[bytes, bytes]) -> FileIndex:
    content = json.loads(metadata[_INDEX])
    consumers = {
        label: ConsumerTables(**tables)
        for label, tables in content["consumers"].items()
    }
    return FileIndex(unit=content["unit"], code=content["code"], consumers=consumers)


def sound_files(
    out: Path, names: Sequence[str] = ()
) -> tuple[dict[str, FileIndex], list[str]]:
    """Return the indices of sound files by name, and the names of damaged ones.

    They are looked for among `names` and the checksums.
    """
    sound, damaged = {}, []
    candidates = sorted({*names, *checksummed_files(out)})
    for name, content in checked_files(out, candidates):
        if content is None:
            damaged.append(name)
        elif (index := read_index(content)) is not None:
            sound[name] = index
    return sound, damaged


def cell_places(files: Mapping[str, FileIndex]) -> dict[tuple[str, str], str]:
    """Return the file of every cell, by the keys of its unit and of its consumer."""
    return {
        (index.unit, consumer.key): name
        for name, index in files.items()
        for consumer in index.consumers.values()
    }


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
    for file in open_files(out, entry, {*columns, *beside}):
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
    """Raise DataError if rows of a file lack a column, or it is empty."""
    for column in columns:
        is_present = column in rows.column_names
        if not is_present or rows[column].null_count == max(rows.num_rows, 1):
            raise DataError(
                f"{path} has no column {column}: it is no cell of the kind"
                " that the manifest says; run the matrix again with --fresh"
            )


def consumer_tables(file: CellFile, entry: Entry) -> ConsumerTables:
    """Return the tables of an entry's consumer; DataError if the file has none."""
    label = entry.label
    if label not in file.index.consumers:
        raise DataError(
            f"{file.path} has no rows of {label}; delete it and run the matrix again"
        )
    return file.index.consumers[label]


def open_files(
    out: Path, entry: Entry, columns: Collection[str] | None
) -> list[CellFile]:
    """Return the files of a cell: some columns, or all but raw scores."""
    stamped = []
    for name in entry.files:
        path = out / FOLDER / name
        with readable(path):
            stat = path.stat()
        stamped.append((path, stat.st_mtime_ns, stat.st_size))
    return _read_files(tuple(stamped), None if columns is None else frozenset(columns))


# Some columns of the newest cell's files, whose consumers are read one after another;
# until another is read, or a file changes.
@lru_cache(maxsize=1)
def _read_files(
    stamped: tuple[tuple[Path, int, int], ...], columns: frozenset[str] | None
) -> list[CellFile]:
    """Return files whose ages and sizes are as `stamped` says."""
    files = []
    for path, *_ in stamped:
        with readable(path):
            table, index = _read_columns(path, columns)
            table = _with_precision(table, pa.float64())
            labels = read_labels(path.parent.parent)
            files.append(CellFile(path, _with_labels(table, labels), index))
    return files


def _read_columns(
    path: Path, columns: frozenset[str] | None
) -> tuple[pa.Table, FileIndex]:
    """Return some columns of a file, or all but raw scores, and the file's index."""
    # Not pq.read_table: its data set machinery takes longer than the read.
    with open_regular(path) as opened:
        metadata = pq.read_metadata(opened)
        present = metadata.schema.to_arrow_schema().names
        wanted = columns or {*present} - {_SCORES}
        names = [name for name in present if name in wanted]
        with pq.ParquetFile(
            opened,
            metadata=metadata,
            read_dictionary=[name for name in names if name in _NAMES],
            page_checksum_verification=True,
        ) as file:
            return file.read(columns=names, use_threads=False), _index(
                metadata.metadata
            )


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn an error of a cell's content into a DataError that names the file."""
    try:
        yield
    except FileNotFoundError:
        raise DataError(
            f"{path} is missing; run the matrix again to compute it"
        ) from None
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        check_limits(error)
        raise DataError(
            f"{path} cannot be read ({error}); delete it and run the matrix again"
        ) from None


def write_gallery(parts: Sequence[pa.Table], *, out: Path) -> None:
    """Write sample tracks into a run folder; without parts remove earlier ones."""
    if not parts:
        (out / GALLERY).unlink(missing_ok=True)
        return
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.concat_tables(parts), sink, compression="zstd", write_page_checksum=True
    )
    write_whole(out / GALLERY, sink.getvalue().to_pybytes())


def read_gallery(out: Path) -> pd.DataFrame | None:
    """Return the sample tracks of a run folder, None without any.

    Raises DataError if they are broken.
    """
    path = out / GALLERY
    if not path.exists():
        return None
    with readable(path):
        # Not pq.read_table: where no further thread can start it ends the process.
        with (
            open_regular(path) as opened,
            pq.ParquetFile(opened, page_checksum_verification=True) as file,
        ):
            # A column that is missing is not an error of `read`.
            table = file.read(use_threads=False).select(SAMPLE_COLUMNS)
        tracks: pd.DataFrame = table.to_pandas(use_threads=False)
        return tracks
