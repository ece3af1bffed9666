"""Readers of tables with named columns (csv, parquet): t (s), id, x, y (m), group, person."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from isac_track.datasets import people, recording
from isac_track.datasets.recording import LENGTHS, TIMES, Column
from isac_track.errors import DataError, error_text
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


_NEEDED = ("t", "id", "x", "y")
_USED = recording.COLUMNS
_ISO = re.compile(
    r"\d{4}(?:-\d\d-\d\d[T"
    r" ]\d\d:\d\d(?::\d\d(?:[.,]\d+)?)?|\d{4}T\d{4}(?:\d\d(?:[.,]\d+)?)?)"
    r"\s*(Z|UTC|GMT|[+-]\d\d:?(?:\d\d)?)?",
    re.IGNORECASE,
)
_SIXTY = re.compile(r"(?<=\d\d:\d\d):60")
_ZONE_0 = re.compile(r"\s*(UTC|GMT)$", re.IGNORECASE)
_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Clocks since 1970: usual times from this number on are taken for this unit."""
_EPOCH_S = 1e9  # Seconds since 1970 in this millennium: 32 bits hold them to 64 s.
_Names: TypeAlias = Mapping[str, Column]
_UNITS = {"t": "seconds", "x": "metres", "y": "metres"}
_DECIMAL = re.compile(r"[+-]?\d+\.\d*(e[+-]?\d+)?", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?\d*\.?\d*(e[+-]?\d+)?", re.IGNORECASE)  # Or empty.
_LONGEST_NAME = 200  # Characters: ids stand in messages, tables and figures.
_BLOCK_BYTES = 1 << 18
# Rows that a file of any size may claim; more take at least a byte a row, since
# equal rows pack a thousandfold.
_FREE_ROWS = 500_000
_FREE_BYTES = 50_000_000
# Above that, a file unpacked may be this many times its size.
_MOST_TIMES = 100


def read_csv(
    *, data: bytes, path: str, columns: _Names | None = None
) -> recording.Rows:
    """Read comma-separated values with a header line; DataError names file and line.

    A second line may name the units of t, x and y. `columns` are the names of the
    columns.
    """
    import pyarrow as pa  # noqa: PLC0415 - a plain import of the package stays quick
    from pyarrow import csv as arrow_csv  # noqa: PLC0415 - only for such a file

    recording.check_text(data=data, path=path)
    names = _csv_header(header=next(recording.iterate_lines(data), ""), path=path)
    used = _match_columns(names, columns or {}, where=f"{path}, line 1")
    _, _, body = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").partition(b"\n")
    table_rows = _unit_line(used, body=body, n_fields=len(names))
    used, body, begins = table_rows.used, table_rows.body, table_rows.begins
    if not body.strip():
        raise DataError(f"{path}: the file holds no rows")
    # A dictionary holds each text once: a long text in every row would otherwise take
    # as much memory as the file.
    text = pa.dictionary(pa.int32(), pa.string())
    is_dated = _is_dated(body, place=used["t"].place)
    numbers = {*_UNITS} - ({"t"} if is_dated else set())
    types = {
        f"c{column.place}": pa.float64() if name in numbers else text
        for name, column in used.items()
    }
    n_rows = sum(1 for _ in _csv_lines(body, begins))
    try:
        table = arrow_csv.read_csv(
            pa.py_buffer(body),
            read_options=arrow_csv.ReadOptions(
                use_threads=False,
                column_names=[f"c{index}" for index in range(len(names))],
                # Several blocks are processed at a time; no line may be longer than a
                # block.
                block_size=max(_BLOCK_BYTES, 1 + max(map(len, io.BytesIO(body)))),
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=[*types]
            ),
        )
        # pyarrow lets quoted fields continue on the next line.
        if table.num_rows != n_rows:
            raise pa.ArrowInvalid(f"{table.num_rows} rows in {n_rows} lines")
    except (pa.ArrowException, MemoryError, UnicodeError) as error:
        for number, line in enumerate(recording.iterate_lines(body), start=begins):
            if message := _csv_fault(line, len(names), used, numbers) if line else "":
                raise DataError(f"{path}, line {number}: {message}") from None
        raise DataError(
            f"{path}: cannot be read as csv ({error_text(error)})"
        ) from None
    place = recording.Place(
        path, lambda: np.fromiter(_csv_lines(body, begins), dtype=np.int64)
    )
    return _build_rows(
        table.rename_columns([*used]), names=names, used=used, place=place
    )


def read_parquet(
    *, data: bytes, path: str, columns: _Names | None = None
) -> recording.Rows:
    """Read a parquet file with these names of columns; DataError names file and row."""
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
        raise DataError(f"{path}: not a parquet file ({error_text(error)})") from None
    names = tuple(schema.names)
    places = _match_columns(names, columns or {}, where=path)
    if n_rows > max(_FREE_ROWS, len(data)):
        raise DataError(
            f"{path}: claims {n_rows} rows in {len(data)} bytes; not a recording"
        )
    if size > max(_FREE_BYTES, _MOST_TIMES * len(data)):
        raise DataError(
            f"{path}: {size} bytes when unpacked, over {_MOST_TIMES} times its size"
        )
    try:
        used = [column.name for column in places.values()]
        # A dictionary holds each text once: a long text in every row would otherwise
        # not fit into memory.
        kinds = {pa.string(), pa.large_string()}
        texts = [name for name in used if schema.field(name).type in kinds]
        file = parquet.ParquetFile(pa.BufferReader(data), read_dictionary=texts)
        table = file.read(columns=used, use_threads=False)
        # pyarrow reads codes beyond the dictionary as they are.
        table.validate(full=True)
        for name in used:  # pyarrow skips columns that some parts name differently
            if name not in table.column_names:
                raise ValueError(f"column {name} is not in it")  # noqa: TRY301 - see below
    except Exception as error:  # noqa: BLE001 - as above
        why = (
            "damaged, or too large for the memory"
            if isinstance(error, MemoryError)
            else "damaged"
        )
        raise DataError(
            f"{path}: the parquet file is {why} ({error_text(error)})"
        ) from None
    place = recording.Place(path, lambda: np.arange(1, n_rows + 1), unit="row")
    table = table.select(used).rename_columns([*places])
    return _build_rows(table, names=names, used=places, place=place)


def read_frame(frame: pd.DataFrame, *, columns: _Names | None = None) -> recording.Rows:
    """Read a pandas DataFrame as if it were a file; DataError names the row."""
    import pyarrow as pa  # noqa: PLC0415 - only for such data

    path = "DataFrame"
    index = [
        name
        for name in frame.index.names
        if name is not None and name not in frame.columns
    ]
    if index:
        frame = frame.reset_index(level=index)
    names = tuple(map(str, frame.columns))
    places = _match_columns(names, columns or {}, where=path)
    columns_read = [
        _arrow_column(frame, column, path=path) for column in places.values()
    ]
    table = pa.table(columns_read, names=[*places])
    place = recording.Place(path, lambda: np.arange(1, len(frame) + 1), unit="row")
    return _build_rows(table, names=names, used=places, place=place)


def _arrow_column(
    frame: pd.DataFrame, column: _UsedColumn, *, path: str
) -> pa.ChunkedArray:
    """Return a column of a frame as an arrow array; DataError if that is impossible."""
    import pandas as pd  # noqa: PLC0415 - only for such data
    import pyarrow as pa  # noqa: PLC0415 - only for such data

    part = frame.iloc[:, [column.place]]
    kind = part.dtypes.iloc[0]
    if isinstance(kind, pd.SparseDtype):
        part = part.astype(kind.subtype)
    try:
        return pa.Table.from_pandas(part, preserve_index=False).column(0)
    except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
        name = recording.printable(column.name[:40])
        way_out = "convert it first, all to numbers or all to text"
        raise DataError(
            f"{path}: column {name} cannot be read ({error_text(error)}); {way_out}"
        ) from None


def _csv_header(*, header: str, path: str) -> tuple[str, ...]:
    """Return the names of the columns; DataError if the line is no header of csv."""
    where = f"{path}, line 1"
    try:
        names = tuple(name.strip() for name in next(csv.reader([header]), []))
    except csv.Error as error:
        raise DataError(f"{where}: the header cannot be read: {error}") from None
    for strange, is_so in {
        "a comment": header.lstrip().startswith("#"),
        "empty": not header.strip(),
        "a line for Excel": header.lower().startswith("sep="),
        "numbers": all(_NUMBER.fullmatch(name) for name in names),
    }.items():
        if is_so:
            raise DataError(
                f"{where}: {strange}; the first line of csv names the columns, id,t,x,y"
            )
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces")):
        if len(names) == 1 and separator in header.strip():
            raise DataError(
                f"{where}: {name} between the columns; csv has commas (and decimal"
                " points); in Python: pandas.read_csv('FILE',"
                f" sep={separator!r}).to_csv('walks.csv', index=False), with"
                " decimal=',' if numbers have commas"
            )
    return names


@dataclass(frozen=True, slots=True)
class _UsedColumn(Column):
    """A column that is read, and its place in the file."""

    place: int = 0


def _match_columns(
    names: Sequence[str], columns: _Names, *, where: str
) -> dict[str, _UsedColumn]:
    """Return the columns to read; DataError if a column is missing or there twice.

    No column is read twice. `_match_column` describes which names match.
    """
    used, missing = dict[str, _UsedColumn](), []
    for name in _USED:
        wanted = columns.get(name, Column(name))
        match = _match_column(names, wanted, quantity=name, where=where)
        if match is not None:
            used[name] = match
        elif name in columns or name in _NEEDED:
            for header in names:
                recording.check_unit(
                    header, quantity=name, name=wanted.name, where=where
                )
            missing.append(wanted.name)
    if missing:
        labels = recording.listed(
            [recording.printable(called[:40]) for called in names]
        )
        frames = next(
            (header for header in names if header.casefold().startswith("frame")), ""
        )
        hint = f"; --columns 't={frames[:40]}[25 fps]' counts frames" if frames else ""
        raise DataError(
            f"{where}: no column {', '.join(missing)} (needed: t in s, id, x and y in"
            f" m); it has {labels}: --columns t=NAME,id=NAME,x=NAME,y=NAME says which"
            f" is which{hint}"
        )
    places = [column.place for column in used.values()]
    for name, column in used.items():
        if places.count(column.place) > 1:
            raise DataError(
                f"{where}: --columns takes {column.name} for {name} and for another"
            )
    return used


def _match_column(
    names: Sequence[str], wanted: Column, *, quantity: str, where: str
) -> _UsedColumn | None:
    """Return the column with the wanted name, exactly or nearly; None without any.

    Nearly: with other capitals, or with a unit in brackets behind the name. DataError
    for several such columns.
    """
    headers = [recording.parse_header(name, quantity=quantity) for name in names]
    small = wanted.name.casefold()
    for matches in (
        [name == wanted.name for name in names],
        [name.casefold() == small for name in names],
        [header.name.casefold() == small for header in headers],
    ):
        places = [place for place, is_match in enumerate(matches) if is_match]
        if len(places) > 1:
            raise DataError(f"{where}: two columns are called {wanted.name}")
        if places:
            break
    else:
        return None
    (place,) = places
    unit = headers[place].unit
    if unit and wanted.unit and unit != wanted.unit:
        raise DataError(
            f"{where}: --columns {quantity}: unit {wanted.unit} contradicts"
            f" {names[place]}"
        )
    return _UsedColumn(names[place], wanted.unit or unit, place)


@dataclass(frozen=True, slots=True)
class _TableRows:
    """The rows of a csv, behind its names and units."""

    used: dict[str, _UsedColumn]
    body: bytes
    begins: int  # Line of the file, counted from 1.


def _unit_line(
    used: dict[str, _UsedColumn], *, body: bytes, n_fields: int
) -> _TableRows:
    """Give the columns the units of a second line, if it names any."""
    first, _, rest = body.partition(b"\n")
    fields = [field.strip(" []()").lower() for field in _fields(first[:1000])]
    if len(fields) != n_fields:
        return _TableRows(used, body, 2)
    units = {name: fields[used[name].place] for name in _UNITS}
    if not all(recording.is_unit(unit, quantity=name) for name, unit in units.items()):
        return _TableRows(used, body, 2)
    named = {
        name: (
            replace(column, unit=column.unit or units[name])
            if name in units
            else column
        )
        for name, column in used.items()
    }
    return _TableRows(named, rest, 3)


def _is_dated(body: bytes, *, place: int) -> bool:
    """Whether the times of a csv are dates, judged by its first row."""
    first = next((line for line in io.BytesIO(body) if line.strip()), b"")
    fields = _fields(first[:4000])
    return len(fields) > place and bool(_ISO.fullmatch(fields[place].strip()))


def _fields(line: bytes) -> list[str]:
    """Return the fields of a line of csv; none if it cannot be parsed."""
    try:
        return next(csv.reader([line.decode("utf-8", "replace").strip()]), [])
    except csv.Error:
        return []


def _csv_lines(body: bytes, begins: int) -> Iterator[int]:
    """Yield the numbers of the lines that are rows; pyarrow skips only empty lines."""
    return (
        number
        for number, line in enumerate(io.BytesIO(body), start=begins)
        if line != b"\n"
    )


def _csv_fault(
    line: str, n_fields: int, used: Mapping[str, _UsedColumn], numbers: Collection[str]
) -> str:
    """Return what is wrong with a line of csv; empty if nothing is."""
    try:
        fields = next(csv.reader([line], strict=True))
    except csv.Error as error:
        is_open = "end of data" in str(error)
        return f"{error}; each row must be on one line" if is_open else str(error)
    if len(fields) != n_fields:
        hints = {
            "; csv has no comments: leave the line out": line.lstrip().startswith("#"),
            "; a decimal comma would split a number": len(fields) > n_fields,
            "; semicolons do not separate columns": ";" in line,
        }
        hint = next((text for text, is_so in hints.items() if is_so), "")
        return f"{len(fields)} column(s) where the header has {n_fields}{hint}"
    for name, unit in _UNITS.items():
        if name not in numbers:
            continue
        field = fields[used[name].place]
        try:
            # Arrow reads no underscores and no digits beyond ASCII.
            float(field.replace("_", "?").encode("ascii", "replace") or "nan")
        except ValueError:
            hint = " (a decimal comma?)" if "," in field else ""
            if name == "t" and re.search(r"\d[:/.]\d+[:/.]\d", field):
                hint = ", nor a date of ISO 8601 such as 2026-03-29T12:00:00.5+01:00"
            return f"{name} {field[:40]!r} is not a number of {unit}{hint}"
    return ""


def _build_rows(
    table: pa.Table,
    *,
    names: Sequence[str],
    used: Mapping[str, _UsedColumn],
    place: recording.Place,
) -> recording.Rows:
    """Build the rows from arrow columns, named as ours; `names` are the file's."""
    if not table.num_rows:
        raise DataError(f"{place.path}: the file holds no rows")
    t = _times(table["t"], used["t"], place=place)
    x, y = (_numbers(table[name], name=name, path=place.path) for name in ("x", "y"))
    recording.check_numbers({"t": t, "x": x, "y": y}, place)
    xy = np.column_stack([x, y])
    units = {name: used[name].unit for name in ("x", "y")}
    unit, notes = _common_unit(units, xy, place=place)
    person, ids = _index_values(table["id"], is_group=False, place=place)
    groups: tuple[tuple[str, str], ...] = ()
    if "group" in used:  # An empty cell is no group.
        group, labels = _index_values(table["group"], is_group=True, place=place)
        pairs = np.unique(np.column_stack([person, group]), axis=0)
        groups = tuple(
            (ids[member], labels[label]) for member, label in pairs if labels[label]
        )
    passages: dict[str, recording.Label] | None = None
    if "person" in used:  # An empty cell is no label.
        value, person_names = _index_values(table["person"], is_group=True, place=place)
        passages = people.label_rows(
            value, person_names, owner=person, ids=ids, place=place
        )
    read = {column.name for column in used.values()}
    if others := [recording.printable(name[:40]) for name in names if name not in read]:
        unused = f"column(s) {recording.listed(others)}: not used, {t.size} rows each"
        note = recording.Repair(
            "ignored-column", len(others), f"{place.path}: {unused}"
        )
        notes = (note, *notes)
    unit_source = "the header or --columns"
    return recording.Rows(
        person,
        ids,
        t - t.min(),
        xy,
        place,
        groups,
        notes,
        unit,
        unit_by=unit_source,
        people=passages,
    )


def _common_unit(
    units: Mapping[str, str], xy: Floats, *, place: recording.Place
) -> tuple[str, tuple[recording.Repair, ...]]:
    """Return the unit of x and y, empty if neither has a unit; two units become m.

    `xy`, (M, 2), is then converted in place, with a note. A common unit is left for the
    caller to convert.
    here.
    """
    scales = [LENGTHS[unit or "m"] for unit in units.values()]
    if scales[0] == scales[1]:
        return units["x"] or units["y"], ()
    xy *= scales
    lengths = " and ".join(f"{name} in {unit or 'm'}" for name, unit in units.items())
    detail = f"{place.path}: {lengths}; converted to m"
    return "m", (recording.Repair("unit", len(xy), detail),)


def _times(
    column: pa.ChunkedArray, used: _UsedColumn, *, place: recording.Place
) -> Floats:
    """Return times in s, (M,), from some origin.

    The column holds numbers, time stamps, durations or ISO 8601 dates.
    """
    import pyarrow as pa  # noqa: PLC0415 - only for such a file

    kind, path = column.type, place.path
    value = kind.value_type if pa.types.is_dictionary(kind) else kind
    if pa.types.is_timestamp(value) or pa.types.is_duration(value):
        ticks = column.cast(pa.int64()).to_numpy().astype(np.float64)
        exact = column.drop_null().cast(pa.int64()).to_numpy()
        # The difference is taken first: a double holds times since 1970 only to 0.2 us.
        if exact.size == ticks.size:
            ticks = (exact - exact.min()).astype(np.float64)
        seconds: Floats = ticks * TIMES[value.unit]
        return seconds
    if value in {pa.string(), pa.large_string()} and len(column):
        return _dates(column, place=place)
    t = _numbers(column, name="t", path=path)
    usual = float(np.median(t)) if np.isfinite(t).all() else 0.0
    with np.errstate(over="ignore"):
        is_single = t.size > 1 and bool((t == t.astype(np.float32)).all())
    if usual > _EPOCH_S and is_single:
        raise DataError(
            f"{path}: times like {usual:.6g} are 32-bit numbers (float32), too coarse"
            " for a clock since 1970; save them as 64-bit numbers, or from the first"
            " sample on"
        )
    if used.unit:
        origin = t.min() if np.isfinite(t).all() else 0.0
        return np.asarray((t - origin) * recording.seconds_per(used.unit))
    for least, unit in _EPOCHS:
        if usual >= least:
            raise DataError(
                f"{path}: times like {usual:.6g} are no seconds: {unit} since 1970? "
                f"--columns t={used.name}[{unit}] reads them so"
            )
    return t


def _dates(column: pa.ChunkedArray, *, place: recording.Place) -> Floats:
    """Return ISO 8601 dates as times in s, (M,); all must have a zone or none."""
    import pandas as pd  # noqa: PLC0415 - only for such a file

    try:
        codes, texts = pd.factorize(
            column.to_pandas(integer_object_nulls=True), use_na_sentinel=False
        )
    except (ValueError, UnicodeError) as error:
        raise DataError(
            f"{place.path}: column t cannot be read ({error_text(error)})"
        ) from None
    zones = set[bool]()
    for code, text in enumerate(texts):
        match = _ISO.fullmatch(text.strip()) if isinstance(text, str) else None
        if match is None:
            if not code:  # The first row is no date: the column is something else.
                raise DataError(
                    f"{place.path}: column t holds string, not numbers of seconds;"
                    " convert it first"
                )
            where = place.at(int((codes == code).argmax()))
            raise DataError(
                f"{where}: t {str(text)[:40]!r} is no date of ISO 8601 like the others"
            )
        zones.add(match[1] is not None)
    if len(zones) > 1:
        raise DataError(f"{place.path}: some times have a zone and others have none")
    # A second of 60 is a leap second, or a rounded time.
    leaps = np.array([bool(_SIXTY.search(text)) for text in texts])
    texts = [_SIXTY.sub(":59", text) for text in texts]
    written = [_ZONE_0.sub("Z", text.strip().replace(",", ".")) for text in texts]
    try:
        dates = pd.to_datetime(written, format="ISO8601", utc=True, errors="coerce")
        ticks = dates.as_unit("ns").asi8
    except (ValueError, OverflowError) as error:
        raise DataError(
            f"{place.path}: column t cannot be read ({error_text(error)})"
        ) from None
    if dates.isna().any():
        code = int(dates.isna().argmax())
        where = place.at(int((codes == code).argmax()))
        raise DataError(
            f"{where}: t {written[code][:40]!r} is no date and time that there is"
        )
    seconds: Floats = (ticks - ticks.min()) * 1e-9 + leaps
    return np.asarray(seconds[codes])


def _numbers(column: pa.ChunkedArray, *, name: str, path: str) -> Floats:
    """Return the numbers of an arrow column, (M,); NaN for null: a check finds it."""
    import pyarrow as pa  # noqa: PLC0415 - only for such a file

    if pa.types.is_dictionary(column.type):  # Categories of pandas.
        column = column.cast(column.type.value_type)
    kind = column.type
    is_number = (
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_decimal(kind)
    )
    if not is_number:
        raise DataError(
            f"{path}: column {name} holds {kind}, not numbers of {_UNITS[name]};"
            " convert it first"
        )
    numbers: Floats = column.cast(pa.float64(), safe=False).to_numpy()
    return numbers


def _index_values(
    column: pa.ChunkedArray, *, is_group: bool, place: recording.Place
) -> tuple[Ints, tuple[str, ...]]:
    """Return indices, (M,), into the cleaned values of an arrow column, and these."""
    import pandas as pd  # noqa: PLC0415 - only for such a file
    import pyarrow as pa  # noqa: PLC0415 - only for such a file

    kind = (
        column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    )
    is_text = kind in {pa.string(), pa.large_string()}
    if not (is_text or pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise DataError(
            f"{place.path}: ids and groups must be numbers or text, not {kind}"
        )
    try:
        values = column.to_pandas(integer_object_nulls=True)
    except (pa.ArrowException, UnicodeError) as error:
        raise DataError(
            f"{place.path}: ids cannot be read ({error_text(error)})"
        ) from None
    codes, distinct = pd.factorize(values, use_na_sentinel=False)
    cleaned = []
    for code, value in enumerate(distinct):
        try:
            # Null is "None" or "nan", which is no valid name.
            cleaned.append(_clean_name(str(value).strip(), is_group=is_group))
        except ValueError as error:
            raise DataError(
                f"{place.at(int((codes == code).argmax()))}: {error}"
            ) from None
    # Sorted as numbers if all values are numbers, else as text.
    are_numbers = all(re.fullmatch(r"-?[0-9]{1,18}", name) for name in cleaned)
    names = sorted(
        set(cleaned), key=lambda name: (int(name) if are_numbers else 0, name)
    )
    position = {name: index for index, name in enumerate(names)}
    positions = np.array([position[name] for name in cleaned], dtype=np.int64)
    return positions[codes], tuple(names)


def _clean_name(name: str, *, is_group: bool) -> str:
    """Return the id or group of a cell, ``1`` for ``1.0``; ValueError for none."""
    if len(name) > _LONGEST_NAME:
        start = f"{name[:20]!r}... has {len(name)} characters"
        raise ValueError(f"the name {start}, over {_LONGEST_NAME}")
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
