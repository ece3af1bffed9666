"""Memory of a process and of its descendants."""

from __future__ import annotations

import psutil

from isac_track.errors import DataError


def check_memory_is_known() -> None:
    """Raise DataError if the system does not tell the proportional set size."""
    if not hasattr(psutil.Process().memory_full_info(), "pss"):
        raise DataError("the proportional set size of processes is told by Linux alone")


def tree_pss_mb(pid: int) -> float:
    """Return the memory of a process and all its descendants, shared pages once, MB."""
    return sum(_pss_mb(process) for process in (pid, *descendants(pid)))


def tree_rss_mb(pid: int) -> float:
    """Return the memory of a process and its descendants, shared pages each time, MB.

    Other programs do not change this number. They do change the proportional size of
    a page that they share.
    """
    return sum(rss_mb(process) for process in (pid, *descendants(pid)))


def rss_mb(pid: int) -> float:
    """Return the resident set of a single process, MB; 0 if it has ended."""
    try:
        return float(psutil.Process(pid).memory_info().rss) / 1e6
    except psutil.Error:
        return 0.0


def descendants(pid: int) -> list[int]:
    """Return the ids of all descendants of a process."""
    try:
        return [child.pid for child in psutil.Process(pid).children(recursive=True)]
    except psutil.Error:
        return []


def command_line(pid: int) -> str:
    """Return the command line of a process; a text if it has ended."""
    try:
        return " ".join(psutil.Process(pid).cmdline())
    except psutil.ZombieProcess:
        return f"process {pid}, not collected"
    except psutil.Error:
        return f"process {pid}, gone"


def _pss_mb(pid: int) -> float:
    try:
        return float(psutil.Process(pid).memory_full_info().pss) / 1e6
    except psutil.Error:
        return 0.0
