"""Rows of a recording as read from a file, and the lines or rows where they stand."""

import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from isac_track.errors import DataError
from isac_track.types import Bools, Floats, Ints, lengths

COLUMNS = ("t", "id", "x", "y", "group", "person")  # Columns of a table.
# Frames and ids are float64, which holds every whole number below this.
WHOLE_LIMIT = 2.0**53
_LIMITS = {
    **dict.fromkeys(("frame", "f", "id", "p"), WHOLE_LIMIT),
    # About 30,000 years: a larger clock is not in seconds.
    "t": 1e12,
    # No coordinate on Earth is larger; larger differences could overflow.
    "x": 1e9,
    "y": 1e9,
}
METRES: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # By unit of length.
FOOT_M = 0.3048
LENGTHS: Mapping[str, float] = {
    **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), 1.0),
    **dict.fromkeys(
        ("cm", "centimeter", "centimetre", "centimeters", "centimetres"), 0.01
    ),
    **dict.fromkeys(
        ("mm", "millimeter", "millimetre", "millimeters", "millimetres"), 0.001
    ),
    **dict.fromkeys(("ft", "foot", "feet"), FOOT_M),
    **dict.fromkeys(("yd", "yard", "yards"), 0.9144),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    "km": 1000.0,
}
"""Metres per unit of length, by the names of the unit in a column's header."""
TIMES: Mapping[str, float] = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hour", "hours"), 3600.0),
}
"""Seconds per unit of time, by the names of the unit in a column's header."""
# A frame at a rate such as ``25 fps`` is a unit of time.
_FRAMES = re.compile(r"(\d+\.?\d*)\s*fps")
_UNITS: Mapping[str, Mapping[str, float]] = {"t": TIMES, "x": LENGTHS, "y": LENGTHS}
CRS = ("degrees",)
ON_DUPLICATE = ("error", "first", "mean")
_EARTH_M = 6_378_137.0  # Semi-major axis of WGS 84.
_FLATNESS = 0.00669437999014  # Its first eccentricity, squared.
_SEVERAL = 5  # Least number of people whose walks show which axis is which.
# Walks must be this much steadier to speak for another order of the axes.
_STEADIER = 0.8
# Frames per second outside are a mistake, and would overflow the clock.
FPS_LIMITS = (1e-3, 1e6)
_SHOWN = 5  # Names that a list shows before it counts the others.
_EXCEL = (
    'an Excel workbook or a zip archive; convert it first: python -c "import pandas; '
    "pandas.read_excel('FILE.xlsx').to_csv('FILE.csv', index=False)\""
)


@dataclass(frozen=True, slots=True)
class Repair:
    """A repair on reading: what was mended, left out or let pass, and how often."""

    # One of the kinds of ``docs/how-to/data.md``, such as `duplicate` or `gap`.
    kind: str
    count: int  # Rows, steps or tracks, as `detail` says.
    detail: str  # File, first line numbers, and what was done.


@dataclass(frozen=True, slots=True)
class Place:
    """The places of rows in a file: line or row numbers."""

    path: str
    # Return the line of every row, (M,), from 1; called only if a row is named.
    lines: Callable[[], Ints]
    unit: str = "line"

    def at(self, row: int) -> str:
        """Return ``FILE, line N`` of one row."""
        return f"{self.path}, {self.unit} {int(self.lines()[row])}"

    def note_rows(self, kind: str, rows: Ints, text: str) -> list[Repair]:
        """Return a repair of `rows` that names the first of them; none for no rows."""
        if not rows.size:
            return []
        numbers = np.sort(self.lines()[rows])
        where = (
            f"{self.path}: {self.unit}{'s' if numbers.size > 1 else ''}"
            f" {listed(numbers)}"
        )
        return [Repair(kind, rows.size, f"{where}: {text}")]


@dataclass(frozen=True, slots=True)
class Label:
    """The person whom a file names for a passage, and where it does."""

    person: str
    line: int  # Line or row of the file, from 1.


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """M rows of a recording: numbers are checked, nothing is sorted or mended yet."""

    person: Ints  # (M,) index into `ids`
    # The people who were recorded, each id once, in the order of the tracks to be.
    ids: tuple[str, ...]
    t: Floats  # (M,) s, on the file's own clock
    xy: Floats  # (M, 2) in the file's unit of length
    place: Place
    groups: tuple[tuple[str, str], ...] = ()  # (id, label of a walking group) pairs
    notes: tuple[Repair, ...] = ()  # What the reader itself mended or left out.
    # A unit of `LENGTHS`, if the file names it; else empty.
    unit: str = ""
    unit_by: str = "the header"  # The source of the unit, for messages.
    # The longest step within a track, if the format says so.
    split_s: float | None = None
    people: Mapping[str, Label] | None = None
    """The person of each id that has a label; None if the file names nobody."""


