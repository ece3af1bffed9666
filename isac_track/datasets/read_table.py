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
    fault,
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
_NUMBERS = ("t", "x", "y")
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
    _refuse_fps(fps=fps, path=path, format_name="csv")
    check_text(data=data, path=path)
    names = _csv_header(header=next(lines_of(data), ""), path=path)
    _, _, body = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").partition(b"\n")
    place = Place(path=path, lines=lambda: _csv_line_numbers(body))
    t, xy, texts = _csv_columns(body=body, names=names, path=path)
    return _rows(t=t, xy=xy, texts=texts, names=names, place=place)


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
        schema = file.schema_arrow
        names = tuple(schema.names)
        n_rows, unpacked_bytes = _claimed(file.metadata)
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
        file = parquet.ParquetFile(pa.BufferReader(data), read_dictionary=_texts(schema))
        used = [name for name in names if name in _USED]
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
    t, x, y = (_numbers(columns.pop(name), name=name, path=path) for name in _NUMBERS)
    return _rows(t=t, xy=np.column_stack([x, y]), texts=columns, names=names, place=place)


def _texts(schema: Any) -> list[str]:  # noqa: ANN401 - pyarrow has no types
    import pyarrow as pa  # noqa: PLC0415

    kinds = (pa.string(), pa.large_string())
    return [field.name for field in schema if field.name in _USED and field.type in kinds]


def _claimed(metadata: Any) -> tuple[int, int]:  # noqa: ANN401 - pyarrow has no types
    """Return how many rows a parquet file says it has, and its bytes when unpacked."""
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    n_rows = max(metadata.num_rows, sum(group.num_rows for group in groups))
    return n_rows, sum(group.total_byte_size for group in groups)


def _refuse_fps(*, fps: float | None, path: str, format_name: str) -> None:
    if fps is not None:
        raise DataError(
            f"{path}: format {format_name} has times in seconds (column t); leave --fps out"
        )


def _csv_header(*, header: str, path: str) -> tuple[str, ...]:
    try:
        names = tuple(name.strip() for name in next(csv.reader([header]), []))
    except csv.Error as error:
        raise fault(path=path, line=1, message=f"the header cannot be read: {error}") from None
    if len(names) == 1:
        for separator, name in ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces")):
            if separator in header.strip():
                message = f"{name} between the columns; csv has commas (and decimal points)"
                raise fault(path=path, line=1, message=message)
    if len(names) > _MOST_COLUMNS:
        message = f"{len(names)} columns, over {_MOST_COLUMNS}; leave out what is not used"
        raise fault(path=path, line=1, message=message)
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


def _csv_columns(
    *, body: bytes, names: tuple[str, ...], path: str
) -> tuple[Floats, Floats, dict[str, Any]]:
    """Return (M,) t, (M, 2) xy and the arrow columns of text; or find the first bad line."""
    import pyarrow as pa  # noqa: PLC0415

    if not body.strip():
        raise DataError(f"{path}: the file holds no rows")
    used = {name: f"c{names.index(name)}" for name in _USED if name in names}
    types = {
        column: pa.float64() if name in _NUMBERS else pa.string() for name, column in used.items()
    }
    # Batch by batch to where it belongs, each text once: the file's columns are never here twice.
    n_rows = sum(1 for _ in _csv_lines(body))
    t, xy = np.empty(n_rows), np.empty((n_rows, 2))
    into = {"t": t, "x": xy[:, 0], "y": xy[:, 1]}
    texts: dict[str, list[Any]] = {name: [] for name in used if name not in _NUMBERS}
    first = 0
    try:
        for batch in _batches(body=body, n_columns=len(names), types=types):
            rows = slice(first, first + batch.num_rows)
            for name, numbers in into.items():
                # A null becomes NaN, which a check names later.
                numbers[rows] = batch[used[name]].to_numpy(zero_copy_only=False)
            for name, parts in texts.items():
                parts.append(batch[used[name]].dictionary_encode())
            first = rows.stop
    except (pa.ArrowException, MemoryError, UnicodeError) as error:
        _raise_first_csv_fault(body=body, names=names, path=path)
        raise DataError(f"{path}: cannot be read as csv ({brief(error)})") from None
    if first != n_rows:  # pyarrow lets quoted fields go on in the next line
        _raise_first_csv_fault(body=body, names=names, path=path)
        raise DataError(f"{path}: cannot be read as csv ({first} rows in {n_rows} lines)")
    return t, xy, {name: pa.chunked_array(parts) for name, parts in texts.items()}


def _batches(*, body: bytes, n_columns: int, types: dict[str, Any]) -> Iterator[Any]:
    """Yield record batches of the columns that have a type."""
    import pyarrow as pa  # noqa: PLC0415
    from pyarrow import csv as arrow_csv  # noqa: PLC0415

    yield from arrow_csv.open_csv(
        pa.py_buffer(body),
        read_options=arrow_csv.ReadOptions(
            use_threads=False,
            column_names=[f"c{index}" for index in range(n_columns)],
            # Several blocks are under way at a time; no line may be longer than one.
            block_size=max(_BLOCK_BYTES, 1 + max(map(len, io.BytesIO(body)))),
        ),
        convert_options=arrow_csv.ConvertOptions(column_types=types, include_columns=list(types)),
    )


def _csv_line_numbers(body: bytes) -> Ints:
    """Return the line number of every row."""
    return np.fromiter(_csv_lines(body), dtype=np.int64)


def _csv_lines(body: bytes) -> Iterator[int]:
    """Yield the numbers of the lines that are rows; pyarrow leaves out empty ones alone."""
    return (number for number, line in enumerate(io.BytesIO(body), start=2) if line != b"\n")


