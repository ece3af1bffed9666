"""The files of a run folder: their names, and how they are opened and written.

Each function here keeps a promise:

- `open_regular` opens regular files alone: no link is followed, and no pipe waited for.
- `write_whole` writes a file whole or not at all, and replaces a link of its name.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
from functools import partial
from pathlib import Path
from typing import IO, Final

from isac_track.errors import DataError

CELLS_FOLDER: Final = "cells"
SUBFOLDERS: Final = (CELLS_FOLDER, "tables", "figures")
MANIFEST: Final = "manifest.json"
CHECKSUMS: Final = "SHA256SUMS"
SAMPLE_TRACKS: Final = "gallery.parquet"
PAGE: Final = "report.html"
LOCK: Final = ".lock"
# Names in cells, and the labels by which readers know them.
PEOPLE: Final = "people.json"
# Key of the pseudonyms, and where the recording lies; mode 0600.
PRIVATE: Final = "private.json"
# CSV files of a report, by field of `Results`.
FRAMES: Final = {
    "summary": "summary.csv",
    "paper_table": "paper_table.csv",
    "claims": "paper_claims.csv",
    "matched": "matched.csv",
    "frontier": "frontier.csv",
    "levels": "levels.csv",
    "attacked": "strongest.csv",
    "decisions": "decisions.csv",
    "curves": "curves.csv",
    "conflict_times": "conflict_times.csv",
    "linkability": "linkability.csv",
    "galleries": "gallery.csv",
    "speeds": "by_speed.csv",
    "failed": "failed.csv",
}
PLUGIN_ERROR: Final = "plugin-error.txt"  # Why a plug-in failed before there is a run.
# All files of a run beside its manifest, its cells, and its figures.
WRITTEN: Final = (
    *FRAMES.values(),
    "flags.json",
    "verdict.json",
    "tables.txt",
    PAGE,
    SAMPLE_TRACKS,
    CHECKSUMS,
    PEOPLE,
    PRIVATE,
    *(
        f"tables/{name}.tex"
        for name in ("sweep", "attacks", "paper", "linkability", "verdict")
    ),
)
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{16}\.tmp")
# A link is an error, and a pipe nothing to wait for; Windows has neither flag.
_NOT_FOLLOWED: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_READABLE_BY_ALL: Final = 0o666  # But for the rights that the user's umask takes away.


def write_whole(path: Path, content: bytes, *, mode: int = _READABLE_BY_ALL) -> None:
    """Write a file under a random temporary name beside it, and rename it.

    A link of the file's name is replaced, and nothing is written through it. The file
    has the rights of `mode` from its first byte on. Raises DataError if the disk is
    full or the folder cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        # x: a file or link of this name is an error.
        with open(temporary, "xb", opener=partial(os.open, mode=mode)) as file:
            file.write(content)
        os.replace(temporary, path)  # noqa: PTH105 - atomic on one file system
    except OSError as error:
        # Where nothing can be written, nothing can be removed.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise DataError(
            f"cannot write {path}: {error.strerror}; finished cells stay"
        ) from None


def is_temporary(name: str) -> bool:
    """Whether a file is temporary: `write_whole` had no time to rename it."""
    return _TEMPORARY.fullmatch(name) is not None


def open_regular(path: Path, mode: str = "rb", *, buffering: int = -1) -> IO[bytes]:
    """Open a regular file in a binary mode; OSError for a link and any other file."""
    return open(path, mode, buffering, opener=_open_descriptor)


def _open_descriptor(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | _NOT_FOLLOWED, _READABLE_BY_ALL)
    kind = os.fstat(descriptor).st_mode
    if stat.S_ISREG(kind) or stat.S_ISDIR(kind):  # `open` itself refuses a folder
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "it is not a regular file", str(path))


def read_regular_file(path: Path) -> bytes:
    """Return the content of a regular file; raises as `open_regular` does."""
    with open_regular(path) as file:
        return file.read()