@dataclass(frozen=True, slots=True)
class Column:
    """The name of a column of a table, and its unit; an empty unit is the usual."""

    name: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Reading:
    """Options of a user for their own file, besides format, frame rate and unit."""

    # By t, id, x, y, group and person.
    columns: Mapping[str, Column] = field(default_factory=dict)
    on_duplicate: str = "error"  # One of `ON_DUPLICATE`.
    crs: str | None = None  # One of `CRS`; None is a plane.
    drop_frozen_s: float | None = None  # Drop longer stretches at one place.

    def __post_init__(self) -> None:
        """Raise DataError for options that are out of range."""
        seconds = self.drop_frozen_s
        if seconds is not None and not isinstance(seconds, int | float):
            raise DataError(f"--drop-frozen takes seconds above 0, got {seconds!r:.40}")
        if self.on_duplicate not in ON_DUPLICATE:
            known = ", ".join(ON_DUPLICATE)
            raise DataError(
                f"--on-duplicate must be one of {known}, got {self.on_duplicate!r:.40}"
            )
        if self.crs not in (None, *CRS):
            raise DataError(f"--crs must be {', '.join(CRS)}, got {self.crs!r:.40}")
        if seconds is not None and not 0 < seconds < math.inf:
            raise DataError(f"--drop-frozen takes seconds above 0, got {seconds:g}")


def parse_columns(text: str | Mapping[str, str] | None) -> dict[str, Column]:
    """Parse column names such as ``t=time[ms],x=pos_x``, else raise DataError."""
    if not text:
        return {}
    if not isinstance(text, str | Mapping):
        raise DataError(
            f"--columns takes t=NAME,id=NAME,x=NAME,y=NAME, got {text!r:.40}"
        )
    pairs = text.items() if isinstance(text, Mapping) else _pairs(text)
    columns = {}
    for name, raw_name in pairs:
        if name not in COLUMNS:
            raise DataError(
                f"--columns names {', '.join(COLUMNS)}, got {str(name)[:40]!r}"
            )
        if name in columns:
            raise DataError(f"--columns names {name} twice")
        called = str(raw_name).strip()
        bare, unit = _split_unit(called)
        if not unit or name not in _UNITS:
            columns[name] = Column(called)
            continue
        if not is_unit(unit, quantity=name):
            known = _known_units(name)
            raise DataError(
                f"--columns {name}: unknown unit {unit[:40]!r} (known: {known})"
            )
        columns[name] = Column(bare, unit)
    return columns


def parse_header(header: str, *, quantity: str) -> Column:
    """Return name and unit of a header such as ``x [cm]``, ``t(s)`` or ``y/m``.

    `quantity` is t, id, x, y, group or person: only t has units of time, only x and y have
    units of length. Text in brackets behind another name is no unit. Without a
    known unit the column has the name of the header.
    """
    bare, unit = _split_unit(header.strip())
    if quantity not in _UNITS:
        return Column(bare)
    if not unit:
        bare, _, unit = header.strip().partition("/")
        bare, unit = bare.strip(), unit.strip().lower()
    return Column(bare, unit) if is_unit(unit, quantity=quantity) else Column(header)


def check_unit(header: str, *, quantity: str, name: str, where: str) -> None:
    """Raise DataError if a header is the column `name` with an unknown unit."""
    bare, unit = _split_unit(header.strip())
    if quantity not in _UNITS or not unit or bare.casefold() != name.casefold():
        return
    way_out, hint = "convert it first", ""
    if quantity != "t":
        way_out = "give its metres by --unit"
        if unit[:3] in {"deg", "\u00b0"}:
            hint = " (degrees: --crs degrees)"
    raise DataError(
        f"{where}: column {printable(header[:40])}: unknown unit {unit[:40]!r}"
        f" (known: {_known_units(quantity)}); take it out of the header, and"
        f" {way_out}{hint}"
    )


def is_unit(text: str, *, quantity: str) -> bool:
    """Whether this is a unit of t, of x or of y, by its name in small letters."""
    is_frame = quantity == "t" and _FRAMES.fullmatch(text) is not None
    return text in _UNITS[quantity] or is_frame


def seconds_per(unit: str) -> float:
    """Return the seconds of a unit of time, by its name or a rate as ``25 fps``."""
    frames = _FRAMES.fullmatch(unit)
    if frames is None:
        return TIMES[unit]
    return 1.0 / check_fps(frames[1], where=f"--columns t: {unit}")


