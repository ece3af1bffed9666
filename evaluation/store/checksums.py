"""Checksums of the files of cells: `SHA256SUMS`, in the format of `sha256sum`.

They say which files are finished. A file that was cut short, garbled or put there by
somebody else does not match, and is computed again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from evaluation.store.files import (
    CELLS_FOLDER,
    CHECKSUMS,
    open_regular,
    read_regular_file,
    write_whole,
)
from isac_track.errors import DataError


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
    return _cell_file_names(out) & dict(_checksum_lines(out)).keys()


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


def drop_stale_checksums(out: Path) -> None:
    """Drop outdated checksums and those of missing cells: `sha256sum` reports these."""
    lines, present = _checksum_lines(out), _cell_file_names(out)
    needed = {name: checksum for name, checksum in lines if name in present}
    if set(lines) != set(needed.items()):
        text = "".join(
            f"{checksum}  {CELLS_FOLDER}/{name}\n" for name, checksum in needed.items()
        )
        write_whole(out / CHECKSUMS, text.encode())


def _cell_file_names(out: Path) -> set[str]:
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
    return [(name, checksum) for checksum, separator, name in parts if separator]
