"""Rows of a recording as a reader found them, and the means to say where a row stands."""

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isac_track.errors import DataError
from isac_track.types import Bools, Floats, Ints

WHOLE_LIMIT = 2.0**53  # Frames and ids are float64, which holds every whole number below this.
_LIMITS = {
    **dict.fromkeys(("frame", "f", "id", "p"), WHOLE_LIMIT),
    # About 30,000 years: a larger clock is not in seconds.
    "t": 1e12,
    # No coordinate on Earth is larger; beyond it differences would overflow or lose the metre.
    "x": 1e9,
    "y": 1e9,
}
METRES: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # By unit of length.
FPS_LIMITS = (1e-3, 1e6)  # Frames per second outside are a mistake, and would overflow the clock.
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Repair:
    """Something that was mended, left out or let pass on reading, and how often."""

    kind: str  # One of the kinds of ``docs/data.md``, such as `duplicate` or `gap`.
    count: int  # Rows, steps or tracks, as `detail` says.
    detail: str  # File, first line numbers, and what was done.


@dataclass(frozen=True, slots=True)
class Place:
    """Where the rows of one file stand in it."""

    path: str
    lines: Callable[[], Ints]  # (M,) line of every row, from 1; called only if a row is named.
    unit: str = "line"

    def at(self, row: int) -> str:
        """Return ``FILE, line N`` of one row."""
        return f"{self.path}, {self.unit} {int(self.lines()[row])}"

    def noted(self, kind: str, rows: Ints, text: str) -> list[Repair]:
        """Return the repair that concerns `rows`, with the first of them; none if they are none."""
        if not rows.size:
            return []
        numbers = np.sort(self.lines()[rows])
        where = f"{self.path}: {self.unit}{'s' if numbers.size > 1 else ''} {listed(numbers)}"
        return [Repair(kind, rows.size, f"{where}: {text}")]


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """M rows of a recording: numbers checked, nothing sorted or mended yet."""

    person: Ints  # (M,) index into `ids`
    ids: tuple[str, ...]  # Who was recorded, each id once, in the order of the tracks to be.
    t: Floats  # (M,) s, on the file's own clock
    xy: Floats  # (M, 2) in the file's unit of length
    place: Place
    groups: tuple[tuple[str, str], ...] = ()  # (id, label of a walking group) pairs
    notes: tuple[Repair, ...] = ()  # What the reader itself mended or left out.
    unit: str = ""  # Of `METRES`, that the file says its lengths are in; empty if it says nothing.
    split_s: float | None = None  # The longest step within a track, if the format says so.


def in_metres(rows: Rows, *, unit: str | None) -> Rows:
    """Return rows in m, a conversion noted; DataError if `unit` contradicts what the file says."""
    told, path = unit or rows.unit or "m", rows.place.path
    if told not in METRES:
        hint = f"must be one of {', '.join(METRES)}, got {told[:40]!r}"
        raise DataError(f"{path}: --unit {hint}")
    if rows.unit and told != rows.unit:
        raise DataError(f"{path}: --unit {told} contradicts the file's header: {rows.unit}")
    if told == "m":
        return rows
    by = "the header" if rows.unit else "--unit"
    detail = f"{path}: positions in {told}, as {by} says; converted to m"
    notes = (*rows.notes, Repair("unit", rows.t.size, detail))
    return replace(rows, xy=rows.xy * METRES[told], unit="m", notes=notes)


def framed(columns: Mapping[str, Floats], place: Place) -> Rows:
    """Return rows, `t` in frames from the first, of the format's frame, id, x and y, (M,) each."""
    check_numbers(columns, place)
    frame, person, x, y = columns.values()
    ids = np.unique(person)
    return Rows(
        person=np.searchsorted(ids, person),  # np.unique's own takes six times the memory
        ids=tuple(str(int(value)) for value in ids),
        t=frame - frame.min(),  # a large frame number over fps would round
        xy=np.column_stack([x, y]),
        place=place,
    )


def check_numbers(columns: Mapping[str, Floats], place: Place) -> None:
    """Raise DataError for the first row with a number not finite, too large, or not whole."""
    offending = []
    for index, (name, column) in enumerate(columns.items()):
        bad = ~(np.abs(column) < _LIMITS[name])  # True for NaN
        if _LIMITS[name] == WHOLE_LIMIT:
            bad |= column != np.floor(column)
        if bad.any():
            offending.append((int(bad.argmax()), index, name))
    if not offending:
        return
    row, _, name = min(offending)
    value, limit = float(columns[name][row]), _LIMITS[name]
    reason = f"{name} {value:g} is not a whole number"
    if not np.isfinite(value):
        reason = f"{name} is {value:g}; leave such rows out (a gap is allowed)"
    elif abs(value) >= limit:
        reason = f"{name} is {value:g}: out of range (below {limit:g} is expected)"
    raise DataError(f"{place.at(row)}: {reason}")


def steps_within(offsets: Ints) -> Bools:
    """Return (M - 1,) which steps lead from a sample to the next one of the same track."""
    within = np.ones(max(offsets[-1] - 1, 0), dtype=bool)
    within[offsets[1:-1] - 1] = False
    return within


def listed(names: Sequence[str] | Ints) -> str:
    """Join the first few of `names` and count the others."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(str(name) for name in names[:_SHOWN]) + more


def printable(text: str) -> str:
    """Return `text` with a question mark for all that would steer a terminal or end a line."""
    return re.sub("[\x00-\x1f\x7f-\x9f\u2028\u2029]", "?", text)


def lines_of(data: bytes) -> Iterator[str]:
    r"""Yield the lines of what `check_text` accepts, ended by any of ``\n \r\n \r``.

    One by one, without mark and line end: a list, or a text with a single wide character, needs
    many times the memory of the file. Not splitlines: that also breaks at form feeds and the like.
    """
    for line in io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig"):
        yield line.removesuffix("\n")


def check_text(*, data: bytes, path: str) -> None:
    """Raise DataError if a file is empty, compressed, binary, or not UTF-8."""
    for is_so, message in (
        (not data, "the file is empty"),
        (data.startswith(b"\x1f\x8b"), "the file is compressed (gzip); unpack it first"),
        (data.startswith(b"PAR1"), "this is a parquet file; read it with --format parquet"),
        (data.startswith((b"\xff\xfe", b"\xfe\xff")), "the file is UTF-16 text; save it as UTF-8"),
        (b"\0" in data, f"the file is binary, not text (zero byte at {data.find(0)})"),
    ):
        if is_so:
            raise DataError(f"{path}: {message}")
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # With a mark, `error.start` counts from behind it; the line number is the same.
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise DataError(
            f"{path}, line {line}: byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8"
        ) from None


def checked_fps(fps: float | str, *, where: str) -> float:
    """Return `fps` if it lies within `FPS_LIMITS`, else raise DataError; `where` opens it."""
    try:
        rate = float(fps)
    except ValueError:
        raise DataError(f"{where}: the framerate {str(fps)[:40]!r} is not a number") from None
    if not FPS_LIMITS[0] <= rate <= FPS_LIMITS[1]:  # NaN fails both
        raise DataError(f"{where}: {rate:g} frames per second is not a frame rate above 0")
    return rate