def _known_units(quantity: str) -> str:
    """Return the units of t, x or y, each by its first name."""
    first_names: dict[float, str] = {}
    for name, scale in _UNITS[quantity].items():
        first_names.setdefault(scale, name)
    names = list(first_names.values())
    if quantity == "t":
        names.append("a frame as 25 fps")
    return ", ".join(names)


def _split_unit(text: str) -> tuple[str, str]:
    """Split off a unit in brackets, in small letters; it is empty if there is none."""
    match = re.fullmatch(r"(.+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", text)
    if match is None:
        return text, ""
    return match[1], (match[2] or match[3] or "").strip().lower()


def _pairs(text: str) -> list[tuple[str, str]]:
    """Split ``t=NAME,id=NAME`` into pairs; DataError for anything else."""
    pairs = []
    for part in text.split(","):
        name, equals, called = part.partition("=")
        if not equals or not called.strip():
            raise DataError(
                f"--columns takes t=NAME,id=NAME,x=NAME,y=NAME, got {part[:40]!r}"
            )
        pairs.append((name.strip(), called.strip()))
    return pairs


def project_degrees(rows: Rows) -> Rows:
    """Project longitude (x) and latitude (y) in degrees to local metres.

    The axes point east and north. The plane touches the ellipsoid WGS 84 at the middle
    of the recording; within 5 km of it distances are right to some 0.1 %. DataError for
    positions that are no degrees or span more than a degree.
    """
    path = rows.place.path
    x, y = rows.xy.T
    if (np.abs(x) > 180).any() or (np.abs(y) > 90).any():  # noqa: PLR2004 - of the Earth
        swapped = (np.abs(x) <= 90).all() and (np.abs(y) <= 180).all()  # noqa: PLR2004 - as above
        hint = (
            "; x is longitude, y latitude: swap them: --columns x=y,y=x"
            if swapped
            else ""
        )
        raise DataError(
            f"{path}: --crs degrees: not degrees, within 180 (x) and 90 (y){hint}"
        )
    if np.ptp(rows.xy, axis=0).max() > 1:
        raise DataError(
            f"{path}: --crs degrees: positions span over a degree; not of one place"
        )
    middle = np.median(rows.xy, axis=0)
    xy = np.radians(rows.xy - middle) * _metres_per_radian(middle[1])
    detail = (
        f"{path}: degrees, x as longitude and y as latitude (swap them with --columns),"
        f" projected to metres around longitude {middle[0]:.5f}, latitude"
        f" {middle[1]:.5f}"
    )
    notes = [*rows.notes, Repair("crs", rows.t.size, detail)]
    if abs(middle[0]) <= 90 and len(rows.ids) >= _SEVERAL:  # noqa: PLR2004 - as above
        swapped = np.radians(rows.xy - middle) * _metres_per_radian(middle[0])[::-1]
        if _speed_variation(rows, swapped) < _STEADIER * _speed_variation(rows, xy):
            text = (
                "x looks like latitude and y like longitude (walks are steadier so); "
                "swap their columns: --columns x=y,y=x where they are called so"
            )
            notes.append(Repair("doubt", 1, f"{path}: {text}"))
    return replace(rows, xy=xy, unit="m", notes=tuple(notes))


def _metres_per_radian(latitude: float) -> Floats:
    """Return the metres of a radian to the east and to the north, (2,), on WGS 84."""
    bend = 1.0 - _FLATNESS * np.sin(np.radians(latitude)) ** 2
    north_m = _EARTH_M * (1.0 - _FLATNESS) / bend**1.5
    return np.array([_EARTH_M / bend**0.5 * np.cos(np.radians(latitude)), north_m])


def _speed_variation(rows: Rows, xy: Floats) -> float:
    """Return the median variation of a walk's speed, as a share of its mean."""
    order = np.lexsort((rows.t, rows.person))
    person, step_s = rows.person[order], np.diff(rows.t[order])
    moves = (person[1:] == person[:-1]) & (step_s > 0)
    speed = lengths(np.diff(xy[order], axis=0)[moves]) / step_s[moves]
    owner, n_people = person[1:][moves], len(rows.ids)
    count = np.maximum(np.bincount(owner, minlength=n_people), 1)
    mean = np.bincount(owner, speed, n_people) / count
    square = np.bincount(owner, speed**2, n_people) / count
    walks = mean > 0
    variance = np.maximum(square[walks] / mean[walks] ** 2 - 1.0, 0.0)
    return float(np.median(np.sqrt(variance))) if walks.any() else 0.0


