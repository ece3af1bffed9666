"""The files of a run folder: their names, atomic writes, checksums, and the lock.

Each mechanism here keeps one promise that no library keeps:

- `open_regular` opens regular files alone: no link is followed, and no pipe waited for.
- `write_whole` writes a file whole or not at all, and replaces a link of its name.
- `SHA256SUMS`, in the format of `sha256sum`, says which files of cells are finished. A
  file that was cut short, garbled or put there by somebody else does not match, and is
  computed again.
- `locked` lets one run write at a time. The lock itself is `filelock`'s. It lasts until
  the `with` block or the process ends, however that ends.
- `to_csv` and `from_csv` keep a spreadsheet from taking a name for a formula.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import hashlib
import io
import json
import os
import re
import secrets
import shlex
import stat
from collections.abc import Iterable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any, Final

from isac_track.errors import DataError, SettingsError

if TYPE_CHECKING:  # workers write files, too, and need no pandas: 40 MB each
    import pandas as pd

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
# By the names of `Results`.
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
# Columns of text; all others are numbers or truth values.
_TEXTS: Final = {
    "dataset",
    "mechanism",
    "family",
    "adding",
    "consumer",
    "knowledge",
    "metric",
    "unit",
    "claim",
    "answer",
    "evidence",
    "criterion",
    "predictor",
    "robot",
    "score",
    "reference",
    "cohort",
    "outcome",
    "invalid",
    "spec",
    "kind",
    "why",
    "task",
    "adversary",
    "first_choice",
    "second_choice",
    "policy",
}
_FORMULA_STARTS: Final = ("=", "+", "-", "@", "\t", "\r")
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


def to_csv(frame: pd.DataFrame) -> bytes:
    """Return a table as CSV; a spreadsheet takes no text in it for a formula."""
    columns = []  # frame.to_csv would take ten times as long
    for name in frame.columns:
        column = frame[name].to_numpy(dtype=object, na_value="").tolist()
        is_number = frame[name].dtype.kind in "biuf"
        columns.append(column if is_number else map(_escape_formula, column))
    lines: list[str] = []
    # With this end of line, either half of it is quoted within a field.
    writer = csv.writer(SimpleNamespace(write=lines.append), lineterminator="\r\n")
    writer.writerow(frame.columns)
    writer.writerows(zip(*columns, strict=True))
    return "".join(f"{line[:-2]}\n" for line in lines).encode()


def from_csv(content: bytes) -> pd.DataFrame:
    """Return the table that `to_csv` wrote; ValueError if it is none."""
    import pandas as pd  # noqa: PLC0415 - 40 MB, as above

    texts = _TEXTS.intersection(content.partition(b"\n")[0].decode().split(","))
    kinds = dict.fromkeys(texts, str)
    # A name may be "NA".
    frame = pd.read_csv(
        io.BytesIO(content), dtype=kinds, keep_default_na=False, na_values=[""]
    )
    for name in texts:
        column = frame[name].fillna("")
        quoted = (
            text
            for text in column.unique()
            if text.startswith("'") and _escape_formula(text[1:]) == text
        )
        frame[name] = column.replace({text: text[1:] for text in quoted})
    return frame


def read_report_file(out: Path, name: str, *, columns: Iterable[str] = ()) -> Any:  # noqa: ANN401 - as said
    """Return a file of a report: some `columns` of a CSV, or JSON.

    Raises DataError, which says how to write the file anew.
    """
    advice = f"python -m evaluation.report {shlex.quote(str(out))} writes it anew"
    try:
        content = read_regular_file(out / name)
        if not name.endswith(".csv"):
            return json.loads(content)
        frame = from_csv(content)
        return frame[list(columns or frame.columns)]
    except FileNotFoundError:
        raise DataError(
            f"{out / name} is missing; {advice} if the run has finished"
        ) from None
    except (OSError, ValueError, KeyError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{out / name} cannot be read ({reason}); {advice}") from None


# The same few names recur in every row; for the life of the process.
@lru_cache(maxsize=4096, typed=True)
def _escape_formula(value: object) -> object:
    """Return a text so that no spreadsheet takes it for a formula; else the value."""
    if not isinstance(value, str) or not value.startswith(_FORMULA_STARTS):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value  # a number in a column of names


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


def write_checked(out: Path, name: str, content: bytes) -> None:
    """Write a file of cells, and its checksum; DataError if that is impossible."""
    # The line comes first: a kill in between leaves a line without a cell, not a cell
    # that looks damaged.
    path = out / CHECKSUMS
    line = f"{hashlib.sha256(content).hexdigest()}  {CELLS_FOLDER}/{name}\n"
    try:
        with open_regular(path, "ab+") as file:
            file.seek(max(file.tell() - 1, 0))
            # A line that was cut short, by a full disk say, must not spoil the next.
            start = "" if file.read(1) in (b"", b"\n") else "\n"
            file.write(f"{start}{line}".encode())
    except OSError as error:
        raise DataError(
            f"cannot write {path}: {error.strerror}; finished cells stay"
        ) from None
    write_whole(out / CELLS_FOLDER / name, content)


def checksummed_files(out: Path) -> set[str]:
    """Return the names of the files of cells that have a checksum, matching or not.

    Raises DataError if the checksums cannot be read, and OSError if the folder of the
    cells cannot.
    """
    return _present(out) & dict(_checksum_lines(out)).keys()


def checked_files(
    out: Path, names: Iterable[str]
) -> Iterator[tuple[str, bytes | None]]:
    """Yield the files that exist among `names`, with their content: None if changed."""
    known = dict(_checksum_lines(out))
    for name in dict.fromkeys(names):
        try:
            content = read_regular_file(out / CELLS_FOLDER / name)
        except FileNotFoundError:
            continue
        except OSError:
            content = b""
        is_sound = content and hashlib.sha256(content).hexdigest() == known.get(name)
        yield name, content if is_sound else None


def check_sound(out: Path, names: Iterable[str], *, sizes: Iterable[str] = ()) -> None:
    """Raise DataError if a file of cells has changed or is missing, or none is named.

    `sizes` are those of a finished run's manifest, by file name: each of these files
    must be there. A changed size needs no check, since the checksum differs, too.
    """
    wanted = list(names)
    if not wanted:
        raise DataError(f"{out} holds no finished cell; run the matrix again")
    for path in (out / CELLS_FOLDER / name for name in sizes):
        if not path.exists():
            raise DataError(f"{path} is missing; run the matrix again to compute it")
    damaged = [name for name, content in checked_files(out, wanted) if content is None]
    if damaged:
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        raise DataError(
            f"{out / CELLS_FOLDER / damaged[0]}{more}: not as the run wrote it (its checksum"
            " differs); run the matrix again to compute it anew"
        )


def forget_missing(out: Path) -> None:
    """Drop outdated checksums and those of missing cells: `sha256sum` reports these."""
    lines, present = _checksum_lines(out), _present(out)
    needed = {name: checksum for name, checksum in lines if name in present}
    if set(lines) != set(needed.items()):
        text = "".join(
            f"{checksum}  {CELLS_FOLDER}/{name}\n" for name, checksum in needed.items()
        )
        write_whole(out / CHECKSUMS, text.encode())


def _present(out: Path) -> set[str]:
    try:
        return {path.name for path in (out / CELLS_FOLDER).iterdir()}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _checksum_lines(out: Path) -> list[tuple[str, str]]:
    """Return name and checksum of every whole line; the last line of a file counts."""
    path = out / CHECKSUMS
    try:
        text = read_regular_file(path).decode(errors="replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        message = f"{path} cannot be read: {error.strerror}"
        raise DataError(f"{message}; make it readable or delete it") from None
    parts = (line.partition(f"  {CELLS_FOLDER}/") for line in text.splitlines())
    return [(name, checksum) for checksum, is_whole, name in parts if is_whole]


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the lock of a run folder: one run at a time writes. Make a missing folder.

    Half written files of killed runs are removed, and at the end the file of the lock.

    Raises SettingsError if another process holds it, the folder cannot be written, or a
    folder in it is a link to somewhere else.
    """
    with contextlib.ExitStack() as opened:
        _take_lock(out, opened)
        try:
            for folder in (out, *(out / name for name in SUBFOLDERS)):
                if folder != out and folder.is_symlink():
                    raise SettingsError(
                        f"{folder} is a link, and a run writes into folders of its own"
                        " alone; remove it or choose another --out"
                    )
                _remove_temporary(folder)
            yield
        finally:
            with contextlib.suppress(OSError):  # Windows removes no open file
                (out / LOCK).unlink()


