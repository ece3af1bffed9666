"""Reader of Grand Central: an archive or a folder with a file for each pedestrian, in pixels.

``Annotation/NNNNNN.txt`` holds x, y (pixels) and frame, one number a line, again and
again; ``H.json`` the homography of [x, y, 1] to metres. An archive is read in memory
and never unpacked on disk: no name in it becomes a path, and limits end one that is not
what it says.
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
from isac_track.errors import DataError, told
from isac_track.types import Floats, Tracks

ARCHIVE = "gc.tgz"
FPS = 25.0
LONGEST_STEP_FRAMES = 20  # Between two annotations; a longer gap ends the track.
# Nobody crosses a hall as fast: steps of the annotation, to be counted.
FAST_PIECE_MPS = 4.0
_USED = re.compile(r"(?:.*/)?(Annotation/\d{1,9}\.txt|H\.json)")
MOST_MEMBERS = 30_000  # Files and folders of an archive; Grand Central's has 12,693.
MOST_BYTES = 64_000_000  # Of an archive unpacked; Grand Central's takes 22 million.
_MOST_FILE_BYTES = 1_000_000


def read_gc(path: Path, *, where: str) -> tuple[Rows, str]:
    """Return the rows of an archive or a folder, in m, and the digest of the files read.

    The digest is that of ``sha256sum Annotation/*.txt H.json | sha256sum``: over the
    hashes and names of the files in the order of the names. A DataError names what
    cannot be read.
    """
    found: dict[str, bytes] = {}
    archive = next((one for one in (path / ARCHIVE, path) if os.path.isfile(one)), None)  # noqa: PTH113 - never raises
    for name, data in (
        _in_folder(path, where) if archive is None else _archived(archive, where)
    ):
        key = _called(name)
        if key in found:
            raise DataError(f"{where}: two files are called {key}")
        found[key] = data
    hashes = (
        f"{hashlib.sha256(found[key]).hexdigest()}  {key}\n" for key in sorted(found)
    )
    digest = hashlib.sha256("".join(hashes).encode()).hexdigest()
    homography = _homography(found.pop("H.json", None), where)
    if not found:
        raise DataError(
            f"{where}: no file Annotation/NUMBER.txt, one for each pedestrian"
        )
    return _rows(found, homography, where), digest


def fast_pieces(tracks: Tracks, *, where: str) -> list[Repair]:
    """Return the note of how many tracks have a step above `FAST_PIECE_MPS`; they are kept."""
    within = recording.steps_within(tracks.offsets)
    distance_m = np.hypot(*np.diff(tracks.xy, axis=0)[within].T)
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets) - 1)
    fast = np.unique(owner[distance_m > FAST_PIECE_MPS * np.diff(tracks.t)[within]])
    names = recording.listed([tracks.source[row] for row in fast])
    text = f"{where}: tracks {names}: a step above {FAST_PIECE_MPS:g} m/s; kept"
    return [Repair("fast-piece", fast.size, text)] if fast.size else []


def _called(name: str) -> str:
    """Return the name in its folder of a file that is used; empty for any other."""
    found = _USED.fullmatch(name)
    return found[1] if found else ""


def _archived(path: Path, where: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the files of an archive that are used; all members are checked."""
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
                if _called(member.name) and (file := archive.extractfile(member)):
                    yield member.name, file.read()
    except (tarfile.TarError, zlib.error, EOFError, OSError, ValueError) as error:
        raise DataError(
            f"{where}: not an archive that can be read ({told(error)})"
        ) from None


def _fault(member: tarfile.TarInfo, count: int) -> str:
    """Return what is wrong with a member of an archive; empty if nothing is."""
    if count > MOST_MEMBERS:
        return f"over {MOST_MEMBERS} members: not Grand Central"
    name, path = recording.printable(member.name[:80]), PurePosixPath(member.name)
    if path.is_absolute() or ".." in path.parts:
        return f"member {name!r} leads out of the archive"
    if not (member.isreg() or member.isdir()):
        return f"member {name!r} is a link or a device, not a file"
    if (
        _called(member.name) and member.size > _MOST_FILE_BYTES
    ):  # sparse, it may be of any size
        return f"member {name!r} has {member.size} bytes: not Grand Central"
    return ""


def _in_folder(path: Path, where: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the files of a folder: H.json, and Annotation beside it."""
    roots = (path, path / "GC", path / "datasets" / "GC")
    root = next((one for one in roots if (one / "H.json").is_file()), path)
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
            if _called(name):
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


def _rows(found: Mapping[str, bytes], homography: Floats, where: str) -> Rows:
    """Return the rows of all pedestrians, by number, in m."""
    tables, numbers = [], []
    for key in sorted(found):
        try:
            values = np.array(found[key].split(), dtype=np.float64)
        except ValueError:
            raise DataError(f"{where}, {key}: not numbers alone, one a line") from None
        if values.size % 3:
            reason = f"{values.size} numbers, not x, y and frame again and again"
            raise DataError(f"{where}, {key}: {reason}")
        tables.append(values.reshape(-1, 3))
        numbers.append(int(key[len("Annotation/") : -len(".txt")]))
    table = np.concatenate(tables)
    person = np.repeat(numbers, [len(one) for one in tables])
    place = Place(where, lambda: person, unit="pedestrian")
    columns = {"frame": table[:, 2], "id": person.astype(np.float64)}
    rows = recording.framed(columns | {"x": table[:, 0], "y": table[:, 1]}, place)
    metric = np.column_stack([rows.xy, np.ones(len(table))]) @ homography.T
    if not (metric[:, 2] > 0).all():
        raise DataError(f"{where}: H.json puts positions beyond the horizon")
    xy = metric[:, :2] / metric[:, 2:]
    return replace(
        rows, xy=xy, t=rows.t / FPS, unit="m", split_s=LONGEST_STEP_FRAMES / FPS
    )
