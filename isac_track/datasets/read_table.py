"""Readers of tables with named columns: csv and parquet, with t (s), id, x, y (m), group."""

from __future__ import annotations

import csv
import io
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.datasets.rows import (
    POSITION_LIMIT_M,
    TIME_LIMIT_S,
    Place,
    Repair,
    Rows,
    brief,
    check_numbers,
    check_text,
    checked_name,
    clean_id,
    lines_of,
    listed,
    printable,
    sort_ids,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isac_track.types import Floats, Ints

_NEEDED = ("t", "id", "x", "y")
_USED = (*_NEEDED, "group")
_UNITS = {"t": "seconds", "x": "metres", "y": "metres"}
_BLOCK_BYTES = 1 << 18
_MOST_COLUMNS = 10_000
"""Of csv: pyarrow takes memory for each, also for those that are not used."""
_FREE_ROWS = 500_000
"""A parquet file above this needs a byte a row: equal rows pack a thousandfold, walks do not."""
_FREE_BYTES = 50_000_000
_MOST_UNPACKING = 100
"""A parquet file above `_FREE_BYTES` when unpacked may be this many times its size."""


def read_csv(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read comma-separated values with a header line.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line, or if `fps` is given.
    """
    import pyarrow as pa  # noqa: PLC0415 - a plain import of the package stays quick
    from pyarrow import csv as arrow_csv  # noqa: PLC0415

    _refuse_fps(fps=fps, path=path, format_name="csv")
    check_text(data=data, path=path)
    names = _csv_header(header=next(lines_of(data), ""), path=path)
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
        _raise_first_csv_fault(body=body, names=names, path=path)
        raise DataError(f"{path}: cannot be read as csv ({brief(error)})") from None
    columns = {name: table[column] for column, name in used.items()}
    del table
    place = Place(path=path, lines=lambda: np.fromiter(_csv_lines(body), dtype=np.int64))
    return _rows(columns, names=names, place=place)


def read_parquet(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read a parquet file.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and row, or if `fps` is given.
    """
    import pyarrow as pa  # noqa: PLC0415 - a plain import of the package stays quick
    from pyarrow import parquet  # noqa: PLC0415

    _refuse_fps(fps=fps, path=path, format_name="parquet")
    if not data:
        raise DataError(f"{path}: the file is empty")
    try:
        file = parquet.ParquetFile(pa.BufferReader(data))
        schema, metadata = file.schema_arrow, file.metadata
        names = tuple(schema.names)
        groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
        n_rows = max(metadata.num_rows, sum(group.num_rows for group in groups))
        unpacked_bytes = sum(group.total_byte_size for group in groups)
    except Exception as error:  # noqa: BLE001 - a damaged file makes pyarrow raise nearly anything
        raise DataError(f"{path}: not a parquet file ({brief(error)})") from None
    _check_header(names=names, where=path)
    if n_rows > max(_FREE_ROWS, len(data)):
        raise DataError(f"{path}: claims {n_rows} rows in {len(data)} bytes; not a recording")
    if unpacked_bytes > max(_FREE_BYTES, _MOST_UNPACKING * len(data)):
        raise DataError(
            f"{path}: {unpacked_bytes} bytes when unpacked, over {_MOST_UNPACKING} times its size"
        )
    try:
        # Each text once: a long one that stands in every row would not fit into the memory.
        used = [name for name in names if name in _USED]
        texts = [
            name for name in used if schema.field(name).type in {pa.string(), pa.large_string()}
        ]
        file = parquet.ParquetFile(pa.BufferReader(data), read_dictionary=texts)
        table = file.read(columns=used, use_threads=False)
        columns = {name: table[name] for name in table.column_names}
        del table
        for column in columns.values():
            column.validate(full=True)  # pyarrow reads codes beyond the dictionary as they are
    except Exception as error:  # noqa: BLE001 - as above
        raise DataError(f"{path}: the parquet file is damaged ({brief(error)})") from None
    lost = [name for name in used if name not in columns]
    if lost:  # pyarrow passes over what its parts call differently
        raise DataError(f"{path}: the parquet file is damaged (column {lost[0]} is not in it)")
    place = Place(path=path, lines=lambda: np.arange(1, n_rows + 1), unit="row")
    return _rows(columns, names=names, place=place)


def _refuse_fps(*, fps: float | None, path: str, format_name: str) -> None:
    if fps is not None:
        raise DataError(
            f"{path}: format {format_name} has times in seconds (column t); leave --fps out"
        )


def _csv_header(*, header: str, path: str) -> tuple[str, ...]:
    message = ""
    names: tuple[str, ...] = ()
    try:
        names = tuple(name.strip() for name in next(csv.reader([header]), []))
    except csv.Error as error:
        message = f"the header cannot be read: {error}"
    if len(names) == 1:
        for separator, name in ((" ", "spaces"), ("\t", "tabs"), (";", "semicolons")):
            if separator in header.strip():
                message = f"{name} between the columns; csv has commas (and decimal points)"
    if len(names) > _MOST_COLUMNS:
        message = f"{len(names)} columns, over {_MOST_COLUMNS}; leave out what is not used"
    if message:
        raise DataError(f"{path}, line 1: {message}")
    _check_header(names=names, where=f"{path}, line 1")
    return names


def _check_header(*, names: Sequence[str], where: str) -> None:
    missing = [name for name in _NEEDED if name not in names]
    if missing:
        near = get_close_matches(missing[0], [name.lower() for name in names], n=1, cutoff=0.3)
        original = next((name for name in names if near and name.lower() == near[0]), None)
        hint = f"; did you mean {original[:40]!r}? Rename it" if original else ""
        raise DataError(
            f"{where}: no column {', '.join(missing)} (needed: t in s, id, x and y in m){hint}"
        )
    for name in _USED:
        if list(names).count(name) > 1:
            raise DataError(f"{where}: two columns are called {name}")


def _csv_lines(body: bytes) -> Iterator[int]:
    """Yield the numbers of the lines that are rows; pyarrow leaves out empty ones alone."""
    return (number for number, line in enumerate(io.BytesIO(body), start=2) if line != b"\n")


def _raise_first_csv_fault(*, body: bytes, names: tuple[str, ...], path: str) -> None:
    for number, line in enumerate(lines_of(body), start=2):
        message = _csv_fault(line, names) if line else ""
        if message:
            raise DataError(f"{path}, line {number}: {message}")


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
            float(field or "nan")
        except ValueError:
            hint = " (a decimal comma?)" if "," in field else ""
            return f"{name} {field[:40]!r} is not a number of {unit}{hint}"
    return ""


def _rows(columns: dict[str, Any], *, names: Sequence[str], place: Place) -> Rows:
    """Return the rows of arrow columns, which are let go one by one; `names` are the file's."""
    t, x, y = (_numbers(columns.pop(name), name=name, path=place.path) for name in _UNITS)
    if not t.size:
        raise DataError(f"{place.path}: the file holds no rows")
    limits = [TIME_LIMIT_S, POSITION_LIMIT_M, POSITION_LIMIT_M]
    check_numbers([t, x, y], names=tuple(_UNITS), limits=limits, place=place)
    xy = np.column_stack([x, y])
    del x, y
    person, ids = _index(columns["id"], clean=clean_id, place=place)
    groups: tuple[tuple[str, str], ...] = ()
    if "group" in columns:  # an empty cell is no group
        group, labels = _index(columns["group"], clean=_clean_label, place=place)
        pairs = np.unique(np.column_stack([person, group]), axis=0)
        groups = tuple((ids[who], labels[label]) for who, label in pairs if labels[label])
    notes: tuple[Repair, ...] = ()
    if others := [printable(name[:40]) for name in names if name not in _USED]:
        detail = f"{place.path}: column(s) {listed(others)}: not used, {t.size} rows each"
        notes = (Repair("ignored-column", len(others), detail),)
    t = t - t.min()
    return Rows(person=person, ids=ids, t=t, xy=xy, place=place, groups=groups, notes=notes)


def _numbers(column: Any, *, name: str, path: str) -> Floats:  # noqa: ANN401 - pyarrow has no types
    """Return (M,) the numbers of an arrow column; NaN for null, which a check names later."""
    import pyarrow as pa  # noqa: PLC0415

    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        kind = kind.value_type if pa.types.is_dictionary(kind) else kind
        raise DataError(f"{path}: column {name} holds {kind}, not numbers of {_UNITS[name]}")
    numbers: Floats = column.cast(pa.float64(), safe=False).to_numpy()
    return numbers


def _index(
    column: Any,  # noqa: ANN401 - pyarrow has no types
    *,
    clean: Callable[[str], str],
    place: Place,
) -> tuple[Ints, tuple[str, ...]]:
    """Return (M,) index into the cleaned values of an arrow column, and these in order."""
    import pandas as pd  # noqa: PLC0415
    import pyarrow as pa  # noqa: PLC0415

    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    known = (pa.types.is_integer, pa.types.is_floating, pa.types.is_string)
    if not any(check(kind) for check in (*known, pa.types.is_large_string)):
        raise DataError(f"{place.path}: ids and groups must be numbers or text, not {kind}")
    try:
        values = column.to_pandas(integer_object_nulls=True)
    except (pa.ArrowException, UnicodeError) as error:
        raise DataError(f"{place.path}: ids cannot be read ({brief(error)})") from None
    codes, distinct = pd.factorize(values, use_na_sentinel=False)
    cleaned = []
    for code, value in enumerate(distinct):
        try:
            cleaned.append(clean(str(value)))  # null is "None" or "nan", which is no name
        except ValueError as error:
            raise DataError(f"{place.at(int((codes == code).argmax()))}: {error}") from None
    names = sort_ids(set(cleaned))
    position = {name: index for index, name in enumerate(names)}
    return np.array([position[name] for name in cleaned], dtype=np.int64)[codes], names


def _clean_label(text: str) -> str:
    label = checked_name(text)
    try:
        return clean_id(label)  # 3.0 is group 3, as a column with empty cells writes it
    except ValueError:
        return "" if label.lower() in {"nan", "none", "null"} else label
