"""Reader of Grand Central: an archive or a folder with a file for each pedestrian.

``Annotation/NNNNNN.txt`` holds x, y (pixels) and frame, one number a line, repeated.
``H.json`` holds the homography of [x, y, 1] to metres. An archive is read in memory and
never unpacked on disk: no name in it becomes a path. Limits reject an archive that is
not Grand Central's.
"""

import gzip
import hashlib
import io
import json
import os
import re
import tarfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from isac_track.datasets import recording
from isac_track.datasets.recording import Place, Repair, Rows
from isac_track.datasets.registry import shown
from isac_track.errors import DataError, error_text
from isac_track.types import Floats, Tracks, lengths

ARCHIVE = "gc.tgz"
FPS = 25.0
LONGEST_STEP_FRAMES = 20  # Between two annotations; a longer gap ends the track.
# Nobody crosses a hall as fast: such steps are of the annotation, and are counted.
FAST_STEP_MPS = 4.0
_USED = re.compile(r"(?:.*/)?(Annotation/\d{1,9}\.txt|H\.json)")
MOST_MEMBERS = 30_000  # Files and folders of an archive; Grand Central's has 12,693.
MOST_BYTES = 64_000_000  # Of an unpacked archive; Grand Central's takes 22 million.
_MOST_FILE_BYTES = 1_000_000


def read_gc(path: Path, *, where: str) -> tuple[Rows, str]:
    """Return the rows of an archive or a folder, in m, and the digest of its files.

    The digest is that of ``sha256sum Annotation/*.txt H.json | sha256sum``: over the
    hashes and names of the files in the order of the names. DataError names a file that
    cannot be read.
    """
    contents: dict[str, bytes] = {}
    candidates = (path / ARCHIVE, path)
    archive = next((file for file in candidates if os.path.isfile(file)), None)  # noqa: PTH113 - never raises
    read = _read_folder if archive is None else _read_archive
    for name, data in read(archive or path, where):
        key = _name_in_folder(name)
        if key in contents:
            raise DataError(f"{where}: two files are called {key}")
        contents[key] = data
    hashes = (
        f"{hashlib.sha256(contents[key]).hexdigest()}  {key}\n"
        for key in sorted(contents)
    )
    digest = hashlib.sha256("".join(hashes).encode()).hexdigest()
    homography = _homography(contents.pop("H.json", None), where)
    if not contents:
        raise DataError(
            f"{where}: no file Annotation/NUMBER.txt, one for each pedestrian"
        )
    return _build_rows(contents, homography, where), digest


def note_fast_tracks(tracks: Tracks, *, where: str) -> list[Repair]:
    """Return a note of the tracks with a step above `FAST_STEP_MPS`; they stay."""
    within = recording.steps_within(tracks.offsets)
    distance_m = lengths(np.diff(tracks.xy, axis=0)[within])
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets) - 1)
    fast = np.unique(owner[distance_m > FAST_STEP_MPS * np.diff(tracks.t)[within]])
    names = recording.listed([tracks.source[row] for row in fast])
    text = f"{where}: tracks {names}: a step above {FAST_STEP_MPS:g} m/s; not cut"
    return [Repair("fast-track", fast.size, text)] if fast.size else []


def _name_in_folder(name: str) -> str:
    """Return a file's name in its folder, if the file is used; else an empty text."""
    match = _USED.fullmatch(name)
    return match[1] if match else ""


def _read_archive(path: Path, where: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the used files of an archive; check all members."""
    try:
        with gzip.open(path) as stream:
            data = stream.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise DataError(
                f"{where}: unpacks to over {MOST_BYTES} bytes: not Grand Central"
            )
        with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
            for count, member in enumerate(archive, start=1):
                if fault := _fault(member, count):
                    raise DataError(f"{where}: {fault}")
                if _name_in_folder(member.name) and (
                    file := archive.extractfile(member)
                ):
                    yield member.name, file.read()
    except (tarfile.TarError, zlib.error, EOFError, OSError, ValueError) as error:
        raise DataError(
            f"{where}: not an archive that can be read ({error_text(error)})"
        ) from None


def _fault(member: tarfile.TarInfo, count: int) -> str:
    """Return the fault of a member of an archive; empty without fault."""
    if count > MOST_MEMBERS:
        return f"over {MOST_MEMBERS} members: not Grand Central"
    name, path = recording.printable(member.name[:80]), PurePosixPath(member.name)
    if path.is_absolute() or ".." in path.parts:
        return f"member {name!r} leads out of the archive"
    if not (member.isreg() or member.isdir()):
        return f"member {name!r} is a link or a device, not a file"
    # A sparse file may have any size.
    if _name_in_folder(member.name) and member.size > _MOST_FILE_BYTES:
        return f"member {name!r} has {member.size} bytes: not Grand Central"
    return ""


def _read_folder(path: Path, where: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of H.json and the files of Annotation in a folder."""
    roots = (path, path / "GC", path / "datasets" / "GC")
    root = next((folder for folder in roots if (folder / "H.json").is_file()), path)
    try:
        for file in (root / "H.json", *(root / "Annotation").glob("*.txt")):
            name = str(file.relative_to(root))
            if (
                not file.is_file()
                or file.is_symlink()
                or file.stat().st_size > _MOST_FILE_BYTES
            ):
                raise DataError(
                    f"{where}: {shown(name)} is no file here of a pedestrian's size"
                )
            if _name_in_folder(name):
                yield name, file.read_bytes()
    except OSError as error:
        raise DataError(f"{where}: cannot be read ({error.strerror})") from None


def _homography(data: bytes | None, where: str) -> Floats:
    """Return the matrix of H.json, (3, 3)."""
    if data is None:
        raise DataError(f"{where}: no H.json, the homography to metres")
    try:
        matrix = np.array(json.loads(data)["homog"], dtype=np.float64)
    except (ValueError, TypeError, KeyError, RecursionError):
        matrix = np.zeros(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise DataError(f'{where}: H.json holds no 3 x 3 numbers under "homog"')
    return matrix


def _build_rows(contents: Mapping[str, bytes], homography: Floats, where: str) -> Rows:
    """Return the rows of all pedestrians, by number, in m."""
    tables, numbers = [], []
    for key in sorted(contents):
        try:
            values = np.array(contents[key].split(), dtype=np.float64)
        except ValueError:
            raise DataError(f"{where}, {key}: not numbers alone, one a line") from None
        if values.size % 3:
            reason = f"{values.size} numbers, not x, y and frame again and again"
            raise DataError(f"{where}, {key}: {reason}")
        tables.append(values.reshape(-1, 3))
        numbers.append(int(key[len("Annotation/") : -len(".txt")]))
    table = np.concatenate(tables)
    person = np.repeat(numbers, [len(pedestrian) for pedestrian in tables])
    place = Place(where, lambda: person, unit="pedestrian")
    columns = {"frame": table[:, 2], "id": person.astype(np.float64)}
    rows = recording.build_rows(columns | {"x": table[:, 0], "y": table[:, 1]}, place)
    metric = np.column_stack([rows.xy, np.ones(len(table))]) @ homography.T
    if not (metric[:, 2] > 0).all():
        raise DataError(f"{where}: H.json puts positions beyond the horizon")
    xy = metric[:, :2] / metric[:, 2:]
    return replace(
        rows, xy=xy, t=rows.t / FPS, unit="m", split_s=LONGEST_STEP_FRAMES / FPS
    )
