"""The formats by name. A format is told, or named by the file's extension, never guessed."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Protocol

from isac_track.datasets.read_frames import OBSMAT, PEDPY, SOCIAL_GAN, read_columns, read_trajnet
from isac_track.datasets.read_table import read_csv, read_parquet
from isac_track.datasets.registry import did_you_mean, shown
from isac_track.datasets.repair import to_tracks
from isac_track.datasets.rows import checked_fps
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from isac_track.datasets.rows import Repair, Rows
    from isac_track.types import Tracks


class Reader(Protocol):
    """Turns the bytes of a file into rows; lets no error but `DataError` out."""

    def __call__(self, *, data: bytes, path: str, fps: float | None) -> Rows: ...  # noqa: D102


FORMATS: Mapping[str, Reader] = {
    **{layout.name: partial(read_columns, layout=layout) for layout in (OBSMAT, SOCIAL_GAN, PEDPY)},
    "trajnet": read_trajnet,
    "csv": read_csv,
    "parquet": read_parquet,
}
_EXTENSIONS = {".csv": "csv", ".parquet": "parquet", ".ndjson": "trajnet"}


def format_of(path: Path, *, format: str | None) -> str:  # noqa: A002 - the name of the option
    """Return the name of the format: `format`, or what the extension of `path` names.

    Raises
    ------
    DataError
        If the format is unknown, or neither given nor named by the extension.
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
    # The rows have no name here: they are let go as soon as they are sorted.
    return to_tracks(FORMATS[format](data=data, path=path, fps=fps), groups=groups)
