"""The files of a run folder: their names; written whole or not at all, checked, and locked.

A file of cells counts as finished when its checksum is written down in `SHA256SUMS`,
which is in the format of `sha256sum`. What was cut short, garbled or put there by
somebody else does not match, and is computed again.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import os
import re
import secrets
import shlex
import stat
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from isac_track.errors import DataError, SettingsError

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows has no flock
    fcntl = None  # type: ignore[assignment]  # a module, where there is one

if TYPE_CHECKING:  # workers write files, too: they do without its 40 MB
    import pandas as pd

FOLDER: Final = "cells"
SUBFOLDERS: Final = (FOLDER, "tables", "figures")
MANIFEST: Final = "manifest.json"
CHECKSUMS: Final = "SHA256SUMS"
GALLERY: Final = "gallery.parquet"
PAGE: Final = "report.html"
LOCK: Final = ".lock"
# Names in cells, and the labels by which readers know them.
PEOPLE: Final = "people.json"
# Key of the pseudonyms, and where the recording lies; mode 0600.
PRIVATE: Final = "private.json"
FRAMES: Final = {  # By the names of `Results`.
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
# All that a run leaves beside its manifest, its cells, and its figures.
WRITTEN: Final = (
    *FRAMES.values(),
    "flags.json",
    "verdict.json",
    "tables.txt",
    PAGE,
    GALLERY,
    CHECKSUMS,
    PEOPLE,
    PRIVATE,
    *(
        f"tables/{name}.tex"
        for name in ("sweep", "attacks", "paper", "linkability", "verdict")
    ),
)
_TEXTS: Final = {  # Columns of text; all others are numbers or truth values.
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
}
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{16}\.tmp")
_NOT_FOLLOWED = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""A link is an error, and a pipe nothing to wait for."""


