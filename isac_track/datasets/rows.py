"""Rows of a recording as a reader found them, and the means to say where a row stands."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isac_track.types import Bools, Floats, Ints

POSITION_LIMIT_M = 1e9
"""No coordinate on Earth is larger; beyond it differences would overflow or lose the metre."""
TIME_LIMIT_S = 1e12
"""About 30,000 years: a larger clock is not in seconds."""
WHOLE_LIMIT = 2.0**53
"""Frames and ids are read as float64, which holds every whole number below this."""
FPS_LIMITS = (1e-3, 1e6)
"""Frames per second outside are a mistake, and would overflow the clock."""
LONGEST_ID = 200
"""Characters: ids stand in messages, tables and figures, and a split track repeats its own."""
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Repair:
    """Something that was mended, left out or let pass on reading, and how often."""

    kind: str
    """One of the kinds of ``docs/data.md``, such as `duplicate` or `gap`."""
    count: int
    """Rows, steps or tracks, as `detail` says."""
    detail: str
    """File, first line numbers, and what was done."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the rows of one file stand in it."""

    path: str
    lines: Callable[[], Ints]
    """Gives (M,) the line number of every row, from 1; called only if a row must be named."""
    unit: str = "line"

    def at(self, row: int) -> str:
        """Return ``FILE, line N`` of one row."""
        return f"{self.path}, {self.unit} {int(self.lines()[row])}"

    def first(self, rows: Ints) -> str:
        """Return ``FILE: lines N, N, ...`` of the first of `rows`, in the order of the file."""
        numbers = self.lines()[rows]
        numbers.sort()
        plural = "s" if numbers.size > 1 else ""
        return f"{self.path}: {self.unit}{plural} {listed(numbers)}"


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """M rows of a recording: numbers checked, nothing sorted or mended yet."""

    person: Ints
    """(M,) index into `ids`"""
    ids: tuple[str, ...]
    """Who was recorded, each id once, in the order of the tracks to be."""
    t: Floats
    """(M,) s, on the file's own clock"""
    xy: Floats
    """(M, 2) m"""
    place: Place
    groups: tuple[tuple[str, str], ...] = ()
    """(id, label of a walking group) pairs"""
    notes: tuple[Repair, ...] = ()
    """What the reader itself mended or left out."""


def framed(
    columns: Sequence[Floats], *, place: Place, names: Sequence[str] = ("frame", "id", "x", "y")
) -> Rows:
    """Return rows whose `t` still counts frames, from the first one.

    Parameters
    ----------
    columns : sequence of (M,) floats
        Frame, id, x in m and y in m.
    place : Place
        Where the rows stand.
    names : sequence of str
        What the format calls the columns.

    Raises
    ------
    DataError
        For the first number that cannot be one of a recording, with its line.
    """
    frame, person, x, y = columns
    limits = [WHOLE_LIMIT, WHOLE_LIMIT, POSITION_LIMIT_M, POSITION_LIMIT_M]
    check_numbers(columns, names=names, limits=limits, place=place, n_whole=2)
    ids = np.unique(person)
    return Rows(
        person=np.searchsorted(ids, person),  # np.unique's own takes six times the memory
        ids=tuple(str(int(value)) for value in ids),
        t=frame - frame.min(),  # a large frame number over fps would round
        xy=np.column_stack([x, y]),
        place=place,
    )


def noted(kind: str, rows: Ints, text: str, *, place: Place) -> list[Repair]:
    """Return the repair that concerns `rows`, or none if there are none."""
    return [Repair(kind, rows.size, f"{place.first(rows)}: {text}")] if rows.size else []


def steps_within(offsets: Ints) -> Bools:
    """Return (M - 1,) which steps lead from a sample to the next one of the same track."""
    within = np.ones(max(offsets[-1] - 1, 0), dtype=bool)
    within[offsets[1:-1] - 1] = False
    return within


