"""The formats by name. A format is told, or named by the file's extension, never guessed."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Protocol

from isac_track.datasets.read_ndjson import read_trajnet
from isac_track.datasets.read_table import read_csv, read_parquet
from isac_track.datasets.read_text import read_obsmat, read_pedpy, read_social_gan
from isac_track.datasets.registry import shown
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
    "obsmat": read_obsmat,
    "social-gan": read_social_gan,
    "pedpy": read_pedpy,
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
    if format is None:
        implied = _EXTENSIONS.get(path.suffix.lower())
        if implied is None:
            raise DataError(
                f"{shown(path)}: the format is not known from the name; give --format "
                f"({', '.join(FORMATS)})"
            )
        return implied
    if format not in FORMATS:
        near = get_close_matches(format, FORMATS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise DataError(f"unknown format {format!r}{hint} (known: {', '.join(FORMATS)})")
    return format


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