def convert_to_metres(rows: Rows, *, unit: str | None) -> Rows:
    """Convert rows to m, with a note; DataError if `unit` contradicts the file."""
    path = rows.place.path
    chosen = str(unit or rows.unit or "m")
    scale = _metres_per(chosen)
    if scale is None:
        hint = (
            f"must be one of {', '.join(METRES)}, ft, or metres a unit, got"
            f" {chosen[:40]!r}"
        )
        raise DataError(f"{path}: --unit {hint}")
    if rows.unit and scale != _metres_per(rows.unit):
        raise DataError(
            f"{path}: --unit {chosen} contradicts the file's header: {rows.unit}"
        )
    if scale == 1.0:
        return rows
    source = "--unit" if unit else rows.unit_by
    detail = f"{path}: positions in {chosen}, as {source} says; converted to m"
    notes = (*rows.notes, Repair("unit", rows.t.size, detail))
    return replace(rows, xy=rows.xy * scale, unit="m", notes=notes)


def _metres_per(unit: str) -> float | None:
    """Return the metres of a unit, given its name or a number; None for others."""
    if unit in LENGTHS:
        return LENGTHS[unit]
    try:
        scale = float(unit)
    except ValueError:
        return None
    return scale if 1e-6 <= scale <= 1e6 else None  # noqa: PLR2004 - beyond is no length


def build_rows(columns: Mapping[str, Floats], place: Place) -> Rows:
    """Return rows of the columns frame, id, x and y, (M,) each, in this order.

    Time `t` is in frames from the first frame.
    """
    check_numbers(columns, place)
    frame, person, x, y = columns.values()
    ids = np.unique(person)
    return Rows(
        # The inverse that np.unique returns takes six times the memory.
        person=np.searchsorted(ids, person),
        ids=tuple(str(int(value)) for value in ids),
        # From the first frame: a large frame number over fps would round.
        t=frame - frame.min(),
        xy=np.column_stack([x, y]),
        place=place,
    )


def check_numbers(columns: Mapping[str, Floats], place: Place) -> None:
    """Raise DataError for the first row with a number that is out of range."""
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
    """Return whether each step leads to a sample of the same track, (M - 1,)."""
    within = np.ones(max(offsets[-1] - 1, 0), dtype=bool)
    within[offsets[1:-1] - 1] = False
    return within


def listed(names: Sequence[str] | Ints) -> str:
    """Join the first few of `names` and count the others."""
    others = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(str(name) for name in names[:_SHOWN]) + others


def printable(text: str) -> str:
    """Return `text` with a question mark for every control character and line end."""
    return re.sub("[\x00-\x1f\x7f-\x9f\u2028\u2029]", "?", text)


def iterate_lines(data: bytes) -> Iterator[str]:
    r"""Yield the lines of text that `check_text` accepts, ended by ``\n \r\n \r``.

    They come one by one, without byte order mark and line end: a list, or a text with a
    single wide character, needs many times the memory of the file. str.splitlines would
    also break at form feeds and the like.
    """
    for line in io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig"):
        yield line.removesuffix("\n")


def check_text(*, data: bytes, path: str) -> None:
    """Raise DataError if a file is empty, compressed, binary, or not UTF-8."""
    for is_wrong, message in (
        (not data, "the file is empty"),
        (
            data.startswith(b"\x1f\x8b"),
            "the file is compressed (gzip); unpack it first",
        ),
        (data.startswith(b"PK\x03\x04"), _EXCEL),
        (
            data.startswith(b"SQLite format 3"),
            "an SQLite database; JuPedSim's: --format jupedsim",
        ),
        (
            data.startswith(b"\x89HDF"),
            "an HDF5 file; the Pedestrian Data Archive's: --format hdf5",
        ),
        (
            data.startswith(b"PAR1"),
            "this is a parquet file; read it with --format parquet",
        ),
        (
            data.startswith((b"\xff\xfe", b"\xfe\xff")),
            "the file is UTF-16 text; save it as UTF-8",
        ),
        (b"\0" in data, f"the file is binary, not text (zero byte at {data.find(0)})"),
    ):
        if is_wrong:
            raise DataError(f"{path}: {message}")
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # With a mark, `error.start` counts from behind it; the line number is the same.
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise DataError(
            f"{path}, line {line}: byte 0x{byte:02x} is not UTF-8 text; save the file"
            " as UTF-8"
        ) from None


def check_fps(fps: float | str, *, where: str) -> float:
    """Return `fps` as a number within `FPS_LIMITS`, or raise DataError at `where`."""
    try:
        rate = float(fps)
    except (TypeError, ValueError):
        raise DataError(
            f"{where}: the framerate {str(fps)[:40]!r} is not a number"
        ) from None
    if not FPS_LIMITS[0] <= rate <= FPS_LIMITS[1]:  # NaN fails both
        raise DataError(
            f"{where}: {rate:g} frames per second is not a frame rate above 0"
        )
    return rate
