"""Where a process is while it computes, and what failed there."""

from __future__ import annotations

import json
import os
import threading
import time
from dataclasses import dataclass
from typing import Final

NOTE_BYTES: Final = 4096


@dataclass(frozen=True, slots=True)
class Failed:
    """A plug-in or a worker failed; what came before it in the work is finished."""

    at: tuple[str, ...]
    """As noted with `note`; empty if that is not known."""
    why: str
    died: bool = False
    """The worker did, and all of its work with it: another try may go well."""


class _Here(threading.local):
    """Where this process is, for the one that waits for it; in a Dask worker, this thread."""

    at: tuple[str, ...] = ()
    file: int | None = None


_here = _Here()


def note_to(file: int) -> None:
    """Write what is noted from now on to a file, too; the one that waits reads it there."""
    _here.file = file


def note(*at: str) -> None:
    """Note where this process is, before it goes there."""
    _here.at = at
    if _here.file is not None:
        content = json.dumps([os.getpid(), time.monotonic(), at]).encode()
        if len(content) > NOTE_BYTES:  # somewhere with an endless name
            content = json.dumps([os.getpid(), time.monotonic(), ("", "")]).encode()
        # One write of one length: whoever reads sees the old or the new.
        os.pwrite(_here.file, content.ljust(NOTE_BYTES), 0)


def noted() -> tuple[str, ...]:
    """Return what was noted last."""
    return _here.at
