"""Where a process is in its work, for the one that waits for it, and what became of it.

Workers import this at once; what they compute with comes with their work.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Failed:
    """A plug-in or a worker failed; what came before it in the work is finished."""

    at: tuple[str, ...]  # As noted with `note`; empty if that is not known.
    why: str
    # The worker did, and what it was at with it: another try may go well.
    died: bool = False
    is_late: bool = False  # It was ended for the time that it took.


class _Here(threading.local):
    """Where this process is, for the one that waits for it; in a Dask worker, this thread."""

    at: tuple[str, ...] = ()  # As noted last.
    tell: Callable[[tuple[str, ...]], None] | None = None  # Gets what is noted, too.


here = _Here()


def note(*at: str) -> None:
    """Note where this process is, before it goes there."""
    here.at = at
    if here.tell is not None:
        here.tell(at)
