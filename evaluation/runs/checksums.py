"""The checksums of a run's cells, in the format of `sha256sum`.

A file of cells counts as finished when its checksum is written down. What was cut short, garbled or
put there by somebody else does not match, and is computed again.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

from evaluation.runs.files import write_whole
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

FOLDER: Final = "cells"
CHECKSUMS: Final = "SHA256SUMS"


def write_checked(out: Path, name: str, content: bytes) -> None:
    """Write a file of cells, and its checksum.

    Raises
    ------
    DataError
        If the disk is full or the folder cannot be written.
    """
    # First: a kill in between leaves a line without a cell, not a cell that looks damaged.
    _write_down(out, name, hashlib.sha256(content).hexdigest())
    write_whole(out / FOLDER / name, content)


def written_down(out: Path) -> set[str]:
    """Return the files that are there and whose checksums are written down.

    Whether these are theirs takes longer: see `checked`.

    Raises
    ------
    DataError
        If the checksums cannot be read.
    OSError
        If the folder of the cells cannot be read.
    """
    return _present(out) & dict(_lines(out)).keys()


def checked(out: Path, names: Iterable[str]) -> Iterator[tuple[str, bytes | None]]:
    """Yield the files that are there with their content; None if it is not as it was written.

    Parameters
    ----------
    out : Path
        Folder of the run.
    names : iterable of str
        Files to look at; those that are not there are left out.
    """
    known = dict(_lines(out))
    for name in dict.fromkeys(names):
        try:
            content = (out / FOLDER / name).read_bytes()
        except FileNotFoundError:
            continue
        except OSError:
            yield name, None
            continue
        is_sound = hashlib.sha256(content).hexdigest() == known.get(name)
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
            f"{out / FOLDER / damaged[0]}{more}: not as the run wrote it (its checksum differs); "
            "run the matrix again to compute it anew"
        )


def forget_missing(out: Path) -> None:
    """Write the checksums anew, if one is of a cell that is not there or was written twice.

    `sha256sum --check` would take it for damage. Lines of cells that are there stay.

    Raises
    ------
    DataError
        If they cannot be read or written.
    OSError
        If the folder of the cells cannot be read.
    """
    lines, there = _lines(out), _present(out)
    needed = {name: checksum for name, checksum in lines if name in there}
    if set(lines) != set(needed.items()):
        text = "".join(f"{checksum}  {FOLDER}/{name}\n" for name, checksum in needed.items())
        write_whole(out / CHECKSUMS, text.encode())


def _write_down(out: Path, name: str, checksum: str) -> None:
    path = out / CHECKSUMS
    try:
        with path.open("ab+") as file:
            end = file.tell()
            file.seek(max(end - 1, 0))
            # A line that was cut short, by a full disk say, must not spoil the next.
            start = "" if file.read(1) in (b"", b"\n") else "\n"
            file.write(f"{start}{checksum}  {FOLDER}/{name}\n".encode())
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; finished cells are kept") from None


def _present(out: Path) -> set[str]:
    try:
        return {path.name for path in (out / FOLDER).iterdir()}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _lines(out: Path) -> list[tuple[str, str]]:
    """Return file and checksum of every whole line; of one that is there twice the last counts."""
    path = out / CHECKSUMS
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise DataError(
            f"{path} cannot be read: {error.strerror}; make it readable or delete it"
        ) from None
    pairs = (line.split(f"  {FOLDER}/", 1) for line in text.splitlines())
    return [(pair[1], pair[0]) for pair in pairs if len(pair) > 1]
