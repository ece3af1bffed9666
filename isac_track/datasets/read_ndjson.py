"""Reader of TrajNet++ files: one JSON object a line, `track` rows and `scene` lines."""

from __future__ import annotations

import json
from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.datasets.rows import (
    POSITION_LIMIT_M,
    WHOLE_LIMIT,
    Place,
    Repair,
    Rows,
    check_numbers,
    check_text,
    checked_fps,
    fault,
    lines_of,
    number_ids,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints

_FIELDS = ("f", "p", "x", "y")
_LONGEST_LINE = 10_000
"""Characters: what a line holds beyond its row is not used, and takes memory."""


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
    columns: tuple[array[float], ...] = tuple(array("d") for _ in _FIELDS)
    lines: array[int] = array("q")
    scene_lines: array[int] = array("q")
    row_rates: dict[float, int] = {}
    check_text(data=data, path=path)
    for number, line in enumerate(lines_of(data), start=1):
        if not line.strip():
            continue
        if len(line) > _LONGEST_LINE:
            message = f"{len(line)} characters, over {_LONGEST_LINE}; one row is on a line"
            raise fault(path=path, line=number, message=message)
        try:
            kind, content = _parse(line)
            if kind == "scene":
                scene_lines.append(number)
                if content.get("fps") is not None:
                    row_rates.setdefault(_number(content, "fps"), number)
                continue
            values = [_number(content, name) for name in _FIELDS]
        except (ValueError, RecursionError) as error:
            reason = "too deeply nested" if isinstance(error, RecursionError) else str(error)
            raise fault(path=path, line=number, message=reason) from None
        lines.append(number)
        for column, value in zip(columns, values, strict=True):
            column.append(value)
    if not lines:
        raise DataError(f"{path}: the file holds no track rows")
    place = Place(path=path, lines=lambda: np.array(lines, dtype=np.int64))
    frame, person, x, y = (np.array(column) for column in columns)
    check_numbers(
        [frame, person, x, y],
        names=_FIELDS,
        limits=[WHOLE_LIMIT, WHOLE_LIMIT, POSITION_LIMIT_M, POSITION_LIMIT_M],
        whole=frozenset({"f", "p"}),
        place=place,
    )
    index, ids = number_ids(person)
    notes = []
    if scene_lines:
        where = Place(path=path, lines=lambda: np.array(scene_lines, dtype=np.int64))
        detail = f"{where.first(np.arange(len(scene_lines)))}: scene lines; whole tracks are used"
        notes.append(Repair("scene-lines", len(scene_lines), detail))
    rate, note = _frame_rate(
        row_rates=row_rates, step=_frame_step(frame=frame, person=index), fps=fps, path=path
    )
    return Rows(
        person=index,
        ids=ids,
        t=(frame - frame.min()) / rate,
        xy=np.column_stack([x, y]),
        place=place,
        notes=(*notes, *note),
    )


def _parse(line: str) -> tuple[str, dict[str, Any]]:
    """Return the kind of line and what it holds."""
    try:
        entry = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error.msg} at column {error.colno}") from None
    if not isinstance(entry, dict) or len(entry) != 1 or not entry.keys() <= {"track", "scene"}:
        raise ValueError('neither a {"track": {...}} nor a {"scene": {...}} line')
    kind, content = next(iter(entry.items()))
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


def _frame_step(*, frame: Floats, person: Ints) -> float:
    """Return the commonest positive step in frames between rows of one person; 1 if none."""
    order = np.lexsort((frame, person))
    steps = np.diff(frame[order])[np.diff(person[order]) == 0]
    values, counts = np.unique(steps[steps > 0], return_counts=True)
    return float(values[counts.argmax()]) if values.size else 1.0


def _frame_rate(
    *, row_rates: dict[float, int], step: float, fps: float | None, path: str
) -> tuple[float, tuple[Repair, ...]]:
    if len(row_rates) > 1:
        (first, first_line), (other, line) = list(row_rates.items())[:2]
        message = f"scene fps {other:g} contradicts the {first:g} of line {first_line}"
        raise fault(path=path, line=line, message=message)
    if not row_rates:
        if fps is None:
            raise DataError(
                f"{path}: no scene line gives fps; give frames per second with --fps "
                '(2.5 only if "f" counts rows, not video frames)'
            )
        return fps, ()
    ((row_rate, line),) = row_rates.items()
    declared = checked_fps(row_rate, where=f"{path}, line {line}") * step
    if fps is not None and not np.isclose(fps, declared, rtol=1e-6):
        raise DataError(
            f"{path}: --fps {fps:g} contradicts the scene lines: {row_rate:g} rows a second, "
            f"{step:g} frames apart, are {declared:g} frames a second; leave --fps out"
        )
    checked_fps(declared, where=f"{path}, line {line}")
    if step == 1.0:
        return declared, ()
    detail = (
        f"{path}: line {line}: {row_rate:g} rows a second, {step:g} frames apart; "
        f"times are frames at {declared:g} a second"
    )
    return declared, (Repair("frame-clock", 1, detail),)