def _take_lock(out: Path, opened: contextlib.ExitStack) -> None:
    """Lock the file of a folder's lock until `opened` closes; SettingsError if held."""
    from filelock import lock_descriptor  # noqa: PLC0415 - a reader needs none

    path, other = out / LOCK, "choose another --out"
    action, way_out = f"write to {out}", other
    try:
        out.mkdir(parents=True, exist_ok=True)
        while True:
            action, way_out = f"write {path}", f"make the folder writable or {other}"
            # Without a buffer: an error of a full disk must not come back at its end.
            file = opened.enter_context(open_regular(path, "ab+", buffering=0))
            action, way_out = f"lock {path}", "choose --out on a local disk"
            if not lock_descriptor(file.fileno(), blocking=False):
                raise SettingsError(
                    f"another run is writing to {out}{_owner(file)}; wait for it or"
                    f" {other}"
                )
            if os.fstat(file.fileno()).st_nlink:
                break
            # Its last owner has just removed it, so that it locks nothing.
    except OSError as error:  # to lock is impossible on some network file systems
        raise SettingsError(f"cannot {action}: {error.strerror}; {way_out}") from None
    with contextlib.suppress(OSError):  # a full disk: the lock holds without a name
        file.truncate(0)
        file.write(f"{os.getpid()}\n".encode())


def _owner(lock: IO[bytes]) -> str:
    """Return the process that holds an open lock as ` (process N)`, or nothing."""
    number = ""
    with contextlib.suppress(OSError):  # Windows shows nobody a locked file
        lock.seek(0)
        number = lock.read().decode(errors="replace").strip()
    return f" (process {number})" if number else ""


def _remove_temporary(folder: Path) -> None:
    """Remove what killed runs left; a missing folder is no error, and files may stay."""
    with contextlib.suppress(OSError):
        # A list: the folder changes while it is read.
        for path in list(folder.iterdir()):
            if is_temporary(path.name):
                path.unlink()