def write_whole(path: Path, content: bytes) -> None:
    """Write a file to a temporary name beside it, which nobody can foresee, and rename it.

    What has the file's name, a link say, is replaced and not written to. Raises
    DataError if the disk is full or the folder cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(content)
        os.replace(temporary, path)  # noqa: PTH105 - atomic on one file system
    except OSError as error:
        with contextlib.suppress(
            OSError
        ):  # where nothing can be written, nothing can be removed
            temporary.unlink(missing_ok=True)
        raise DataError(
            f"cannot write {path}: {error.strerror}; finished cells are kept"
        ) from None


def to_csv(frame: pd.DataFrame) -> bytes:
    """Return a table as CSV; no text in it is a formula to a spreadsheet, wherever it came from."""
    columns = []  # frame.to_csv would take ten times as long
    for name in frame.columns:
        column = frame[name].to_numpy(dtype=object, na_value="").tolist()
        is_number = frame[name].dtype.kind in "biuf"
        columns.append([str(one) if is_number else _field(one) for one in column])
    # Of one column alone a line without a field would be none.
    rows = (",".join(row) or '""' for row in zip(*columns, strict=True))
    return "\n".join([",".join(frame.columns), *rows, ""]).encode()


def from_csv(content: bytes) -> pd.DataFrame:
    """Return the table that `to_csv` wrote; ValueError if it is none."""
    import pandas as pd  # noqa: PLC0415 - as said above

    texts = _TEXTS.intersection(content.partition(b"\n")[0].decode().split(","))
    kinds = dict.fromkeys(texts, str)
    # A name may be "NA".
    frame = pd.read_csv(
        io.BytesIO(content), dtype=kinds, keep_default_na=False, na_values=[""]
    )
    for name in texts:
        column = frame[name].fillna("")
        quoted = (
            one
            for one in column.unique()
            if one.startswith("'") and _safe(one[1:]) == one
        )
        frame[name] = column.replace({one: one[1:] for one in quoted})
    return frame


def made_of(out: Path, name: str, *, columns: Iterable[str] = ()) -> Any:  # noqa: ANN401 - as said
    """Return a file of a report: of a CSV some `columns`, else JSON; DataError has the way out."""
    again = f"python -m evaluation.report {shlex.quote(str(out))} writes it anew"
    try:
        content = content_of(out / name)
        if not name.endswith(".csv"):
            return json.loads(content)
        frame = from_csv(content)
        return frame[list(columns or frame.columns)]
    except FileNotFoundError:
        raise DataError(
            f"{out / name} is missing; {again} if the run has finished"
        ) from None
    except (OSError, ValueError, KeyError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{out / name} cannot be read ({reason}); {again}") from None


def _safe(text: str) -> str:
    if not text.startswith(("=", "+", "-", "@", "\t", "\r")):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text  # a number, in a column of names


@lru_cache(maxsize=4096, typed=True)  # the same few names in every row
def _field(value: object) -> str:
    """Return what is not in a column of numbers as a field of a CSV file."""
    text = _safe(value) if isinstance(value, str) else str(value)
    needs_quotes = any(mark in text for mark in ',"\r\n')
    return '"{}"'.format(text.replace('"', '""')) if needs_quotes else text


def label_of(entry: Mapping[str, Any]) -> str:
    """Return the label of the consumer of an entry of a manifest."""
    from evaluation.plan.axes import (  # noqa: PLC0415 - a reader needs none
        consumer_label,
    )

    return consumer_label(entry["consumer"], entry["knowledge"], entry.get("world", ""))


def is_temporary(name: str) -> bool:
    """Return whether a file is one that `write_whole` had no time to rename."""
    return _TEMPORARY.fullmatch(name) is not None


def opened(path: Path, flags: int) -> int:
    """Open a regular file by the flags of `os.open`; OSError as there, or if it is none."""
    file = os.open(path, flags | _NOT_FOLLOWED, 0o644)
    mode = os.fstat(file).st_mode
    if stat.S_ISREG(mode):
        return file
    os.close(file)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "it is not a regular file", str(path))


def content_of(path: Path) -> bytes:
    """Return what is in a regular file of a run folder; raises OSError as `opened` does."""
    with os.fdopen(opened(path, os.O_RDONLY), "rb") as file:
        return file.read()


def write_checked(out: Path, name: str, content: bytes) -> None:
    """Write a file of cells, and its checksum; DataError if that cannot be."""
    # First the line: a kill in between leaves one without a cell, not a cell that looks
    # damaged.
    path = out / CHECKSUMS
    try:
        with os.fdopen(
            opened(path, os.O_RDWR | os.O_CREAT | os.O_APPEND), "ab+"
        ) as file:
            file.seek(max(file.tell() - 1, 0))
            # A line that was cut short, by a full disk say, must not spoil the next.
            start = "" if file.read(1) in (b"", b"\n") else "\n"
            file.write(
                f"{start}{hashlib.sha256(content).hexdigest()}  {FOLDER}/{name}\n".encode()
            )
    except OSError as error:
        raise DataError(
            f"cannot write {path}: {error.strerror}; finished cells are kept"
        ) from None
    write_whole(out / FOLDER / name, content)


def written_down(out: Path) -> set[str]:
    """Return the files of cells that are there and have a checksum written down, theirs or not.

    Raises DataError if the checksums cannot be read, and OSError if the folder of the
    cells cannot.
    """
    return _present(out) & dict(_lines(out)).keys()


def checked(out: Path, names: Iterable[str]) -> Iterator[tuple[str, bytes | None]]:
    """Yield those of some files that are there, with their content: None if it has changed."""
    known = dict(_lines(out))
    for name in dict.fromkeys(names):
        try:
            content = content_of(out / FOLDER / name)
        except FileNotFoundError:
            continue
        except OSError:
            content = b""
        is_sound = content and hashlib.sha256(content).hexdigest() == known.get(name)
        yield name, content if is_sound else None


def check_sound(out: Path, names: Iterable[str]) -> None:
    """Raise DataError if a cell is not as it was written, or there is none at all."""
    wanted = list(names)
    if not wanted:
        raise DataError(f"{out} holds no finished cell; run the matrix again")
    damaged = [name for name, content in checked(out, wanted) if content is None]
    if damaged:
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        raise DataError(
            f"{out / FOLDER / damaged[0]}{more}: not as the run wrote it (its checksum"
            " differs); run the matrix again to compute it anew"
        )


def forget_missing(out: Path) -> None:
    """Forget checksums of missing cells, and outdated ones: to `sha256sum` they are damage."""
    lines, there = _lines(out), _present(out)
    needed = {name: checksum for name, checksum in lines if name in there}
    if set(lines) != set(needed.items()):
        text = "".join(
            f"{checksum}  {FOLDER}/{name}\n" for name, checksum in needed.items()
        )
        write_whole(out / CHECKSUMS, text.encode())


def _present(out: Path) -> set[str]:
    try:
        return {path.name for path in (out / FOLDER).iterdir()}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _lines(out: Path) -> list[tuple[str, str]]:
    """Return file and checksum of every whole line; of one that is there twice the last counts."""
    path = out / CHECKSUMS
    try:
        text = content_of(path).decode(errors="replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        what = f"{path} cannot be read: {error.strerror}"
        raise DataError(f"{what}; make it readable or delete it") from None
    parts = (line.partition(f"  {FOLDER}/") for line in text.splitlines())
    return [(name, checksum) for checksum, is_whole, name in parts if is_whole]


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the lock of a run folder, which is made if it is missing: one run at a time writes.

    The lock is the system's (flock): it ends with its process, however that ends. What
    killed runs left half written is removed.

    Raises SettingsError if another process holds it, the folder cannot be written, or a
    folder in it is a link to somewhere else.
    """
    if fcntl is None:  # pragma: no cover - as above
        raise SettingsError("runs need a system with flock (Linux, macOS, WSL)")
    path = out / LOCK
    while (file := _locked(path)) is None:
        pass  # its last owner has just deleted it: that lock is nobody else's obstacle
    try:
        with contextlib.suppress(OSError):  # a full disk: the lock holds without a name
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        for folder in (out, *(out / name for name in SUBFOLDERS)):
            if folder != out and folder.is_symlink():
                raise SettingsError(
                    f"{folder} is a link, and a run writes into folders of its own"
                    " alone; remove it or choose another --out"
                )
            with contextlib.suppress(
                OSError
            ):  # not there, or what cannot be removed may stay
                for path in [
                    path for path in folder.iterdir() if is_temporary(path.name)
                ]:
                    path.unlink()
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(file)


def _locked(path: Path) -> int | None:
    """Return the open file, locked; None if it is no longer the one of that name."""
    way_out, what = "choose another --out", f"write to {path.parent}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        way_out, what = f"make the folder writable or {way_out}", f"write {path}"
        file = opened(path, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise SettingsError(f"cannot {what}: {error.strerror}; {way_out}") from None
    wrong = ""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with contextlib.suppress(FileNotFoundError):
            if os.fstat(file).st_ino == path.stat().st_ino:
                return file
    except BlockingIOError:
        owner = os.pread(file, 32, 0).decode(errors="replace").strip()
        who = f" (process {owner})" if owner else ""
        wrong = (
            f"another run is writing to {path.parent}{who}; wait for it or choose"
            " another --out"
        )
    except OSError as error:  # some network file systems
        wrong = f"cannot lock {path}: {error.strerror}; choose --out on a local disk"
    os.close(file)
    if wrong:
        raise SettingsError(wrong)
    return None