def _raise_first_csv_fault(*, body: bytes, names: tuple[str, ...], path: str) -> None:
    for number, line in enumerate(lines_of(body), start=2):
        if not line:
            continue
        try:
            fields = next(csv.reader([line], strict=True))
        except csv.Error as error:
            hint = "; each row must be on one line" if "end of data" in str(error) else ""
            raise fault(path=path, line=number, message=f"{error}{hint}") from None
        if len(fields) != len(names):
            hint = "; semicolons do not separate columns" if ";" in line else ""
            message = (
                f"{len(fields)} column(s) where the header has {len(names)}; "
                f"a decimal comma would split a number{hint}"
            )
            raise fault(path=path, line=number, message=message)
        for name in _NUMBERS:
            field = fields[names.index(name)]
            try:
                float(field or "nan")
            except ValueError:
                hint = " (a decimal comma?)" if "," in field else ""
                unit = "seconds" if name == "t" else "metres"
                message = f"{name} {field[:40]!r} is not a number of {unit}{hint}"
                raise fault(path=path, line=number, message=message) from None


def _numbers(column: Any, *, name: str, path: str) -> Floats:  # noqa: ANN401 - see above
    """Return (M,) the numbers of an arrow column; NaN for null, which a check names later."""
    import pyarrow as pa  # noqa: PLC0415

    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        unit = "seconds" if name == "t" else "metres"
        kind = kind.value_type if pa.types.is_dictionary(kind) else kind
        raise DataError(f"{path}: column {name} holds {kind}, not numbers of {unit}")
    numbers: Floats = column.cast(pa.float64(), safe=False).to_numpy()
    return numbers


def _rows(
    *, t: Floats, xy: Floats, texts: dict[str, Any], names: Sequence[str], place: Place
) -> Rows:
    """Return the rows of (M,) t in s, (M, 2) xy in m, and the arrow columns `id` and `group`."""
    if not t.size:
        raise DataError(f"{place.path}: the file holds no rows")
    check_numbers(
        [t, xy[:, 0], xy[:, 1]],
        names=_NUMBERS,
        limits=[TIME_LIMIT_S, POSITION_LIMIT_M, POSITION_LIMIT_M],
        place=place,
    )
    person, ids = _index(texts["id"], clean=clean_id, place=place)
    return Rows(
        person=person,
        ids=ids,
        t=t - t.min(),
        xy=xy,
        place=place,
        groups=_groups(texts.get("group"), person=person, ids=ids, place=place),
        notes=_ignored(names=names, path=place.path, n_rows=t.size),
    )


def _ignored(*, names: Sequence[str], path: str, n_rows: int) -> tuple[Repair, ...]:
    others = [printable(name[:40]) for name in names if name not in _USED]
    if not others:
        return ()
    detail = f"{path}: column(s) {listed(others)}: not used, {n_rows} rows each"
    return (Repair("ignored-column", len(others), detail),)


def _index(
    column: Any,  # noqa: ANN401 - pyarrow has no types
    *,
    clean: Callable[[str], str],
    place: Place,
) -> tuple[Ints, tuple[str, ...]]:
    """Return (M,) index into the cleaned values, and these in order."""
    codes, values = _encode(column, place=place)
    cleaned = []
    for code, value in enumerate(values):
        try:
            cleaned.append(clean("" if value is None else str(value)))
        except ValueError as error:
            row = int(np.flatnonzero(codes == code)[0])
            raise DataError(f"{place.at(row)}: {error}") from None
    names = sort_ids(set(cleaned))
    position = {name: index for index, name in enumerate(names)}
    return np.array([position[name] for name in cleaned], dtype=np.int64)[codes], names


def _groups(
    column: Any,  # noqa: ANN401 - pyarrow has no types
    *,
    person: Ints,
    ids: tuple[str, ...],
    place: Place,
) -> tuple[tuple[str, str], ...]:
    """Return the (id, label) pairs of a group column; an empty cell is no group."""
    if column is None:
        return ()
    codes, labels = _index(column, clean=_clean_label, place=place)
    pairs = np.unique(np.column_stack([person, codes]), axis=0)
    return tuple((ids[who], labels[label]) for who, label in pairs if labels[label])


def _clean_label(text: str) -> str:
    label = checked_name(text)
    try:
        return clean_id(label)  # 3.0 is group 3, as a column with empty cells writes it
    except ValueError:
        return "" if label.lower() in {"nan", "none", "null"} else label


def _encode(column: Any, *, place: Place) -> tuple[Ints, list[Any]]:  # noqa: ANN401
    """Return (M,) codes and the value of each code, None for null."""
    import pyarrow as pa  # noqa: PLC0415

    try:
        is_encoded = pa.types.is_dictionary(column.type)
        kind = column.type.value_type if is_encoded else column.type
        known = (pa.types.is_integer, pa.types.is_floating, pa.types.is_string)
        if not any(check(kind) for check in (*known, pa.types.is_large_string)):
            raise DataError(f"{place.path}: ids and groups must be numbers or text, not {kind}")
        encoded = (column if is_encoded else column.dictionary_encode()).combine_chunks()
        values = [*encoded.dictionary.to_pylist(), None]
        null = pa.scalar(len(values) - 1, pa.int64())
        indices = encoded.indices.cast(pa.int64()).fill_null(null).to_numpy(zero_copy_only=False)
        used = np.flatnonzero(np.bincount(indices, minlength=len(values)))
        # Codes without gaps; np.unique would take six times the memory.
        position = np.zeros(len(values), dtype=np.int64)
        position[used] = np.arange(used.size)
        return position[indices], [values[index] for index in used]
    except (pa.ArrowException, UnicodeError) as error:
        raise DataError(f"{place.path}: ids cannot be read ({brief(error)})") from None
