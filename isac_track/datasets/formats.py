"""The formats by name. A format is told, or named by the file's extension, never guessed."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from isac_track.datasets import read_frames, read_table
from isac_track.datasets.recording import checked_fps
from isac_track.datasets.registry import did_you_mean, shown
from isac_track.datasets.repair import to_tracks
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from isac_track.datasets.recording import Repair, Rows
    from isac_track.types import Tracks

_WITH_CLOCK: Mapping[str, Callable[..., Rows]] = {
    "csv": read_table.read_csv,
    "parquet": read_table.read_parquet,
}
FORMATS: Mapping[str, Callable[..., Rows]] = {
    **{
        layout.name: partial(read_frames.read_columns, layout=layout)
        for layout in read_frames.LAYOUTS
    },
    "trajnet": read_frames.read_trajnet,
    **_WITH_CLOCK,
}
"""Each turns the bytes of a file into rows, and lets no error but `DataError` out."""
_EXTENSIONS = {".csv": "csv", ".parquet": "parquet", ".ndjson": "trajnet"}


def format_of(path: Path, *, format: str | None) -> str:  # noqa: A002 - the name of the option
    """Return the name of the format: `format`, or what the extension of `path` names.

    It is a DataError if the format is unknown, or neither given nor named by the extension.
    """
    name = _EXTENSIONS.get(path.suffix.lower()) if format is None else format
    known = ", ".join(FORMATS)
    if name is None:
        raise DataError(
            f"{shown(path)}: the format is not known from the name; give --format ({known})"
        )
    if name not in FORMATS:
        hint = did_you_mean(name, FORMATS)
        raise DataError(f"unknown format {name!r}{hint} (known: {known})")
    return name


def read(
    *,
    data: bytes,
    path: str,
    format: str,  # noqa: A002 - the name of the option
    fps: float | None = None,
    groups: Iterable[tuple[str, str]] = (),
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks in the bytes of one file, and what was mended or left out.

    Parameters
    ----------
    data : bytes
        The file.
    path : str
        Its name, for messages.
    format : str
        One of `FORMATS`.
    fps : float, optional
        Frames per second, for formats that count frames.
    groups : iterable of (id, label), optional
        Who walks together, if that is in another file.

    Raises
    ------
    DataError
        For anything that cannot be read as tracks; the message names file and line.
    """
    if fps is not None:
        checked_fps(fps, where="--fps")
        if format in _WITH_CLOCK:
            raise DataError(
                f"{path}: format {format} has times in seconds (column t); leave --fps out"
            )
    clock = {} if format in _WITH_CLOCK else {"fps": fps}
    # The rows have no name here: they are let go as soon as they are sorted.
    return to_tracks(FORMATS[format](data=data, path=path, **clock), groups=groups)
