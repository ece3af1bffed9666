"""Readers of formats that count frames: obsmat, social-gan, pedpy, trajnet."""

import json
import re
import warnings
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isac_track.datasets import people, recording
from isac_track.datasets.recording import Label, Repair, Rows, listed
from isac_track.errors import DataError
from isac_track.types import Floats

COLUMNS = {
    # From OpenTraj; height and velocities are not used.
    "obsmat": ("frame", "id", "x", "z", "y", "vx", "vz", "vy"),
    # From Social-GAN and its successors.
    "social-gan": ("frame", "id", "x", "y"),
    # From PeTrack, PedPy and JuPedSim; there may be more columns. Comments before the
    # first row may give the `framerate: 25`, the unit (`x/m`, `x/cm`, `x/mm`) and the
    # columns in another order.
    "pedpy": ("id", "frame", "x", "y"),
}
"""Columns of each format with a row of numbers a line."""
_HEADER_CHARACTERS = 1000
_COLUMN_NAMES = {
    **dict.fromkeys(("id", "persid", "personid", "trackid", "ped"), "id"),
    **dict.fromkeys(("frame", "fr", "frameid", "framenr"), "frame"),
    # From PeTrack: on the person's head, the same in all runs.
    "markerid": "marker",
    "x": "x",
    "y": "y",
}
"""Names of the used columns in headers, in small letters and without unit."""
_FRAME_RATE = re.compile(r"frame\s*rate|\bfps(?=\s*[:=])", re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_RATE = re.compile(
    rf"({_NUMBER})(?:\s*/\s*({_NUMBER}))?(?![\d.,/]|\s*(,|-|\u2013|to\b|or\b)\s*\d"
    r"|[^#]*/\s*\d|[^#]*[,;]\s*\d)",
    re.IGNORECASE,
)
_BEGINS = re.compile(r"[-+.]?\d[^\s;)\]]*")
_LENGTH = re.compile(r"\b[xy]\s*[/\[(]\s*(?:in\s+)?([a-z]+)|\bin\s+([cm]?m)\b")
_POSITIONS = re.compile(
    r"\b([xy]|xy|positions?|coordinates?|trajector(y|ies)|lengths?|units?|distances?|points?|data|"
    r"all|everything|values)\b"
)
"""Words for positions in a sentence of a header that names their unit."""
_NO_POSITIONS = re.compile(
    r"\b(errors?|accurac(y|ies)|precision|resolution|noise|uncertaint(y|ies)|deviations?|"
    r"tolerances?|walls?|cameras?)\b"
)
"""Words for properties of positions or distances that are no positions."""
_CONVERTED = re.compile(
    r"\b(?:converted|transformed|rescaled) (?:in)?to ([cm]?m|metres?|meters?)\b"
)
_USED = ("frame", "id", "x", "y")
_TRACK_FIELDS = ("f", "p", "x", "y")


@dataclass(frozen=True, slots=True)
class Header:
    """Contents of the comments before the first row of a file."""

    fps: float | None = None
    unit: str = ""  # A unit of `recording.METRES`; empty if none is named.
    columns: Mapping[str, int] = field(default_factory=dict)
    """Places of frame, id, x and y; empty unless a line names all columns."""
    line: int = 0  # The line that names the columns.
    marker: int | None = None  # Column of the person's number, the same in all files.
    labels: Mapping[str, Label] = field(default_factory=dict)
    """The person of each passage that a comment names."""


def read_columns(
    format_name: str, *, data: bytes, path: str, fps: float | None
) -> Rows:
    """Read rows of numbers with spaces or tabs between them; ``#`` begins a comment.

    The header's labels or its marker name the people; a marker of -1 names nobody.
    DataError names file and line, or says that `fps` is missing or contradicts the
    file's.
    """
    recording.check_text(data=data, path=path)
    header = read_header(format_name, data=data, path=path)
    rate = _choose_rate(fps, header.fps, format_name=format_name, path=path)
    fault: Exception | None = None
    try:
        with warnings.catch_warnings():
            # The warning of an empty table: that is an error below.
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(recording.iterate_lines(data), dtype=np.float64, ndmin=2)
    except (ValueError, OverflowError, MemoryError) as error:
        fault, table = error, np.zeros((1, 0))
    if not len(table):
        raise DataError(f"{path}: the file holds no rows")
    if not _has_width(table.shape[1], format_name):
        n_first = 0
        for number, fields in _split_rows(data):
            if message := _fault(fields, format_name, n_first):
                raise DataError(f"{path}, line {number}: {message}")
            n_first = len(fields)
        raise DataError(f"{path}: cannot be read as {format_name}: {fault}")
    place = recording.Place(
        path, lambda: np.fromiter((n for n, _ in _split_rows(data)), dtype=np.int64)
    )
    columns = header.columns or {
        name: COLUMNS[format_name].index(name) for name in _USED
    }
    rows = recording.build_rows(
        {name: table[:, columns[name]] for name in _USED}, place
    )
    labels: Mapping[str, Label] | None = header.labels or None
    if header.marker is not None:
        labels = _marker_labels(table[:, header.marker], rows)
    return replace(rows, t=rows.t / rate, unit=header.unit, people=labels)


def _marker_labels(marker: Floats, rows: Rows) -> Mapping[str, Label]:
    """Return the person of each passage by its marker, (M,); DataError for two.

    A negative marker is PeTrack's sign for none.
    """
    values, index = np.unique(marker, return_inverse=True)
    names = [f"{value:.0f}" if value >= 0 else "" for value in values.tolist()]
    return people.label_rows(
        index, names, owner=rows.person, ids=rows.ids, place=rows.place
    )


def _choose_rate(
    fps: float | None, declared: float | None, *, format_name: str, path: str
) -> float:
    """Return the frame rate of user or header; DataError if none, or if they differ."""
    rate = declared if fps is None else fps
    if rate is None:
        no_rate = ""
        if format_name == "pedpy":
            no_rate = " and the file's header has no framerate"
        raise DataError(
            f"{path}: format {format_name} counts frames{no_rate}; "
            "give frames per second with --fps (25 for UCY)"
        )
    if declared not in {None, rate}:
        raise DataError(
            f"{path}: --fps {rate:g} contradicts the file's framerate {declared:g}"
        )
    return rate


def read_header(format_name: str, *, data: bytes, path: str) -> Header:
    """Read the header, if the format has any; DataError if it is ambiguous."""
    if format_name != "pedpy":
        return Header()
    recording.check_text(data=data, path=path)
    rates: dict[float, int] = {}
    units: dict[str, int] = {}
    named: list[tuple[int, list[str]]] = []
    labels: list[tuple[str, Label]] = []
    n_fields = 0
    for number, line in enumerate(recording.iterate_lines(data), start=1):
        # The search is quadratic in the worst case: the text must be short.
        text = line.strip()[:_HEADER_CHARACTERS]
        if text and not text.startswith("#"):
            n_fields = len(text.split("#", 1)[0].split())
            break
        if label := people.parse_label(text, line=number):
            labels.append(label)
            continue
        fps = _declared_rate(text, where=f"{path}, line {number}")
        if fps is not None:
            rates.setdefault(fps, number)
        for unit in _declared_units(text.lower()):
            units.setdefault(unit[:40], number)
        names = _column_names(text)
        if all(names.count(name) == 1 for name in _USED):
            named.append((number, names))
    _check_single(rates, units, path=path)
    # There must be as many names as the first row has fields: a sentence about the
    # columns does not count.
    fitting = [entry for entry in named if len(entry[1]) == n_fields]
    header_line, names = next(iter(fitting), (0, []))
    places = {name: names.index(name) for name in _USED if header_line}
    marker = names.index("marker") if names.count("marker") == 1 else None
    if marker is not None and labels:
        raise DataError(
            f"{path}, line {labels[0][1].line}: a label, and line {header_line} names a"
            " markerID; leave one of them, so that a passage has one person"
        )
    return Header(
        fps=next(iter(rates), None),
        unit=next(iter(units), ""),
        columns=places,
        line=header_line,
        marker=marker,
        labels=people.collect_labels(labels, path=path),
    )


def _column_names(text: str) -> list[str]:
    """Return our name of each word of a comment; empty for a word that names none."""
    bare = re.sub(r"\s*[/\[(]\s*[a-z]+[\])]?", "", text.lower()[1:])
    return [_COLUMN_NAMES.get(word, "") for word in re.split(r"[\s,;]+", bare.strip())]


def _check_single(
    rates: Mapping[float, int], units: Mapping[str, int], *, path: str
) -> None:
    """Raise DataError if a header names two frame rates or units, or an unknown unit.

    `rates` and `units` map each to the number of the first line that names it.
    """
    if len(rates) > 1:
        rate_list = " and ".join(
            f"{rate:g} (line {number})" for rate, number in [*rates.items()][:2]
        )
        raise DataError(
            f"{path}: the header names two framerates: {rate_list}; leave the right one"
        )
    if len(units) > 1:
        raise DataError(
            f"{path}: the header names two units of length: {listed(list(units))}"
        )
    for unit, number in units.items():
        if unit not in recording.METRES:
            way_out = "convert them to m (x/m), cm (x/cm) or mm (x/mm)"
            raise DataError(
                f"{path}, line {number}: lengths are in {unit!r}; {way_out}"
            )


def _declared_rate(text: str, *, where: str) -> float | None:
    """Return the frame rate that a comment gives; None without, DataError if unclear.

    It is a number, or a fraction, directly behind the word or behind the last colon or
    equals sign.
    """
    keyword = _FRAME_RATE.search(text)
    if keyword is None:
        return None
    behind = text[keyword.end() :]
    for value in (behind, re.split("[:=]", behind)[-1]):
        # Its unit may stand before the number.
        bare = re.sub(r"^\s*([\[(][^\])]*[\])])?\s*[:=]*", "", value).strip()
        if begins := _BEGINS.match(bare):
            break
    else:
        return None
    rate = _RATE.match(bare.rstrip(". "))
    if rate is None:
        is_several = re.match(r"[\d.]+( *(-|\u2013|to|or)|[^,;]*\s[^,;]*[,;])", bare)
        written = bare[:40] if is_several else begins[0][:40]
        hint = "; write a decimal point" if re.match(r"\d+ *,", written) else ""
        raise DataError(
            f"{where}: the framerate {written!r} is not a single number{hint}"
        )
    fps = recording.check_fps(rate[1], where=where)
    if rate[2]:
        fps = recording.check_fps(
            fps / recording.check_fps(rate[2], where=where), where=where
        )
    return fps


def _declared_units(text: str) -> list[str]:
    """Return the units of positions that a comment names, in small letters.

    Units of heights do not count.
    """
    if converted := _CONVERTED.search(text):
        return [converted[1] if converted[1] in recording.METRES else "m"]
    units, end = [], 0
    for match in _LENGTH.finditer(text):
        subject = re.split(r"[;.:(\[]", text[end : match.start()])[-1]
        end = match.end()
        if match[1]:
            units.append(match[1])
        elif _NO_POSITIONS.search(subject):
            continue
        elif _POSITIONS.search(subject) or not re.search("[a-z]", subject):
            units.append(match[2])
    return units


def _split_rows(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and fields of every row, counted as np.loadtxt does."""
    for number, line in enumerate(recording.iterate_lines(data), start=1):
        if fields := line.split("#", 1)[0].split():
            yield number, fields


def _has_width(n_fields: int, format_name: str) -> bool:
    """Whether rows of the format may have so many fields."""
    needed = len(COLUMNS[format_name])
    return n_fields == needed or (format_name == "pedpy" and n_fields > needed)


def _fault(fields: list[str], format_name: str, n_first: int) -> str:
    """Return the fault of a row behind rows of `n_first` fields; empty for none."""
    for separator, name in ((";", "semicolons"), (",", "commas")):
        fields_with = [field for field in fields if separator in field]
        if len(fields) > 1 and any(
            re.fullmatch(r"[-+]?\d*,\d+", field) for field in fields_with
        ):
            return f"{fields_with[0][:40]!r} has a decimal comma; write a decimal point"
        if fields_with:
            way_out = "this format has spaces or tabs (or use --format csv)"
            return f"{name} between the numbers; {way_out}"
    if not _has_width(len(fields), format_name):
        columns = COLUMNS[format_name]
        prefix = "at least " if format_name == "pedpy" else ""
        needed = f"{prefix}{len(columns)} ({' '.join(columns)})"
        return f"{len(fields)} column(s) where {format_name} has {needed}"
    if n_first not in {0, len(fields)}:
        return f"{len(fields)} columns where the rows before have {n_first}"
    for text in fields:
        try:
            float(text)
        except ValueError:
            return f"{text[:40]!r} is not a number"
    return ""


def read_trajnet(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read ``{"track": {"f", "p", "x", "y"}}`` and ``{"scene": {..., "fps"}}`` lines.

    A scene's `fps` counts *rows* a second, while `f` keeps the frame numbers of the
    video (2.5 rows a second, 10 frames apart, are 25 frames a second). So the frame
    rate is that `fps` times the commonest frame step. The argument `fps` is frames a
    second. DataError names file and line. Forecasts, no `fps` at all, and two that
    contradict each other are errors, too.
    """
    values: array[float] = array("d")
    lines, scene_lines = array("q"), array("q")
    row_rate, rate_line = None, 0
    recording.check_text(data=data, path=path)
    for number, line in enumerate(recording.iterate_lines(data), start=1):
        if not line.strip():
            continue
        try:
            kind, content = _parse(line)
            if kind == "track":
                values.extend([_number(content, name) for name in _TRACK_FIELDS])
                lines.append(number)
                continue
            scene_lines.append(number)
            rate = None if content.get("fps") is None else _number(content, "fps")
            if rate is not None and row_rate not in {None, rate}:
                conflict = f"contradicts the {row_rate:g} of line {rate_line}"
                raise ValueError(f"scene fps {rate:g} {conflict}")  # noqa: TRY301 - see below
        except (ValueError, RecursionError) as error:
            reason = (
                "too deeply nested" if isinstance(error, RecursionError) else str(error)
            )
            raise DataError(f"{path}, line {number}: {reason}") from None
        if row_rate is None:
            row_rate, rate_line = rate, number
    if not lines:
        raise DataError(f"{path}: the file holds no track rows")
    place = recording.Place(path, lambda: np.array(lines, dtype=np.int64))
    table = np.frombuffer(values).reshape(-1, 4).T
    rows = recording.build_rows(dict(zip(_TRACK_FIELDS, table, strict=True)), place)
    scenes = recording.Place(path, lambda: np.array(scene_lines, dtype=np.int64))
    scene_rows, text = np.arange(len(scene_lines)), "scene lines; whole tracks are used"
    notes = scenes.note_rows("scene-lines", scene_rows, text)
    if row_rate is not None:
        fps, rate_notes = _frame_rate(
            rows, row_rate, where=f"{path}, line {rate_line}", fps=fps
        )
        notes += rate_notes
    if fps is None:
        raise DataError(
            f"{path}: no scene line gives fps; give frames per second with --fps "
            '(2.5 only if "f" counts rows, not video frames)'
        )
    return replace(rows, t=rows.t / fps, notes=tuple(notes))


def _frame_rate(
    rows: Rows, row_rate: float, *, where: str, fps: float | None
) -> tuple[float, list[Repair]]:
    """Return the frame rate of the scene lines, and a note if it is not their `fps`."""
    # The commonest step in frames between rows of a person; 1 if there is none.
    order = np.lexsort((rows.t, rows.person))
    steps = np.diff(rows.t[order])[np.diff(rows.person[order]) == 0]
    commonest, counts = np.unique(steps[steps > 0], return_counts=True)
    step = float(commonest[counts.argmax()]) if commonest.size else 1.0
    declared = recording.check_fps(row_rate * step, where=where)
    clock = f"{row_rate:g} rows a second, {step:g} frames apart"
    if fps is not None and not np.isclose(fps, declared, rtol=1e-6):
        raise DataError(
            f"{rows.place.path}: --fps {fps:g} contradicts the scene lines: {clock}, "
            f"are {declared:g} frames a second; leave --fps out"
        )
    detail = f"{where}: {clock}; times are frames at {declared:g} a second"
    return declared, [Repair("frame-clock", 1, detail)] if step != 1.0 else []


def _parse(line: str) -> tuple[str, dict[str, Any]]:
    """Return the kind of a line, track or scene, and its content."""
    try:
        entry = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error.msg} at column {error.colno}") from None
    if (
        not isinstance(entry, dict)
        or len(entry) != 1
        or not entry.keys() <= {"track", "scene"}
    ):
        raise ValueError('neither a {"track": {...}} nor a {"scene": {...}} line')
    ((kind, content),) = entry.items()
    if not isinstance(content, dict):
        raise ValueError(f"{kind} holds no object")  # noqa: TRY004 - all faults of a line are one
    for name in ("prediction_number", "pred_number"):
        if kind == "track" and content.get(name) is not None:
            raise ValueError(
                f"{name} marks a forecast; only recorded tracks can be read"
            )
    return kind, content


def _number(content: dict[str, Any], name: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        description = (
            "missing"
            if name not in content
            else f"{json.dumps(value)[:40]}, not a number"
        )
        raise ValueError(f"{name} is {description}")  # noqa: TRY004 - all faults of a line are one
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{name} is out of range") from None
