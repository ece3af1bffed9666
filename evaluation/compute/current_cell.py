"""The cell that this process computes, and the record of a failed cell.

Workers import this module at once; modules that compute come with the work.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Failure:
    """A plug-in or a worker failed; earlier cells of the same work are finished."""

    # Names of the cell, as in `note_cell`; empty if unknown.
    cell: tuple[str, ...]
    message: str
    # The worker process died, perhaps by another's fault: a second try may succeed.
    worker_died: bool = False
    # The parent process ended the worker because the cell took too long.
    timed_out: bool = False


class _CurrentCell(threading.local):
    """The cell under way in this process; in a Dask worker, in this thread."""

    names: tuple[str, ...] = ()
    # Called with the names of every new cell.
    report: Callable[[tuple[str, ...]], None] | None = None


current_cell = _CurrentCell()


def note_cell(*names: str) -> None:
    """Note the cell that this process is about to compute, and report it."""
    current_cell.names = names
    if current_cell.report is not None:
        current_cell.report(names)
