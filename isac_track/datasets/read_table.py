"""Readers of tables with named columns: csv and parquet, with t (s), id, x, y (m), group."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isac_track.datasets import recording
from isac_track.errors import DataError, told
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    import pyarrow as pa


_NEEDED = ("t", "id", "x", "y")
_USED = (*_NEEDED, "group")
_UNITS = {"t": "seconds", "x": "metres", "y": "metres"}
_DECIMAL = re.compile(r"[+-]?\d+\.\d*(e[+-]?\d+)?", re.IGNORECASE)
_LONGEST_NAME = 200  # Characters: ids stand in messages, tables and figures.
_BLOCK_BYTES = 1 << 18
_FREE_ROWS = 500_000  # Above it a file needs a byte a row: equal rows pack a thousandfold.
_FREE_BYTES = 50_000_000
_MOST_TIMES = 100  # A file above `_FREE_BYTES` unpacked may be this many times its size.


def read_csv(*, data: bytes, path: str) -> recording.Rows:
    """Read comma-separated values with a header line; DataError names file and line."""
    import pyarrow as pa  # noqa: PLC0415 - a plain import of the package stays quick
    from pyarrow import csv as arrow_csv  # noqa: PLC0415 - only for such a file

    recording.check_text(data=data, path=path)
    names = _csv_header(header=next(recording.lines_of(data), ""), path=path)
    _, _, body = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").partition(b"\n")
    if not body.strip():
        raise DataError(f"{path}: the file holds no rows")
    # Each text once: a long one that stands in every row would take as much memory as the file.
    text = pa.dictionary(pa.int32(), pa.string())
    used = {f"c{names.index(name)}": name for name in _USED if name in names}
    types = {column: pa.float64() if name in _UNITS else text for column, name in used.items()}
    n_rows = sum(1 for _ in _csv_lines(body))
    try:
        table = arrow_csv.read_csv(
            pa.py_buffer(body),
            read_options=arrow_csv.ReadOptions(
                use_threads=False,
                column_names=[f"c{index}" for index in range(len(names))],
                # Several blocks are under way at a time; no line may be longer than one.
                block_size=max(_BLOCK_BYTES, 1 + max(map(len, io.BytesIO(body)))),
            ),
            convert_options=arrow_csv.ConvertOptions(column_types=types, include_columns=[*types]),
        )
        if table.num_rows != n_rows:  # pyarrow lets quoted fields go on in the next line
            raise pa.ArrowInvalid(f"{table.num_rows} rows in {n_rows} lines")
    except (pa.ArrowException, MemoryError, UnicodeError) as error:
        for number, line in enumerate(recording.lines_of(body), start=2):
            if message := _csv_fault(line, names) if line else "":
                raise DataError(f"{path}, line {number}: {message}") from None
        raise DataError(f"{path}: cannot be read as csv ({told(error)})") from None
    place = recording.Place(path, lambda: np.fromiter(_csv_lines(body), dtype=np.int64))
    return _rows(table.rename_columns([*used.values()]), names=names, place=place)


def read_parquet(*, data: bytes, path: str) -> recording.Rows:
    """Read a parquet file; DataError names file and row."""
    import pyarrow as pa  # noqa: PLC0415 - a plain import of the package stays quick
    from pyarrow import parquet  # noqa: PLC0415 - only for such a file

    if not data:
        raise DataError(f"{path}: the file is empty")
    try:
        metadata = parquet.read_metadata(pa.BufferReader(data))
        schema = metadata.schema.to_arrow_schema()
        groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
        n_rows = max(metadata.num_rows, sum(group.num_rows for group in groups))
        size = sum(group.total_byte_size for group in groups)
    except Exception as error:  # noqa: BLE001 - a damaged file makes pyarrow raise nearly anything
        raise DataError(f"{path}: not a parquet file ({told(error)})") from None
    names = tuple(schema.names)
    _check_header(names=names, where=path)
    if n_rows > max(_FREE_ROWS, len(data)):
        raise DataError(f"{path}: claims {n_rows} rows in {len(data)} bytes; not a recording")
    if size > max(_FREE_BYTES, _MOST_TIMES * len(data)):
        raise DataError(f"{path}: {size} bytes when unpacked, over {_MOST_TIMES} times its size")
    try:
        used = [name for name in names if name in _USED]
        # Each text once: a long one that stands in every row would not fit into the memory.
        kinds = {pa.string(), pa.large_string()}
        texts = [name for name in used if schema.field(name).type in kinds]
        file = parquet.ParquetFile(pa.BufferReader(data), read_dictionary=texts)
        table = file.read(columns=used, use_threads=False)
        table.validate(full=True)  # pyarrow reads codes beyond the dictionary as they are
        for name in used:  # pyarrow passes over what its parts call differently
            if name not in table.column_names:
                raise ValueError(f"column {name} is not in it")  # noqa: TRY301 - told below
    except Exception as error:  # noqa: BLE001 - as above
        raise DataError(f"{path}: the parquet file is damaged ({told(error)})") from None
    place = recording.Place(path, lambda: np.arange(1, n_rows + 1), unit="row")
    return _rows(table, names=names, place=place)


def _csv_header(*, header: str, path: str) -> tuple[str, ...]:
    where = f"{path}, line 1"
    try:
        names = tuple(name.strip() for name in next(csv.reader([header]), []))
    except csv.Error as error:
        raise DataError(f"{where}: the header cannot be read: {error}") from None
    if header.lstrip().startswith("#"):
        raise DataError(f"{where}: a comment; the first line of csv names the columns, id,t,x,y")
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces")):
        if len(names) == 1 and separator in header.strip():
            message = f"{name} between the columns; csv has commas (and decimal points)"
            raise DataError(f"{where}: {message}")
    _check_header(names=names, where=where)
    return names


def _check_header(*, names: Sequence[str], where: str) -> None:
    missing = [name for name in _NEEDED if name not in names]
    if missing:
        near = [name for name in names if name.lower() == missing[0]]
        hint = f"; did you mean {near[0]!r}? Rename it" if near else ""
        raise DataError(
            f"{where}: no column {', '.join(missing)} (needed: t in s, id, x and y in m){hint}"
        )
    for name in _USED:
        if list(names).count(name) > 1:
            raise DataError(f"{where}: two columns are called {name}")


def _csv_lines(body: bytes) -> Iterator[int]:
    """Yield the numbers of the lines that are rows; pyarrow leaves out empty ones alone."""
    return (number for number, line in enumerate(io.BytesIO(body), start=2) if line != b"\n")


def _csv_fault(line: str, names: tuple[str, ...]) -> str:
    try:
        fields = next(csv.reader([line], strict=True))
    except csv.Error as error:
        return f"{error}{'; each row must be on one line' if 'end of data' in str(error) else ''}"
    if len(fields) != len(names):
        return (
            f"{len(fields)} column(s) where the header has {len(names)}; a decimal comma would "
            f"split a number{'; semicolons do not separate columns' if ';' in line else ''}"
        )
    for name, unit in _UNITS.items():
        field = fields[names.index(name)]
        try:
            float(field.replace("_", "?").encode("ascii", "replace") or "nan")  # as arrow has it
        except ValueError:
            hint = " (a decimal comma?)" if "," in field else ""
            return f"{name} {field[:40]!r} is not a number of {unit}{hint}"
    return ""


def _rows(table: pa.Table, *, names: Sequence[str], place: recording.Place) -> recording.Rows:
    """Return the rows of arrow columns; `names` are the file's."""
    t, x, y = (_numbers(table[name], name=name, path=place.path) for name in _UNITS)
    if not t.size:
        raise DataError(f"{place.path}: the file holds no rows")
    recording.check_numbers({"t": t, "x": x, "y": y}, place)
    person, ids = _index(table["id"], is_group=False, place=place)
    groups: tuple[tuple[str, str], ...] = ()
    if "group" in names:  # an empty cell is no group
        group, labels = _index(table["group"], is_group=True, place=place)
        pairs = np.unique(np.column_stack([person, group]), axis=0)
        groups = tuple((ids[who], labels[label]) for who, label in pairs if labels[label])
    notes: tuple[recording.Repair, ...] = ()
    if others := [recording.printable(name[:40]) for name in names if name not in _USED]:
        unused = f"column(s) {recording.listed(others)}: not used, {t.size} rows each"
        notes = (recording.Repair("ignored-column", len(others), f"{place.path}: {unused}"),)
    return recording.Rows(person, ids, t - t.min(), np.column_stack([x, y]), place, groups, notes)


