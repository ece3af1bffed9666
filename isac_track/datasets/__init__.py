"""Pedestrian tracks by name or from a file of one's own.

``load("students03")``, ``load("plaza")``, ``load("walk.csv")``, and ``load()`` for the best
that is here. `registry` knows the names and places, `formats` the readers, `repair` what is
mended on reading, `summary` the statistics; ``docs/data.md`` describes it all.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from isac_track.datasets.registry import (
    DEFAULT,
    FALLBACK,
    GROUPS_FILE,
    KNOWN,
    MAIN_FILE,
    Known,
    checked_bytes,
    complete,
    known,
    locate,
    read_bytes,
    searched,
    shown,
)
from isac_track.datasets.rows import Repair
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isac_track.types import Tracks

__all__ = ["Dataset", "Repair", "load"]


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """Tracks, where they come from, and what was done to them on reading."""

    name: str
    """Name in the registry, or of the file."""
    tracks: Tracks
    path: str
    """Where it was found; for bundled data relative to the package."""
    sha256: str
    """Hash of the main file."""
    format: str
    simulated: bool
    """True for the bundled crowd; of a file of one's own nothing is known: False."""
    repairs: tuple[Repair, ...]
    notice: str | None
    """Says that another data set than the preferred one was taken; to be shown."""
    citation: str
    """Whom to credit; empty if unknown."""
    licence: str
    """Empty if unknown."""


def load(
    name: str | Path | None = None,
    *,
    format: str | None = None,  # noqa: A002 - the name of the option
    fps: float | None = None,
    download: bool = True,
) -> Dataset:
    """Load a known data set, a file, or the best data set that is on this machine.

    Parameters
    ----------
    name : str or Path, optional
        A known name, or else the path of a file. Without it: students03 if it is here,
        otherwise the bundled crowd plaza, with a notice; never a download.
    format : str, optional
        Format of a file; ``.csv``, ``.parquet`` and ``.ndjson`` (trajnet) name theirs.
    fps : float, optional
        Frames per second, for a format that counts frames.
    download : bool
        Whether a known data set that was named may be downloaded if it is not here.

    Returns
    -------
    Dataset
        Times in s from the first sample of the recording, positions in m.

    Raises
    ------
    DataError
        If there is no such data set, it cannot be had, or it cannot be read; the message
        names file and line, or the way out.
    """
    chosen, notice = _chosen(name)
    if chosen is None:
        return _load_file(Path(str(name)), format=format, fps=fps)
    if format is not None or fps is not None:
        raise DataError(
            f"{'the default data set' if name is None else chosen.name} is known by name: "
            "leave --format and --fps out (they describe a file of your own)"
        )
    if chosen.session is not None:
        return _load_bundled(chosen, session=chosen.session, notice=notice)
    files = locate(chosen)
    if not complete(chosen, files):
        if name is None or not download:
            raise _missing(chosen, files=files)
        from isac_track.datasets.download import fetch  # noqa: PLC0415 - seldom needed

        files, _ = fetch(chosen)
    return _load_files(chosen, files=files)


def _chosen(name: str | Path | None) -> tuple[Known | None, str | None]:
    """Return the known data set or None for a path, and what to say if it is second best."""
    if name is None:
        if locate(KNOWN[DEFAULT]):
            return KNOWN[DEFAULT], None
        notice = (
            f"{DEFAULT} is not here ({searched()}): using the bundled simulated crowd {FALLBACK}. "
            f"To get it: python -m isac_track.datasets fetch {DEFAULT}"
        )
        return KNOWN[FALLBACK], notice
    if isinstance(name, Path):
        return None, None
    # A mistyped name is a better guess than a missing file if nothing in it looks like a path.
    is_path = os.sep in name or "." in name or os.path.exists(name)  # noqa: PTH110 - never raises
    return None if is_path and name not in KNOWN else known(name), None


def _missing(data_set: Known, *, files: Mapping[str, Path]) -> DataError:
    absent = [name for name in data_set.sha256 if name not in files]
    here = "".join(f"; {shown(path)} is" for path in files.values())
    return DataError(
        f"{data_set.name}: {' and '.join(absent)} not found{here} ({searched()}). "
        f"To get it: python -m isac_track.datasets fetch {data_set.name}"
    )


def _load_files(data_set: Known, *, files: Mapping[str, Path]) -> Dataset:
    path = files[MAIN_FILE]
    data = checked_bytes(path, data_set=data_set)
    groups: list[tuple[str, str]] = []
    if GROUPS_FILE in files:
        text = checked_bytes(files[GROUPS_FILE], data_set=data_set).decode()
        for members in (line.split() for line in text.splitlines()):
            groups += [(member, members[0]) for member in members]
    return _read(data_set, path=path, data=data, groups=groups)


def _load_file(path: Path, *, format: str | None, fps: float | None) -> Dataset:  # noqa: A002
    from isac_track.datasets import formats  # noqa: PLC0415 - a plain import stays quick

    # A missing file is told before a missing --format.
    data = read_bytes(path)
    format_name = formats.format_of(path, format=format)
    # Rows of another recording must never pass for those of a known one.
    name = path.name if path.stem in KNOWN else path.stem
    own = Known(name=shown(Path(name)), format=format_name, fps=fps)
    return _read(own, path=path, data=data)


def _read(
    source: Known, *, path: Path, data: bytes, groups: Sequence[tuple[str, str]] = ()
) -> Dataset:
    from isac_track.datasets import formats  # noqa: PLC0415 - a plain import stays quick

    tracks, repairs = formats.read(
        data=data, path=shown(path), format=source.format, fps=source.fps, groups=groups
    )
    return _dataset(source, path=shown(path), data=data, tracks=tracks, repairs=repairs)


def _load_bundled(data_set: Known, *, session: int, notice: str | None) -> Dataset:
    from isac_track.datasets import crowd  # noqa: PLC0415 - a plain import stays quick

    path = crowd.bundled_path(session)
    return _dataset(
        data_set,
        path=f"isac_track/datasets/{path.name}",
        data=read_bytes(path),
        tracks=crowd.bundled(session),
        notice=notice,
    )


def _dataset(
    source: Known,
    *,
    path: str,
    data: bytes,
    tracks: Tracks,
    repairs: tuple[Repair, ...] = (),
    notice: str | None = None,
) -> Dataset:
    return Dataset(
        name=source.name,
        tracks=tracks,
        path=path,
        sha256=hashlib.sha256(data).hexdigest(),
        format=source.format,
        simulated=source.simulated,
        repairs=repairs,
        notice=notice,
        citation=source.citation,
        licence=source.licence,
    )