def listed(names: Sequence[str] | Ints) -> str:
    """Join the first few of `names` and count the others."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(str(name) for name in names[:_SHOWN]) + more


def brief(error: Exception) -> str:
    """Return the first line of what a library says of a file, for a message of our own."""
    return printable((str(error).splitlines() or [type(error).__name__])[0][:160])


_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")


def printable(text: str) -> str:
    """Return `text` with a question mark for all that would steer a terminal or end a line."""
    return _CONTROL.sub("?", text)


def lines_of(data: bytes) -> Iterator[str]:
    r"""Yield the lines of what `check_text` accepts, ended by any of ``\n \r\n \r``.

    One by one, without mark and line end: as a list, or as a text with a single wide
    character, they would need many times the memory of the file. Not splitlines: that also
    breaks at form feeds and the like.
    """
    for line in io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig"):
        yield line.removesuffix("\n")


def check_text(*, data: bytes, path: str) -> None:
    """Check that a file is text.

    Raises
    ------
    DataError
        If the file is empty, compressed, binary, or not UTF-8.
    """
    if not data:
        raise DataError(f"{path}: the file is empty")
    for beginnings, message in (
        (b"\x1f\x8b", "the file is compressed (gzip); unpack it first"),
        (b"PAR1", "this is a parquet file; read it with --format parquet"),
        ((b"\xff\xfe", b"\xfe\xff"), "the file is UTF-16 text; save it as UTF-8"),
    ):
        if data.startswith(beginnings):
            raise DataError(f"{path}: {message}")
    if b"\0" in data:
        raise DataError(f"{path}: the file is binary, not text (zero byte at {data.index(0)})")
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # With a mark, `error.start` counts from behind it; the line number is the same.
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise DataError(
            f"{path}, line {line}: byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8"
        ) from None


def checked_fps(fps: float, *, where: str) -> float:
    """Return `fps` if it is a frame rate.

    Raises
    ------
    DataError
        If it is not a finite number within `FPS_LIMITS`; `where` opens the message.
    """
    low, high = FPS_LIMITS
    if not low <= fps <= high:  # NaN fails both
        raise DataError(f"{where}: {fps:g} frames per second is not a frame rate above 0")
    return fps


def check_numbers(
    columns: Sequence[Floats],
    *,
    names: Sequence[str],
    limits: Sequence[float],
    place: Place,
    n_whole: int = 0,
) -> None:
    """Check that all numbers are finite and below their limit, and the first `n_whole` whole.

    Raises
    ------
    DataError
        For the first offending row, with its line.
    """
    bad = np.zeros((columns[0].size, len(columns)), dtype=bool)
    for index, (column, limit) in enumerate(zip(columns, limits, strict=True)):
        bad[:, index] = ~(np.abs(column) < limit)  # True for NaN
        if index < n_whole:
            bad[:, index] |= column != np.floor(column)
    if not bad.any():
        return
    row, index = divmod(int(bad.argmax()), len(columns))
    value, name, limit = float(columns[index][row]), names[index], limits[index]
    if not np.isfinite(value):
        reason = f"{name} is {value:g}; leave such rows out (a gap is allowed)"
    elif abs(value) >= limit:
        reason = f"{name} is {value:g}: out of range (below {limit:g} is expected)"
    else:
        reason = f"{name} {value:g} is not a whole number"
    raise DataError(f"{place.at(row)}: {reason}")


def checked_name(text: str) -> str:
    """Return an id or a label without the space around it.

    Raises
    ------
    ValueError
        If it is too long, or would not stand on one line of a terminal.
    """
    name = text.strip()
    if len(name) > LONGEST_ID:
        raise ValueError(f"the name {name[:20]!r}... has {len(name)} characters, over {LONGEST_ID}")
    if _CONTROL.search(name):
        raise ValueError(f"the name {name!r} has a control character")
    return name


_DECIMAL = re.compile(r"[+-]?\d+\.\d*(e[+-]?\d+)?", re.IGNORECASE)


def clean_id(text: str) -> str:
    """Return the id that `text` stands for: ``1.0`` is ``1``, names stay as they are.

    Raises
    ------
    ValueError
        If it is empty, too long, not printable, or a number that is not whole; the message
        says so.
    """
    name = checked_name(text)
    if name.lower() in {"", "nan", "none", "null"}:
        raise ValueError("the id is missing")
    if _DECIMAL.fullmatch(name):
        number = float(name)
        if not abs(number) < WHOLE_LIMIT or number != int(number):
            raise ValueError(f"id {name} is not a whole number")
        return str(int(number))
    return name


def sort_ids(names: set[str]) -> tuple[str, ...]:
    """Return ids in ascending order: as numbers if all of them are, else as text."""
    if all(re.fullmatch(r"-?[0-9]{1,18}", name) for name in names):
        return tuple(sorted(names, key=lambda name: (int(name), name)))
    return tuple(sorted(names))
