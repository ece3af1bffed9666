"""Readers of the whitespace-separated formats: obsmat, social-gan and pedpy."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
    listed,
    number_ids,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


@dataclass(frozen=True, slots=True)
class _Layout:
    name: str
    columns: tuple[str, ...]
    may_have_more: bool = False


_OBSMAT = _Layout("obsmat", ("frame", "id", "x", "z", "y", "vx", "vz", "vy"))
_SOCIAL_GAN = _Layout("social-gan", ("frame", "id", "x", "y"))
_PEDPY = _Layout("pedpy", ("id", "frame", "x", "y"), may_have_more=True)
_HEADER_CHARACTERS = 1000
_METRES = {"m": 1.0, "cm": 0.01}


def read_obsmat(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read OpenTraj's ``frame id x z y vx vz vy``; height and velocities are not used.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line.
    """
    return _rows(data=data, path=path, layout=_OBSMAT, fps=fps)


def read_social_gan(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read the ``frame id x y`` of Social-GAN and its successors.

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line.
    """
    return _rows(data=data, path=path, layout=_SOCIAL_GAN, fps=fps)


def read_pedpy(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read the ``id frame x y [z ...]`` of PedPy and JuPedSim.

    Comments before the first row may hold the frame rate (``# framerate: 25``) and the unit
    (``x/m`` or ``x/cm``; metres without).

    Raises
    ------
    DataError
        For anything that is not this format, naming file and line, or if `fps` contradicts
        the frame rate in the file.
    """
    check_text(data=data, path=path)
    declared_fps, metres = _pedpy_header(data=data, path=path)
    if fps is not None and declared_fps is not None and fps != declared_fps:
        raise DataError(f"{path}: --fps {fps:g} contradicts the file's framerate {declared_fps:g}")
    rate = declared_fps if fps is None else fps
    return _rows(data=data, path=path, layout=_PEDPY, fps=rate, metres=metres)


def _pedpy_header(*, data: bytes, path: str) -> tuple[float | None, float]:
    """Return the declared frame rate and the metres per unit of length."""
    fps: float | None = None
    units: dict[str, int] = {}
    for number, line in enumerate(lines_of(data), start=1):
        if not line.strip():
            continue
        if not line.lstrip().startswith("#"):
            break
        line = line[:_HEADER_CHARACTERS]  # noqa: PLW2901 - the search is quadratic in the worst case
        found = re.search(r"frame\s*rate[^\d.+-]*([-+]?[\d.]+(?:e[-+]?\d+)?)", line, re.IGNORECASE)
        if found and fps is None:
            try:
                fps = float(found[1])
            except ValueError:
                message = f"the framerate {found[1][:40]!r} is not a number"
                raise fault(path=path, line=number, message=message) from None
            checked_fps(fps, where=f"{path}, line {number}")
        for unit in re.findall(r"\bx\s*[/\[(]\s*([a-z]+)|\bin\s+(c?m)\b", line.lower()):
            units.setdefault((unit[0] or unit[1])[:40], number)
    if len(units) > 1:
        raise DataError(f"{path}: the header names two units of length: {listed(list(units))}")
    for unit, number in units.items():
        if unit not in _METRES:
            message = f"lengths are in {unit!r}; convert them to m (x/m) or cm (x/cm)"
            raise fault(path=path, line=number, message=message)
    return fps, _METRES[next(iter(units), "m")]


def _rows(
    *, data: bytes, path: str, layout: _Layout, fps: float | None, metres: float = 1.0
) -> Rows:
    check_text(data=data, path=path)
    if fps is None:
        header = " and the file's header has no framerate" if layout is _PEDPY else ""
        raise DataError(
            f"{path}: format {layout.name} counts frames{header}; "
            "give frames per second with --fps (25 for UCY)"
        )
    table = _table(data=data, path=path, layout=layout)
    place = Place(path=path, lines=lambda: _line_numbers(data))
    frame, person, x, y = (
        table[:, layout.columns.index(name)] for name in ("frame", "id", "x", "y")
    )
    check_numbers(
        [frame, person, x, y],
        names=["frame", "id", "x", "y"],
        limits=[WHOLE_LIMIT, WHOLE_LIMIT, POSITION_LIMIT_M, POSITION_LIMIT_M],
        whole=frozenset({"frame", "id"}),
        place=place,
    )
    index, ids = number_ids(person)
    notes: tuple[Repair, ...] = ()
    if metres != 1.0:
        detail = f"{path}: positions in cm, as the header says; converted to m"
        notes = (Repair("unit", frame.size, detail),)
    xy = np.column_stack([x, y])
    xy *= metres
    t = frame - frame.min()  # a large frame number over fps would round
    t /= fps
    return Rows(
        person=index,
        ids=ids,
        t=t,
        xy=xy,
        place=place,
        notes=notes,
    )


def _table(*, data: bytes, path: str, layout: _Layout) -> Floats:
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
    if not _fits(table.shape[1], layout):
        _raise_first_fault(data=data, path=path, layout=layout)
    return np.asarray(table, dtype=np.float64)


def _fits(n_columns: int, layout: _Layout) -> bool:
    needed = len(layout.columns)
    return n_columns >= needed if layout.may_have_more else n_columns == needed


def _line_numbers(data: bytes) -> Ints:
    """Return the line number of every row, as loadtxt counts rows."""
    rows = (n for n, line in enumerate(lines_of(data), start=1) if line.split("#", 1)[0].strip())
    return np.fromiter(rows, dtype=np.int64)


def _raise_first_fault(*, data: bytes, path: str, layout: _Layout) -> None:
    n_first = 0
    for number, line in enumerate(lines_of(data), start=1):
        fields = line.split("#", 1)[0].split()
        if not fields:
            continue
        message = _separator_fault(fields) or _count_fault(len(fields), layout, n_first)
        for field in fields:
            message = message or _number_fault(field)
        if message:
            raise fault(path=path, line=number, message=message)
        n_first = n_first or len(fields)


def _separator_fault(fields: list[str]) -> str:
    for separator, name in ((";", "semicolons"), (",", "commas")):
        if not any(separator in field for field in fields):
            continue
        if separator == "," and any(re.fullmatch(r"[-+]?\d*,\d+", field) for field in fields):
            field = next(field for field in fields if "," in field)
            if len(fields) > 1:
                return f"{field[:40]!r} has a decimal comma; write a decimal point"
        return f"{name} between the numbers; this format has spaces or tabs (or use --format csv)"
    return ""


def _count_fault(n_fields: int, layout: _Layout, n_first: int) -> str:
    columns = " ".join(layout.columns)
    if not _fits(n_fields, layout):
        least = "at least " if layout.may_have_more else ""
        return (
            f"{n_fields} column(s) where {layout.name} has {least}{len(layout.columns)} ({columns})"
        )
    if n_first and n_fields != n_first:
        return f"{n_fields} columns where the rows before have {n_first}"
    return ""


def _number_fault(field: str) -> str:
    try:
        float(field)
    except ValueError:
        return f"{field[:40]!r} is not a number"
    # float() takes what loadtxt does not.
    return f"{field[:40]!r} is not a plain number" if "_" in field or not field.isascii() else ""
