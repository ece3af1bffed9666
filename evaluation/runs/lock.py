"""One run at a time writes into a folder."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING, Final

from isac_track.errors import SettingsError

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows has no flock
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LOCK: Final = ".lock"


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the lock of a run folder, which is made if it is missing.

    The lock is the system's (flock): it ends with its process, however that ends.

    Raises
    ------
    SettingsError
        If another process holds it, or the folder cannot be written.
    """
    if fcntl is None:  # pragma: no cover - as above
        raise SettingsError("runs need a system with flock (Linux, macOS, WSL)")
    path = out / LOCK
    file = _locked(path)
    try:
        with contextlib.suppress(OSError):  # a full disk: the lock holds without a name
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(file)


def _locked(path: Path) -> int:
    """Return the open file, locked."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SettingsError(
                f"cannot write to {path.parent}: {error.strerror}; choose another --out"
            ) from None
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise SettingsError(
                f"cannot write {path}: {error.strerror}; "
                "make the folder writable or choose another --out"
            ) from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.fstat(file).st_ino == path.stat().st_ino:
                return file
        except BlockingIOError:
            owner = os.pread(file, 32, 0).decode(errors="replace").strip()
            who = f" (process {owner})" if owner else ""
            os.close(file)
            raise SettingsError(
                f"another run is writing to {path.parent}{who}; wait for it or choose another --out"
            ) from None
        except FileNotFoundError:
            pass
        except OSError as error:  # some network file systems
            os.close(file)
            raise SettingsError(
                f"cannot lock {path}: {error.strerror}; choose --out on a local disk"
            ) from None
        # Its last owner has just deleted it: that lock is nobody else's obstacle.
        os.close(file)