def _numbers(column: pa.ChunkedArray, *, name: str, path: str) -> Floats:
    """Return (M,) the numbers of an arrow column; NaN for null, which a check names later."""
    import pyarrow as pa  # noqa: PLC0415 - only for such a file

    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        kind = kind.value_type if pa.types.is_dictionary(kind) else kind
        raise DataError(f"{path}: column {name} holds {kind}, not numbers of {_UNITS[name]}")
    numbers: Floats = column.cast(pa.float64(), safe=False).to_numpy()
    return numbers


def _index(
    column: pa.ChunkedArray, *, is_group: bool, place: recording.Place
) -> tuple[Ints, tuple[str, ...]]:
    """Return (M,) index into the cleaned values of an arrow column, and these in order."""
    import pandas as pd  # noqa: PLC0415 - only for such a file
    import pyarrow as pa  # noqa: PLC0415 - only for such a file

    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    is_text = kind in {pa.string(), pa.large_string()}
    if not (is_text or pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise DataError(f"{place.path}: ids and groups must be numbers or text, not {kind}")
    try:
        values = column.to_pandas(integer_object_nulls=True)
    except (pa.ArrowException, UnicodeError) as error:
        raise DataError(f"{place.path}: ids cannot be read ({told(error)})") from None
    codes, distinct = pd.factorize(values, use_na_sentinel=False)
    cleaned = []
    for code, value in enumerate(distinct):
        try:
            # Null is "None" or "nan", which is no name.
            cleaned.append(_cleaned(str(value).strip(), is_group=is_group))
        except ValueError as error:
            raise DataError(f"{place.at(int((codes == code).argmax()))}: {error}") from None
    # As numbers if all of them are, else as text.
    are_numbers = all(re.fullmatch(r"-?[0-9]{1,18}", name) for name in cleaned)
    names = sorted(set(cleaned), key=lambda name: (int(name) if are_numbers else 0, name))
    position = {name: index for index, name in enumerate(names)}
    return np.array([position[name] for name in cleaned], dtype=np.int64)[codes], tuple(names)


def _cleaned(name: str, *, is_group: bool) -> str:
    """Return the id or group of a cell, ``1`` for ``1.0``; ValueError for what is none."""
    if len(name) > _LONGEST_NAME:
        shown = f"{name[:20]!r}... has {len(name)} characters"
        raise ValueError(f"the name {shown}, over {_LONGEST_NAME}")
    if recording.printable(name) != name:
        raise ValueError(f"the name {name!r} has a control character")
    if name.lower() in {"", "nan", "none", "null"}:
        if is_group:
            return ""
        raise ValueError("the id is missing")
    if not _DECIMAL.fullmatch(name):
        return name
    number = float(name)
    if abs(number) < recording.WHOLE_LIMIT and number == int(number):
        return str(int(number))
    if is_group:
        return name
    raise ValueError(f"id {name} is not a whole number")
