"""The lock of a run folder: one run at a time writes.

The lock itself is `filelock`'s. It lasts until the `with` block or the process ends,
however that ends.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from evaluation.store.files import LOCK, SUBFOLDERS, is_temporary, open_regular
from isac_track.errors import SettingsError


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
