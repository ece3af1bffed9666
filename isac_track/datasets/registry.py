"""The data sets known by name, and where on this machine their files are."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from isac_track.datasets.recording import printable
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

DATA_VARIABLE = "ISAC_TRACK_DATA"
"""Folder of data sets that the user keeps: ``NAME/obsmat.txt``. Only read."""
CACHE_VARIABLE = "ISAC_TRACK_CACHE"
"""Folder for downloads, instead of the user's cache."""
DEFAULT = "students03"
FALLBACK = "plaza"
MAIN_FILE = "obsmat.txt"
GROUPS_FILE = "groups.txt"


@dataclass(frozen=True, slots=True)
class Known:
    """A data set that is known by name, or a file of one's own."""

    name: str
    about: str = ""
    citation: str = ""
    licence: str = ""
    session: int | None = None
    """Number of the bundled session, if this is the bundled crowd."""
    format: str = "npz"
    fps: float | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)
    """Hash of every file, by file name; empty if bundled or of one's own."""

    @property
    def simulated(self) -> bool:
        """True if nobody walked there."""
        return self.session is not None


_UCY = partial(
    Known,
    citation="A. Lerner, Y. Chrysanthou, D. Lischinski: Crowds by Example. "
    "Computer Graphics Forum 26(3), 655-664, 2007",
    licence="free to use with credit to the authors; in metres by OpenTraj",
    format="obsmat",
    fps=25.0,
)
_PLAZA = partial(
    Known,
    citation="isac-track: the simulated crowd plaza, made by isac_track.datasets.crowd",
    licence="MIT, as isac-track",
)
_KNOWN = (
    _UCY(
        "students03",
        "UCY students 3, Tel Aviv campus",
        sha256={
            MAIN_FILE: "d9fd7048eab7d3d9550d7ac4f59b19d97a87612310e8c8e48cf3aaf59764ff80",
            GROUPS_FILE: "93f1c1d59e089de38ca9d3a81d1592f8add87fac92130abdedcc3a8267177e02",
        },
    ),
    _UCY(
        "zara01",
        "UCY zara 1, shopping street",
        sha256={MAIN_FILE: "bd999ebcfbc506821fa5032a10b9101e150defcff85f1ef037d09ce7c6a8c2aa"},
    ),
    _PLAZA("plaza", "simulated crowd, bundled", session=1),
    _PLAZA("plaza-session2", "the same simulated people another time, bundled", session=2),
)
KNOWN: Mapping[str, Known] = {known.name: known for known in _KNOWN}


def known(name: str) -> Known:
    """Return the data set called `name`; DataError with the nearest name if there is none."""
    if name in KNOWN:
        return KNOWN[name]
    hint = did_you_mean(name.lower(), KNOWN)
    raise DataError(
        f"{name!r} is neither a known data set nor a file{hint} (known: {', '.join(KNOWN)})"
    )


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return the end of a message that offers the nearest of `names`; empty if none is near."""
    near = get_close_matches(name, list(names), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _folder(variable: str) -> Path | None:
    """Return the folder that an environment variable names, if it is set."""
    value = os.environ.get(variable, "").strip()
    return Path(os.path.expanduser(value)) if value else None  # noqa: PTH111 - never raises


def cache_folder() -> Path:
    """Return the folder of downloads: ``ISAC_TRACK_CACHE`` or the user's cache."""
    if folder := _folder(CACHE_VARIABLE):
        return folder
    import pooch  # noqa: PLC0415 - a plain import stays quick

    return Path(pooch.os_cache("isac-track"))


def locate(data_set: Known) -> dict[str, Path]:
    """Return the path of each file of `data_set` that is here, by file name.

    The data folder comes before the cache. Hashes are checked when the files are read.
    """
    folders = [folder for folder in (cache_folder(), _folder(DATA_VARIABLE)) if folder]
    return {
        file_name: folder / data_set.name / file_name
        for folder in folders
        for file_name in data_set.sha256
        if os.path.isfile(folder / data_set.name / file_name)  # noqa: PTH113 - never raises
    }


def missing(data_set: Known, files: Mapping[str, Path]) -> list[str]:
    """Return the names of the files of `data_set` that are not among `files`."""
    return [file_name for file_name in data_set.sha256 if file_name not in files]


def searched() -> str:
    """Return in words where a data set was looked for."""
    folder = _folder(DATA_VARIABLE)
    first = f"{DATA_VARIABLE} is not set"
    if folder is not None:
        lacks = "" if os.path.isdir(folder) else ", which is no folder"  # noqa: PTH112 - never raises
        first = f"{DATA_VARIABLE} is {shown(folder)}{lacks}"
    return f"{first}; cache is {shown(cache_folder())}"


def shown(path: Path | str) -> str:
    """Return a path as one line that can be printed whatever bytes its name has."""
    return printable(str(path).encode("utf-8", "replace").decode())


def read_bytes(path: Path, *, data_set: Known | None = None) -> bytes:
    """Return what a file holds, of a known data set if one is given.

    DataError if it cannot be had, or is not the file that the registry means.
    """
    try:
        if not path.is_file():
            reason = "this is a folder, not a file" if path.is_dir() else "no such file"
            raise DataError(f"{shown(path)}: {reason}")
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{shown(path)}: cannot be read ({error.strerror})") from None
    except MemoryError:
        raise DataError(f"{shown(path)}: the file is too large for the memory") from None
    if data_set is None:
        return data
    actual, expected = hashlib.sha256(data).hexdigest(), data_set.sha256[path.name]
    if actual != expected:
        raise DataError(
            f"{shown(path)} is not the {path.name} of {data_set.name}: sha256 is {actual}, "
            f"expected {expected}. Remove it and run `python -m isac_track.datasets fetch "
            f"{data_set.name}`, or use it as a recording of your own: give its path, --format "
            f"{data_set.format} and --fps"
        )
    return data
