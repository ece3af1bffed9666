"""Readers of the formats that count frames: obsmat, social-gan, pedpy, and trajnet's JSON lines."""

from __future__ import annotations

import json
import re
import warnings
from array import array
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.datasets.rows import (
    Place,
    Repair,
    Rows,
    check_text,
    checked_fps,
    framed,
    lines_of,
    listed,
    noted,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.types import Floats


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns of one format."""

    name: str
    columns: tuple[str, ...]
    """``frame``, ``id``, ``x`` and ``y`` are used."""
    may_have_more: bool = False
    has_header: bool = False
    """Whether comments may tell frame rate and unit of length."""


OBSMAT = Layout("obsmat", ("frame", "id", "x", "z", "y", "vx", "vz", "vy"))
"""Of OpenTraj; height and velocities are not used."""
SOCIAL_GAN = Layout("social-gan", ("frame", "id", "x", "y"))
"""Of Social-GAN and its successors."""
PEDPY = Layout("pedpy", ("id", "frame", "x", "y"), may_have_more=True, has_header=True)
"""Of PedPy and JuPedSim: ``# framerate: 25`` and ``x/m`` or ``x/cm`` before the first row."""
_HEADER_CHARACTERS = 1000
_METRES = {"m": 1.0, "cm": 0.01}
_TRACK_FIELDS = ("f", "p", "x", "y")
_LONGEST_LINE = 10_000
"""Characters: what a line holds beyond its row is not used, and takes memory."""


def read_columns(*, data: bytes, path: str, fps: float | None, layout: Layout) -> Rows:
    """Read rows of numbers with spaces or tabs between them; ``#`` begins a comment.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line, or if `fps` is missing or
        contradicts the frame rate in the file.
    """
    check_text(data=data, path=path)
    declared, metres = _header(data=data, path=path) if layout.has_header else (None, 1.0)
    if fps is not None and declared is not None and fps != declared:
        raise DataError(f"{path}: --fps {fps:g} contradicts the file's framerate {declared:g}")
    rate = declared if fps is None else fps
    if rate is None:
        header = " and the file's header has no framerate" if layout.has_header else ""
        raise DataError(
            f"{path}: format {layout.name} counts frames{header}; "
            "give frames per second with --fps (25 for UCY)"
        )
    table = _table(data=data, path=path, layout=layout)
    place = Place(
        path=path,
        lines=lambda: np.fromiter((number for number, _ in _split(data)), dtype=np.int64),
    )
    columns = [table[:, layout.columns.index(name)] for name in ("frame", "id", "x", "y")]
    rows = framed(columns, place=place)
    if metres == 1.0:
        return replace(rows, t=rows.t / rate)
    detail = f"{path}: positions in cm, as the header says; converted to m"
    notes = (Repair("unit", rows.t.size, detail),)
    return replace(rows, t=rows.t / rate, xy=rows.xy * metres, notes=notes)


def _header(*, data: bytes, path: str) -> tuple[float | None, float]:
    """Return the declared frame rate and the metres per unit of length."""
    fps: float | None = None
    units: dict[str, int] = {}
    for number, line in enumerate(lines_of(data), start=1):
        text = line.strip()[:_HEADER_CHARACTERS]  # the search is quadratic in the worst case
        if not text:
            continue
        if not text.startswith("#"):
            break
        found = re.search(r"frame\s*rate[^\d.+-]*([-+]?[\d.]+(?:e[-+]?\d+)?)", text, re.IGNORECASE)
        if found and fps is None:
            where = f"{path}, line {number}"
            try:
                fps = checked_fps(float(found[1]), where=where)
            except ValueError:
                reason = f"the framerate {found[1][:40]!r} is not a number"
                raise DataError(f"{where}: {reason}") from None
        for unit in re.findall(r"\bx\s*[/\[(]\s*([a-z]+)|\bin\s+(c?m)\b", text.lower()):
            units.setdefault((unit[0] or unit[1])[:40], number)
    if len(units) > 1:
        raise DataError(f"{path}: the header names two units of length: {listed(list(units))}")
    for unit, number in units.items():
        if unit not in _METRES:
            way_out = "convert them to m (x/m) or cm (x/cm)"
            raise DataError(f"{path}, line {number}: lengths are in {unit!r}; {way_out}")
    return fps, _METRES[next(iter(units), "m")]


def _table(*, data: bytes, path: str, layout: Layout) -> Floats:
    """Return (M, columns): in one go if all is well, else the first bad line is looked for."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty table: an error below
            table = np.loadtxt(lines_of(data), dtype=np.float64, ndmin=2)
    except (ValueError, OverflowError, MemoryError) as error:
        _raise_first_fault(data=data, path=path, layout=layout)
        raise DataError(f"{path}: cannot be read as {layout.name}: {error}") from None
    if not table.size:
        raise DataError(f"{path}: the file holds no rows")
    if _count_fault(table.shape[1], layout):
        _raise_first_fault(data=data, path=path, layout=layout)
    return np.asarray(table, dtype=np.float64)


def _split(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and fields of every row, as loadtxt counts rows."""
    for number, line in enumerate(lines_of(data), start=1):
        if fields := line.split("#", 1)[0].split():
            yield number, fields


def _raise_first_fault(*, data: bytes, path: str, layout: Layout) -> None:
    n_first = 0
    for number, fields in _split(data):
        message = _separator_fault(fields) or _count_fault(len(fields), layout)
        if not message and n_first not in {0, len(fields)}:
            message = f"{len(fields)} columns where the rows before have {n_first}"
        message = message or next(filter(None, map(_number_fault, fields)), "")
        if message:
            raise DataError(f"{path}, line {number}: {message}")
        n_first = len(fields)


def _separator_fault(fields: list[str]) -> str:
    for separator, name in ((";", "semicolons"), (",", "commas")):
        found = [field for field in fields if separator in field]
        if not found:
            continue
        is_decimal = any(re.fullmatch(r"[-+]?\d*,\d+", field) for field in found)
        if is_decimal and separator == "," and len(fields) > 1:
            return f"{found[0][:40]!r} has a decimal comma; write a decimal point"
        return f"{name} between the numbers; this format has spaces or tabs (or use --format csv)"
    return ""


def _count_fault(n_fields: int, layout: Layout) -> str:
    needed = len(layout.columns)
    if n_fields == needed or (layout.may_have_more and n_fields > needed):
        return ""
    least = "at least " if layout.may_have_more else ""
    columns = " ".join(layout.columns)
    return f"{n_fields} column(s) where {layout.name} has {least}{needed} ({columns})"


def _number_fault(field: str) -> str:
    try:
        float(field)
    except ValueError:
        return f"{field[:40]!r} is not a number"
    # float() takes what loadtxt does not.
    return f"{field[:40]!r} is not a plain number" if "_" in field or not field.isascii() else ""


def read_trajnet(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read ``{"track": {"f", "p", "x", "y"}}`` and ``{"scene": {..., "fps"}}`` lines.

    A scene's `fps` counts *rows* a second, while `f` keeps the frame numbers of the video
    (2.5 rows a second, 10 frames apart, are 25 frames a second): the frame rate is that
    `fps` times the commonest frame step. The argument `fps` is frames a second.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line; for forecasts; without
        any `fps`, or if two contradict each other.
    """
    values: array[float] = array("d")
    lines, scene_lines = array("q"), array("q")
    row_rates: dict[float, int] = {}
    check_text(data=data, path=path)
    for number, line in enumerate(lines_of(data), start=1):
        if not line.strip():
            continue
        try:
            kind, content = _parse(line)
            if kind == "track":
                values.extend([_number(content, name) for name in _TRACK_FIELDS])
                lines.append(number)
                continue
            scene_lines.append(number)
            if content.get("fps") is not None:
                row_rates.setdefault(_number(content, "fps"), number)
        except (ValueError, RecursionError) as error:
            reason = "too deeply nested" if isinstance(error, RecursionError) else str(error)
            raise DataError(f"{path}, line {number}: {reason}") from None
    if not lines:
        raise DataError(f"{path}: the file holds no track rows")
    place = Place(path=path, lines=lambda: np.array(lines, dtype=np.int64))
    rows = framed([*np.frombuffer(values).reshape(-1, 4).T], names=_TRACK_FIELDS, place=place)
    fps, clock = _frame_rate(row_rates=row_rates, step=_frame_step(rows), fps=fps, path=path)
    scenes = noted(
        "scene-lines",
        np.arange(len(scene_lines)),
        "scene lines; whole tracks are used",
        place=Place(path=path, lines=lambda: np.array(scene_lines, dtype=np.int64)),
    )
    return replace(rows, t=rows.t / fps, notes=(*scenes, *clock))


def _parse(line: str) -> tuple[str, dict[str, Any]]:
    """Return the kind of line and what it holds."""
    if len(line) > _LONGEST_LINE:
        raise ValueError(f"{len(line)} characters, over {_LONGEST_LINE}; one row is on a line")
    try:
        entry = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error.msg} at column {error.colno}") from None
    if not isinstance(entry, dict) or len(entry) != 1 or not entry.keys() <= {"track", "scene"}:
        raise ValueError('neither a {"track": {...}} nor a {"scene": {...}} line')
    ((kind, content),) = entry.items()
    if not isinstance(content, dict):
        raise ValueError(f"{kind} holds no object")  # noqa: TRY004 - all faults of a line are one
    for name in ("prediction_number", "pred_number"):
        if kind == "track" and content.get(name) is not None:
            raise ValueError(f"{name} marks a forecast; only recorded tracks can be read")
    return kind, content


def _number(content: dict[str, Any], name: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        shown = "missing" if name not in content else f"{json.dumps(value)[:40]}, not a number"
        raise ValueError(f"{name} is {shown}")  # noqa: TRY004 - all faults of a line are one
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{name} is out of range") from None


def _frame_step(rows: Rows) -> float:
    """Return the commonest positive step in frames between rows of one person; 1 if none."""
    order = np.lexsort((rows.t, rows.person))
    steps = np.diff(rows.t[order])[np.diff(rows.person[order]) == 0]
    values, counts = np.unique(steps[steps > 0], return_counts=True)
    return float(values[counts.argmax()]) if values.size else 1.0


def _frame_rate(
    *, row_rates: dict[float, int], step: float, fps: float | None, path: str
) -> tuple[float, list[Repair]]:
    if len(row_rates) > 1:
        (first, first_line), (other, line) = list(row_rates.items())[:2]
        reason = f"scene fps {other:g} contradicts the {first:g} of line {first_line}"
        raise DataError(f"{path}, line {line}: {reason}")
    if not row_rates:
        if fps is None:
            raise DataError(
                f"{path}: no scene line gives fps; give frames per second with --fps "
                '(2.5 only if "f" counts rows, not video frames)'
            )
        return fps, []
    ((row_rate, line),) = row_rates.items()
    declared = checked_fps(row_rate, where=f"{path}, line {line}") * step
    clock = f"{row_rate:g} rows a second, {step:g} frames apart"
    if fps is not None and not np.isclose(fps, declared, rtol=1e-6):
        raise DataError(
            f"{path}: --fps {fps:g} contradicts the scene lines: {clock}, "
            f"are {declared:g} frames a second; leave --fps out"
        )
    checked_fps(declared, where=f"{path}, line {line}")
    if step == 1.0:
        return declared, []
    detail = f"{path}: line {line}: {clock}; times are frames at {declared:g} a second"
    return declared, [Repair("frame-clock", 1, detail)]
